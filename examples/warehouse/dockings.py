"""Dockings in the warehouse: the share within 1 cm and 1 degree.

`python -m examples.warehouse.dockings [--runs 100] [--first-seed 0] [--jobs 2] [--rendered]`. In a
warehouse of its own, the robot turns once at the dock, which faces the aisle between the racks, and
drives to a goal 3 to 7 m away. Then one of the boxes next to the dock is moved, and it docks.
Detections are simulated with the errors of rendered ones; `--rendered` detects tags in images.
"""

from __future__ import annotations

import argparse
import math
from concurrent.futures import ProcessPoolExecutor
from itertools import repeat
from typing import NamedTuple

import numpy as np

from benchmarks.docking import summary
from examples.warehouse.detections import Camera, Simulated
from examples.warehouse.robot import SETTINGS, Eye, Robot
from examples.warehouse.world import World
from homeward.geometry.frames import Pose, compose, inverse
from homeward.live import messages as msg

DOCK = Pose(1.8, 4.0, 0.0)
"""In the hall, with 1.2 m of free floor behind it."""
NEAR_M = 3.0
"""Maximum distance of the moved box from the dock [m]."""
REACHED_M, REACHED_RAD = 0.01, math.radians(1.0)
LONGEST_S = 300.0


class Docked(NamedTuple):
    """Result of a docking, and the true errors."""

    seed: int
    words: str
    has_arrived: bool
    seconds: float
    """From the command to dock until its end."""
    failures: int
    """Attempts that failed."""
    position: float
    """[m]"""
    heading: float
    """[rad]"""
    contacts: tuple[str, ...]

    @property
    def succeeded(self) -> bool:
        """Whether the robot reports that it is there, and is."""
        near = self.position <= REACHED_M and self.heading <= REACHED_RAD
        return self.has_arrived and near and not self.contacts


def dock(seed: int, is_rendered: bool) -> Docked:
    """Let a robot dock in a warehouse of its own."""
    world = World(seed, starts=(DOCK,))
    eye: Eye = Camera(world, seed) if is_rendered else Simulated(world, seed)
    rng = np.random.default_rng([seed, 7])
    away = DOCK.x + rng.uniform(3.0, 7.0), DOCK.y + rng.uniform(-0.3, 0.3)
    inside = compose(inverse(DOCK), Pose(*away, 0.0))
    leave = msg.GoTo(x=float(inside.x), y=float(inside.y))
    tasks = [msg.TurnHome(), msg.GoTo(x=0.4, y=0.0), leave, msg.GoHome(dock=True)]
    settings = SETTINGS.model_copy(update={"together": world.together})
    robot = Robot(world, eye, tasks, DOCK, settings)
    left = math.nan
    while not robot.done and world.t < LONGEST_S:
        robot.tick()
        if math.isnan(left) and any(o.task == leave for o in robot.outcomes):
            left = world.t
            near = [b for b in world.present if math.dist((b.x, b.y), DOCK[:2]) <= NEAR_M]
            world.move(near[rng.integers(len(near))])
    last = robot.outcomes[-1] if robot.outcomes else None
    has_ended = last is not None and last.task == tasks[-1]
    off = robot.true_pose()
    return Docked(
        seed,
        f"{last.state}: {last.reason}" if last is not None and has_ended else robot.doing,
        last is not None and has_ended and last.state == "arrived",
        world.t - left,
        sum(o.state == "failed" for o in robot.outcomes),
        math.hypot(off.x, off.y),
        abs(off.heading),
        tuple(sorted({name for _, name in robot.collisions})),
    )


def main() -> None:
    """Dock in many warehouses."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=100)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--rendered", action="store_true")
    given = parser.parse_args()
    seeds = range(given.first_seed, given.first_seed + given.runs)
    runs = []
    with ProcessPoolExecutor(given.jobs) as pool:
        for run in pool.map(dock, seeds, repeat(given.rendered)):
            runs.append(run)
            if not run.succeeded:
                print(
                    f"seed {run.seed}: {run.words}; truly {1e3 * run.position:.1f} mm, "
                    f"{math.degrees(run.heading):.2f} degrees, after {run.seconds:.0f} s; "
                    f"contacts {', '.join(run.contacts) or 'none'}",
                    flush=True,
                )
    print(f"{summary(runs)}; {sum(run.failures for run in runs)} attempts that failed")


if __name__ == "__main__":
    main()
