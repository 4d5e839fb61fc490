"""Docking by bearings: the share of dockings within 1 cm and 1 degree.

A dock at a wall of a room, six tags around it, six more in the room. One of the six was moved by
0.3 m after the dock's bearings were stored. The camera sees 90 degrees with an error of 0.3 px at
640 px, three times as much in one image of ten (light); odometry has noise, and is 2 % too long.
The robot starts anywhere 1 to 3 m from the dock, drives as `StartGuide` advises while it has no
pose, and docks. Run:

    python -m benchmarks.docking --runs 100
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from benchmarks import monte_carlo
from benchmarks.guided import followed, in_view
from homeward.control.docking import DockGoal
from homeward.control.goals import Belief, GoalState
from homeward.control.limits import Limits
from homeward.control.start_guide import StartGuide
from homeward.drives.drive import HomeBearing
from homeward.drives.settings import DriveSettings, OdometryNoise, Sensor
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose, Twist, advance, bearing
from homeward.localizer.localizer import Localizer

DT, EVERY, MAX_S = 0.05, 2, 180.0
VIEW, PIXEL = math.radians(90.0), math.radians(90.0) / 640.0
SIGMA = 0.3 * PIXEL
DOCK = Pose(0.0, 0.0, 0.0)
TOO_LONG, NOISE = 0.02, 0.005


class Docked(NamedTuple):
    """Result of one docking, and the true errors."""

    state: GoalState
    reason: str
    seconds: float
    position: float
    """[m]"""
    heading: float
    """[rad]"""

    @property
    def succeeded(self) -> bool:
        """Whether the robot reports that it is there, and is."""
        near = self.position <= 0.01 and self.heading <= math.radians(1.0)
        return self.state is GoalState.ARRIVED and near


def room(rng: np.random.Generator) -> np.ndarray:
    """Return the positions of the tags (12, 2): six at the wall of the dock, six elsewhere [m]."""
    wall = np.stack([rng.uniform(0.6, 1.0, 6), np.linspace(-1.4, 1.4, 6)], axis=1)
    wall[:, 1] += rng.uniform(-0.15, 0.15, 6)
    angle = math.pi + np.linspace(-1.8, 1.8, 6) + rng.uniform(-0.2, 0.2, 6)
    far = rng.uniform(3.0, 5.0, 6)
    return np.concatenate([wall, np.stack([far * np.cos(angle), far * np.sin(angle)], axis=1)])


def dock(seed: int, moved: bool = True) -> Docked:
    """Let a robot dock in a room of its own."""
    rng = np.random.default_rng(seed)
    tags = room(rng)
    stored = 0.3 * SIGMA  # of some seconds at rest
    home = {
        f"L{i}": HomeBearing(bearing(DOCK, x, y) + stored * rng.normal(), stored)
        for i, (x, y) in enumerate(tags.tolist())
    }
    if moved:
        shift = rng.uniform(-math.pi, math.pi)
        tags[rng.integers(6)] += 0.3 * np.array([math.cos(shift), math.sin(shift)])
    far, side = rng.uniform(1.0, 3.0), rng.uniform(-0.8, 0.8)
    start = -far * math.cos(side), far * math.sin(side), rng.uniform(-math.pi, math.pi)
    robot = Pose(*map(float, start))
    odometry = OdometryNoise(speed_sigma=NOISE, turn_sigma=NOISE)
    sensor = Sensor(bearing_sigma=SIGMA, field_of_view=VIEW)
    localizer = Localizer(home, **DriveSettings(sensor=sensor, odometry=odometry).robot)
    limits = Limits()
    controller = DockGoal("the dock", DOCK).controller(limits)
    twist, output, light = Twist(0.0, 0.0), None, 1.0
    guide, reckoned = StartGuide(home, Pose(0.0, 0.0, 0.0)), Pose(0.0, 0.0, 0.0)
    advised = followed(guide, DT)
    for k in range(round(MAX_S / DT)):
        t = k * DT
        if k % EVERY == 0:
            light = 3.0 if rng.random() < 0.1 else 1.0
            seen = in_view(robot, tags, VIEW, 0.2, light * SIGMA, rng)
            localizer.bearings(t, seen)
            guide.add(reckoned, seen)
        estimate = localizer.estimate(t)
        if estimate.pose is not None:
            belief = Belief(estimate.status, estimate.pose, estimate.covariance)
            output = controller.step(t, belief, "")
            wanted = output.twist
            if output.state in (GoalState.ARRIVED, GoalState.FAILED):
                break
        else:
            wanted = next(advised)
        twist, _ = limits.accelerated(twist, wanted, DT)
        moving = float(twist != (0.0, 0.0))
        noise = moving * NOISE / math.sqrt(DT) * rng.normal(size=2)
        localizer.odometry(t, (1.0 + TOO_LONG) * twist.v + noise[0], twist.omega + noise[1])
        robot, reckoned = advance(robot, twist, DT), advance(reckoned, twist, DT)
    state, reason = (GoalState.HELD, "no pose") if output is None else output[:2]
    return Docked(state, reason, t, math.hypot(robot.x, robot.y), abs(float(wrap(robot.heading))))


def summary(runs: Sequence[Any]) -> str:
    """Return the share of dockings that succeeded, and quantiles of errors, in words.

    Runs are as `Docked`, here or in `examples.warehouse.dockings`.
    """
    position = 1e3 * np.array([run.position for run in runs])
    heading = np.degrees([run.heading for run in runs])
    return (
        f"{sum(run.succeeded for run in runs)} of {len(runs)} within 10 mm and 1 degree; position "
        f"median {np.median(position):.1f} mm, 99 % {np.quantile(position, 0.99):.1f} mm; heading "
        f"median {np.median(heading):.2f}, 99 % {np.quantile(heading, 0.99):.2f} degrees; "
        f"median duration {np.median([run.seconds for run in runs]):.0f} s"
    )


def main() -> None:
    given = monte_carlo.parsed(__doc__, runs=100, first_seed=0)
    runs = []
    for seed in range(given.first_seed, given.first_seed + given.runs):
        runs.append(found := dock(seed))
        if not found.succeeded:
            print(
                f"seed {seed}: {found.state.value}: {found.reason}; truly "
                f"{1e3 * found.position:.1f} mm, {math.degrees(found.heading):.2f} degrees",
                flush=True,
            )
    print(summary(runs))


if __name__ == "__main__":
    main()
