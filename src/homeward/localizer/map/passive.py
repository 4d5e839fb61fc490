"""Passive landmarks: those of the map without sightings in the window.

They are not unknowns of the window. Given its oldest pose, the calibration and the landmarks that
are in it (the active ones), together r, they are

    p = mean + by_active (r - at) + common e + own,    e ~ N(0, I),

where `own` is independent of one landmark to the other. This is exact: an unknown that leaves the
prior of the window leaves its conditional here, as in the compressed filter of Guivant and Nebot
(2001), and returns when it is needed. Only where there are many, `common` is limited to its largest
directions, and the rest of each landmark's variance is kept as its own: no variance changes, but
small correlations are lost. So cost and memory are linear in the number of passive landmarks.
"""

from __future__ import annotations

import numpy as np

from homeward.localizer.motions import HEAD
from homeward.localizer.reference.window import Conditional
from homeward.localizer.tunables import COMMON_DIRECTIONS, COMMON_SPARE
from homeward.table import GrowingTable


class PassiveLandmarks:
    """Passive landmarks of a smoother, given the unknowns r of its prior."""

    def __init__(self) -> None:
        self.ids = np.zeros(0, int)
        """(n,): in no order."""
        self.p_static = np.zeros(0)
        """(n,): probability of each to be static [1]."""
        self._mean = np.zeros(0)
        """(2 n,): positions at the linearisation point [m]."""
        self._by_active = np.zeros((0, HEAD))
        """(2 n, 13 + 2 a)"""
        self._errors = GrowingTable((0,))
        """(k, 2 n): `common`, transposed."""
        self._own = np.zeros((0, 2, 2))
        """(n, 2, 2): covariance of their independent errors [m^2]."""

    def __len__(self) -> int:
        return self.ids.size

    @property
    def _common(self) -> np.ndarray:
        """Jacobian of their positions by the common errors, (2 n, k)."""
        return self._errors.rows.T

    @_common.setter
    def _common(self, common: np.ndarray) -> None:
        self._errors = GrowingTable.of(np.ascontiguousarray(common.T))

    def index(self, ids: np.ndarray) -> np.ndarray:
        """Return the indices of passive landmarks with these ids, shape (k,)."""
        order = self.ids.argsort()
        return np.asarray(order[self.ids.searchsorted(ids, sorter=order)])

    def positions(self, index: np.ndarray, step: np.ndarray) -> np.ndarray:
        """Return positions of some (k, 2) [m], after a step of r (13 + 2 a,)."""
        rows = columns(index).ravel()
        return np.asarray(self._mean[rows] + self._by_active[rows] @ step).reshape(-1, 2)

    def by_active(self, index: np.ndarray) -> np.ndarray:
        """Return the Jacobian of the positions of some by r, (2 k, 13 + 2 a)."""
        return np.asarray(self._by_active[columns(index).ravel()])

    def covariances(self, index: np.ndarray) -> np.ndarray:
        """Return the covariance of each of some, given r, (k, 2, 2) [m^2]."""
        common = self._common[columns(index)]
        return np.asarray(self._own[index] + common @ common.transpose(0, 2, 1))

    def errors(self, index: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the Jacobian of some by common errors (2 k, c), and their own covariances."""
        return self._common[columns(index).ravel()], self._own[index]

    def covariance(self, index: np.ndarray) -> np.ndarray:
        """Return the joint covariance of some, given r, (2 k, 2 k) [m^2]."""
        common, each = self._common[columns(index).ravel()], columns(np.arange(index.size))
        found = common @ common.T
        found[each[:, :, None], each[:, None]] += self._own[index]
        return np.asarray(found)

    def move(self, step: np.ndarray) -> None:
        """Move the linearisation point by a step (13 + 2 a,)."""
        if not len(self):
            return
        self._mean = self._mean + self._by_active @ step

    def insert_unknowns(self, at: int, count: int) -> None:
        """Insert unknowns into r before index `at`, on which nothing depends yet."""
        if not len(self):
            return
        nothing = np.zeros((len(self._mean), count))
        self._by_active = np.hstack([self._by_active[:, :at], nothing, self._by_active[:, at:]])

    def replace(self, place: slice, found: Conditional) -> None:
        """Replace unknowns of r by others in their place, given their conditional on the new r."""
        if len(self):
            by_old = self._by_active[:, place].copy()
            self._by_active[:, place] = 0.0
            self._by_active += by_old @ found.by_rest
            self._mean = self._mean + by_old @ found.mean
            self._errors.extend(_root(found.covariance).T @ by_old.T)
            self._compress()

    def eliminate(self, out: np.ndarray, found: Conditional) -> None:
        """Replace unknowns of r, by their indices (k,), by their conditional on the others."""
        if len(self):
            self._absorb(out, found)
            self._compress()

    def _absorb(self, out: np.ndarray, found: Conditional) -> None:
        """Do the same; the errors of the unknowns are the last columns of `common`."""
        by_out, rest = self._by_active[:, out], np.delete(self._by_active, out, axis=1)
        self._mean = self._mean + by_out @ found.mean
        self._by_active = rest + by_out @ found.by_rest
        self._errors.extend(_root(found.covariance).T @ by_out.T)

    def add(
        self,
        ids: np.ndarray,
        p_static: np.ndarray,
        at: np.ndarray,
        out: np.ndarray,
        found: Conditional,
    ) -> None:
        """Add k landmarks that are unknowns of r, by their indices `out` (2 k,).

        `at` (2 k,) are their positions at the linearisation point [m], `found` is their conditional
        on the others, and `p_static` (k,) the probability of each to be static.
        """
        if not len(self):
            self._by_active = np.zeros((0, found.by_rest.shape[1] + out.size))
            self._common = np.zeros((0, 0))
        self._absorb(out, found)
        errors = np.zeros((found.mean.size, self._common.shape[1]))
        errors[:, -found.mean.size :] = _root(found.covariance)
        self.ids, self.p_static = np.append(self.ids, ids), np.append(self.p_static, p_static)
        self._mean = np.append(self._mean, at + found.mean)
        self._by_active = np.vstack([self._by_active, found.by_rest])
        self._common = np.vstack([self._common, errors])
        self._own = np.concatenate([self._own, np.zeros((ids.size, 2, 2))])
        self._compress()

    def take(self, index: np.ndarray) -> tuple[np.ndarray, Conditional]:
        """Take landmarks out, (k,), which become the last unknowns of r.

        Return their positions (2 k,) [m], the new linearisation point, and their conditional.
        """
        rows = columns(index).ravel()
        errors, covariance = self._common[rows], self.covariance(index)
        at, nothing = self._mean[rows], np.zeros(rows.size)
        found = Conditional(nothing, self._by_active[rows], covariance)
        self.drop(index)
        by_landmarks = np.linalg.solve(covariance, errors @ self._common.T).T
        rest = self._by_active - by_landmarks @ found.by_rest
        self._by_active = np.hstack([rest, by_landmarks])
        # Given the landmarks, the covariance of e is I - errors' C^-1 errors from now on.
        whitened = np.linalg.solve(np.linalg.cholesky(covariance), errors)
        _, shares, directions = np.linalg.svd(whitened, full_matrices=False)
        left = np.sqrt(np.maximum(1.0 - shares**2, 0.0))
        self._common = self._common - (self._common @ directions.T * (1.0 - left)) @ directions
        return at, found

    def reorder(self, order: np.ndarray) -> None:
        """Bring the unknowns of r into another order (13 + 2 a,)."""
        if len(self):
            self._by_active = self._by_active[:, order]

    def drop(self, index: np.ndarray) -> None:
        """Drop landmarks (k,)."""
        rows = columns(index).ravel()
        self.ids, self.p_static = np.delete(self.ids, index), np.delete(self.p_static, index)
        self._mean, self._by_active = (
            np.delete(self._mean, rows),
            np.delete(self._by_active, rows, 0),
        )
        self._common, self._own = np.delete(self._common, rows, 0), np.delete(self._own, index, 0)

    def _compress(self) -> None:
        """Limit `common` to its largest directions, once there are more than can be spared."""
        if self._common.shape[1] <= COMMON_DIRECTIONS + COMMON_SPARE:
            return
        _, vectors = np.linalg.eigh(self._common.T @ self._common)
        directions = self._common @ vectors
        small = directions[:, :-COMMON_DIRECTIONS].reshape(
            -1, 2, vectors.shape[1] - COMMON_DIRECTIONS
        )
        self._own = self._own + small @ small.transpose(0, 2, 1)
        self._common = directions[:, -COMMON_DIRECTIONS:]


def columns(index: np.ndarray) -> np.ndarray:
    """Return the indices of the coordinates of landmarks (k,), (k, 2)."""
    return np.asarray(2 * index[:, None] + np.arange(2))


def _root(covariance: np.ndarray) -> np.ndarray:
    """Return a root of a covariance, which rounding may have left not quite positive."""
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))
