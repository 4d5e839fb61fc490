"""Variance components of odometry: how far its noise is from what is believed (Foerstner 1979).

What the solved map leaves of a motion is smaller than the motion's error by as much as poses
followed it: the expected square of it, over the variance that is believed, is not the number of
motions but their redundancy, a trace, which is estimated with random signs (Hutchinson 1990).

A part of that redundancy stands for errors of bearings, to which poses that believe them give way.
Where bearings are better than is believed of them (as where nobody tells their noise) that part
leaves less, and odometry would pass for better than it is. So the variance of bearings is a
component, too, by which that part is weighed (Helmert 1907).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.special import chdtri

from homeward.localizer.inputs.bearing_noise import MAX_INFLATION
from homeward.localizer.map.elimination import Elimination
from homeward.localizer.map.factors import OdometryErrors, cauchy_weights
from homeward.localizer.motion.preintegration import NC
from homeward.localizer.tunables import GATE

CHI_SQUARES = chdtri(3, (np.arange(64) + 0.5) / 64)
"""Quantiles of the squared Mahalanobis error of a motion."""
PARTS = (slice(0, 2), slice(2, 3))
"""Of a motion: the way along and across, and the turn."""


class BearingErrors(NamedTuple):
    """What a solved map leaves of m bearings."""

    error: np.ndarray
    """(m,): over the deviation of a single one [1]."""
    jacobian: np.ndarray
    """(m, 13): of `bearing_residuals`, over the deviations by which they count beside others."""
    pose: np.ndarray
    """(m,), int: from which pose each was made."""
    landmark: np.ndarray
    """(m,), int: of which landmark."""
    own: np.ndarray
    """(m,): how much of their variance is their own, not that of the way from the keyframe [1]."""

    def by_step(self, poses: np.ndarray, shared: np.ndarray) -> np.ndarray:
        """Return the change, (m,) [1], by a step of poses (w, 3) and of what they share."""
        by_pose, by_common, by_place = np.split(self.jacobian, [3, 3 + NC], axis=1)
        places = shared[NC:].reshape(-1, 2)[self.landmark]
        turned = (by_pose * poses[self.pose]).sum(axis=1) + (by_place * places).sum(axis=1)
        return np.asarray(turned + by_common @ shared[:NC])

    def variance(self, left: Elimination, rng: np.random.Generator) -> float:
        """Return their variance over that which is believed, 1 at most: worse ones are doubted.

        Parameters are those of `misfit`.
        """
        clear = self.own >= MAX_INFLATION**-2.0
        if not clear.any():
            return 1.0
        signs = rng.choice([-1.0, 1.0], clear.shape) * clear
        pulled = self.jacobian * signs[:, None]
        slope, common = left.zero_gradient()
        np.add.at(slope, self.pose, pulled[:, :3])
        common[:NC] = pulled[:, 3 : 3 + NC].sum(axis=0)
        np.add.at(common[NC:].reshape(-1, 2), self.landmark, pulled[:, 3 + NC :])
        free = (signs - self.by_step(*left.step(slope, common)))[clear]
        redundancy, own = float(signs[clear] @ free), float(free @ free)
        squares = float(np.minimum(self.error[clear] ** 2, GATE**2).sum())
        return min(max((squares - (redundancy - own)) / own, 0.0), 1.0)


class Misfit(NamedTuple):
    """What a solved map leaves of motions, shift and turn apart, each (2, 2).

    By their weights in the first row; in the second all alike, but for what is absurd.
    """

    squares: np.ndarray
    """Sums of their squares over the variances that are believed."""
    redundancies: np.ndarray
    """What these are expected to be."""


def misfit(
    left: Elimination,
    steps: OdometryErrors,
    seen: BearingErrors,
    rng: np.random.Generator,
) -> Misfit:
    """Compare what is left of motions with what is expected to be left.

    Parameters
    ----------
    left : Elimination
        Of everything, around the solution.
    steps : OdometryErrors
        The motions between all its poses.
    seen : BearingErrors
        The bearings.
    rng : numpy.random.Generator
        For the signs.
    """
    covariance = np.linalg.inv(steps.information)
    squares, redundancies = np.zeros((2, len(PARTS))), np.zeros((2, len(PARTS)))
    weight, better = steps.weight[:, None, None], 1.0 - seen.variance(left, rng)
    for i, part in enumerate(PARTS):
        root = np.linalg.cholesky(np.linalg.inv(covariance[:, part, part]))
        root = root.transpose(0, 2, 1) * np.sqrt(weight)
        square = (root @ steps.error[:, part, None]) ** 2
        by_state = root @ steps.jacobian[:, part]
        signs = rng.choice([-1.0, 1.0], square.shape)
        poses, shared = _pulled(left, by_state, signs)
        calibration = np.tile(shared[:NC], (len(signs), 1))
        step = np.concatenate([poses[:-1], poses[1:], calibration], axis=1)
        free = signs * (signs - by_state @ step[:, :, None])
        by_bearings = (seen.own * seen.by_step(poses, shared) ** 2).sum() / max(free.sum(), 1e-9)
        free *= 1.0 - better * min(float(by_bearings), 1.0)
        squares[:, i] = (weight * square).sum(), np.minimum(square / weight, GATE**2).sum()
        redundancies[:, i] = (weight * free).sum(), free.sum()
    redundancies[0] *= _kept(redundancies[1].sum() / steps.error.size)
    return Misfit(squares, redundancies)


def _kept(redundancy: float) -> float:
    """Return the share that weights leave of the squares of Gaussian motions, so redundant [1]."""
    left = max(redundancy, 1e-3) * CHI_SQUARES
    weight = cauchy_weights(left)
    return float((weight**2 * left).mean() / (weight.mean() * left.mean()))


def _pulled(
    left: Elimination, by_state: np.ndarray, errors: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return what poses, and what they share, take up of errors (k, i, 1) of motions."""
    pulled = (by_state.transpose(0, 2, 1) @ errors)[:, :, 0]
    slope, common = left.zero_gradient()
    slope[:-1] += pulled[:, :3]
    slope[1:] += pulled[:, 3:6]
    common[:NC] = pulled[:, 6:].sum(axis=0)
    return left.step(slope, common)
