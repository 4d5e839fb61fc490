"""What the baselines in Cartesian coordinates share: odometry between frames, and the protocol."""

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from homeward.drives.drive import Drive
from homeward.estimator import Counts, Estimate, LandmarkEstimate, Status
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose, Twist, advance, between, compose, inverse
from homeward.lab.filters.settings import (
    DEFAULT_BEARING_SIGMA,
    DEFAULT_SPEED_SIGMA,
    DEFAULT_TURN_SIGMA,
)
from homeward.localizer.resection import poses_from_triples
from homeward.odometry.validity import TwistValidity

Belief = tuple[Pose, np.ndarray]
"""A pose, and the covariance of (x, y, heading)."""
GATE = 10.83  # 99.9 % quantile of chi-square with one degree of freedom
INLIER_SIGMAS = 4.0  # maximum residual of a bearing in a consensus
STEPS = 6  # of Gauss-Newton
MIN_AGREEING = 5  # home bearings that must agree with one pose of home, and half of those mapped
MAX_SIGMA = 0.1  # of the direction of a mapped landmark, in the search for home [rad]


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
        self.home = {name: b.bearing for name, b in drive.home.items()}
        self.mount = drive.settings.sensor.pose
        self.home_mount = drive.settings.home_mount.pose
        self.belief: Belief | None = None  # of the robot in the home frame
        self.tested: set[str] = set()
        self.moved: set[str] = set()  # of the tested landmarks
        self.replaced: set[str] = set()  # landmarks that moved during the drive
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
        return [LandmarkEstimate(name, moved=name in self.moved) for name in sorted(self.tested)]

    def locate(self, robot: Pose, places: Mapping[str, np.ndarray], P: np.ndarray) -> None:
        """Find home in a map; arguments as for `find_home`. Landmarks that do not agree moved."""
        home, sigma = self.home, self.noise.bearing
        found = find_home(robot, places, P, home, sigma, self.home_mount)
        if found is not None:
            self.belief = found.belief
            self.tested = {*places} & {*home}
            self.moved = found.outliers | self.replaced & self.tested


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


def residuals(poses: np.ndarray, places: np.ndarray, bearings: np.ndarray) -> np.ndarray:
    """Return the residuals of bearings (q,) of places (q, 2) at camera poses (..., 3) [rad]."""
    off = places - poses[..., :2]
    return np.asarray(wrap(bearings - np.arctan2(off[..., 1], off[..., 0]) + poses[..., 2]))


class Home(NamedTuple):
    """The robot's belief in the home frame, and the home bearings that do not agree with it."""

    belief: Belief
    outliers: frozenset[str]


def find_home(
    robot: Pose,
    places: Mapping[str, np.ndarray],
    P: np.ndarray,
    bearings: Mapping[str, float],
    sigma: float,
    mount: Pose,
) -> Home | None:
    """Return home by resection in a map: RANSAC over triples, then least squares of the inliers.

    `P` is the covariance of the robot's pose and of `places`, (3 + 2 q, 3 + 2 q), `mount` the
    camera's pose on the robot at home. At least `MIN_AGREEING` home bearings, and half of those of
    mapped landmarks, must agree. The covariance of the result has the landmarks' in it, and their
    correlation with the robot.
    """
    names = [n for n in places if n in bearings]
    if len(names) < MIN_AGREEING:
        return None
    order = list(places)
    rows = 3 + 2 * np.array([order.index(n) for n in names])
    at, seen = np.array([places[n] for n in names]), np.array([bearings[n] for n in names])
    poses = poses_from_triples(at, seen)
    if not len(poses):
        return None
    spread = np.sqrt([P[k : k + 2, k : k + 2].trace() for k in rows])
    near = np.maximum(np.hypot(*(poses[:, None, :2] - at).T).T, 1e-6)
    sigmas = np.minimum(np.hypot(sigma, spread / near), MAX_SIGMA)
    close = np.abs(residuals(poses[:, None], at, seen)) < INLIER_SIGMAS * sigmas
    use = close[int(np.argmax(close.sum(axis=1)))]
    camera = Pose(*poses[int(np.argmax(close.sum(axis=1)))].tolist())
    if use.sum() < max(MIN_AGREEING, len(use) / 2):
        return None
    R = np.eye(int(use.sum())) * sigma**2
    for _ in range(STEPS):
        parts = [sight(camera, Pose(0.0, 0.0, 0.0), *p) for p in at[use].tolist()]
        H, L = np.array([p[1] for p in parts]), np.zeros((len(parts), len(P)))
        for i, (row, part) in enumerate(zip(rows[use], parts, strict=True)):
            L[i, row : row + 2] = part[2]
        off = wrap(seen[use] - [p[0] for p in parts])
        W = np.linalg.inv(R + L @ P @ L.T)
        gain = np.linalg.pinv(H.T @ W @ H) @ H.T @ W
        camera = Pose(*(np.array(camera) + gain @ off).tolist())
    # The robot in home's frame, with gradients by the camera at home and by the map.
    home = compose(camera, inverse(mount))
    c, s = math.cos(home.heading), math.sin(home.heading)
    turn = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
    lever = np.eye(3)
    lever[0, 2], lever[1, 2] = -(robot.y - camera.y), robot.x - camera.x
    by_home = -turn @ lever @ gain
    by_state = -by_home @ L
    by_state[:, :3] += turn
    covariance = by_state @ P @ by_state.T + by_home @ R @ by_home.T
    outliers = frozenset(n for n, good in zip(names, use, strict=True) if not good)
    return Home((Pose(*map(float, between(home, robot))), covariance), outliers)
