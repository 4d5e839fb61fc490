"""What the baselines in Cartesian coordinates share: odometry between frames, and the protocol."""

import math
from collections.abc import Mapping

import numpy as np

from homeward.drives.drive import Drive
from homeward.estimator import Counts, Estimate, Estimator, LandmarkEstimate, Status
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose, Twist, advance
from homeward.lab.filters.settings import (
    DEFAULT_BEARING_SIGMA,
    DEFAULT_SPEED_SIGMA,
    DEFAULT_TURN_SIGMA,
)
from homeward.localizer.smoothing import smooth
from homeward.odometry.validity import TwistValidity
from homeward.registry import make_estimator

Belief = tuple[Pose, np.ndarray]
"""A pose, and the covariance of (x, y, heading)."""
GATE = 10.83  # 99.9 % quantile of chi-square with one degree of freedom


class Noise:
    """Standard deviations from a drive's settings, or the defaults of homeward's filters."""

    def __init__(self, drive: Drive) -> None:
        known, sensor = drive.settings.odometry, drive.settings.sensor
        speed = DEFAULT_SPEED_SIGMA if known.speed_sigma is None else known.speed_sigma
        turn = DEFAULT_TURN_SIGMA if known.turn_sigma is None else known.turn_sigma
        self.density = np.diag(np.square([max(speed, 1e-6), max(turn, 1e-6)]))
        self.bearing = sensor.bearing_sigma or DEFAULT_BEARING_SIGMA

    def predicted(self, belief: Belief, twist: Twist, dt: float) -> Belief:
        """Return a belief after `dt` of a twist."""
        pose, covariance = belief
        after = advance(pose, twist, dt)
        middle = pose.heading + 0.5 * twist.omega * dt
        c, s = math.cos(middle), math.sin(middle)
        by_state = np.array([[1, 0, pose.y - after.y], [0, 1, after.x - pose.x], [0, 0, 1]])
        by_input = np.array([[c, -0.5 * dt * twist.v * s], [s, 0.5 * dt * twist.v * c], [0, 1]])
        grown = by_input @ self.density @ by_input.T * dt
        after = Pose(after.x, after.y, math.remainder(after.heading, math.tau))
        return after, by_state @ covariance @ by_state.T + grown


class Baseline:
    """An estimator that dead-reckons between frames; a subclass adds what a frame does."""

    notes: tuple[str, ...] = ()

    def __init__(self, drive: Drive) -> None:
        self.name = type(self).__name__
        self.counts, self.noise = Counts(), Noise(drive)
        self.mount = drive.settings.sensor.pose
        self.home_mount = drive.settings.home_mount.pose
        self.belief: Belief | None = None  # of the robot in the home frame
        self._t, self._twist, self._hold = math.nan, Twist(0.0, 0.0), TwistValidity()
        self._until = -math.inf

    def move(self, twist: Twist, dt: float) -> None:
        """Process a motion; overridden where the belief is not all that moves."""
        if self.belief is not None:
            self.belief = self.noise.predicted(self.belief, twist, dt)

    def frame(self, t: float, seen: Mapping[str, float]) -> None:
        """Process the bearings of a frame [rad]."""
        raise NotImplementedError

    def _span(self, t: float) -> float:
        """Return the time until `t` for which the last twist is valid [s]."""
        return max(0.0, min(t, self._until) - self._t) if t > self._t else 0.0

    def _advance(self, t: float) -> None:
        if dt := self._span(t):
            self.move(self._twist, dt)
        self._t = t if math.isnan(self._t) else max(self._t, t)

    def odometry(self, t: float, v: float, omega: float) -> None:
        self._advance(t)
        if math.isfinite(v) and math.isfinite(omega):
            self._twist = Twist(v, omega)
        self._until = t + self._hold.add(t)

    def bearings(
        self, t: float, seen: Mapping[str, float], sigmas: Mapping[str, float] | None = None
    ) -> Estimate:
        self._advance(t)
        self.frame(t, seen)
        self.counts.used += len(seen)
        return self.estimate(t)

    def estimate(self, t: float) -> Estimate:
        if self.belief is None:
            return Estimate(t, Status.MAPPING, "no pose yet")
        pose, covariance = self.belief
        if dt := self._span(t):
            pose, covariance = self.noise.predicted(self.belief, self._twist, dt)
        covariance = (covariance + covariance.T) / 2
        return Estimate(t, Status.LOCALISED, "a pose", Pose(*map(float, pose)), covariance)

    def landmarks(self) -> list[LandmarkEstimate]:
        return []


class Solved(Baseline):
    """Poses of a whole drive by stamp: an answer that uses later samples."""

    def __init__(self, drive: Drive) -> None:
        super().__init__(drive)
        self.solved: dict[float, Belief] = {}

    def frame(self, t: float, seen: Mapping[str, float]) -> None:
        self.belief = self.solved.get(t)


def smoothed(drive: Drive) -> Solved:
    """Return the poses of `homeward run --smooth`."""
    estimator, track = Solved(drive), smooth(drive)
    for k in np.flatnonzero(track.has_pose):
        pose = Pose(track.x[k], track.y[k], track.heading[k])
        estimator.solved[float(track.t[k])] = pose, track.covariance[k]
    return estimator


def start_belief(drive: Drive) -> Belief:
    """Return the start prior of a drive, its position as wide in all directions."""
    start = drive.settings.start
    assert start is not None
    x, y = start.R * math.cos(start.theta), start.R * math.sin(start.theta)
    wide = start.sigma_R**2
    return Pose(x, y, start.alpha), np.diag([wide, wide, start.sigma_alpha**2])


def sight(pose: Pose, mount: Pose, x: float, y: float) -> tuple[float, np.ndarray, np.ndarray]:
    """Return the bearing of a point from a camera, and its gradients by robot pose and point."""
    c, s = math.cos(pose.heading), math.sin(pose.heading)
    ox, oy = c * mount.x - s * mount.y, s * mount.x + c * mount.y
    dx, dy = x - pose.x - ox, y - pose.y - oy
    square = max(dx * dx + dy * dy, 1e-12)
    by_place = np.array([-dy, dx]) / square
    turned = by_place @ np.array([oy, -ox]) - 1.0
    angle = math.remainder(math.atan2(dy, dx) - pose.heading - mount.heading, math.tau)
    return angle, np.array([-by_place[0], -by_place[1], turned]), by_place


def crossing(eyes: np.ndarray, angles: np.ndarray) -> np.ndarray | None:
    """Return the point nearest to lines from `eyes` (n, 2) at `angles` (n,); None if behind one."""
    across = np.column_stack([-np.sin(angles), np.cos(angles)])
    point = np.linalg.lstsq(across, (across * eyes).sum(axis=1), rcond=None)[0]
    ahead = ((point - eyes) * np.column_stack([np.cos(angles), np.sin(angles)])).sum(axis=1)
    return np.asarray(point) if (ahead > 0).all() else None


def parallax(angles: np.ndarray) -> float:
    """Return the largest angle between directions (n,) [rad]."""
    return float(np.ptp(wrap(np.asarray(angles) - angles[0])))


def robust_started(drive: Drive) -> Estimator:
    """Return `robust` with the start prior that the filters get."""
    return make_estimator("robust", drive)


robust_started.needs_start = True  # type: ignore[attr-defined]
