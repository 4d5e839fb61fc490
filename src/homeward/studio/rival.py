"""Estimators that run side by side in the studio, their errors, and the bound."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from typing import Any

import numpy as np

from homeward.drives.drive import Drive
from homeward.errors import HomewardError
from homeward.estimator import Estimate, Status
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose, Twist, compose, polar_covariance_to_pose, to_polar
from homeward.lab.bounds import RunningBound
from homeward.lab.simulation.live_robot import LiveRobot
from homeward.lab.simulation.scenario import Scenario
from homeward.registry import make_estimator
from homeward.runs.scoring import CHI_SQUARE_3_95, normalised_squared

MOVED = 0.5
"""Minimum probability of a landmark that is shown as moved."""
LANDMARKS_S = 0.5
"""Interval of updates of landmark estimates [s of the drive]."""


class Rival:
    """An estimator in the studio; one that fails gets no more data."""

    def __init__(self, name: str, drive: Drive) -> None:
        self.name = name
        self.estimate = Estimate(0.0, Status.WAITING, "no sightings yet")
        self.failure: str | None = None
        self.update_s = math.nan
        """Wall time of the last update [s]; NaN until the second: the first one prepares."""
        self._updates = 0
        self._landmarks_t = -math.inf
        self._marks: dict[str, tuple[float, float]] = {}
        self._moved: dict[str, float] = {}
        self.error = self.nees = math.nan
        """Position error [m], and NEES, which is 3 on average if consistent."""
        self._scored, self._sum = 0, 0.0
        try:
            self._estimator = make_estimator(name, drive)
        except HomewardError as error:
            self.failure = str(error)

    def feed(self, t: float, twist: Twist, seen: Mapping[str, float] | None) -> None:
        """Process the samples at `t` [s]: odometry, and bearings if there is a frame."""
        if self.failure is not None:
            return
        try:
            self._estimator.odometry(t, twist.v, twist.omega)
            if seen is None:
                self.estimate = self._estimator.estimate(t)
                return
            began = time.perf_counter()
            self.estimate = self._estimator.bearings(t, seen)
            if self._updates:
                self.update_s = time.perf_counter() - began
            self._updates += 1
            if t - self._landmarks_t >= LANDMARKS_S:
                self._landmarks_t = t
                self._update_landmarks()
        except HomewardError as error:
            self.failure = str(error)
            self.estimate = Estimate(t, Status.WAITING, "failed")

    def _update_landmarks(self) -> None:
        known = self._estimator.landmarks()
        self._marks = {m.landmark: (m.x, m.y) for m in known if math.isfinite(m.x)}
        self._moved = {
            m.landmark: m.moved_probability for m in known if m.moved_probability > MOVED
        }

    def score(self, true: Pose) -> None:
        """Compare the estimate with the true pose in the home frame."""
        pose, covariance = self.estimate.pose, self.estimate.covariance
        self.error = self.nees = math.nan
        if pose is None or covariance is None:
            return
        off = np.array(pose) - true
        off[2] = wrap(off[2])
        self.error = math.hypot(off[0], off[1])
        self.nees = float(normalised_squared(off[None], covariance[None])[0])
        self._scored += 1
        self._sum += self.nees

    def state(self, home: Pose) -> dict[str, Any]:
        """Return the state for the page, in room coordinates."""
        pose, covariance = self.estimate.pose, self.estimate.covariance
        out: dict[str, Any] = {
            "status": self.estimate.status.value,
            "overconfident": self.nees > CHI_SQUARE_3_95,  # true pose outside the 95 % region
            "reason": self.failure or self.estimate.reason,
            "update_ms": 1e3 * self.update_s,
            "moved": self._moved,
            "marks": {i: compose(home, Pose(*at, 0.0))[:2] for i, at in self._marks.items()},
        }
        if pose is not None and covariance is not None:
            out["pose"] = [float(part) for part in compose(home, pose)]
            out["ellipse"] = ellipse(covariance[:2, :2], home.heading)
            out["error"], out["nees"] = self.error, self.nees
            out["nees_mean"] = self._sum / self._scored if self._scored else None
        return out


def ellipse(covariance: np.ndarray, turn: float = 0.0) -> list[float] | None:
    """Return half axes [m] and direction [rad] of a rotated 1-sigma ellipse; None if infinite."""
    if not np.isfinite(covariance).all():
        return None
    values, vectors = np.linalg.eigh(covariance)
    a, b = np.sqrt(np.maximum(values[::-1], 0.0))
    return [float(a), float(b), float(math.atan2(vectors[1, 1], vectors[0, 1]) + turn)]


MIN_R_M = 1e-3
"""Minimum distance from home for a prior in polar coordinates [m]."""


class Best:
    """Posterior Cramer-Rao bound on the pose of the robot, including kidnapping."""

    radius: float | None = None
    """One sigma of the position [m]; None where unobservable, or without bearing noise."""

    def __init__(self, robot: LiveRobot, scenario: Scenario) -> None:
        self._robot, self._last = robot, (math.nan, robot.pose)
        self._bound: RunningBound | None = None
        if not scenario.noise.bearing_sigma:
            return
        world, start, errors = robot.world, scenario.start, scenario.odometry
        covariance = None
        if start.prior:
            polar = to_polar(robot.pose)._replace(R=max(math.hypot(*robot.pose[:2]), MIN_R_M))
            covariance = polar_covariance_to_pose(polar, np.diag(start.sigmas**2))
        self._bound = RunningBound(
            world.in_home_frame,
            bearing_sigma=scenario.noise.bearing_sigma,
            home_sigma=scenario.noise.home_sigma or scenario.noise.bearing_sigma,
            speed_sigma=errors.speed_sigma,
            turn_sigma=errors.turn_sigma,
            moved=np.array([i in world.moved or i not in robot.drive.home for i in world.ids]),
            start_covariance=covariance,
            mount=scenario.sensor.pose,
        )

    def see(self, t: float, pose: Pose, seen: set[str]) -> None:
        """Add the sightings at `t` [s] from a true pose in the home frame."""
        if self._bound is None:
            return
        world, now, (then, before) = self._robot.world, np.array(pose, float), self._last
        if math.isfinite(then):
            # For a short arc the chord is nearly as long.
            length = math.hypot(pose.x - before.x, pose.y - before.y)
            twist = np.array([length, wrap(pose.heading - before.heading)]) / (t - then)
            self._bound.drive(np.array(before, float), now, twist, t - then)
        self._bound.see(now, world.in_home_frame, np.array([i in seen for i in world.ids]))
        self._last = t, pose
        axes = ellipse(self._bound.covariance()[:2, :2])
        self.radius = None if axes is None else math.hypot(axes[0], axes[1])

    def carry(self) -> None:
        """Account for a robot that was carried elsewhere."""
        self._last = math.nan, self._robot.pose
        if self._bound is not None:
            self._bound.carry()

    def move(self, landmark: str) -> None:
        """Account for a moved landmark."""
        if self._bound is not None:
            self._bound.move(self._robot.world.ids.index(landmark))

    def sense_by(self, scenario: Scenario) -> None:
        """Account for a changed camera or noise."""
        if self._bound is not None and scenario.noise.bearing_sigma:
            self._bound.bearing_sigma = scenario.noise.bearing_sigma
            self._bound.mount = scenario.sensor.pose
