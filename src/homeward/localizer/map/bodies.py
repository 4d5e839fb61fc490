"""Bodies: groups of landmarks that may move as one, such as two tags on the same box.

Their labels, in place or moved, are then equal, and a body that moved keeps its shape: its
landmarks agree with each other, but this is no evidence that they are in place.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from homeward.localizer import kernels
from homeward.localizer.tunables import BODY_M, CLOSE, GIVEN_WRONG, ONE_BODY


@dataclass(frozen=True)
class Bodies:
    """Bodies among k items."""

    members: np.ndarray
    """(b, k), bool: members of each, at least two; no item is in two bodies."""
    one_body: np.ndarray
    """(b,): prior probability that they move as one."""

    @staticmethod
    def none(items: int) -> Bodies:
        """Return no bodies among k items."""
        return Bodies(np.zeros((0, items), bool), np.zeros(0))

    def among(self, items: np.ndarray) -> Bodies:
        """Return the bodies among some of the items, by their indices."""
        members = self.members[:, items]
        several = members.sum(axis=1) > 1
        return Bodies(members[several], self.one_body[several])

    def independent(self, items: np.ndarray) -> int:
        """Return the number of independent ones among items (k,), bool: a body counts once."""
        inside = (self.members & items).sum(axis=1) if self.members.size else np.zeros(0, int)
        return int(np.count_nonzero(items) - np.maximum(inside - 1, 0).sum())

    def log_labels(
        self, right: np.ndarray, wrong: np.ndarray | float, more: np.ndarray
    ) -> np.ndarray:
        """Return the log prior of labels, and the gain in density of bodies that moved, (f,).

        `right` (f, k) are the labels: the items in place; `wrong` (k,), or one for all, is the
        prior probability of each to be moved; `more` (b,) is the log density of a body that moved,
        less that of its members moved independently.
        """
        return kernels.log_labels(self.members, self.one_body, right, wrong, more)


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
    group = _clusters(places, min(BODY_M, CLOSE * size))
    given = np.zeros(len(names), int)
    for number, landmarks in enumerate(together, 1):
        of = np.isin(names, landmarks)
        given[of | (np.isin(given, given[of]) & (given > 0))] = number
    group = np.where(given > 0, -given, group)
    numbers, count = np.unique(group, return_counts=True)
    numbers = numbers[count > 1]
    one_body = np.where(numbers < 0, 1.0 - GIVEN_WRONG, ONE_BODY)
    return Bodies(group == numbers[:, None], one_body)


def _clusters(places: np.ndarray, reach: float) -> np.ndarray:
    """Return the cluster (k,) of each place (k, 2), by complete linkage up to `reach` [m]."""
    cluster = np.arange(len(places))
    apart = np.hypot(*(places[:, None] - places).transpose(2, 0, 1))
    apart[apart > reach] = np.inf
    apart[cluster, cluster] = np.inf
    while True:
        i, j = divmod(int(apart.argmin()), len(places))
        if apart[i, j] == np.inf:
            return cluster
        apart[i] = apart[:, i] = np.maximum(apart[i], apart[j])
        apart[j] = apart[:, j] = np.inf
        cluster[cluster == j] = i
