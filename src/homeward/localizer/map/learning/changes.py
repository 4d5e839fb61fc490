"""Tests for changes during a drive: the camera is knocked, or the odometry has another scale.

From some keyframe on, all bearings are turned by one angle, or the speed has another scale, as
wheels spin, a wheel blocks or a gear slips. The change that fits best follows from the last
solution by one Gauss-Newton step, with poses, calibration and landmarks marginalised (Willsky and
Jones, "A generalized likelihood ratio approach to the detection and estimation of jumps in linear
systems", 1976). Both look alike, and the explanation with the higher likelihood counts.

A turn of the camera looks like a turn of the robot until the robot drives: then the landmarks show
a direction of motion that differs from the robot's heading by that angle. So the yaw may change at
the motions whose turns odometry denies most, and a turn of the robot there is marginalised, too.

The scale of odometry alone is not observable without distances, but a change of it is: the map has
the scale of the odometry before.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from homeward.localizer import kernels
from homeward.localizer.map.smoother import Smoother
from homeward.localizer.motions import CAMERA_YAW, SPEED_SCALE
from homeward.localizer.reference.extension import Unknown
from homeward.localizer.tunables import (
    FINAL_GATE,
    GATE,
    INLIER,
    LINEAR,
    MIN_CHANGE,
    MIN_CHANGED,
    MIN_JUMP_EVIDENCE,
    MIN_SCALE,
    NUM_JUMPS,
    NUM_SCALE_CHANGES,
)


class ModelChange(NamedTuple):
    """Change of one state of the calibration: the camera's yaw [rad], or the speed scale [1]."""

    state: int
    """`CAMERA_YAW` or `SPEED_SCALE`."""
    keyframe: int
    """Number of the first keyframe after which it holds."""
    size: float
    sigma: float
    """Standard deviation of the size."""
    log_bayes_factor: float = -math.inf
    """Of a turn of the camera by the turn that odometry denies there, against one of the robot [1].
    """

    @property
    def square(self) -> float:
        """Squared Mahalanobis distance from no change."""
        return (self.size / self.sigma) ** 2


class ChangeTest:
    """Test of the solutions of one map for one kind of change."""

    def __init__(self) -> None:
        self.possible: ModelChange | None = None
        """Change by the last solution, if more evidence is worth some effort ..."""
        self.is_suspected = False
        """... and whether the status reports it."""
        self.proved: ModelChange | None = None
        """The change if it was suspected before, and is proved now: so the status reports it before
        it is applied."""

    @property
    def square(self) -> float:
        """Squared Mahalanobis distance from no change, if one is possible."""
        return 0.0 if self.possible is None else self.possible.square

    @property
    def _gate(self) -> float:
        """Gate of a suspicion, which stays until a single test is passed [standard deviations]."""
        return INLIER if self.is_suspected else GATE

    def _add(
        self, found: ModelChange | None, possible: bool, suspected: bool, proved: bool
    ) -> None:
        """Add what a solution shows."""
        self.possible = found if possible else None
        self.proved = found if self.is_suspected and proved else None
        self.is_suspected = suspected

    def add_yaw(self, smoother: Smoother, mount_sigmas: np.ndarray) -> None:
        """Test a solution for a knocked camera; see `yaw_change`.

        It is suspected if a fixed camera fails the test of the 40 keyframes of a window, and proved
        by the gate of final decisions, if it is small enough to be linear.
        `numpy.linalg.LinAlgError` when the solution has become singular.
        """
        found = yaw_change(smoother, mount_sigmas)
        square, evidence = 0.0, -math.inf
        if found is not None:
            square, evidence = found.square, found.log_bayes_factor
        is_linear = found is not None and abs(found.size) < LINEAR
        self._add(
            found,
            square > INLIER**2 or evidence > 0.0,
            square > self._gate**2 or evidence > MIN_JUMP_EVIDENCE,
            square > FINAL_GATE**2 and is_linear,
        )

    def add_scale(self, smoother: Smoother, rival: float) -> None:
        """Test a solution for another scale of the odometry's speed.

        It is suspected by the same gate if it is no drift, and proved if it explains more than a
        rival by the gate of final decisions: moved landmarks look like both. `rival` is the squared
        Mahalanobis distance of another explanation. It is also suspected where one that was applied
        was none. `numpy.linalg.LinAlgError` as for `add_yaw`.
        """
        found, scale = scale_change(smoother), 1.0 + smoother.state.calibration[SPEED_SCALE]
        is_change = found is not None and abs(found.size) > MIN_CHANGE
        square = found.square if found is not None and is_change else 0.0
        # Wheels that hardly move the robot, or move it backwards, are no change of the scale.
        suspected = square > self._gate**2 or bool(scale < MIN_SCALE)
        proved = square > rival + FINAL_GATE**2
        self._add(found, suspected, suspected, proved)


def yaw_change(smoother: Smoother, mount_sigmas: np.ndarray) -> ModelChange | None:
    """Return the most probable change of the camera's yaw; None if none is observable.

    `mount_sigmas` (3,) are prior standard deviations of the extrinsics that allow for wrong ones,
    which would look like a change [rad, m, m].

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
    # Unknowns: first the change at each of these motions, then a turn of the robot there.
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
    found = _best_fit(CAMERA_YAW, smoother.first + at + 1, slope, information, LINEAR**-2.0)
    if found is None:
        return None
    motion = found.keyframe - 1 - smoother.first
    if not FINAL_GATE**2 < denied[motion] < math.inf:
        return found
    turn_of_robot = -float(motions.error[motion, 2])
    evidence = turn_of_robot * (found.size - 0.5 * turn_of_robot) / found.sigma**2
    return found._replace(log_bayes_factor=evidence)


def scale_change(smoother: Smoother) -> ModelChange | None:
    """Return the most probable change of the scale; None if the window has too few motions.

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
    return _best_fit(SPEED_SCALE, smoother.first + at, extra.slope, information, 0.0)


def _best_fit(
    state: int, keyframes: np.ndarray, slope: np.ndarray, information: np.ndarray, least: float
) -> ModelChange | None:
    """Return the most probable change of a state at one of k keyframes (k,).

    None if none has the `least` information.

    `information` and `slope` (k,) are of each, all else being marginalised.
    """
    observable = information > least
    square = np.divide(slope**2, information, out=np.zeros(slope.size), where=observable)
    k = int(square.argmax())
    if not observable[k]:
        return None
    size, sigma = float(slope[k] / information[k]), float(information[k] ** -0.5)
    return ModelChange(state, int(keyframes[k]), size, sigma)
