"""Marginalisation prior of the window."""

from __future__ import annotations

import numpy as np

from homeward.localizer.motions import HEAD
from homeward.localizer.reference.window import Elimination


class Prior:
    """Marginalisation prior on oldest pose, calibration and landmarks, around zero.

    A Gaussian in information form (12 + 2 n, 12 + 2 n), with a fixed linearisation point.
    """

    def __init__(self, information: np.ndarray) -> None:
        self.information = information
        self.gradient = np.zeros(len(information))
        """Negative gradient at ..."""
        self.at = np.zeros(len(information))
        """... the linearisation point."""

    def add_landmark(self, position: np.ndarray, sigma: float) -> None:
        """Add a landmark with a weak prior, around (2,) with standard deviation `sigma`."""
        size = len(self.gradient)
        grown = np.zeros((size + 2, size + 2))
        grown[:size, :size] = self.information
        grown[size, size] = grown[size + 1, size + 1] = sigma**-2.0
        self.information = grown
        self.gradient = np.append(self.gradient, [0.0, 0.0])
        self.at = np.append(self.at, position)

    def drop_landmark(self, index: int, now: np.ndarray) -> None:
        """Marginalise a landmark, linearised at `now`, shape (12 + 2 n,)."""
        out = HEAD + 2 * index + np.arange(2)
        keep = np.delete(np.arange(now.size), out)
        information = self.information
        gain = np.linalg.solve(information[np.ix_(out, out)], information[np.ix_(out, keep)]).T
        gradient = self.gradient - information @ (now - self.at)
        self.information = information[np.ix_(keep, keep)] - gain @ information[np.ix_(out, keep)]
        self.gradient = gradient[keep] - gain @ gradient[out]
        self.at = now[keep]

    def replace(self, eliminated: Elimination, at: np.ndarray, drift: np.ndarray) -> None:
        """Replace it by an elimination, linearised at `at`.

        The calibration drifts meanwhile by variances (9,): the old one is marginalised, and the new
        one takes its place.
        """
        c = slice(3, HEAD)
        inverse = np.diag(1.0 / (drift + 1e-16))
        information, gradient = eliminated.information, eliminated.gradient
        gain = np.linalg.inv(information[c, c] + inverse)
        by_new = information[:, c] @ gain
        new = information - by_new @ information[c, :]
        new_gradient = gradient - by_new @ gradient[c]
        cross = by_new @ inverse
        new[:, c], new[c, :] = cross, cross.T
        new[c, c] = inverse - inverse @ gain @ inverse
        new_gradient[c] = inverse @ gain @ gradient[c]
        self.information, self.gradient, self.at = 0.5 * (new + new.T), new_gradient, at
