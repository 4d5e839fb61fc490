"""Prior of the smoother: what marginalised keyframes say of oldest pose, calibration and map."""

from __future__ import annotations

import numpy as np

from homeward.localizer.map.elimination import Elimination, NormalEquations
from homeward.localizer.map.state import HEAD


class Prior:
    """A Gaussian in information form, linear around a point.

    Parameters
    ----------
    information : ndarray, shape (11 + 2 n, 11 + 2 n)
        On oldest pose, calibration and landmarks, around zero.
    """

    def __init__(self, information: np.ndarray) -> None:
        self._information = information
        self._gradient = np.zeros(len(information))
        self._at = np.zeros(len(information))

    def add_to(self, e: NormalEquations, now: np.ndarray) -> None:
        """Add it to the normal equations around `now`, shape (11 + 2 n,)."""
        information = self._information
        downhill = self._gradient - information @ (now - self._at)
        e.own[0] += information[:3, :3]
        e.shared[0] += information[:3, 3:]
        e.common[:] += information[3:, 3:]
        e.slope[0] += downhill[:3]
        e.common_slope[:] += downhill[3:]

    def add_landmark(self, position: np.ndarray, sigma: float) -> None:
        """Add a landmark of which nothing is known but that it is around (2,) within `sigma`."""
        size = len(self._gradient)
        grown = np.zeros((size + 2, size + 2))
        grown[:size, :size] = self._information
        grown[size, size] = grown[size + 1, size + 1] = sigma**-2.0
        self._information = grown
        self._gradient = np.append(self._gradient, [0.0, 0.0])
        self._at = np.append(self._at, position)

    def drop_landmark(self, index: int, now: np.ndarray) -> None:
        """Marginalise a landmark, linearised at `now`, shape (11 + 2 n,)."""
        out = HEAD + 2 * index + np.arange(2)
        keep = np.delete(np.arange(now.size), out)
        information = self._information
        gain = np.linalg.solve(information[np.ix_(out, out)], information[np.ix_(out, keep)]).T
        gradient = self._gradient - information @ (now - self._at)
        self._information = information[np.ix_(keep, keep)] - gain @ information[np.ix_(out, keep)]
        self._gradient = gradient[keep] - gain @ gradient[out]
        self._at = now[keep]

    def replace(self, left: Elimination, at: np.ndarray, drift: np.ndarray) -> None:
        """Take what is left of keyframes that were eliminated, linearised at `at`.

        The calibration drifts by variances (8,) meanwhile: the old one is marginalised, the new one
        takes its place.
        """
        c = slice(3, HEAD)
        inverse = np.diag(1.0 / (drift + 1e-16))
        information, gradient = left.information, left.gradient
        gain = np.linalg.inv(information[c, c] + inverse)
        by_new = information[:, c] @ gain
        new = information - by_new @ information[c, :]
        new_gradient = gradient - by_new @ gradient[c]
        cross = by_new @ inverse
        new[:, c], new[c, :] = cross, cross.T
        new[c, c] = inverse - inverse @ gain @ inverse
        new_gradient[c] = inverse @ gain @ gradient[c]
        self._information, self._gradient, self._at = 0.5 * (new + new.T), new_gradient, at
