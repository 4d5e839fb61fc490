"""The simulator: truth, sensors, an estimator perhaps, and a control law, in one loop.

The truth follows the commanded twist exactly; odometry and bearings measure it with their errors.
Numbers are kept as a log would hold them: stamps to 1 ms (the world is sampled at the rounded
stamp), twists to 1e-4 m/s and rad/s, bearings to 1e-5 rad, truth and start prior to 1e-4 m and rad.
An estimator in the loop gets these very numbers, so that a replay of the drive repeats it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from homeward.drives.drive import Drive
from homeward.errors import InputError
from homeward.estimator import Estimator
from homeward.geometry.frames import Pose
from homeward.lab.simulation.course import Camera, Driven, Log, before, drive_course
from homeward.lab.simulation.scenario import Scenario
from homeward.lab.simulation.trajectories import as_visitor
from homeward.lab.simulation.world import World, build_world, home_bearings


@dataclass(frozen=True)
class Simulation(Driven):
    """A simulated drive, and the truth about it."""

    scenario: Scenario
    world: World
    reason: str
    """Why the robot gave up, if it did."""


def prepare(scenario: Scenario) -> Drive:
    """Return the drive of a scenario before it begins: home and settings, no samples.

    An estimator for the closed loop is made from this; where a route is repeated, it knows the
    place instead of home. Raises `InputError` when the scenario cannot be built.
    """
    return as_visitor(scenario, _prepare(scenario, build_world(scenario)))


def simulate(
    scenario: Scenario,
    estimator: Estimator | None = None,
    progress: Callable[[float], None] | None = None,
) -> Simulation:
    """Simulate a drive, which follows from its scenario to the last bit.

    The pose of a fresh estimator, made for ``prepare(scenario)`` and used up, steers the robot;
    None: the truth. `progress` gets the share of the longest duration that is done, in [0, 1].
    Raises `InputError` when the scenario cannot be built, or names an estimator and none is given.
    """
    if estimator is None and scenario.estimator != "truth":
        raise InputError(f"estimator: the scenario is steered by {scenario.estimator}; none given")
    world = build_world(scenario)
    camera, log = Camera(scenario, world), Log(estimator, scenario.sensor.yaw)
    before = _prepare(scenario, world)

    def look(t: float, robot: Pose) -> None:
        log.bearings(t, camera.look(robot))

    ending, pose = drive_course(scenario, log, look, before.home_bearings(), progress)
    drive = log.fill(before)
    return Simulation(drive, ending, pose, log.estimates, scenario, world, log.last_words)


def _prepare(scenario: Scenario, world: World) -> Drive:
    sigma = scenario.noise.bearing_sigma or None
    return before(scenario, home_bearings(world, scenario), sigma, scenario.view)
