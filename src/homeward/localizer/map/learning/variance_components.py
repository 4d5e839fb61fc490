"""Variance component estimation of odometry noise (Helmert 1907, Foerstner 1979).

Residuals of motions are smaller than the errors, since poses follow them: the expected sum of their
squares, over the assumed variance, is not the number of motions but their redundancy. That is a
trace, estimated with random signs (Hutchinson 1990).

Part of the redundancy is due to bearing errors, to which the poses give way. Where bearings are
better than assumed (as where their noise is not given) that part is smaller, and odometry would
seem better than it is. So the variance of bearings is a component, too, and weights that part.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.special import chdtri

from homeward.localizer.motions import NC
from homeward.localizer.reference.factors import OdometryErrors, cauchy_weights
from homeward.localizer.reference.window import Elimination
from homeward.localizer.tunables import GATE, MAX_INFLATION

CHI_SQUARES = chdtri(3, (np.arange(64) + 0.5) / 64)
"""Quantiles of the squared Mahalanobis distance of a motion."""
PARTS = (slice(0, 2), slice(2, 3))
"""Components of a motion: shift along and across, and turn."""


class BearingErrors(NamedTuple):
    """Residuals of m bearings in a solved map."""

    error: np.ndarray
    """(m,): normalised by the standard deviation of a single bearing [1]."""
    jacobian: np.ndarray
    """(m, 14): Jacobian of `bearing_residuals`, normalised by effective standard deviations."""
    pose: np.ndarray
    """(m,), int: the pose from which each was made."""
    landmark: np.ndarray
    """(m,), int: its landmark."""
    own: np.ndarray
    """(m,): share of their own noise in their variance; the rest is from odometry [1]."""

    def change(self, poses: np.ndarray, shared: np.ndarray) -> np.ndarray:
        """Return the change (m,) [1] by a step of poses (w, 3) and shared unknowns."""
        by_pose, by_common, by_place = np.split(self.jacobian, [3, 3 + NC], axis=1)
        places = shared[NC:].reshape(-1, 2)[self.landmark]
        turned = (by_pose * poses[self.pose]).sum(axis=1) + (by_place * places).sum(axis=1)
        return np.asarray(turned + by_common @ shared[:NC])

    def variance(self, eliminated: Elimination, rng: np.random.Generator) -> float:
        """Return their variance over the assumed one, 1 at most: larger ones are handled elsewhere.

        Parameters are those of `misfit`.
        """
        clear = self.own >= MAX_INFLATION**-2.0
        if not clear.any():
            return 1.0
        signs = rng.choice([-1.0, 1.0], clear.shape) * clear
        pulled = self.jacobian * signs[:, None]
        slope, common = eliminated.zero_gradient()
        np.add.at(slope, self.pose, pulled[:, :3])
        common[:NC] = pulled[:, 3 : 3 + NC].sum(axis=0)
        np.add.at(common[NC:].reshape(-1, 2), self.landmark, pulled[:, 3 + NC :])
        free = (signs - self.change(*eliminated.step(slope, common)))[clear]
        redundancy, own = float(signs[clear] @ free), float(free @ free)
        squares = float(np.minimum(self.error[clear] ** 2, GATE**2).sum())
        return min(max((squares - (redundancy - own)) / own, 0.0), 1.0)


class Misfit(NamedTuple):
    """Residuals of motions in a solved map, for shift and turn, each (2, 2).

    In the first row with robust weights; in the second unweighted, but bounded by the gate.
    """

    squares: np.ndarray
    """Sums of squared residuals over the assumed variances."""
    redundancies: np.ndarray
    """Their expectations."""


def misfit(
    eliminated: Elimination, steps: OdometryErrors, seen: BearingErrors, rng: np.random.Generator
) -> Misfit:
    """Compare the residuals of motions with their expectation.

    `eliminated` is the elimination of all normal equations at the solution, `steps` the motions
    between all its poses, and `rng` the source of the signs.
    """
    covariance = np.linalg.inv(steps.information)
    squares, redundancies = np.zeros((2, len(PARTS))), np.zeros((2, len(PARTS)))
    weight, overestimated = steps.weight[:, None, None], 1.0 - seen.variance(eliminated, rng)
    for i, part in enumerate(PARTS):
        root = np.linalg.cholesky(np.linalg.inv(covariance[:, part, part]))
        root = root.transpose(0, 2, 1) * np.sqrt(weight)
        square = (root @ steps.error[:, part, None]) ** 2
        by_state = root @ steps.jacobian[:, part]
        signs = rng.choice([-1.0, 1.0], square.shape)
        poses, shared = _absorbed(eliminated, by_state, signs)
        calibration = np.tile(shared[:NC], (len(signs), 1))
        step = np.concatenate([poses[:-1], poses[1:], calibration], axis=1)
        free = signs * (signs - by_state @ step[:, :, None])
        by_bearings = (seen.own * seen.change(poses, shared) ** 2).sum() / max(free.sum(), 1e-9)
        free *= 1.0 - overestimated * min(float(by_bearings), 1.0)
        squares[:, i] = (weight * square).sum(), np.minimum(square / weight, GATE**2).sum()
        redundancies[:, i] = (weight * free).sum(), free.sum()
    redundancies[0] *= _robust_share(redundancies[1].sum() / steps.error.size)
    return Misfit(squares, redundancies)


def _robust_share(redundancy: float) -> float:
    """Return the share of the squares of Gaussian motions that robust weights leave [1]."""
    squares = max(redundancy, 1e-3) * CHI_SQUARES
    weight = cauchy_weights(squares)
    return float((weight**2 * squares).mean() / (weight.mean() * squares.mean()))


def _absorbed(
    eliminated: Elimination, by_state: np.ndarray, errors: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the steps of poses and shared unknowns that absorb errors (k, i, 1) of motions."""
    pulled = (by_state.transpose(0, 2, 1) @ errors)[:, :, 0]
    slope, common = eliminated.zero_gradient()
    slope[:-1] += pulled[:, :3]
    slope[1:] += pulled[:, 3:6]
    common[:NC] = pulled[:, 6:].sum(axis=0)
    return eliminated.step(slope, common)
