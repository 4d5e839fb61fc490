"""The loop of every simulated drive: a control law, wheels, a camera, and the log."""

from __future__ import annotations

import enum
import math
from bisect import bisect_left
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import zip_longest

import numpy as np

from homeward.control.goals import Belief
from homeward.drives.drive import (
    Drive,
    DriveSettings,
    HomeBearing,
    Odometry,
    OdometryNoise,
    Sensor,
    Sightings,
    Start,
    Truth,
)
from homeward.estimator import Estimate, Estimator
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Polar, Pose, Twist, advance, compose, from_polar, to_polar
from homeward.lab.simulation.scenario import Course, Repeat
from homeward.lab.simulation.sensing import Wheels
from homeward.lab.simulation.trajectories import exact, make_control
from homeward.lab.simulation.world import Stream, generator, quantise


def stamps(course: Course) -> tuple[list[float], list[float], list[float]]:
    """Return the increasing stamps of a drive's odometry, bearings and truth [s]."""
    rates, duration = course.rates, course.trajectory.duration
    rng = generator(course, Stream.TIMES)
    odometry = _stamps(rates.odometry, duration, rates.jitter, rng)
    bearings = _stamps(rates.bearings, duration, rates.jitter, rng)
    return odometry, bearings, _stamps(rates.truth, duration, 0.0, rng)


def within(stamps: list[float], begin: float, end: float) -> list[float]:
    """Return those in [begin, end) of increasing stamps."""
    return stamps[bisect_left(stamps, begin) : bisect_left(stamps, end)]


def _stamps(rate: float, duration: float, jitter: float, rng: np.random.Generator) -> list[float]:
    """Return increasing stamps [s] from 0 to `duration`, whole milliseconds."""
    regular = np.arange(int(duration * rate + 1e-9) + 1) / rate
    off = rng.uniform(-jitter, jitter, regular.size)
    off[0] = 0.0
    return [quantise(t, 3) for t in (regular + off).tolist()]


class Log:
    """What a robot would log, told to the estimator in the loop as it is written.

    `yaw` is that of the camera on the robot [rad].
    """

    def __init__(self, estimator: Estimator | None, yaw: float = 0.0) -> None:
        self._estimator, self._yaw = estimator, yaw
        self._odometry: list[tuple[float, float, float]] = []
        self._sightings: list[tuple[float, str, float, float]] = []
        self._truth: list[tuple[float, float, float, float]] = []
        self.estimates: list[Estimate] = []
        self.seen: dict[str, float] = {}
        """Id to direction in the home frame [rad], of what was seen last, as far as is known."""
        self._latest: Mapping[str, float] = {}
        self.last_words = ""
        """Why the robot gave up."""

    def believed(self, t: float, true: Pose) -> Belief:
        """Return the estimate that steers: the estimator's, or the truth."""
        if self._estimator is None:
            return exact(true, self.seen)
        estimate = self._estimator.estimate(t)
        return Belief(estimate.status, estimate.pose, estimate.covariance, self.seen)

    def odometry(self, t: float, twist: Twist) -> None:
        """Log a measured twist."""
        self._odometry.append((t, twist.v, twist.omega))
        if self._estimator is not None:
            self._estimator.odometry(t, twist.v, twist.omega)

    def bearings(
        self, t: float, seen: Mapping[str, float], sigmas: Mapping[str, float] | None = None
    ) -> None:
        """Log id to bearing and perhaps sigma [rad]; where nothing was seen, nothing is left."""
        self._latest, given = seen, sigmas or {}
        self._sightings.extend((t, i, value, given.get(i, np.nan)) for i, value in seen.items())
        if self._estimator is not None and seen:
            self.estimates.append(self._estimator.bearings(t, seen, sigmas))

    def face(self, t: float, true: Pose) -> None:
        """Turn what was seen at `t` [s] into the home frame, by the heading of what steers."""
        if self.estimates and self.estimates[-1].t == t:
            pose = self.estimates[-1].pose  # it has just answered
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
        """Return the drive with everything that was logged."""
        return replace(
            drive,
            odometry=Odometry(*np.array(self._odometry, float).T),
            sightings=Sightings.of_rows(self._sightings),
            truth=Truth(*np.array(self._truth, float).T),
        )


STEPS_PER_TELLING = 200
"""Progress is told once in so many steps."""


class Ending(enum.Enum):
    """Why a drive ended."""

    DONE = "done"
    """The control law was done, as far as the robot knew."""
    GAVE_UP = "gave up"
    """It got nowhere."""
    TIME_UP = "time up"
    """The longest duration was reached."""


@dataclass(frozen=True)
class Driven:
    """What came of a simulated drive."""

    drive: Drive
    """With truth in the home frame."""
    ending: Ending
    final_pose: Pose
    """True pose in the home frame where the drive ended."""
    estimates: list[Estimate]
    """What the estimator in the loop answered to each stamp of bearings; empty without one."""

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
    """Drive, and log odometry and truth; return why the drive ended, and the true pose there.

    Parameters
    ----------
    course : Course
        What is driven.
    log : Log
        What is written to, and who is asked for the pose that steers.
    look : callable
        Called at each stamp of the camera with the time [s] and the true pose of the robot's
        centre in the home frame; it logs what it sees.
    home : mapping of str to float
        Home bearings [rad] by their ids, for laws that steer by them.
    progress : callable, optional
        Called now and then with the share of the longest duration that is done, in [0, 1].
    """
    pose = course.start.in_home_frame(course.home.pose)
    control, wheels = make_control(course, pose, home), Wheels(course)
    odometry, bearings, truth = stamps(course)
    push = course.trajectory.push if isinstance(course.trajectory, Repeat) else None
    for step, (t, until) in enumerate(zip_longest(odometry, odometry[1:])):
        if progress is not None and step % STEPS_PER_TELLING == 0:
            progress(t / course.trajectory.duration)
        twist = control.twist(t, log.believed(t, pose))
        if twist is None or until is None:
            break
        log.odometry(t, wheels.measure(twist))
        for stamp in within(bearings, t, until):
            there = advance(pose, twist, stamp - t)
            look(stamp, there)
            log.face(stamp, there)
        for stamp in within(truth, t, until):
            log.truth(stamp, advance(pose, twist, stamp - t))
        pose = advance(pose, twist, until - t)
        if push is not None and t <= push.at < until:
            pose = compose(pose, Pose(push.x, push.y, push.turn))
    # Every drive ends standing still, with a last word of odometry and truth.
    log.odometry(t, wheels.measure(Twist(0.0, 0.0)))
    log.truth(t, pose)
    log.last_words = control.gave_up
    ended = Ending.GAVE_UP if control.gave_up else Ending.DONE
    return ended if twist is None else Ending.TIME_UP, pose


def before(
    course: Course,
    home: dict[str, HomeBearing],
    bearing_sigma: float | None,
    field_of_view: float,
) -> Drive:
    """Return the drive of a course before it begins: home and settings, no samples.

    Of errors that were drawn it tells the sigmas alone. Sigma, where known, and field of view are
    those of the camera [rad].
    """
    told = set(OdometryNoise.model_fields)
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
            odometry=OdometryNoise(**course.odometry.model_dump(include=told)),
            start=_draw_prior(course) if course.start.prior else None,
        ),
    )


def _draw_prior(scenario: Course) -> Start:
    """Return a start prior whose mean is off the truth as its sigmas say."""
    start = scenario.start
    true = to_polar(start.in_home_frame(scenario.home.pose))
    sigmas = np.array([start.sigma_R, start.sigma_theta, start.sigma_alpha])
    drawn = Polar(*(np.array(true) + sigmas * generator(scenario, Stream.PRIOR).standard_normal(3)))
    if drawn.R < 0:  # the same place, said with a positive distance
        drawn = to_polar(from_polar(drawn))
    return Start(
        R=quantise(drawn.R, 4),
        theta=quantise(wrap(drawn.theta), 4),
        alpha=quantise(wrap(drawn.alpha), 4),
        sigma_R=start.sigma_R,
        sigma_theta=start.sigma_theta,
        sigma_alpha=start.sigma_alpha,
    )
