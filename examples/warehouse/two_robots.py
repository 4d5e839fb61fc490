"""Two robots in one hall share a place live, while boxes are moved.

`python -m examples.warehouse.two_robots [--seed 0] [--seconds 180] [--moves 3] [--mqtt URL]`, with
an MQTT broker there (`mosquitto`). One robot has mapped the hall on the day before. Then `homeward
place serve` merges the visits, and two robots that stand elsewhere (kidnapped robots) join the
place and patrol the outer aisles, half a round apart.
Every 30 s a box is moved that neither has in view. Printed are the figures of each robot, and the
times from the first sighting of each moved box until the own map of a robot has its new position,
and until both robots have it, in their own map or in the place of the fleet. The merger runs on
the wall clock, so the simulation is at most as fast as it, and runs with the same seed differ.
"""

from __future__ import annotations

import argparse
import math
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import cycle, islice
from pathlib import Path
from typing import Any

import numpy as np

from examples.warehouse.demo import HOME
from examples.warehouse.detections import Simulated, corners_in_view
from examples.warehouse.nights import NODES, REACHED_M, goals_within, true_positions
from examples.warehouse.robot import SETTINGS, TICK_S, Robot
from examples.warehouse.world import Box, World
from homeward.errors import HomewardError
from homeward.estimator import Status
from homeward.geometry.frames import Pose, compose, inverse
from homeward.live import messages as msg
from homeward.live.fleet.connection import Broker
from homeward.live.fleet.robot import join_place
from homeward.live.place_session import PlaceSession
from homeward.places.place import DAY_S
from homeward.registry import DEFAULT

ROUND = ("w", "nw", "n", "ne", "e", "se", "s", "sw")
"""Goals of a round, clockwise, so that the robots do not meet."""
MAPPING_S = 400.0
"""The day before ends after this time [s]."""
FIRST_MOVE_S, MOVE_S = 40.0, 30.0
"""Time of the first move, and between moves [s]."""
FAR_M = 2.0
"""Minimum distance of a box that is moved from the robots [m]."""
KNOWN_M = 0.25
"""A position with a smaller error is known [m]."""
CHECK_TICKS = 5


@dataclass
class Move:
    """A box that was moved, and when the robots had its new position."""

    box: Box
    t: float
    """[s] on the clock of the simulation, as `seen_t`."""
    seen_by: int | None = None
    """Robot that had a tag of the box in view first ..."""
    seen_t: float = math.nan
    seen_wall: float = math.nan
    """... and when, on the wall clock [s]."""
    mapped_by: int | None = None
    """Robot whose own map had the new position of a tag first ..."""
    mapped_wall: float = math.nan
    """... and when, on the wall clock [s]."""
    known_wall: float = math.nan
    """When the other robot had it, too [s]."""


def goals(first: str, number: int) -> list[msg.Input]:
    """Return goals along the round, from the one after `first`."""
    begin = ROUND.index(first) + 1
    there = [NODES[name] for name in islice(cycle(ROUND), begin, begin + number)]
    inside = [compose(inverse(HOME), Pose(x, y, 0.0)) for x, y in there]
    return [msg.GoTo(x=float(p.x), y=float(p.y)) for p in inside]


def _is_known(positions: Mapping[str, Any], true: Mapping[str, Any]) -> bool:
    """Return whether any of the tags has about its true position."""
    both = positions.keys() & true.keys()
    return any(math.dist(positions[n], true[n]) < KNOWN_M for n in both)


def map_hall(robot: Robot) -> None:
    """Drive once round the hall, and write the place."""
    while not robot.done and robot.world.t < MAPPING_S:
        robot.tick()
    robot.session.localisation.finalise()


class Patrol:
    """The two robots in the place of a fleet."""

    def __init__(self, world: World, seed: int, where: str, seconds: float) -> None:
        self.world, self.began, self.seconds = world, world.t, seconds
        settings = SETTINGS.model_copy(update={"together": world.together})
        rng = np.random.default_rng([seed, 6])
        self.robots = []
        self.places: list[PlaceSession] = []
        for k, node in enumerate(("w", "e")):
            world.robots[k].carry(*NODES[node], float(rng.uniform(-math.pi, math.pi)))
            broker = Broker(where, f"robot{k + 1}")
            self.places.append(join_place("warehouse", True, DEFAULT, broker))
            self.robots.append(
                Robot(
                    world, Simulated(world, seed, k), goals(node, 100), HOME, settings,
                    self.places[k], number=k,
                )
            )  # fmt: skip
        self.moves: list[Move] = []
        self._rng, self._wall = rng, time.monotonic()

    def drive(self, moves: int) -> None:
        """Drive, while boxes are moved."""
        ticks = 0
        while (t := self.world.t - self.began) < self.seconds:
            time.sleep(max(self._wall + t - time.monotonic(), 0.0))
            for robot in self.robots:
                robot.act()
            self.world.advance(TICK_S)
            for robot in self.robots:
                robot.note_contacts()
            if len(self.moves) < moves and t >= FIRST_MOVE_S + MOVE_S * len(self.moves):
                self._move()
            ticks += 1
            if ticks % CHECK_TICKS == 0:
                self._check()

    @property
    def seconds_per_second(self) -> float:
        """Seconds on the wall clock for each second of the simulation."""
        return (time.monotonic() - self._wall) / max(self.world.t - self.began, 1e-9)

    def _move(self) -> None:
        """Move a box that is in the place, was not moved, and that no robot has in view."""
        place = self.places[0].place
        assert place is not None
        moved = [move.box.name for move in self.moves]
        in_view = {n for k in range(2) for n in corners_in_view(self.world, k)[0]}
        for k in self._rng.permutation(len(self.world.present)):
            box = self.world.present[k]
            tags = set(map(str, box.tags))
            near = [math.dist((box.x, box.y), r.vehicle.pose[:2]) for r in self.robots]
            is_hidden = min(near) > FAR_M and not tags & in_view
            if is_hidden and tags & {*place.map.names} and box.name not in moved:
                self.world.move(box)
                self.moves.append(Move(box, self.world.t))
                return

    def _check(self) -> None:
        """Note when a robot sees a moved box, when one has its position, and when both do."""
        now = time.monotonic()
        positions = true_positions(self.world)
        for move in self.moves:
            tags = [str(tag) for tag in move.box.tags]
            if move.seen_by is None:
                for k, robot in enumerate(self.robots):
                    if robot.seen is not None and not robot.seen.bearings.keys().isdisjoint(tags):
                        move.seen_by, move.seen_t, move.seen_wall = k, self.world.t, now
                continue
            true = {tag: positions[tag] for tag in tags}
            owners = [k for k in range(2) if _is_known(self._own_map(k), true)]
            if math.isnan(move.mapped_wall) and owners:
                move.mapped_by, move.mapped_wall = owners[0], now
            known = [k in owners or _is_known(self._place(k), true) for k in range(2)]
            if math.isnan(move.known_wall) and all(known):
                move.known_wall = now

    def _own_map(self, k: int) -> dict[str, Any]:
        """Return the positions of tags in the own map of a robot."""
        return {m.landmark: (m.x, m.y) for m in self.robots[k].landmarks if m.x is not None}

    def _place(self, k: int) -> dict[str, Any]:
        """Return the positions of tags in the place that a robot received last."""
        place = self.places[k].place
        assert place is not None
        return dict(zip(place.map.names, place.map.positions.tolist(), strict=True))

    def report(self) -> str:
        """Return the figures of the robots and of the moved boxes."""
        lines = []
        for k, robot in enumerate(self.robots, start=1):
            localised = [m for m in robot.moments if m.status is Status.LOCALISED]
            error = np.array([m.error for m in localised]) if localised else np.array([math.nan])
            arrived = goals_within(robot)
            first = localised[0].t - self.began if localised else math.inf
            lines.append(
                f"robot {k}: first pose after {first:.1f} s; {sum(arrived)} of {len(arrived)} "
                f"goals within {100 * REACHED_M:.0f} cm, failed attempts "
                f"{sum(o.state == 'failed' for o in robot.outcomes)}; position error RMSE "
                f"{100 * math.sqrt(np.mean(error**2)):.1f} cm, largest {100 * error.max():.1f} cm; "
                f"touched {', '.join(sorted({n for _, n in robot.collisions})) or 'nothing'}"
            )
        for move in self.moves:
            words = f"box {move.box.name} moved at {move.t - self.began:.0f} s: "
            if move.seen_by is None:
                lines.append(words + "not seen again")
                continue
            words += f"seen by robot {move.seen_by + 1} at {move.seen_t - self.began:.1f} s, "
            if move.mapped_by is None:
                lines.append(words + "in no map")
                continue
            known = move.known_wall - move.seen_wall
            lines.append(
                words + f"in the map of robot {move.mapped_by + 1} "
                f"{move.mapped_wall - move.seen_wall:.1f} s later, known to both "
                + ("never" if math.isnan(known) else f"{known:.1f} s later")
            )
        lines.append(f"a second of the simulation took {self.seconds_per_second:.1f} s")
        return "\n".join(lines)


def main() -> None:
    """Map the hall, serve the place, and let two robots patrol."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--seconds", type=float, default=180.0)
    parser.add_argument("--moves", type=int, default=3)
    parser.add_argument("--mqtt", default="mqtt://127.0.0.1")
    given = parser.parse_args()
    world = World(given.seed, starts=(HOME, Pose(11.2, 7.4, math.pi)))
    settings = SETTINGS.model_copy(update={"together": world.together})
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / "warehouse"
        yesterday = PlaceSession("warehouse", time.time() / DAY_S - 1.0, True, folder)
        tasks = [msg.TurnHome(), *goals("w", 8)]
        map_hall(Robot(world, Simulated(world, given.seed), tasks, HOME, settings, yesterday))
        arguments = ["place", "serve", str(folder), "--mqtt", given.mqtt]
        server = subprocess.Popen(
            [sys.executable, "-u", "-m", "homeward", *arguments],
            stdout=subprocess.PIPE,
            text=True,
            env=os.environ | {"XDG_STATE_HOME": scratch},
        )
        try:
            assert server.stdout is not None
            server.stdout.readline()
            patrol = Patrol(world, given.seed, given.mqtt, given.seconds)
            patrol.drive(given.moves)
            print(patrol.report(), flush=True)
            for k, robot in enumerate(patrol.robots, start=1):
                try:
                    words = robot.session.localisation.finalise()
                except HomewardError as error:
                    words = str(error)
                print(f"robot {k}, at the end: {words}")
        finally:
            server.terminate()
            server.wait()


if __name__ == "__main__":
    main()
