"""Test for a knocked camera: from some keyframe on, all bearings are turned by one angle.

A turn of the camera looks like a turn of the robot until the robot drives: then the landmarks show
a direction of motion that differs from the robot's heading by that angle. So the yaw may jump at
the motions whose turns odometry denies most. The jump that fits best follows from the last solution
by one Gauss-Newton step, with poses, calibration, landmarks and a turn of the robot at the same
motion marginalised (Willsky and Jones, "A generalized likelihood ratio approach to the detection
and estimation of jumps in linear systems", 1976).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from homeward.localizer import kernels
from homeward.localizer.map.smoother import Smoother
from homeward.localizer.motions import CAMERA_YAW
from homeward.localizer.reference.extension import Unknown
from homeward.localizer.tunables import (
    FINAL_GATE,
    GATE,
    INLIER,
    LINEAR,
    MIN_JUMP_EVIDENCE,
    NUM_JUMPS,
)


class CameraJump(NamedTuple):
    """Jump of the camera's yaw."""

    keyframe: int
    """Number of the first keyframe after it."""
    size: float
    """[rad]"""
    sigma: float
    """Its standard deviation [rad]."""
    log_bayes_factor: float = -math.inf
    """Of a jump by the turn that odometry denies there, against a turn of the robot [1]."""

    def exceeds(self, gate: float) -> bool:
        """Return whether it contradicts a fixed camera by a gate [standard deviations]."""
        return abs(self.size) > gate * self.sigma

    @property
    def is_proved(self) -> bool:
        """Whether it passes the gate of final decisions, and is small enough to be linear."""
        return self.exceeds(FINAL_GATE) and abs(self.size) < LINEAR


class JumpTest:
    """Test of the solutions of one map: whether the camera was knocked."""

    def __init__(self) -> None:
        self.possible: CameraJump | None = None
        """Most probable jump by the last solution, if more evidence is worth some effort ..."""
        self.is_suspected = False
        """... and whether a fixed camera fails the test of the 40 keyframes of a window."""
        self.proved: CameraJump | None = None
        """The same jump if that was suspected before, and now passes the gate of final decisions:
        so the status reports a jump before it is corrected."""

    @property
    def square(self) -> float:
        """Squared Mahalanobis distance of the jump from a fixed camera, if one is possible."""
        found = self.possible
        return 0.0 if found is None else (found.size / found.sigma) ** 2

    def add_solution(self, smoother: Smoother, mount_sigmas: np.ndarray) -> None:
        """Test a solution; see `find_jump`.

        `numpy.linalg.LinAlgError` when it has become singular.
        """
        found, suspected = find_jump(smoother, mount_sigmas), self.is_suspected
        possible = found is not None and (found.exceeds(INLIER) or found.log_bayes_factor > 0.0)
        self.possible = found if possible else None
        self.is_suspected = found is not None and (
            found.exceeds(GATE) or found.log_bayes_factor > MIN_JUMP_EVIDENCE
        )
        self.proved = found if suspected and found is not None and found.is_proved else None


def find_jump(smoother: Smoother, mount_sigmas: np.ndarray) -> CameraJump | None:
    """Return the most probable jump of the yaw; None if none is observable.

    `mount_sigmas` (3,) are prior standard deviations of the extrinsics that allow for wrong ones,
    which would look like a jump [rad, m, m].

    With several cameras neither: all bearings turn alike only if all cameras do.
    `numpy.linalg.LinAlgError` when the normal equations are singular.
    """
    w, n = len(smoother.stamps), len(smoother.ids)
    if w < 2 or not n or smoother.frames.offsets:
        return None
    given = smoother.linearised(mount_sigmas)
    seen, motions = given.seen, given.motions
    denied = smoother.denied_turns(motions)
    at = np.sort(np.argsort(-denied, kind="stable")[:NUM_JUMPS])
    # Unknowns: first the jump at each of these motions, then a turn of the robot there.
    count, camera, robot = at.size, np.arange(at.size), at.size + np.arange(at.size)
    by_bearing, by_motion = np.zeros((seen.pose.size, 2 * count)), np.zeros((w - 1, 3, 2 * count))
    yaw = seen.jacobian[:, 3 + CAMERA_YAW, None]
    by_bearing[:, :count], by_motion[at, 2, robot] = yaw * (seen.pose[:, None] > at), 1.0
    unknown = Unknown(by_bearing, np.zeros_like(seen.pose), np.zeros(2 * count), by_motion)
    extra, own = kernels.extend(given, unknown), motions.weight * motions.information[:, 2, 2]
    both = extra.information[camera, robot]
    share = both / np.maximum(extra.information[robot, robot], 1e-12 * own[at])
    information = extra.information[camera, camera] - share * both
    slope = extra.slope[camera] - share * extra.slope[robot]
    observable = information > LINEAR**-2.0
    square = np.divide(slope**2, information, out=np.zeros(count), where=observable)
    k = int(square.argmax())
    if not observable[k]:
        return None
    size, sigma = float(slope[k] / information[k]), float(information[k] ** -0.5)
    jump = CameraJump(smoother.first + int(at[k]) + 1, size, sigma)
    if not FINAL_GATE**2 < denied[at[k]] < math.inf:
        return jump
    turn_of_robot = -float(motions.error[at[k], 2])
    evidence = turn_of_robot * (size - 0.5 * turn_of_robot) / sigma**2
    return jump._replace(log_bayes_factor=evidence)
