"""The demonstration: a tour through the warehouse while boxes are moved behind the robot's back.

`make demo-physics`, or `python -m examples.warehouse.demo [--seed 0] [--out out/demo-physics]`.
The robot turns once at home, drives two rounds, and returns. The command prints its distance from
home, pose errors, and which moved boxes were named; it writes a film, a GIF, and a drive folder
for `homeward run`.
"""

from __future__ import annotations

import argparse
import math
import shutil
import time
from collections import Counter
from functools import partial
from pathlib import Path

import numpy as np

from examples.warehouse.detections import Camera, corners_in_view
from examples.warehouse.film import Film
from examples.warehouse.robot import SETTINGS, Robot
from examples.warehouse.world import Box, World
from homeward.estimator import Status
from homeward.geometry.frames import Pose
from homeward.live import messages as msg
from homeward.live.recording import Recorder

HOME = Pose(1.5, 4.0, 0.0)
"""In the hall."""
ROUNDS = (
    ((10.2, 4.0), (10.2, 1.55), (1.8, 1.55), (1.8, 3.8)),
    ((10.2, 4.0), (10.2, 6.45), (1.8, 6.45)),
)
"""Goals of the two rounds, in the hall [m]."""
MOVED_AFTER = {2: 3, 6: 2}
"""Number of boxes that are moved when this number of goals is reached."""
MIN_SIGHTINGS = 5
"""A moved box counts for recall if it was seen this often before and after."""
LONGEST_S = 400.0


class Helper:
    """Someone who moves boxes that the robot does not see at the moment."""

    def __init__(self, world: World) -> None:
        self._world = world
        self.moved: dict[str, tuple[float, Pose, float]] = {}
        """Time [s], former pose in the hall, and height of the underside [m] of each moved box."""

    def move(self, seen: Counter[str], count: int) -> list[Box]:
        """Move `count` boxes that were seen before and are out of view; return them."""
        world, chosen = self._world, []
        in_view = set(corners_in_view(world)[0])
        for k in world.rng.permutation(len(world.present)):
            box = world.present[k]
            tags = set(map(str, box.tags))
            is_far = math.dist((box.x, box.y), world.robots[0].pose[:2]) > 2.0
            known = max(seen[t] for t in tags) >= MIN_SIGHTINGS
            if is_far and known and not tags & in_view and box.name not in self.moved:
                self.moved[box.name] = world.t, Pose(box.x, box.y, box.yaw), box.z
                world.move(box)
                chosen.append(box)
            if len(chosen) == count:
                break
        return chosen


def named(robot: Robot) -> set[str]:
    """Return the boxes of which any tag is reported as moved: tags move with their box."""
    moved = {m.landmark for m in robot.landmarks if (m.moved_probability or 0.0) > 0.5}
    return with_tags(robot.world, moved)


def with_tags(world: World, tags: set[str]) -> set[str]:
    """Return the names of the boxes with any of the tags."""
    return {box.name for box in world.boxes if not tags.isdisjoint(map(str, box.tags))}


def report(robot: Robot, moved: set[str], seen_again: set[str]) -> str:
    """Return the figures of a finished drive in words."""
    home = math.hypot(*robot.true_pose()[:2])
    last = robot.outcomes[-1]
    error = np.array([m.error for m in robot.moments if m.status is Status.LOCALISED])
    has = [m for m in robot.moments if m.covariance is not None]
    nees = [nees_of(m.truth, m.pose, m.covariance) for m in has if m.pose is not None]
    found = named(robot)
    lines = [
        f"{last.state}: {last.reason}; true distance from home {100 * home:.1f} cm",
        f"position error while localised: RMSE {100 * math.sqrt(np.mean(error**2)):.1f} cm, "
        f"largest {100 * error.max():.1f} cm ({len(error)} answers of {len(robot.moments)})",
        f"NEES of (x, y, heading), 3 is ideal: mean {np.mean(nees):.1f}",
        f"moved boxes: {', '.join(sorted(moved))}; of these seen again: "
        f"{', '.join(sorted(seen_again)) or 'none'}",
        f"named as moved: {', '.join(sorted(found)) or 'none'}: "
        f"precision {_share(len(found & moved), len(found))}, "
        f"recall {_share(len(found & seen_again), len(seen_again))}",
        f"goals reached {sum(o.state == 'arrived' for o in robot.outcomes)}, "
        f"attempts that failed {sum(o.state == 'failed' for o in robot.outcomes)}, "
        f"contacts {', '.join(sorted({n for _, n in robot.collisions})) or 'none'}",
    ]
    return "\n".join(lines)


def nees_of(truth: Pose, pose: Pose, covariance: np.ndarray) -> float:
    """Return the normalised estimation error squared of a pose."""
    error = np.subtract(pose, truth)
    error[2] = math.remainder(error[2], math.tau)
    return float(error @ np.linalg.solve(covariance, error))


def _share(part: int, whole: int) -> str:
    return f"{part / whole:.2f}" if whole else "undefined"


def main() -> None:
    """Run the demonstration."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("out/demo-physics"))
    given = parser.parse_args()
    began = time.perf_counter()
    shutil.rmtree(given.out / "drive", ignore_errors=True)
    world = World(given.seed, starts=(HOME,))
    camera = Camera(world, given.seed)
    goals = [msg.GoTo(x=x - HOME.x, y=y - HOME.y) for one in ROUNDS for x, y in one]
    settings = SETTINGS.model_copy(update={"together": world.together})
    recorder = partial(Recorder, given.out / "drive", robot=settings, homes={})
    tasks = [msg.TurnHome(), *goals, msg.GoHome()]
    robot = Robot(world, camera, tasks, HOME, settings, recorder=recorder)
    helper, film = Helper(world), Film(world, robot, camera, HOME)
    seen, since = Counter[str](), dict[str, Counter[str]]()
    due = dict(MOVED_AFTER)
    while not robot.done and world.t < LONGEST_S:
        looked = robot.looks
        robot.tick()
        if robot.seen is not None and robot.looks > looked:
            seen.update(robot.seen.bearings.keys())
            for counts in since.values():
                counts.update(robot.seen.bearings.keys())
        reached = sum(o.state == "arrived" for o in robot.outcomes)
        if due.get(reached):
            boxes = helper.move(seen, due[reached])
            due[reached] -= len(boxes)
            since |= {box.name: Counter() for box in boxes}
            if boxes:
                names = ", ".join(box.name for box in boxes)
                print(f"{world.t:6.1f} s: moved behind its back: {names}", flush=True)
        for outcome in robot.outcomes[len(film.reported) :]:
            film.reported.append(outcome)
            print(f"{outcome.t:6.1f} s: {outcome.task.type}: {outcome.state}: {outcome.reason}")
        film.record(helper.moved, named(robot))
    camera.close()
    again = {
        box.name
        for box in world.boxes
        if box.name in since and max(since[box.name][str(t)] for t in box.tags) >= MIN_SIGHTINGS
    }
    print(report(robot, set(helper.moved), again))
    assert robot.recording is not None
    robot.recording.close()
    truth = np.array([(t, *pose) for t, pose in robot.truth])
    header = {"header": "t,x,y,heading", "comments": "", "fmt": "%.6f", "delimiter": ","}
    np.savetxt(given.out / "drive" / "truth.csv", truth, **header)
    print(f"simulated {world.t:.0f} s in {time.perf_counter() - began:.0f} s")
    film.write(given.out)
    print(f"{given.out / 'film.mp4'} and film.gif after {time.perf_counter() - began:.0f} s")


if __name__ == "__main__":
    main()
