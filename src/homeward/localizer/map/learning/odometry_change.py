"""Test for odometry that changes: from some keyframe on, its speed and turn have another scale.

Wheels spin, a wheel blocks, a gear slips. The scale of odometry alone is not observable without
distances, but a change of it is: the map has the scale of the odometry before. It follows from the
last solution by one Gauss-Newton step, with everything else marginalised, as for a knocked camera,
whose bearings it resembles; the explanation with the higher likelihood counts.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from homeward.localizer import kernels
from homeward.localizer.map.smoother import Smoother
from homeward.localizer.motions import SPEED_SCALE, TURN_SCALE
from homeward.localizer.reference.extension import Unknown
from homeward.localizer.tunables import FINAL_GATE, MIN_CHANGE, NUM_CHANGES

_SCALES = [SPEED_SCALE, TURN_SCALE]


class OdometryChange(NamedTuple):
    """Change of the scales of odometry."""

    keyframe: int
    """Number of the first keyframe after which they are changed."""
    scale: np.ndarray
    """(2,): scale of speed and of turn after it [1]."""
    size: np.ndarray
    """(2,): their changes [1]."""
    sigma: np.ndarray
    """(2,): their standard deviations [1]."""
    square: float
    """Squared Mahalanobis distance from no change."""

    @property
    def is_proved(self) -> bool:
        """Whether one of them passes the gate of final decisions, and is no drift."""
        off = np.abs(self.size)
        return bool(((off > FINAL_GATE * self.sigma) & (off > MIN_CHANGE)).any())


class ChangeTest:
    """Test of the solutions of one map: whether the odometry changed."""

    def __init__(self) -> None:
        self.is_suspected = False
        """Whether the last solution showed a change."""
        self.proved: OdometryChange | None = None
        """The change if it was suspected before: so the status reports it before it is applied."""

    def add_solution(self, smoother: Smoother, rival: float) -> bool:
        """Test a solution; return whether a change explains it better than a rival does.

        `rival` is the squared Mahalanobis distance of another explanation.
        `numpy.linalg.LinAlgError` when the solution has become singular.
        """
        found, suspected = find_change(smoother), self.is_suspected
        self.is_suspected = found is not None and found.is_proved and found.square > rival
        is_forwards = found is not None and (found.scale > 0.0).all()  # else the signs are wrong
        self.proved = found if suspected and self.is_suspected and is_forwards else None
        return self.is_suspected


def find_change(smoother: Smoother) -> OdometryChange | None:
    """Return the most probable change in the last motions; None if the window has too few.

    `numpy.linalg.LinAlgError` when the normal equations are singular.
    """
    w, n = len(smoother.stamps), len(smoother.ids)
    if w < 3 or not n:
        return None
    given = smoother.linearised()
    seen, scales = given.seen, given.motions.jacobian[:, :, 6:][:, :, _SCALES]
    at = np.arange(max(1, w - 1 - NUM_CHANGES), w - 1)
    is_after = np.arange(w - 1)[:, None] >= at
    by_motion = (scales[:, :, :, None] * is_after[:, None, None]).reshape(w - 1, 3, -1)
    count, none = at.size, np.full(seen.pose.size, -1)
    unknown = Unknown(np.zeros((none.size, 1)), none, np.ones(2 * count), by_motion)
    extra = kernels.extend(given, unknown)
    pairs = np.arange(count)[:, None] + np.array([0, count])
    information = extra.information[pairs[:, :, None], pairs[:, None, :]]
    slope = extra.slope[pairs]
    covariance = np.linalg.inv(information)
    size = (covariance @ slope[:, :, None])[:, :, 0]
    square = (size * slope).sum(axis=1)
    k = int(square.argmax())
    sigma = np.sqrt(covariance[k].diagonal())
    scale = 1.0 + smoother.state.calibration[_SCALES] + size[k]
    return OdometryChange(smoother.first + int(at[k]), scale, size[k], sigma, float(square[k]))
