"""Loop of a simulated drive: control law, sensors and log."""

from __future__ import annotations

import enum
import math
from bisect import bisect_left
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import zip_longest

import numpy as np

from homeward.control.goals import Belief
from homeward.drives.drive import Drive, HomeBearing, Odometry, Sightings, Truth
from homeward.drives.settings import DriveSettings, OdometryNoise, Sensor, Start
from homeward.estimator import Estimate, Estimator, add_twist
from homeward.geometry.angles import wrap
from homeward.geometry.frames import (
    Polar,
    Pose,
    Twist,
    advance,
    bearing,
    compose,
    from_polar,
    to_polar,
)
from homeward.lab.simulation.scenario import Course, OdometryErrors, Repeat, Robot, Scenario
from homeward.lab.simulation.trajectories import exact, make_control
from homeward.lab.simulation.world import Stream, World, generator, in_view, quantise


class Wheels:
    """Odometry: the commanded twist, which the robot follows exactly, plus errors."""

    def __init__(self, scenario: Course) -> None:
        errors, root = scenario.odometry, math.sqrt(scenario.rates.odometry)
        constants = generator(scenario, Stream.ODOMETRY_CONSTANTS)
        self._speed_scale, self._turn_scale, self._turn_bias = _constant_errors(errors, constants)
        self._sigmas = errors.speed_sigma * root, errors.turn_sigma * root
        self._noise = generator(scenario, Stream.ODOMETRY)
        sideways, scale = errors.sideways_sigma, errors.sideways_scale
        self._sideways_sigma = self._sigmas[0] if sideways is None else sideways * root
        if scale is None:
            scale = (errors.sideways_scale_sigma or 0.0) * float(constants.standard_normal())
        self._sideways_scale = (1.0 + self._speed_scale) * (1.0 + scale)

    def measure_sideways(self, vy: float) -> float:
        """Return the measured speed to the left of a robot that moves sideways [m/s]."""
        white = float(self._noise.standard_normal())
        return quantise(self._sideways_scale * vy + self._sideways_sigma * white, 4)

    def measure(self, twist: Twist) -> Twist:
        """Return the measured twist, rounded as in a log."""
        white_v, white_omega = self._noise.standard_normal(2).tolist()
        v = (1 + self._speed_scale) * twist.v + self._sigmas[0] * white_v
        omega = (1 + self._turn_scale) * twist.omega + self._turn_bias
        return Twist(quantise(v, 4), quantise(omega + self._sigmas[1] * white_omega, 4))


def _constant_errors(
    errors: OdometryErrors, rng: np.random.Generator
) -> tuple[float, float, float]:
    """Return the speed scale, turn scale and turn bias [rad/s]: given, or drawn for this drive."""
    draws = rng.standard_normal(3).tolist()
    given = errors.speed_scale, errors.turn_scale, errors.turn_bias
    sigmas = errors.speed_scale_sigma, errors.turn_scale_sigma, errors.turn_bias_sigma
    speed_scale, turn_scale, turn_bias = (
        sigma * draw if value is None else value
        for value, sigma, draw in zip(given, sigmas, draws, strict=True)
    )
    return speed_scale, turn_scale, turn_bias


SWAY_HZ = 2.0
"""Frequency of the sway of legs [Hz]."""


class Chassis:
    """Twist of a robot that drives a path with any heading."""

    def __init__(self, robot: Robot) -> None:
        self._robot, self._off = robot, 0.0
        self.is_holonomic = robot.drive != "differential" or robot.sway > 0.0
        """Whether the robot moves sideways."""

    def ahead(self, belief: Belief) -> Belief:
        """Return the belief of a robot that looks where it drives."""
        pose = belief.pose
        if pose is None or not self._off:
            return belief
        return belief._replace(pose=pose._replace(heading=pose.heading - self._off))

    def driven(self, t: float, twist: Twist, dt: float) -> tuple[Twist, float]:
        """Return the twist, and the speed to the left [m/s], for `dt` [s] of a twist ahead."""
        robot, off = self._robot, self._off
        sway = robot.sway * math.cos(math.tau * SWAY_HZ * t) if twist.v else 0.0
        if robot.drive == "differential":
            return twist, sway
        omega = robot.yaw_rate if robot.drive == "omni" else 0.0
        self._off += (omega - twist.omega) * dt
        return Twist(twist.v * math.cos(off), omega), sway - twist.v * math.sin(off)


class Camera:
    """Camera: noisy bearings of a random part of the landmarks in view."""

    def __init__(self, scenario: Scenario, world: World) -> None:
        self._scenario, self._world = scenario, world
        self._chance = generator(scenario, Stream.VISIBILITY)
        self._noise = generator(scenario, Stream.BEARINGS)
        self._confusion = generator(scenario, Stream.WRONG_IDS)

    def look(self, robot: Pose) -> dict[str, float]:
        """Return id to bearing from the camera's axis [rad], rounded as in a log.

        `robot` is the true pose of its centre in the home frame. Each call draws as many random
        numbers as there are landmarks, so that the noise does not depend on the view.
        """
        world, sigma = self._world, self._scenario.noise.bearing_sigma
        camera = compose(world.home, compose(robot, self._scenario.sensor.pose))
        noise = sigma * self._noise.standard_normal(len(world.ids))
        measured = wrap(bearing(camera, world.places[:, 0], world.places[:, 1]) + noise)
        ids = self._read_ids()
        return {ids[i]: quantise(measured[i], 5) for i in np.flatnonzero(self._seen(camera))}

    def _seen(self, camera: Pose) -> np.ndarray:
        """Return which landmarks are seen, shape (q,), from a camera in room coordinates.

        Each landmark in view is seen with the given probability. If these are fewer than
        `at_least`, further landmarks in view are added at random up to that number.
        """
        visibility = self._scenario.visibility
        view = in_view(camera, self._world.places, visibility, self._scenario.room)
        draw = self._chance.random(view.size)
        seen = view & (draw < visibility.probability)
        wanted = min(visibility.at_least, int(view.sum()))
        if seen.sum() < wanted:
            luckiest = np.argsort(np.where(view, draw, np.inf), kind="stable")[:wanted]
            seen[luckiest] = True
        return np.asarray(seen)

    def _read_ids(self) -> list[str]:
        """Return the id that is read for each landmark; a share of the ids is wrong."""
        ids, q = self._world.ids, len(self._world.ids)
        wrong = self._confusion.random(q) < self._scenario.noise.wrong_ids
        steps = self._confusion.integers(1, max(q, 2), q)
        return [ids[(i + int(steps[i])) % q] if wrong[i] else ids[i] for i in range(q)]


def stamps(course: Course) -> tuple[list[float], list[float], list[float]]:
    """Return the increasing stamps of odometry, bearings and ground truth [s]."""
    rates, duration = course.rates, course.trajectory.duration
    rng = generator(course, Stream.TIMES)
    odometry = _stamps(rates.odometry, duration, rates.jitter, rng)
    bearings = _stamps(rates.bearings, duration, rates.jitter, rng)
    return odometry, bearings, _stamps(rates.truth, duration, 0.0, rng)


def within(stamps: list[float], begin: float, end: float) -> list[float]:
    """Return the stamps in [begin, end), from increasing stamps."""
    return stamps[bisect_left(stamps, begin) : bisect_left(stamps, end)]


def _stamps(rate: float, duration: float, jitter: float, rng: np.random.Generator) -> list[float]:
    """Return increasing stamps [s] from 0 to `duration`, in whole milliseconds."""
    regular = np.arange(int(duration * rate + 1e-9) + 1) / rate
    off = rng.uniform(-jitter, jitter, regular.size)
    off[0] = 0.0
    return [quantise(t, 3) for t in (regular + off).tolist()]


class Log:
    """Log of a robot; each sample also goes to the estimator in the loop.

    `yaw` is the camera's yaw on the robot [rad].
    """

    def __init__(self, estimator: Estimator | None, yaw: float = 0.0) -> None:
        self._estimator, self._yaw = estimator, yaw
        self._odometry: list[tuple[float, float, float, float]] = []
        self._sightings: list[tuple[float, str, float, float]] = []
        self._truth: list[tuple[float, float, float, float]] = []
        self.estimates: list[Estimate] = []
        self.seen: dict[str, float] = {}
        """Id to direction [rad] of the last sightings, in the estimated home frame."""
        self._latest: Mapping[str, float] = {}
        self.failure = ""
        """Why the robot gave up."""

    def believed(self, t: float, true: Pose) -> Belief:
        """Return the estimate that the controller uses: the estimator's, or the true pose."""
        if self._estimator is None:
            return exact(true, self.seen)
        estimate = self._estimator.estimate(t)
        return Belief(estimate.status, estimate.pose, estimate.covariance, self.seen)

    def odometry(self, t: float, twist: Twist, vy: float = 0.0) -> None:
        """Log a measured twist, and the speed to the left [m/s]."""
        self._odometry.append((t, twist.v, twist.omega, vy))
        if self._estimator is not None:
            add_twist(self._estimator, t, twist.v, twist.omega, vy)

    def bearings(
        self, t: float, seen: Mapping[str, float], sigmas: Mapping[str, float] | None = None
    ) -> None:
        """Log bearings and optional sigmas by id [rad]; without sightings nothing is logged."""
        self._latest, given = seen, sigmas or {}
        self._sightings.extend((t, i, value, given.get(i, np.nan)) for i, value in seen.items())
        if self._estimator is not None and seen:
            self.estimates.append(self._estimator.bearings(t, seen, sigmas))

    def face(self, t: float, true: Pose) -> None:
        """Rotate the sightings at `t` [s] into the home frame by the heading used for control."""
        if self.estimates and self.estimates[-1].t == t:
            pose = self.estimates[-1].pose  # the answer to these sightings
        else:
            pose = self.believed(t, true).pose
        if pose is not None:
            turn = self._yaw + pose.heading
            self.seen = {i: float(wrap(b + turn)) for i, b in self._latest.items()}

    def truth(self, t: float, pose: Pose) -> None:
        """Log the true pose in the home frame."""
        heading = float(wrap(pose.heading))
        self._truth.append((t, quantise(pose.x, 4), quantise(pose.y, 4), quantise(heading, 4)))

    def fill(self, drive: Drive) -> Drive:
        """Return the drive with the logged samples."""
        return replace(
            drive,
            odometry=Odometry(*np.array(self._odometry, float).T),
            sightings=Sightings.of_rows(self._sightings),
            truth=Truth(*np.array(self._truth, float).T),
        )


STEPS_PER_REPORT = 200
"""Number of steps between two reports of progress."""


class Ending(enum.Enum):
    """Why a drive ended."""

    DONE = "done"
    """The control law ended, according to the robot's estimate."""
    GAVE_UP = "gave up"
    """The robot made no progress."""
    TIME_UP = "time up"
    """The maximum duration was reached."""


@dataclass(frozen=True)
class Driven:
    """Result of a simulated drive."""

    drive: Drive
    """With ground truth in the home frame."""
    ending: Ending
    final_pose: Pose
    """True pose in the home frame at the end."""
    estimates: list[Estimate]
    """Answers of the estimator in the loop, one for each stamp of bearings; empty without one."""

    @property
    def final_distance(self) -> float:
        """True distance from home at the end [m]."""
        return math.hypot(self.final_pose.x, self.final_pose.y)


def drive_course(
    course: Course,
    log: Log,
    look: Callable[[float, Pose], None],
    home: Mapping[str, float],
    progress: Callable[[float], None] | None = None,
) -> tuple[Ending, Pose]:
    """Drive, and log odometry and ground truth; return why the drive ended, and the last true pose.

    `look` logs the sightings: it is called at each stamp of the camera with the time [s] and the
    true pose of the robot's centre in the home frame. `home` has home bearings [rad] by id, for
    bearing-only laws. `progress` receives the fraction of the maximum duration, in [0, 1].
    """
    pose = course.start.in_home_frame(course.home.pose)
    control, wheels, chassis = (
        make_control(course, pose, home),
        Wheels(course),
        Chassis(course.robot),
    )
    odometry, bearings, truth = stamps(course)
    push = course.trajectory.push if isinstance(course.trajectory, Repeat) else None
    for step, (t, until) in enumerate(zip_longest(odometry, odometry[1:])):
        if progress is not None and step % STEPS_PER_REPORT == 0:
            progress(t / course.trajectory.duration)
        wanted = control.twist(t, chassis.ahead(log.believed(t, pose)))
        if wanted is None or until is None:
            break
        twist, vy = chassis.driven(t, wanted, until - t)
        measured = wheels.measure(twist)
        log.odometry(t, measured, wheels.measure_sideways(vy) if chassis.is_holonomic else 0.0)
        for stamp in within(bearings, t, until):
            there = advance(pose, twist, stamp - t, vy)
            look(stamp, there)
            log.face(stamp, there)
        for stamp in within(truth, t, until):
            log.truth(stamp, advance(pose, twist, stamp - t, vy))
        pose = advance(pose, twist, until - t, vy)
        if push is not None and t <= push.at < until:
            pose = compose(pose, Pose(push.x, push.y, push.turn))
    # Every drive ends at rest, with a last sample of odometry and ground truth.
    log.odometry(t, wheels.measure(Twist(0.0, 0.0)))
    log.truth(t, pose)
    log.failure = control.gave_up
    ended = Ending.GAVE_UP if control.gave_up else Ending.DONE
    return ended if wanted is None else Ending.TIME_UP, pose


def before(
    course: Course,
    home: dict[str, HomeBearing],
    bearing_sigma: float | None,
    field_of_view: float,
) -> Drive:
    """Return the drive of a course before it begins: home and settings, no samples.

    Its settings contain the sigmas of the drawn errors, not the errors. `bearing_sigma` (None where
    unknown) and `field_of_view` are those of the camera [rad].
    """
    errors = course.odometry.model_dump(exclude_none=True)
    sigmas = {key: sigma for key, sigma in errors.items() if key.endswith("_sigma")}
    if Chassis(course.robot).is_holonomic:
        same = {"sideways_sigma": course.odometry.speed_sigma, "sideways_scale_sigma": 0.0}
        sigmas = same | sigmas
    return Drive(
        name=course.name,
        odometry=Odometry(*np.empty((3, 0))),
        sightings=Sightings.of_rows(()),
        home=home,
        settings=DriveSettings(
            sensor=Sensor(
                **course.sensor.model_dump(),
                bearing_sigma=bearing_sigma,
                field_of_view=field_of_view,
            ),
            home_sensor=course.home_sensor,
            odometry=OdometryNoise(**sigmas),
            start=_draw_prior(course) if course.start.prior else None,
        ),
    )


def _draw_prior(scenario: Course) -> Start:
    """Return a start prior whose mean is drawn around the true start with its sigmas."""
    true, sigmas = to_polar(scenario.start.in_home_frame(scenario.home.pose)), scenario.start.sigmas
    drawn = Polar(*(np.array(true) + sigmas * generator(scenario, Stream.PRIOR).standard_normal(3)))
    if drawn.R < 0:  # the same place with a positive distance
        drawn = to_polar(from_polar(drawn))
    mean = drawn.R, wrap(drawn.theta), wrap(drawn.alpha)
    return Start.about(Polar(*(quantise(value, 4) for value in mean)), *sigmas)
