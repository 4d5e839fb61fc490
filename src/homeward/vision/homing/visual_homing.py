"""Visual homing: an estimator that compares each panorama with home's, around one that maps.

Two panoramas tell heading and direction from home at once, where a map takes a while; and near home
they tell the pose better than the map (`homing.resection`). Odometry leads from one comparison to
the next. A pose that home's picture contradicts is never called localised.
"""

from __future__ import annotations

import dataclasses
import math
import threading
from collections.abc import Mapping
from typing import Unpack

import numpy as np

from homeward.drives.known import known_robot
from homeward.drives.settings import OdometryDefaults, Robot, noise_rates
from homeward.estimator import (
    Counts,
    Estimate,
    EstimatesExtrinsics,
    Estimator,
    LandmarkEstimate,
    Status,
    guarded,
    synchronised,
)
from homeward.geometry.angles import wrap
from homeward.geometry.frames import (
    Polar,
    Pose,
    between,
    compose,
    from_polar,
    inverse,
    polar_covariance_to_pose,
)
from homeward.io.blas_threads import single_threaded_blas
from homeward.odometry.clock import MAX_DELAY_S, Clock
from homeward.odometry.history import TwistHistory
from homeward.odometry.limits import MAX_RATE
from homeward.reasons import Rejection
from homeward.vision.comparison import Comparison
from homeward.vision.front_end import home_name
from homeward.vision.homing.direction_voting import DirectionVoting
from homeward.vision.homing.fix import DIRECTION_HOLD_S, POSE_HOLD_S, Fix, fused, propagated
from homeward.vision.homing.moved_landmark_filter import MovedLandmarkFilter
from homeward.vision.homing.resection import NEAR_HOME, Direction, HomeLandmarks, resect

MIN_MAPPED = 4
"""Least number of mapped landmarks that a resection uses: one more than a pose has unknowns."""
AGREEING = 0.7
"""Least share of the landmarks in the map that agree with a resection."""
GUESSED = 4.0
"""Standard deviation of the distance of a landmark outside the map, as a multiple of the median."""
UNKNOWN_DISTANCE = 3.0
"""Distance from home where only the direction is known, and its standard deviation [m]."""
CONTRADICTS = 4.0
"""Map and home's picture contradict each other from so many standard deviations on."""
REFUSALS = 3
"""A map that says `NEAR_HOME` is doubted after so many refused comparisons."""


class VisualHoming:
    """Adds visual homing to an estimator; itself an `Estimator`.

    Parameters
    ----------
    estimator : Estimator
        Maps the landmarks.
    **robot : Robot
        As the estimator was told: where the camera is on the robot, now and at home.
    """

    def __init__(self, estimator: Estimator, **robot: Unpack[Robot]) -> None:
        self._inner, self._turn = estimator, threading.RLock()
        self.name = estimator.name
        self._told = known_robot(robot)
        self._odometry = TwistHistory()
        self._noise_rates = noise_rates(self._told.odometry, OdometryDefaults())
        self._fix: Fix | None = None
        self._pictured = -math.inf
        """The newest stamp of a picture [s]."""
        self._refused = 0
        """How often in a row home's picture was not recognised."""
        self._moved_filter, self._votes = MovedLandmarkFilter(), DirectionVoting(self._odometry)
        self._clock = Clock()

    @property
    def counts(self) -> Counts:
        """Those of the other estimator, and the pictures that came late."""
        return self._inner.counts

    @property
    def notes(self) -> tuple[str, ...]:
        """Those of the other estimator."""
        return self._inner.notes

    @guarded
    def odometry(self, t: float, v: float, omega: float) -> None:
        """Take a twist that holds from `t` [s] on: `v` [m/s] forward, `omega` [rad/s]."""
        self._inner.odometry(t, v, omega)
        t = self._clock.read(t)
        if not (math.isfinite(t) and abs(v) < MAX_RATE and abs(omega) < MAX_RATE):
            return
        if t >= self._odometry.newest:
            self._odometry.add(t, v, omega)
            self._forget_odometry()

    @guarded
    def bearings(
        self, t: float, sightings: Mapping[str, float], sigmas: Mapping[str, float] | None = None
    ) -> Estimate:
        """Take all sightings of stamp `t` [s] (id to bearing [rad] from the camera's axis)."""
        self._moved_filter.add_frame(sightings)
        innovations = self._inner.bearings(t, sightings, sigmas).innovations
        return dataclasses.replace(self.estimate(t), innovations=innovations)

    @synchronised
    @single_threaded_blas()
    def home(self, t: float, seen: Comparison | None) -> None:
        """Take how the picture of stamp `t` [s] compares with home's; None: it was not tried.

        It may come up to `MAX_DELAY_S` after odometry of its stamp, and counts at its own. One that
        is later, or older than another picture before, is left out and counted.
        """
        said, t = t, self._clock.read(t)
        if seen is None:
            return
        if not math.isfinite(t) or t < max(self._pictured, self._odometry.newest - MAX_DELAY_S):
            self.counts.reject(Rejection.LATE_PICTURE)
            return
        self._pictured = t
        self._refused = 0 if seen.accepted else self._refused + 1
        if not seen.accepted:
            self._votes.add(t, seen)
            return
        self._votes.clear()
        self._moved_filter.add_comparison(seen)
        fix = self._pose(t, seen) or self._direction(t, seen, self._inner.estimate(said).polar)
        if fix is not None:
            self._fix = fused(self._carried(t), fix)
            self._forget_odometry()

    @guarded
    def estimate(self, t: float) -> Estimate:
        """Predict to `t` [s], not before the last sample, and change nothing."""
        mapped, at = self._inner.estimate(t), self._clock.peek(t)
        fix = self._carried(at)
        if fix is None or not (fix.tells_distance or fix.contradicted or not agree(mapped, fix)):
            return self._unless_refused(mapped if mapped.pose else self._voted(mapped, at))
        return self._answer(mapped, fix)

    @guarded
    def landmarks(self) -> list[LandmarkEstimate]:
        """Everything known of each landmark; none is called moved that may be a wrong match."""
        return self._moved_filter.filtered(self._inner.landmarks())

    def _voted(self, mapped: Estimate, t: float) -> Estimate:
        """Return the consensus of refused pictures; what the map says where there is none."""
        consensus = self._votes.at(t)
        if consensus is None:
            return mapped
        words = f"{consensus.votes} pictures that do not match home's agree on the direction home"
        there = self._of_robot(*_far(consensus.direction, UNKNOWN_DISTANCE))
        return self._answer(mapped, Fix(t, *there, False, False, False, words))

    def _answer(self, mapped: Estimate, fix: Fix) -> Estimate:
        """Return a pose that leads home, though its distance may be a guess."""
        status = Status.LOCALISED if fix.sure else Status.UNVERIFIED
        return Estimate(mapped.t, status, fix.reason, fix.pose, fix.covariance)

    def _unless_refused(self, mapped: Estimate) -> Estimate:
        """Return what the map says; unverified where home's picture should be seen, but is not."""
        polar = mapped.polar
        if polar is None or polar.R > NEAR_HOME or self._refused < REFUSALS:
            return mapped
        words = "the map says that this is home, but the pictures do not match"
        return dataclasses.replace(mapped, status=Status.UNVERIFIED, reason=words)

    def _pose(self, t: float, seen: Comparison) -> Fix | None:
        """Return the pose by resection; None where too few landmarks are seen or mapped."""
        anchors = self._anchors(seen)
        mapped = anchors.mapped
        if mapped.sum() < MIN_MAPPED or seen.motion is None:
            return None
        found = resect(anchors, _told(seen), seen.tilt_covariance)
        if found is None:
            return None
        there = found.pose, found.covariance
        agreeing, of = int(found.agrees[mapped].sum()), int(mapped.sum())
        words = f"{agreeing} of {of} mapped landmarks agree with home's picture"
        if agreeing < AGREEING * of:
            if seen.knows_direction:
                there = _far(_told(seen), UNKNOWN_DISTANCE)
            return Fix(t, *self._of_robot(*there), False, False, True, f"only {words}")
        return Fix(t, *self._of_robot(*there), True, True, False, words)

    def _direction(self, t: float, seen: Comparison, mapped: Polar | None) -> Fix | None:
        """Return heading and direction from home, the distance being the map's or a guess."""
        if not seen.knows_direction:
            return None
        there = _far(_told(seen), UNKNOWN_DISTANCE if mapped is None else float(mapped.R))
        words = "home's picture tells the direction home, but not how far it is"
        return Fix(t, *self._of_robot(*there), False, False, False, words)

    def _anchors(self, seen: Comparison) -> HomeLandmarks:
        """Return home's landmarks that are seen now."""
        pairs, rows = seen.pairs[seen.agrees], seen.home_row[seen.agrees]
        known = {m.landmark: m for m in self._inner.landmarks() if m.moved is False}
        home_mount = self._mounts()[0]
        distance, sigma = np.full((2, len(rows)), np.nan)
        for i, row in enumerate(rows.tolist()):
            landmark = known.get(home_name(row))
            if landmark is not None and math.isfinite(landmark.distance):
                at = between(home_mount, Pose(landmark.x, landmark.y, 0.0))
                distance[i], sigma[i] = math.hypot(at.x, at.y), landmark.sigma_distance
        mapped = np.isfinite(distance)
        if mapped.any():
            distance[~mapped] = np.median(distance[mapped])
            sigma[~mapped] = GUESSED * distance[~mapped]
        now, lean = seen.tilt.level(pairs.now)
        return HomeLandmarks(pairs.home[:, 0], now, pairs.sigma, distance, sigma, mapped, lean)

    def _mounts(self) -> tuple[Pose, Pose]:
        """Return the camera on the robot, at home and now: as told, or as was found out."""
        told, now = self._told, self._told.sensor.pose
        if isinstance(self._inner, EstimatesExtrinsics):
            now = self._inner.mount or now
        return (now if told.home_sensor is None else told.home_mount.pose), now

    def _of_robot(self, camera: Pose, covariance: np.ndarray) -> tuple[Pose, np.ndarray]:
        """Return pose and covariance of the robot's centre, from the camera's."""
        home_mount, mount = self._mounts()
        off = inverse(mount)
        robot = compose(compose(home_mount, camera), off)
        c, s = math.cos(home_mount.heading), math.sin(home_mount.heading)
        arm = compose(Pose(0.0, 0.0, home_mount.heading + camera.heading), off)
        jacobian = np.array([[c, -s, -arm.y], [s, c, arm.x], [0.0, 0.0, 1.0]])
        return robot, jacobian @ covariance @ jacobian.T

    def _carried(self, t: float) -> Fix | None:
        """Return the last fix, propagated to `t` by odometry; None where it is too old."""
        fix = self._fix
        if fix is None:
            return None
        t = max(fix.t, t)
        if t - fix.t > (POSE_HOLD_S if fix.tells_distance else DIRECTION_HOLD_S):
            return None
        return propagated(fix, t, self._odometry, self._noise_rates)

    def _forget_odometry(self) -> None:
        """Drop the odometry that no picture and no fix will need any more."""
        since = self._odometry.newest - MAX_DELAY_S
        if self._fix is not None and self._odometry.newest - self._fix.t <= DIRECTION_HOLD_S:
            since = min(since, self._fix.t)
        self._odometry.forget(since)


def _told(seen: Comparison) -> Direction:
    return Direction(seen.direction, seen.heading, seen.covariance)


def _far(told: Direction, distance: float) -> tuple[Pose, np.ndarray]:
    """Return the camera's pose, and its covariance, at a distance that nobody knows [m]."""
    there = Polar(distance, told.theta, told.alpha)
    covariance = np.zeros((3, 3))
    covariance[0, 0], covariance[1:, 1:] = UNKNOWN_DISTANCE**2, told.covariance
    return from_polar(there), polar_covariance_to_pose(there, covariance)


def agree(mapped: Estimate, fix: Fix) -> bool:
    """Say whether the map's pose lies in the direction that home's picture tells."""
    if mapped.pose is None or mapped.covariance is None:
        return False
    off = np.array(mapped.pose) - np.array(fix.pose)
    off[2] = wrap(off[2])
    return bool(off @ np.linalg.solve(mapped.covariance + fix.covariance, off) <= CONTRADICTS**2)
