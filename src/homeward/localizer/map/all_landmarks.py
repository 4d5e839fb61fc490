"""All landmarks of a map together: the active ones of a window, and the passive ones."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from homeward.localizer.map.passive import PassiveLandmarks
from homeward.localizer.map.state import Marginal
from homeward.localizer.motions import HEAD
from homeward.localizer.reference.window import Linearised, eliminate, positive_inverse


class LinearState(NamedTuple):
    """Newest pose, calibration and n landmarks, by r unknowns with errors that many have in common.

    The state has the size N = 13 + 2 n.
    """

    mean: np.ndarray
    """(N,)"""
    by_window: np.ndarray
    """(N, r): Jacobian by unknowns of the window, ..."""
    of_window: np.ndarray
    """(r, r): ... and their covariance."""
    errors: np.ndarray
    """(N, c): Jacobian by common errors, independent and of variance 1."""
    own: np.ndarray
    """(n, 2, 2): covariance of the independent errors of each landmark [m^2]."""

    def covariance(self) -> np.ndarray:
        """Return the joint covariance, (N, N)."""
        found = np.hstack([self.by_window @ self.of_window, self.errors])
        found = found @ np.hstack([self.by_window, self.errors]).T
        each = Marginal.columns(np.arange(len(self.own)))
        found[each[:, :, None], each[:, None]] += self.own
        return np.asarray(found)


@dataclass(frozen=True)
class AllLandmarks:
    """Active and passive landmarks, each by its id, by a solution of the window."""

    active: np.ndarray
    """(n,): ids of the active ones, ascending, ..."""
    p_static: np.ndarray
    """(n,): ... their probability to be static ..."""
    state: Marginal
    """... and the state with them."""
    passive: PassiveLandmarks
    """The others, and ..."""
    step: np.ndarray
    """(13 + 2 n,): ... the step from their linearisation point to the solution."""
    linearised: Callable[[], Linearised]
    """Returns the window at the solution."""

    @property
    def ids(self) -> np.ndarray:
        """(m,): ids of all of them, ascending."""
        return np.sort(np.append(self.active, self.passive.ids))

    def positions(self, ids: np.ndarray) -> np.ndarray:
        """Return their positions, (k, 2) [m]."""
        passive, found = self._is_passive(ids), np.empty((ids.size, 2))
        found[~passive] = self.state.positions[self.active.searchsorted(ids[~passive])]
        if passive.any():
            found[passive] = self.passive.positions(self.passive.index(ids[passive]), self.step)
        return found

    def static_probabilities(self, ids: np.ndarray) -> np.ndarray:
        """Return the probability of each to be static, (k,) [1]."""
        passive, found = self._is_passive(ids), np.empty(ids.size)
        found[~passive] = self.p_static[self.active.searchsorted(ids[~passive])]
        found[passive] = self.passive.p_static[self.passive.index(ids[passive])]
        return found

    def places(self, ids: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return their positions, (k, 2) [m], and covariances, (k, 2, 2) [m^2]."""
        passive, covariances = self._is_passive(ids), np.empty((ids.size, 2, 2))
        index = self.active.searchsorted(ids[~passive])
        covariances[~passive] = self.state.places(index)[1]
        if passive.any():
            index = self.passive.index(ids[passive])
            by_window, of_window = self._by_window(index)
            by_each = by_window.reshape(index.size, 2, -1)
            found = by_each @ of_window @ by_each.transpose(0, 2, 1)
            covariances[passive] = found + self.passive.covariances(index)
        return self.positions(ids), covariances

    def joint(self, ids: np.ndarray) -> Marginal:
        """Return the state with these landmarks, in this order, and no others."""
        if not self._is_passive(ids).any():
            columns = Marginal.columns(self.active.searchsorted(ids)).ravel()
            return self.state.reordered(np.append(np.arange(HEAD), columns))
        found = self.linear(ids)
        return Marginal(found.mean, found.covariance())

    def linear(self, ids: np.ndarray) -> LinearState:
        """Return the same by unknowns of the window, of which the size is linear in landmarks."""
        passive = self._is_passive(ids)
        mean = np.concatenate([self.state.mean[:HEAD], self.positions(ids).ravel()])
        columns = Marginal.columns(self.active.searchsorted(ids[~passive]))
        is_active = np.append(np.full(HEAD, True), np.repeat(~passive, 2))
        by_passive, of_window = np.zeros((0, self.state.mean.size)), self.state.covariance
        index = self.passive.index(ids[passive])
        if passive.any():
            by_passive, of_window = self._by_window(index)
        errors, own = self.passive.errors(index)
        found = LinearState(
            mean,
            np.zeros((mean.size, len(of_window))),
            of_window,
            np.zeros((mean.size, errors.shape[1])),
            np.zeros((ids.size, 2, 2)),
        )
        found.by_window[is_active, np.append(np.arange(HEAD), columns)] = 1.0
        found.by_window[~is_active], found.errors[~is_active] = by_passive, errors
        found.own[passive] = own
        return found

    def _is_passive(self, ids: np.ndarray) -> np.ndarray:
        """Return which landmarks are passive, (k,) bool."""
        return np.isin(ids, self.passive.ids)

    def _by_window(self, index: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the Jacobian of passive landmarks by unknowns of the window, and their covariance.

        The unknowns are the newest pose, the calibration, the active landmarks, and the error of
        the oldest pose given those.
        """
        eliminated = eliminate(self.linearised().equations)
        oldest, size = eliminated.oldest(), len(eliminated.gradient)
        covariance = np.zeros((size + 3, size + 3))
        covariance[:size, :size] = positive_inverse(eliminated.information)
        covariance[size:, size:] = oldest.covariance
        by_tail = np.eye(size, size + 3)
        by_tail[:3] = np.hstack([oldest.by_rest, np.eye(3)])
        return self.passive.by_active(index) @ by_tail, covariance
