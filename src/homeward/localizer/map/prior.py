"""Marginalisation prior of the window, and the marginalised keyframes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from homeward.localizer.map.sightings import Frames
from homeward.localizer.motions import HEAD
from homeward.localizer.reference.window import Conditional, Elimination


class Prior:
    """Marginalisation prior on oldest pose, calibration and landmarks, around zero.

    A Gaussian in information form (13 + 2 n, 13 + 2 n), with a fixed linearisation point.
    """

    def __init__(self, information: np.ndarray) -> None:
        self.information = information
        self.gradient = np.zeros(len(information))
        """Negative gradient at ..."""
        self.at = np.zeros(len(information))
        """... the linearisation point."""

    def add_landmark(self, position: np.ndarray, sigma: float) -> None:
        """Add a landmark with a weak prior, around (2,) with standard deviation `sigma`."""
        nothing = np.zeros((2, len(self.at)))
        self.append(position, Conditional(np.zeros(2), nothing, sigma**2 * np.eye(2)))

    def append(self, at: np.ndarray, found: Conditional) -> None:
        """Append k unknowns with this conditional, linearised at its mean, `at` (k,)."""
        inverse = np.linalg.inv(found.covariance)
        cross = inverse @ found.by_rest
        old = self.information + found.by_rest.T @ cross
        self.information = np.block([[old, -cross.T], [-cross, 0.5 * (inverse + inverse.T)]])
        self.gradient = np.append(self.gradient, np.zeros(len(inverse)))
        self.at = np.append(self.at, at)

    def move_to(self, now: np.ndarray) -> None:
        """Move the linearisation point to `now` (13 + 2 n,)."""
        self.gradient = self.gradient - self.information @ (now - self.at)
        self.at = now

    def reorder(self, order: np.ndarray) -> None:
        """Bring the unknowns into another order (13 + 2 n,)."""
        self.information = self.information[np.ix_(order, order)]
        self.gradient, self.at = self.gradient[order], self.at[order]

    def take_out(self, out: np.ndarray) -> Conditional:
        """Marginalise unknowns (k,), and return their conditional."""
        keep, gradient = np.delete(np.arange(self.at.size), out), self.gradient
        covariance = np.linalg.inv(self.information[np.ix_(out, out)])
        covariance = 0.5 * (covariance + covariance.T)
        cross = self.information[np.ix_(out, keep)]
        gain = covariance @ cross
        self.information = self.information[np.ix_(keep, keep)] - cross.T @ gain
        self.gradient = gradient[keep] - gain.T @ gradient[out]
        self.at = self.at[keep]
        return Conditional(covariance @ gradient[out], -gain, covariance)

    def replace(self, eliminated: Elimination, at: np.ndarray, drift: np.ndarray) -> Conditional:
        """Replace it by an elimination, linearised at `at`.

        The calibration drifts meanwhile by variances (10,): the old one is marginalised, and the
        new one takes its place. Return the conditional of the old one.
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
        by_rest = -by_new.T
        by_rest[:, c] = gain @ inverse
        return Conditional(gain @ gradient[c], by_rest, 0.5 * (gain + gain.T))


class Closed(NamedTuple):
    """Keyframes that were marginalised, and their measurements."""

    poses: np.ndarray
    stamps: list[float]
    sightings: np.ndarray
    frames: Frames
    steps: np.ndarray

    @staticmethod
    def joined(parts: Sequence[Closed]) -> Closed:
        """Return consecutive parts as one."""
        poses, stamps, sightings, frames, steps = zip(*parts, strict=True)
        return Closed(
            np.concatenate(poses),
            [t for part in stamps for t in part],
            np.concatenate(sightings),
            Frames.joined(frames),
            np.concatenate(steps),
        )
