"""Test for odometry that changes: from some keyframe on, its speed has another scale.

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
from homeward.localizer.motions import SPEED_SCALE
from homeward.localizer.reference.extension import Unknown
from homeward.localizer.tunables import (
    FINAL_GATE,
    MIN_CHANGE,
    MIN_CHANGED,
    MIN_SCALE,
    NUM_SCALE_CHANGES,
)


class OdometryChange(NamedTuple):
    """Change of the scale of the speed."""

    keyframe: int
    """Number of the first keyframe after which it is changed."""
    scale: float
    """Scale after it [1]."""
    size: float
    """Its change [1]."""
    sigma: float
    """Standard deviation of the change [1]."""

    @property
    def square(self) -> float:
        """Squared Mahalanobis distance from no change."""
        return (self.size / self.sigma) ** 2

    def is_proved(self, rival: float) -> bool:
        """Whether it explains more than a rival by the gate of final decisions, and is no drift.

        `rival` is the squared Mahalanobis distance of another explanation.
        """
        is_large = abs(self.size) > MIN_CHANGE and self.scale > MIN_SCALE
        return is_large and self.square > rival + FINAL_GATE**2


class ChangeTest:
    """Test of the solutions of one map: whether the odometry changed."""

    def __init__(self) -> None:
        self.is_suspected = False
        """Whether the last solution showed a change, or one that was applied was none."""
        self.proved: OdometryChange | None = None
        """The change if it was suspected before: so the status reports it before it is applied."""

    def add_solution(self, smoother: Smoother, rival: float) -> bool:
        """Test a solution; return whether a change explains it better than a rival does.

        `rival` is the squared Mahalanobis distance of another explanation.
        `numpy.linalg.LinAlgError` when the solution has become singular.
        """
        found, suspected = find_change(smoother), self.is_suspected
        is_proved = found is not None and found.is_proved(rival)
        self.proved = found if suspected and is_proved else None
        # Wheels that hardly move the robot, or move it backwards, are no change of the scale.
        self.is_suspected = is_proved or smoother.state.calibration[SPEED_SCALE] < MIN_SCALE - 1.0
        return self.is_suspected


def find_change(smoother: Smoother) -> OdometryChange | None:
    """Return the most probable change in the last motions; None if the window has too few.

    `numpy.linalg.LinAlgError` when the normal equations are singular.
    """
    num_motions = len(smoother.stamps) - 1
    at = np.arange(max(1, num_motions - NUM_SCALE_CHANGES), num_motions - MIN_CHANGED + 1)
    if not at.size or not len(smoother.ids):
        return None
    given = smoother.linearised()
    is_after = np.arange(num_motions)[:, None] >= at
    by_motion = given.motions.jacobian[:, :, 6 + SPEED_SCALE, None] * is_after[:, None]
    none = np.full(given.seen.pose.size, -1)
    unknown = Unknown(np.zeros((none.size, 1)), none, np.ones(at.size), by_motion)
    extra = kernels.extend(given, unknown)
    information = extra.information.diagonal()
    k = int((extra.slope**2 / information).argmax())
    size, sigma = float(extra.slope[k] / information[k]), float(information[k] ** -0.5)
    scale = 1.0 + float(smoother.state.calibration[SPEED_SCALE]) + size
    return OdometryChange(smoother.first + int(at[k]), scale, size, sigma)
