"""Bodies: groups of landmarks that may move as one, such as two tags on the same box.

Their labels, in place or moved, are then equal, and a body that moved keeps its shape: its
landmarks agree with each other, but this is no evidence that they are in place.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.cluster.hierarchy import fcluster, linkage

from homeward.localizer.tunables import BODY_M, CLOSE, ONE_BODY


class Bodies(NamedTuple):
    """Bodies among k items."""

    members: np.ndarray
    """(b, k), bool: members of each, at least two; no item is in two bodies."""
    one_body: np.ndarray
    """(b,): prior probability that they move as one."""

    @staticmethod
    def none(items: int) -> Bodies:
        """Return no bodies among k items."""
        return Bodies(np.zeros((0, items), bool), np.zeros(0))

    def log_prior(
        self, right: np.ndarray, wrong: np.ndarray | float, more: np.ndarray | float = 0.0
    ) -> np.ndarray:
        """Return the log ratio of the prior of labels to that of independent items, (f,).

        Parameters
        ----------
        right : ndarray, shape (f, k), bool
            Labels: the items in place.
        wrong : ndarray, shape (k,), or float
            Prior probability of each to be moved.
        more : ndarray, shape (b,), or float
            Log density of a body that moved, less that of its members moved independently.
        """
        number, wrong = self.members.sum(axis=1), np.broadcast_to(wrong, self.members.shape[1:])
        share = self.members @ wrong / number
        stayed = np.log1p(-share) - self.members @ np.log1p(-wrong)
        moved = np.log(share) - self.members @ np.log(wrong) + more
        inside = right @ self.members.T.astype(int)
        as_one = np.where(inside == number, stayed, np.where(inside == 0, moved, -np.inf))
        independent = np.log1p(-self.one_body)
        return np.asarray(np.logaddexp(independent, np.log(self.one_body) + as_one).sum(axis=1))


def find_bodies(places: np.ndarray, size: float) -> Bodies:
    """Return the groups of landmarks at `places` (k, 2) [m] that are near each other.

    `size` is that of the site [m].
    """
    if len(places) < 2:
        return Bodies.none(len(places))
    group = fcluster(linkage(places, "complete"), min(BODY_M, CLOSE * size), "distance")
    members = group == np.unique(group)[:, None]
    members = members[members.sum(axis=1) > 1]
    return Bodies(members, np.full(len(members), ONE_BODY))
