"""The simulator: truth, sensors, an estimator perhaps, and a control law, in one loop.

The truth follows the commanded twist exactly; odometry and bearings measure it with their errors.
Numbers are kept as a log would hold them: stamps to 1 ms (the world is sampled at the rounded
stamp), twists to 1e-4 m/s and rad/s, bearings to 1e-5 rad, truth and start prior to 1e-4 m and rad.
An estimator in the loop gets these very numbers, so that a replay of the drive repeats it.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from homeward.angles import wrap
from homeward.control import Twist
from homeward.drives.drive import (
    Drive,
    DriveSettings,
    Odometry,
    OdometryNoise,
    Sensor,
    Sightings,
    Start,
)
from homeward.errors import InputError
from homeward.estimator import Estimate, Estimator
from homeward.frames import Polar, Pose, from_polar, to_polar
from homeward.simulation.log import Clock, Log
from homeward.simulation.scenario import Scenario
from homeward.simulation.sensing import Camera, Wheels
from homeward.simulation.trajectories import advance, make_control
from homeward.simulation.world import (
    Stream,
    World,
    build_world,
    generator,
    home_bearings,
    quantise,
)

STEPS_PER_TELLING = 200
"""Progress is told once in so many steps."""


class Ending(enum.Enum):
    """Why a drive ended."""

    DONE = "done"
    """The control law was done, as far as the robot knew."""
    TIME_UP = "time up"
    """The longest duration was reached."""


@dataclass(frozen=True)
class Simulation:
    """A simulated drive, and the truth about it."""

    scenario: Scenario
    drive: Drive
    """With truth in the home frame."""
    world: World
    ending: Ending
    final_pose: Pose
    """True pose in the home frame where the drive ended."""
    estimates: list[Estimate] = field(default_factory=list)
    """What the estimator in the loop answered to each stamp of bearings; empty without one."""

    @property
    def final_distance(self) -> float:
        """True distance from home at the end [m]."""
        return math.hypot(self.final_pose.x, self.final_pose.y)


def prepare(scenario: Scenario) -> Drive:
    """Return the drive of a scenario before it begins: home and settings, no samples.

    An estimator for the closed loop is made from this.

    Raises
    ------
    InputError
        When the scenario cannot be built.
    """
    return _prepare(scenario, build_world(scenario))


def simulate(
    scenario: Scenario,
    estimator: Estimator | None = None,
    progress: Callable[[float], None] | None = None,
) -> Simulation:
    """Simulate a drive.

    Parameters
    ----------
    scenario : Scenario
        What is driven, where and how; everything follows from it to the last bit.
    estimator : Estimator, optional
        A fresh one made for ``prepare(scenario)``, whose pose steers the robot; it is used up.
        None: the truth steers.
    progress : callable, optional
        Told now and then the share of the longest duration that is done, in [0, 1].

    Raises
    ------
    InputError
        When the scenario cannot be built, or names an estimator and none is given.
    """
    if estimator is None and scenario.estimator != "truth":
        raise InputError(f"estimator: the scenario is steered by {scenario.estimator}; none given")
    world = build_world(scenario)
    pose = scenario.start.in_home_frame(scenario.home.pose)
    control, wheels = make_control(scenario, pose), Wheels(scenario)
    camera, log, clock = Camera(scenario, world), Log(estimator), Clock(scenario)
    for step, (t, until) in enumerate(clock.steps()):
        if progress is not None and step % STEPS_PER_TELLING == 0:
            progress(t / scenario.trajectory.duration)
        twist = control.twist(t, *log.believed(t, pose))
        if twist is None or until is None:
            break
        log.odometry(t, wheels.measure(twist))
        for stamp in clock.bearings.before(until):
            log.bearings(stamp, camera.look(advance(pose, twist, stamp - t)))
        for stamp in clock.truth.before(until):
            log.truth(stamp, advance(pose, twist, stamp - t))
        pose = advance(pose, twist, until - t)
    # Every drive ends standing still, with a last word of odometry and truth.
    log.odometry(t, wheels.measure(Twist(0.0, 0.0)))
    log.truth(t, pose)
    ending = Ending.DONE if twist is None else Ending.TIME_UP
    drive = log.fill(_prepare(scenario, world))
    return Simulation(scenario, drive, world, ending, pose, log.estimates)


def _prepare(scenario: Scenario, world: World) -> Drive:
    nothing = np.empty(0)
    return Drive(
        name=scenario.name,
        odometry=Odometry(nothing, nothing, nothing),
        sightings=Sightings(nothing, np.empty(0, object), nothing, nothing),
        home=home_bearings(world, scenario),
        settings=_drive_settings(scenario),
    )


def _drive_settings(scenario: Scenario) -> DriveSettings:
    """Return what drive.yaml may tell of a scenario: never an error drawn, only its sigma."""
    errors, mount = scenario.odometry, scenario.sensor
    return DriveSettings(
        sensor=Sensor(
            x=mount.x,
            y=mount.y,
            yaw=mount.yaw,
            bearing_sigma=scenario.noise.bearing_sigma or None,
            field_of_view=scenario.visibility.field_of_view,
        ),
        home_sensor=scenario.home_sensor,
        odometry=OdometryNoise(
            speed_sigma=errors.speed_sigma,
            turn_sigma=errors.turn_sigma,
            speed_scale_sigma=errors.speed_scale_sigma,
            turn_scale_sigma=errors.turn_scale_sigma,
            turn_bias_sigma=errors.turn_bias_sigma,
        ),
        start=_draw_prior(scenario) if scenario.start.prior else None,
    )


def _draw_prior(scenario: Scenario) -> Start:
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
