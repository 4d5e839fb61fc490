"""Visual homing: an estimator that compares each panorama with home's, around one that maps.

Two panoramas give heading and direction from home at once, while a map takes time; and near home
their pose is more accurate than the map's (`homing.resection`). Odometry bridges the time between
comparisons. A pose that home's picture contradicts is never reported as localised.

The moved-landmark filter distinguishes landmarks that moved from wrong matches. Most features whose
home bearing is wrong were matched with another feature of home: such matches come and go, or slide
along an edge. A feature of a moved object is seen repeatedly, clearly away from its old position;
or is matched together with others of that object; or has moved like a neighbour of which that is
known.
"""

from __future__ import annotations

import dataclasses
import math
import threading
from collections import Counter
from collections.abc import Iterable, Mapping
from typing import Unpack

import numpy as np

from homeward.drives.robot import known_robot
from homeward.drives.settings import OdometryDefaults, Robot, noise_rates
from homeward.errors import Restartable
from homeward.estimator import (
    Counts,
    Estimate,
    EstimatesExtrinsics,
    Estimator,
    LandmarkEstimate,
    Status,
    add_twist,
    guarded,
    synchronised,
    takes_sideways,
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
from homeward.geometry.se2 import lever, rotation
from homeward.io.blas_threads import single_threaded_blas
from homeward.odometry.history import TwistHistory
from homeward.odometry.validity import MAX_DELAY_S, MAX_RATE, Clock
from homeward.reasons import Rejection
from homeward.vision.comparison import Comparison
from homeward.vision.front_end import home_name
from homeward.vision.homing.fix import (
    DIRECTION_HOLD_S,
    POSE_HOLD_S,
    DirectionVoting,
    Fix,
    fused,
    propagated,
)
from homeward.vision.homing.resection import NEAR_HOME, Direction, HomeLandmarks, resect

LASTING_SIGHTINGS, LASTING_SHARE = 8, 0.3
"""Minimum number of sightings of a lasting landmark, also as a share of frames since the first."""
MIN_MOVED_M = 0.2
"""Minimum shift of a lasting landmark across the line from home [m]: features slide on edges by
less."""
MIN_TOGETHER, TOGETHER_SHARE = 3, 0.1
"""Minimum number of frames, also as a share of its sightings, with a landmark in a moved group."""
ALIKE = 0.2
"""Maximum angle at home between a moved landmark and a neighbour [rad], and maximum relative
difference of their distances and of their bearing errors."""


class MovedLandmarkFilter:
    """Collects sightings of landmarks, and reverts `moved` where a wrong match explains it."""

    def __init__(self) -> None:
        self._frames = 0
        self._seen: dict[str, tuple[int, int]] = {}
        """Number of sightings of each landmark, and of frames before the first."""
        self._together: Counter[str] = Counter()
        """Number of frames in which each landmark was in a moved group."""

    def add_frame(self, names: Iterable[str]) -> None:
        """Add the landmarks seen in one frame."""
        for name in names:
            times, first = self._seen.get(name, (0, self._frames))
            self._seen[name] = times + 1, first
        self._frames += 1

    def add_comparison(self, seen: Comparison) -> None:
        """Add the comparison of a frame with home's picture."""
        self._together.update(home_name(row) for row in seen.home_row[seen.moved].tolist())

    def filtered(self, landmarks: list[LandmarkEstimate]) -> list[LandmarkEstimate]:
        """Return the landmarks; `moved` is None where it may be due to a wrong match."""
        moved = [m for m in landmarks if m.moved]
        certain = [m for m in moved if self._lasts(m) or self._in_moved_group(m)]
        kept = {m.landmark for m in moved if any(m is s or _moved_alike(m, s) for s in certain)}
        return [
            m
            if not m.moved or m.landmark in kept
            else dataclasses.replace(m, moved=None, moved_probability=math.nan)
            for m in landmarks
        ]

    def _lasts(self, found: LandmarkEstimate) -> bool:
        """Return whether a landmark moved during the drive, or is lastingly seen elsewhere."""
        times, first = self._seen.get(found.landmark, (0, self._frames))
        lasting = times >= LASTING_SIGHTINGS and times >= LASTING_SHARE * (self._frames - first)
        away = found.distance * abs(_bearing_error(found))
        return math.isfinite(found.moved_at) or (lasting and away >= MIN_MOVED_M)

    def _in_moved_group(self, found: LandmarkEstimate) -> bool:
        """Return whether a landmark was in a moved group in enough frames."""
        times, _ = self._seen.get(found.landmark, (0, 0))
        return self._together[found.landmark] >= max(MIN_TOGETHER, TOGETHER_SHARE * times)


def _bearing_error(found: LandmarkEstimate) -> float:
    """Return the error of a stored home bearing [rad]."""
    return float(wrap(found.home_bearing_estimated - found.home_bearing_stored))


def _moved_alike(found: LandmarkEstimate, other: LandmarkEstimate) -> bool:
    """Return whether two landmarks were neighbours at home, and have moved in the same way."""
    apart = wrap(found.home_bearing_stored - other.home_bearing_stored)
    error, error_of_other = _bearing_error(found), _bearing_error(other)
    return (
        abs(float(apart)) < ALIKE
        and abs(float(wrap(error - error_of_other))) < ALIKE * abs(error_of_other)
        and abs(found.distance - other.distance) < ALIKE * other.distance
    )


MIN_MAPPED = 4
"""Minimum number of mapped landmarks in a resection: one more than a pose has unknowns."""
MIN_AGREEING = 0.7
"""Minimum share of mapped landmarks that agree with a resection."""
GUESS_SIGMA = 4.0
"""Standard deviation of the distance of an unmapped landmark, as a multiple of the median."""
UNKNOWN_DISTANCE = 3.0
"""Assumed distance from home if only the direction is known, and its standard deviation [m]."""
CONTRADICTS = 4.0
"""Difference from which map and home's picture contradict each other [standard deviations]."""
REFUSALS = 3
"""Number of refused comparisons after which a pose within `NEAR_HOME` is unverified."""


class VisualHoming:
    """Adds visual homing to an estimator, which maps the landmarks; itself an `Estimator`.

    `robot` is as given to it: camera extrinsics, now and at home.
    """

    def __init__(self, estimator: Estimator, **robot: Unpack[Robot]) -> None:
        self._inner, self._turn = estimator, threading.RLock()
        self.name, self.uses_sideways = estimator.name, takes_sideways(estimator)
        self._robot = known_robot(robot)
        self._odometry = TwistHistory()
        self._noise_rates = noise_rates(self._robot.odometry, OdometryDefaults())
        self._fix: Fix | None = None
        self._pictured = -math.inf
        """The newest stamp of a picture [s]."""
        self._refused = 0
        """Number of refused comparisons in a row."""
        self._moved_filter, self._votes = MovedLandmarkFilter(), DirectionVoting(self._odometry)
        self._clock = Clock()

    def restart(self) -> None:
        """Restart the inner estimator after an internal error, and forget the last fix.

        `TypeError` where it cannot be restarted.
        """
        if not isinstance(self._inner, Restartable):
            raise TypeError(f"{self._inner.name} cannot be restarted")
        self._inner.restart()
        self._fix, self._votes = None, DirectionVoting(self._odometry)

    @property
    def counts(self) -> Counts:
        """Counts of the inner estimator, and of late pictures."""
        return self._inner.counts

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes of the inner estimator."""
        return self._inner.notes

    @guarded
    def odometry(self, t: float, v: float, omega: float, vy: float = 0.0) -> None:
        """Process a twist that is valid from `t` [s] on, as `Localizer.odometry`."""
        add_twist(self._inner, t, v, omega, vy)
        t = self._clock.read(t)
        if not (math.isfinite(t) and all(abs(rate) < MAX_RATE for rate in (v, omega, vy))):
            return
        if t >= self._odometry.newest:
            self._odometry.add(t, v, omega, vy=vy)
            self._forget_odometry()

    @guarded
    def bearings(
        self, t: float, sightings: Mapping[str, float], sigmas: Mapping[str, float] | None = None
    ) -> Estimate:
        """Process all sightings of stamp `t` [s] (id to bearing [rad] from the camera's axis)."""
        self._moved_filter.add_frame(sightings)
        innovations = self._inner.bearings(t, sightings, sigmas).innovations
        return dataclasses.replace(self.estimate(t), innovations=innovations)

    @synchronised
    @single_threaded_blas()
    def home(self, t: float, seen: Comparison | None) -> None:
        """Process the comparison of the picture of stamp `t` [s] with home's; None: not made.

        It may arrive up to `MAX_DELAY_S` after odometry of its stamp. Later pictures, and pictures
        older than an earlier one, are ignored and counted.
        """
        stamp, t = t, self._clock.read(t)
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
        fix = self._pose(t, seen) or self._direction(t, seen, self._inner.estimate(stamp).polar)
        if fix is not None:
            self._fix = fused(self._carried(t), fix)
            self._forget_odometry()

    @guarded
    def estimate(self, t: float) -> Estimate:
        """Predict to `t` [s], not before the last sample, without changing the state."""
        mapped, at = self._inner.estimate(t), self._clock.peek(t)
        fix = self._carried(at)
        if fix is None or not (fix.has_distance or fix.contradicted or not agree(mapped, fix)):
            return self._unless_refused(mapped if mapped.pose else self._voted(mapped, at))
        return self._answer(mapped, fix)

    @guarded
    def landmarks(self) -> list[LandmarkEstimate]:
        """Estimate of each landmark; `moved` is None where it may be due to a wrong match."""
        return self._moved_filter.filtered(self._inner.landmarks())

    def _voted(self, mapped: Estimate, t: float) -> Estimate:
        """Return the consensus of refused pictures; the map's estimate if there is none."""
        consensus = self._votes.at(t)
        if consensus is None:
            return mapped
        words = f"{consensus.votes} pictures that do not match home's agree on the direction home"
        there = self._of_robot(*_far(consensus.direction, UNKNOWN_DISTANCE))
        return self._answer(mapped, Fix(t, *there, False, False, False, words))

    def _answer(self, mapped: Estimate, fix: Fix) -> Estimate:
        """Return the estimate of a fix, whose distance may be a guess."""
        status = Status.LOCALISED if fix.is_verified else Status.UNVERIFIED
        return Estimate(mapped.t, status, fix.reason, fix.pose, fix.covariance)

    def _unless_refused(self, mapped: Estimate) -> Estimate:
        """Return the map's estimate; unverified if home's picture should match, but does not."""
        polar = mapped.polar
        if polar is None or polar.R > NEAR_HOME or self._refused < REFUSALS:
            return mapped
        words = "home according to the map, but the pictures do not match"
        return dataclasses.replace(mapped, status=Status.UNVERIFIED, reason=words)

    def _pose(self, t: float, seen: Comparison) -> Fix | None:
        """Return the pose from resection; None if too few landmarks are seen or mapped."""
        anchors = self._anchors(seen)
        mapped = anchors.mapped
        if mapped.sum() < MIN_MAPPED or seen.motion is None:
            return None
        found = resect(anchors, _measured(seen), seen.tilt_covariance)
        if found is None:
            return None
        there = found.pose, found.covariance
        agreeing, of = int(found.agrees[mapped].sum()), int(mapped.sum())
        words = f"{agreeing} of {of} mapped landmarks agree with home's picture"
        if agreeing < MIN_AGREEING * of:
            if seen.has_direction:
                there = _far(_measured(seen), UNKNOWN_DISTANCE)
            return Fix(t, *self._of_robot(*there), False, False, True, f"only {words}")
        return Fix(t, *self._of_robot(*there), True, True, False, words)

    def _direction(self, t: float, seen: Comparison, mapped: Polar | None) -> Fix | None:
        """Return heading and direction from home, with the map's distance or a guess."""
        if not seen.has_direction:
            return None
        there = _far(_measured(seen), UNKNOWN_DISTANCE if mapped is None else float(mapped.R))
        words = "home's picture gives the direction home, but not the distance"
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
            sigma[~mapped] = GUESS_SIGMA * distance[~mapped]
        now, lean = seen.tilt.level(pairs.now)
        return HomeLandmarks(pairs.home[:, 0], now, pairs.sigma, distance, sigma, mapped, lean)

    def _mounts(self) -> tuple[Pose, Pose]:
        """Return the camera extrinsics at home and now, as given or as estimated."""
        robot, now = self._robot, self._robot.sensor.pose
        if isinstance(self._inner, EstimatesExtrinsics):
            now = self._inner.mount or now
        return (now if robot.home_sensor is None else robot.home_mount.pose), now

    def _of_robot(self, camera: Pose, covariance: np.ndarray) -> tuple[Pose, np.ndarray]:
        """Return pose and covariance of the robot's centre, from the camera's."""
        home_mount, mount = self._mounts()
        there = compose(home_mount, camera)
        robot = compose(there, inverse(mount))
        jacobian = lever(np.subtract(robot, there)) @ rotation(home_mount.heading)
        return robot, jacobian @ covariance @ jacobian.T

    def _carried(self, t: float) -> Fix | None:
        """Return the last fix, propagated to `t` by odometry; None if it is too old."""
        fix = self._fix
        if fix is None:
            return None
        t = max(fix.t, t)
        if t - fix.t > (POSE_HOLD_S if fix.has_distance else DIRECTION_HOLD_S):
            return None
        return propagated(fix, t, self._odometry, self._noise_rates)

    def _forget_odometry(self) -> None:
        """Drop odometry that is older than any late picture or valid fix."""
        since = self._odometry.newest - MAX_DELAY_S
        if self._fix is not None and self._odometry.newest - self._fix.t <= DIRECTION_HOLD_S:
            since = min(since, self._fix.t)
        self._odometry.forget(since)


def _measured(seen: Comparison) -> Direction:
    return Direction(seen.direction, seen.heading, seen.covariance)


def _far(seen: Direction, distance: float) -> tuple[Pose, np.ndarray]:
    """Return the camera's pose and covariance from a direction and a guessed distance [m]."""
    there = Polar(distance, seen.theta, seen.alpha)
    covariance = np.zeros((3, 3))
    covariance[0, 0], covariance[1:, 1:] = UNKNOWN_DISTANCE**2, seen.covariance
    return from_polar(there), polar_covariance_to_pose(there, covariance)


def agree(mapped: Estimate, fix: Fix) -> bool:
    """Return whether the map's pose agrees with a fix from home's picture."""
    if mapped.pose is None or mapped.covariance is None:
        return False
    off = np.array(mapped.pose) - np.array(fix.pose)
    off[2] = wrap(off[2])
    return bool(off @ np.linalg.solve(mapped.covariance + fix.covariance, off) <= CONTRADICTS**2)
