"""Bodies: groups of landmarks that may move as one, such as two tags on the same box.

Their labels, in place or moved, are then equal, and a body that moved keeps its shape: its
landmarks agree with each other, but this is no evidence that they are in place.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Sequence
from typing import NamedTuple

import numpy as np
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.special import betaln

from homeward.localizer.tunables import BODY_M, CLOSE, GIVEN_WRONG, ONE_BODY, UPHEAVAL


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

    def independent(self, items: np.ndarray) -> int:
        """Return the number of independent ones among items (k,), bool: a body counts once."""
        inside = (self.members & items).sum(axis=1) if self.members.size else np.zeros(0, int)
        return int(np.count_nonzero(items) - np.maximum(inside - 1, 0).sum())

    def log_labels(
        self, right: np.ndarray, wrong: np.ndarray | float, more: np.ndarray
    ) -> np.ndarray:
        """Return the log prior of labels, and the gain in density of bodies that moved, (f,).

        As a rule each item has its own probability to be moved; after an upheaval, or at another
        place, any share of them may be. `right` (f, k) are the labels: the items in place; `wrong`
        (k,), or one for all, is the prior probability of each to be moved; `more` (b,) is the log
        density of a body that moved, less that of its members moved independently.
        """
        number, wrong = right.sum(axis=1), np.broadcast_to(wrong, right.shape[1:])
        rule = np.where(right, np.log1p(-wrong), np.log(wrong)).sum(axis=1)
        rule = rule + self._log_factor(right, wrong, more)
        upheaval = betaln(1.0 + number, 1.0 + right.shape[1] - number)
        upheaval = upheaval + self._log_factor(right, np.full(wrong.size, 0.5), more)
        log = np.logaddexp(math.log1p(-UPHEAVAL) + rule, math.log(UPHEAVAL) + upheaval)
        return np.asarray(log)

    def _log_factor(self, right: np.ndarray, wrong: np.ndarray, more: np.ndarray) -> np.ndarray:
        """Return the log ratio of a prior to that of independent items, (f,)."""
        size, inside = self.members.sum(axis=1), right @ self.members.T.astype(int)
        share = self.members @ wrong / size
        stayed = np.log1p(-share) - self.members @ np.log1p(-wrong)
        moved = np.log(share) - self.members @ np.log(wrong) + more
        as_one = np.where(inside == size, stayed, np.where(inside == 0, moved, -np.inf))
        independent = np.log1p(-self.one_body)
        return np.asarray(np.logaddexp(independent, np.log(self.one_body) + as_one).sum(axis=1))


def given_bodies(together: Iterable[Sequence[str]], site: Collection[str]) -> list[Sequence[str]]:
    """Return the given groups without any that is all of a site: it is then the reference."""
    return [group for group in together if not {*site} <= {*group}]


def find_bodies(
    names: Sequence[str], places: np.ndarray, together: Sequence[Sequence[str]], size: float
) -> Bodies:
    """Return the bodies among landmarks: those given, and others near each other.

    Of k landmarks by name, with `places` (k, 2) [m]; one landmark alone is on no body of the groups
    `together`. `size` is that of the site [m].
    """
    if len(names) < 2:
        return Bodies.none(len(names))
    group = fcluster(linkage(places, "complete"), min(BODY_M, CLOSE * size), "distance")
    given = np.zeros(len(names), int)
    for number, landmarks in enumerate(together, 1):
        of = np.isin(names, landmarks)
        given[of | (np.isin(given, given[of]) & (given > 0))] = number
    group = np.where(given > 0, -given, group)
    numbers, count = np.unique(group, return_counts=True)
    numbers = numbers[count > 1]
    one_body = np.where(numbers < 0, 1.0 - GIVEN_WRONG, ONE_BODY)
    return Bodies(group == numbers[:, None], one_body)
