"""The loop of every simulated drive: a control law, wheels, and eyes that look now and then."""

from __future__ import annotations

import enum
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import zip_longest

import numpy as np

from homeward.drives.drive import (
    Drive,
    DriveSettings,
    HomeBearing,
    Odometry,
    OdometryNoise,
    Sensor,
    Sightings,
    Start,
)
from homeward.estimator import Estimate
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Polar, Pose, Twist, advance, compose, from_polar, to_polar
from homeward.lab.simulation.log import Log, stamps, within
from homeward.lab.simulation.scenario import Course, Repeat
from homeward.lab.simulation.sensing import Wheels
from homeward.lab.simulation.trajectories import make_control
from homeward.lab.simulation.world import Stream, generator, quantise

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
    """Drive, and log odometry and truth.

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
        Told now and then the share of the longest duration that is done, in [0, 1].

    Returns
    -------
    ending : Ending
        Why the drive ended.
    pose : Pose
        True pose in the home frame where it ended.
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
