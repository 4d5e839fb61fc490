"""Days and nights in one warehouse: a patrol every day, boxes that move every night.

`python -m examples.warehouse.nights [--days 30] [--seed 0] [--rendered] [--goals 20]`. Every night
10 % of the boxes move with their tags, 5 % leave, and as many arrive. Every morning the robot is
somewhere else (kidnapped robot), and nothing is reset by hand. It drives to 20 goals in the place,
which it updates at the end of the day. Detections are simulated with the errors of rendered ones;
`--rendered` detects tags in images. Peers see the same odometry and bearings: an EKF with the
survey of day 0 and the true start of each day, the resection of each frame in that survey, and with
`--gtsam` (extra `bench`) GTSAM's fixed-lag smoother with survey, start and a Cauchy kernel.
`--laser` (extra `bench`) adds a robot with a laser scanner: scan matching in the map of day 0.
"""

from __future__ import annotations

import argparse
import importlib
import math
import tempfile
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from benchmarks.peers.surveyed import IteratedEkf, MultiTag
from examples.warehouse.demo import HOME, MIN_SIGHTINGS, named, with_tags
from examples.warehouse.detections import Camera, Simulated
from examples.warehouse.robot import SETTINGS, Eye, Robot
from examples.warehouse.world import World
from homeward.drives.drive import Drive, Samples, Truth
from homeward.drives.landmarks import KnownLandmarks, SurveyedLandmark
from homeward.drives.settings import Start
from homeward.errors import HomewardError
from homeward.estimator import Estimator, Status
from homeward.geometry.frames import Pose, compose, inverse, to_polar
from homeward.live import messages as msg
from homeward.live.place_session import PlaceSession
from homeward.places import files
from homeward.runs.scoring import errors
from homeward.track import run

if TYPE_CHECKING:
    from examples.warehouse.laser import LaserPeer

NODES = {
    "w": (1.8, 4.0), "m": (6.0, 4.0), "e": (10.2, 4.0),
    "sw": (1.8, 1.55), "s": (6.0, 1.55), "se": (10.2, 1.55),
    "nw": (1.8, 6.45), "n": (6.0, 6.45), "ne": (10.2, 6.45),
}  # fmt: skip
"""Positions of goals in the hall [m]."""
EDGES = ("w m", "m e", "w sw", "w nw", "sw s", "s se", "se e", "nw n", "n ne", "ne e")
"""Straight ways that are free."""
MOVE, LEAVE = 0.10, 0.05
"""Shares of the boxes that move, and that leave and arrive, each night."""
REACHED_M, MAX_ERROR_M = 0.05, 0.3
PEER_MAX_M = 10.0
"""Larger errors of peers count as this [m]."""
Peer = Callable[[Drive], Estimator]
DAY_S = 900.0
"""A day ends after this time, also if goals are left [s]."""
FIRST_DAY = 20000.0
"""[days since 1970]"""


@dataclass(frozen=True)
class Day:
    """The figures of a day."""

    first_s: float
    """Time of the first pose with status localised; infinity: never."""
    goals: int
    reached: int
    """Goals at which the true position was within `REACHED_M`."""
    failures: int
    """Attempts that failed."""
    contacts: tuple[str, ...]
    rmse: float
    """Of the position while localised [m]."""
    largest: float
    """Largest position error while localised [m]."""
    moved: frozenset[str]
    """Boxes that moved since the place last had them, seen often enough before and today."""
    named: frozenset[str]
    """Boxes that the robot named during the day ..."""
    wrong: frozenset[str]
    """... and those of them that did not move since the place last had any of their tags."""
    merge_named: frozenset[str]
    """Boxes that the merge into the place named in the evening ..."""
    merge_wrong: frozenset[str]
    """... and those of them that did not move."""
    lasted_s: float
    merged: str
    peers: dict[str, float]
    """Position RMSE of the peers [m]."""


def true_positions(world: World) -> dict[str, tuple[float, float]]:
    """Return the true positions of the tags in the home frame [m]."""
    names, at, _ = world.tags()
    c, s = math.cos(HOME.heading), math.sin(HOME.heading)
    x, y = (at[:, :2] - HOME[:2]).T
    return dict(zip(names, zip(c * x + s * y, c * y - s * x, strict=True), strict=True))


def goals_within(robot: Robot) -> list[bool]:
    """Return for each goal at which the robot arrived whether it is truly within `REACHED_M`."""
    return [
        math.dist(o.at[:2], (o.task.x, o.task.y)) < REACHED_M
        for o in robot.outcomes
        if isinstance(o.task, msg.GoTo) and o.state == "arrived" and o.at is not None
    ]


class Warehouse:
    """The hall over days, and what the place has of it."""

    def __init__(
        self,
        seed: int,
        days: int,
        rendered: bool,
        folder: Path,
        peers: Mapping[str, Peer],
        has_laser: bool = False,
    ) -> None:
        boxes = 56
        spare = round(LEAVE * boxes) * (days - 1)
        self.world = World(seed, boxes=boxes, spare=min(spare, 146 - boxes), starts=(HOME,))
        self.eye: Eye = Camera(self.world, seed) if rendered else Simulated(self.world, seed)
        self.rng = np.random.default_rng([seed, 5])
        self.folder, self.peers = folder, peers
        self.laser: LaserPeer | None = None
        if has_laser:
            self.laser = importlib.import_module("examples.warehouse.laser").LaserPeer(
                self.world, seed
            )
        self.mapped: dict[str, tuple[Pose, int]] = {}
        """Pose of each box when it was last merged into the place, and its sightings there."""
        self.placed: dict[str, Pose] = {}
        """Pose of its box when the place last had a position of each tag of the place."""
        self.box_of = {str(tag): box.name for box in self.world.boxes for tag in box.tags}
        self.survey = {
            name: SurveyedLandmark(x=float(x), y=float(y))
            for name, (x, y) in true_positions(self.world).items()
        }

    def night(self) -> None:
        """Move, remove and add boxes, and carry the robot elsewhere."""
        world = self.world
        present = [world.present[k] for k in self.rng.permutation(len(world.present))]
        leave, move = round(LEAVE * len(present)), round(MOVE * len(present))
        gone = [box for box in world.boxes if box.x < 0]
        for box in present[:leave]:
            world.remove(box)
        for box in gone[:leave]:
            world.arrive(box)
        for box in present[leave : leave + move]:
            world.move(box)
        a, b = EDGES[self.rng.integers(len(EDGES))].split()
        x, y = np.array(NODES[a]) + self.rng.random() * np.subtract(NODES[b], NODES[a])
        world.robots[0].carry(float(x), float(y), float(self.rng.uniform(-math.pi, math.pi)))

    def goals(self, number: int) -> list[tuple[float, float]]:
        """Return goals in the hall along free ways, from the node next to the robot."""
        ways: dict[str, list[str]] = {}
        for a, b in map(str.split, EDGES):
            ways.setdefault(a, []).append(b)
            ways.setdefault(b, []).append(a)
        here = self.world.robots[0].pose[:2]
        at, found = min(NODES, key=lambda n: math.dist(NODES[n], here)), []
        before = ""
        for _ in range(number):
            found.append(tuple((np.array(NODES[at]) + self.rng.uniform(-0.1, 0.1, 2)).tolist()))
            onwards = [n for n in ways[at] if n != before] or ways[at]
            before, at = at, onwards[self.rng.integers(len(onwards))]
        return found

    def day(self, number: int, goals: int) -> Day:
        """Drive for a day; the first one begins at home and creates the place."""
        when = FIRST_DAY + number
        if number:
            version = files.newest(self.folder)
            place = PlaceSession(
                files.load_place(self.folder, version), when, True, self.folder, version
            )
        else:
            place = PlaceSession("warehouse", when, True, self.folder)
        at = self.goals(goals)
        inside = [compose(inverse(HOME), Pose(x, y, 0.0)) for x, y in at]
        tasks: list[msg.Input] = [msg.GoTo(x=float(p.x), y=float(p.y)) for p in inside]
        settings = SETTINGS.model_copy(update={"together": self.world.together})
        robot = Robot(
            self.world, self.eye, tasks if number else [msg.TurnHome(), *tasks], HOME, settings,
            place,
        )  # fmt: skip
        began, samples, seen, looked = self.world.t, Samples(), Counter[str](), 0
        while not robot.done and self.world.t < began + DAY_S:
            robot.tick()
            if robot.looks > looked and robot.seen is not None:
                looked = robot.looks
                seen.update(robot.seen.bearings.keys())
                t = robot.truth[-1][0]
                samples.add_bearings(t, robot.seen.bearings, robot.seen.sigmas)
                if self.laser is not None:
                    self.laser.scan(robot.true_pose())
        robot.session.request_landmarks()
        for out in robot.session.process():
            robot._on_output(out)
        try:
            words = robot.session.localisation.finalise() or ""
            is_merged = True
        except HomewardError as error:
            words, is_merged = str(error), False
        return self._figures(robot, began, seen, samples, goals, words, is_merged)

    def _figures(
        self,
        robot: Robot,
        began: float,
        seen: Counter[str],
        samples: Samples,
        goals: int,
        words: str,
        is_merged: bool,
    ) -> Day:
        localised = [m for m in robot.moments if m.status is Status.LOCALISED]
        error = np.array([m.error for m in localised])
        times = {b.name: max(seen[str(t)] for t in b.tags) for b in self.world.present}
        here = {box.name: Pose(box.x, box.y, box.yaw) for box in self.world.boxes}
        moved = {n for n, (pose, _) in self.mapped.items() if here[n] != pose}
        often = {n for n in moved if min(times.get(n, 0), self.mapped[n][1]) >= MIN_SIGHTINGS}
        found, merge_found, box_of = named(robot), set[str](), self.box_of
        shifted = {t for t, pose in self.placed.items() if here[box_of[t]] != pose}
        shifted_boxes = with_tags(self.world, shifted)
        if is_merged:
            place = files.load_place(self.folder, files.newest(self.folder))
            events = (e for e in place.events if e.visit == place.visits[-1].number)
            merge_found = with_tags(self.world, {e.landmark for e in events if e.what == "moved"})
            now = {m.landmark: here[box_of[m.landmark]] for m in robot.landmarks if m.x is not None}
            both = self.placed | now
            self.placed = {t: both[t] for t in place.map.names}
            for name in [n for n, count in times.items() if count]:
                before = 0 if name in moved else self.mapped.get(name, (None, 0))[1]
                self.mapped[name] = here[name], before + times[name]
        return Day(
            localised[0].t - began if localised else math.inf,
            goals,
            sum(goals_within(robot)),
            sum(o.state == "failed" for o in robot.outcomes),
            tuple(sorted({name for _, name in robot.collisions})),
            float(np.sqrt(np.mean(error**2))) if len(error) else math.nan,
            float(error.max()) if len(error) else math.nan,
            frozenset(often),
            frozenset(found),
            frozenset(found - shifted_boxes),
            frozenset(merge_found),
            frozenset(merge_found - shifted_boxes),
            self.world.t - began,
            words,
            self._peers(robot, samples),
        )

    def _peers(self, robot: Robot, samples: Samples) -> dict[str, float]:
        """Return the position RMSE of peers on the same samples [m]."""
        for t, v, omega in robot.measured:
            samples.add_twist(t, v, omega)
        truth = np.array([(t, *pose) for t, pose in robot.truth])
        start = Start.about(to_polar(robot.truth[0][1]), 0.02, 0.02, 0.02)
        settings = robot.settings.model_copy(update={"start": start, "together": ()})
        drive = Drive(
            "day",
            samples.odometry(),
            samples.sightings(),
            {},
            settings,
            truth=Truth(*truth.T),
            known=KnownLandmarks(frame="home", landmarks=self.survey),
        )
        found = {}
        for name, peer in self.peers.items():
            off = errors(run(drive, peer(drive)), drive.truth)
            capped = np.minimum(off.position, PEER_MAX_M)
            found[name] = float(np.sqrt(np.mean(capped**2))) if off.t.size else math.nan
        if self.laser is not None:
            found["laser"] = self.laser.rmse(drive.odometry)
        return found


def main() -> None:
    """Print a line for each day, and the figures of all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--days", type=int, default=30)
    parser.add_argument("--goals", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--rendered", action="store_true")
    parser.add_argument("--laser", action="store_true")
    given = parser.parse_args()
    days: list[Day] = []
    peers: dict[str, Peer] = {"EKF": IteratedEkf, "resection": MultiTag}
    print(
        "day first[s] goals failures rmse[cm] max[cm] moved named wrong merge: named wrong"
        + "".join(f" {name + '[cm]':>13}" for name in (*peers, *["laser"] * given.laser))
    )
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / "warehouse"
        hall = Warehouse(given.seed, given.days, given.rendered, folder, peers, given.laser)
        for number in range(given.days):
            if number:
                hall.night()
            day = hall.day(number, given.goals)
            days.append(day)
            print(
                f"{number:3} {day.first_s:8.1f} {day.reached:2}/{day.goals:2} {day.failures:8}"
                f" {100 * day.rmse:8.1f} {100 * day.largest:7.1f} {len(day.moved):5}"
                f" {len(day.named & day.moved):5} {len(day.wrong):5}"
                f" {len(day.merge_named & day.moved):12} {len(day.merge_wrong):5}"
                + "".join(f" {100 * day.peers[name]:13.1f}" for name in day.peers)
                + f"  {day.lasted_s:.0f} s, touched {', '.join(day.contacts) or 'nothing'}"
                f"; {day.merged}",
                flush=True,
            )
    print(summary(days))


def summary(days: list[Day]) -> str:
    """Return the figures of all days but the first, which creates the place."""
    later = days[1:] or days
    moved = sum(len(d.moved) for d in later)

    def counts(named: list[frozenset[str]], wrong: list[frozenset[str]]) -> str:
        hits = sum(len(n & d.moved) for n, d in zip(named, later, strict=True))
        found, bad = sum(map(len, named)), sum(map(len, wrong))
        return (
            f"{hits} (recall {hits / max(moved, 1):.2f}), wrongly {bad} "
            f"(precision {(found - bad) / max(found, 1):.2f})"
        )

    during = counts([d.named for d in later], [d.wrong for d in later])
    evening = counts([d.merge_named for d in later], [d.merge_wrong for d in later])
    share = 100 * sum(d.reached for d in days) / sum(d.goals for d in days)
    return "\n".join(
        [
            f"goals reached within {100 * REACHED_M:.0f} cm: {share:.1f} %",
            f"days with a contact: {sum(bool(d.contacts) for d in days)} of {len(days)}",
            f"first localised pose: median {np.median([d.first_s for d in later]):.1f} s, worst "
            f"{max(d.first_s for d in later):.1f} s",
            f"moved boxes: {moved}, named during the day {during}; by the merge {evening}",
            f"days with an error above {MAX_ERROR_M} m while localised: "
            f"{sum(d.largest > MAX_ERROR_M for d in days)}; largest "
            f"{max(d.largest for d in days):.2f} m",
            "median RMSE of a day: homeward "
            f"{100 * np.median([d.rmse for d in days]):.1f} cm, "
            + ", ".join(
                f"{name} {100 * np.median([d.peers[name] for d in days]):.1f} cm"
                for name in days[0].peers
            ),
        ]
    )


if __name__ == "__main__":
    main()
