"""Kidnapped robots: relocalisation, and overconfident poses.

`python -m benchmarks.kidnapped [--only calamities ...] [--seeds 10]`. Calamities are kidnappings,
blackouts, outliers, gaps and swapped ids in the first half minute of a drive, followed by a minute
without faults; "alone" is that minute alone. In the others a robot is carried through a large hall,
of which it sees only a part at a time. Shares of drives, by the end of each: with a pose, localised
and right, localised and wrong; and the error of the last pose.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from benchmarks.measures import Figures, figures
from benchmarks.monte_carlo import Column, Run, benchmark
from homeward.drives.drive import Drive, HomeBearing, Odometry, Sightings, Truth
from homeward.drives.settings import DriveSettings, Sensor
from homeward.estimator import Status
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose, bearing
from homeward.localizer.localizer import Localizer
from homeward.track import run as follow

DT, EVERY = 0.1, 2  # interval of odometry [s], and number of twists per frame of bearings
SIGMA, SPEED_SIGMA, TURN_SIGMA = 0.01, 0.01, 0.01
"""Noise of bearings [rad] and of twists [m/s, rad/s, at 1 Hz]."""
BAD_S, GOOD_S = 30.0, 60.0  # duration of the faults, and of the drive without faults [s]
LATE_S = 10.0  # duration of the evaluated end of a drive [s]
CALAMITIES = "calamities"
COLUMNS = (
    Column("pose, alone", "alone", np.nanmean),
    Column("pose", by=np.nanmean),
    Column("right", by=np.nanmean),
    Column("wrong", by=np.nanmean),
    Column("median [m]", "error", digits=2),
    Column("worst [m]", "error", np.nanmax, 2),
)
START = Pose(0.5, 0.3, 0.0)
Marks = dict[str, tuple[float, float]]
Bearings = dict[str, float]


class Sample(NamedTuple):
    """Inputs of the estimator at one time: a twist, and at some times bearings."""

    t: float
    truth: Pose
    twist: tuple[float, float] | None
    seen: Bearings | None


@dataclass
class World:
    """A robot that wanders among landmarks."""

    marks: Marks
    rng: np.random.Generator
    reach: float  # maximum distance from `middle` [m]
    speed: float
    sight: float = math.inf  # range of the camera [m]
    half_view: float = math.pi  # half of its field of view [rad]
    middle: tuple[float, float] = (0.0, 0.0)
    pose: Pose = START
    t: float = 0.0
    target: tuple[float, float] = (0.0, 0.0)  # next waypoint [m]

    def home(self) -> dict[str, HomeBearing]:
        near = {n: p for n, p in self.marks.items() if math.hypot(*p) < self.sight}
        noise = self.rng.normal(size=len(near)) * SIGMA
        return {
            n: HomeBearing(float(wrap(math.atan2(y, x) + e)), SIGMA)
            for (n, (x, y)), e in zip(near.items(), noise.tolist(), strict=True)
        }

    def look(self) -> Bearings:
        seen = {}
        for name, (x, y) in self.marks.items():
            beta = bearing(self.pose, x, y)
            near = math.hypot(x - self.pose.x, y - self.pose.y) < self.sight
            if near and abs(wrap(beta)) < self.half_view:
                seen[name] = float(wrap(beta + SIGMA * self.rng.normal()))
        return seen

    def drive(
        self,
        seconds: float,
        spoil: Callable[[Bearings], Bearings | None] = lambda seen: seen,
        feel: bool = True,
    ) -> Iterator[Sample]:
        """Drive on; `spoil` may change the bearings, and without `feel` there is no odometry."""
        for k in range(round(seconds / DT)):
            v, omega = self._law()
            noise = self.rng.normal(size=2) * [SPEED_SIGMA, TURN_SIGMA] / math.sqrt(DT)
            seen = spoil(self.look()) if k % EVERY == 0 else None
            yield Sample(
                self.t, self.pose, (v + noise[0], omega + noise[1]) if feel else None, seen
            )
            x, y, heading = self.pose
            middle = heading + 0.5 * omega * DT
            x, y = x + v * DT * math.cos(middle), y + v * DT * math.sin(middle)
            self.pose = Pose(x, y, float(wrap(heading + omega * DT)))
            self.t += DT

    def _law(self) -> tuple[float, float]:
        x, y, heading = self.pose
        while math.hypot(self.target[0] - x, self.target[1] - y) < 2.0 * self.speed:
            way, away = self.rng.uniform(-math.pi, math.pi), self.rng.uniform(0.2, 1.0)
            self.target = (
                self.middle[0] + self.reach * away * math.cos(way),
                self.middle[1] + self.reach * away * math.sin(way),
            )
        off = wrap(math.atan2(self.target[1] - y, self.target[0] - x) - heading)
        return self.speed, float(np.clip(1.5 * off, -0.7, 0.7))


class Outcome(NamedTuple):
    """Result of a drive."""

    pose: float  # availability of a pose in the last seconds [1]
    lies: float  # share of the last seconds with a reliable status, and wrong [1]
    status: Status
    error: float  # of the last pose [m]


def outcome(drive: Drive) -> Outcome:
    """Return what the localiser answers at the end of a drive."""
    track = follow(drive, Localizer(drive.home, **drive.settings.robot))
    begin = float(track.t[-1]) - LATE_S
    found = figures(track, drive.truth, after_s=begin - float(track.t[0]))
    has_pose = float(track.has_pose[track.t > begin].mean())
    return Outcome(
        has_pose, found.get("wrong", 0.0), track.status[-1], found.get("final", math.nan)
    )


def drive_of(home: dict[str, HomeBearing], sensor: Sensor, samples: list[Sample]) -> Drive:
    """Return the drive of samples."""
    twists = np.array([(s.t, *s.twist) for s in samples if s.twist is not None])
    seen = [(s.t, n, b, math.nan) for s in samples for n, b in (s.seen or {}).items()]
    truth = np.array([(s.t, *s.truth) for s in samples])
    tables = Odometry(*twists.T), Sightings.of_rows(seen)
    return Drive("kidnapped", *tables, home, DriveSettings(sensor=sensor), Truth(*truth.T))


def calamity(seed: int) -> tuple[Drive, Drive]:
    """Return a minute without faults, and the same after half a minute of faults."""
    rng = np.random.default_rng(seed)
    count, far = int(rng.integers(5, 13)), float(rng.uniform(3.0, 6.0))
    angles = 2 * math.pi * (np.arange(count) + rng.uniform(-0.4, 0.4, count)) / count
    distances = rng.uniform(2.0, far, count)
    marks = {
        f"L{i}": (float(d * math.cos(a)), float(d * math.sin(a)))
        for i, (a, d) in enumerate(zip(angles, distances, strict=True))
    }
    narrow = rng.random() < 0.3
    half_view = float(rng.uniform(0.6, 1.2)) if narrow else math.pi
    world = World(marks, rng, 1.5, 0.3, half_view=half_view)
    home, is_given = world.home(), bool(rng.random() < 0.5)
    sensor = Sensor(bearing_sigma=SIGMA if is_given else None)
    bad: list[Sample] = []
    while world.t < BAD_S - DT:
        bad += _mishap(world, min(float(rng.uniform(1.0, 12.0)), BAD_S - world.t))
    good = list(world.drive(GOOD_S))
    return drive_of(home, sensor, good), drive_of(home, sensor, bad + good)


def _mishap(world: World, seconds: float) -> list[Sample]:
    """Return samples with one fault, or none, for a duration."""
    rng, names = world.rng, list(world.marks)
    share = float(rng.uniform(0.2, 0.8))
    mixed = dict(zip(names, rng.permutation(names).tolist(), strict=True))

    def wild(seen: Bearings) -> Bearings:
        angle = rng.uniform
        return {n: angle(-math.pi, math.pi) if angle() < share else b for n, b in seen.items()}

    match rng.choice(["none", "kidnap", "blind", "deaf", "gap", "wild", "mixed"]):
        case "kidnap":
            x, y = rng.uniform(-1.5, 1.5, 2).tolist()
            world.pose = Pose(x, y, float(rng.uniform(-math.pi, math.pi)))
        case "gap":  # nothing at all, for longer
            world.t += 10.0 * seconds
        case "blind":
            return list(world.drive(seconds, spoil=lambda _: {}))
        case "deaf":
            return list(world.drive(seconds, feel=False))
        case "wild":
            return list(world.drive(seconds, spoil=wild))
        case "mixed":
            return list(
                world.drive(seconds, lambda seen: {mixed.get(n, n): b for n, b in seen.items()})
            )
    return list(world.drive(seconds))


class Carried(NamedTuple):
    """How a robot is carried in the hall."""

    metres: float  # distance along the hall
    turn: float = 0.0  # rotation [rad]
    back: bool = False  # whether it is carried back later, instead of driving back
    blind: bool = False  # whether it drives without bearings for some seconds before and after
    half_view: float = math.pi  # half of its field of view [rad]


CARRIED = {
    f"carried {metres:.0f} m{words}": Carried(metres, **how)
    for metres in (10.0, 20.0, 40.0)
    for words, how in {
        "": {},
        ", turned": {"turn": 1.5},
        ", and back": {"back": True},
        ", blind": {"blind": True},
        ", narrow camera": {"half_view": 0.6},
    }.items()
}


def hall(seed: int, how: Carried, times: float = 1.0) -> Drive:
    """Return a drive (300 s x `times`) in which the robot is carried."""
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(-20.0, 60.0, 60), rng.uniform(-20.0, 20.0, 60)
    marks = {f"L{i}": p for i, p in enumerate(zip(x.tolist(), y.tolist(), strict=True))}
    world = World(marks, rng, 8.0, 0.8, sight=15.0, half_view=how.half_view)
    home = world.home()
    samples = list(world.drive(times * 90.0))
    samples += _carry(world, how.metres, how.turn, how.blind)
    samples += world.drive(times * 60.0)
    if how.back:
        samples += _carry(world, -how.metres, -how.turn, how.blind)
    else:
        world.middle = (0.0, 0.0)
    samples += world.drive(times * 150.0)
    return drive_of(home, Sensor(bearing_sigma=SIGMA), samples)


def _carry(world: World, metres: float, turn: float, blind: bool) -> list[Sample]:
    """Carry the robot, and the middle of its path, along the hall."""
    samples = list(world.drive(10.0, spoil=lambda _: {})) if blind else []
    x, y, heading = world.pose
    world.pose = Pose(x + metres, y, float(wrap(heading + turn)))
    world.middle = (world.middle[0] + metres, world.middle[1])
    world.target = world.pose[:2]
    return samples + (list(world.drive(10.0, spoil=lambda _: {})) if blind else [])


def measured(run: Run) -> Figures:
    """Return what happened at the end of a drive; for calamities, also after their last minute."""
    alone = {}
    if run.scenario == CALAMITIES:
        last, drive = calamity(run.seed)
        alone = {"alone": outcome(last).pose > 0.5}
    else:
        drive = hall(run.seed, CARRIED[run.scenario])
    found = outcome(drive)
    right = found.status is Status.LOCALISED and found.lies == 0.0
    return alone | {
        "pose": found.pose > 0.5,
        "right": right,
        "wrong": found.lies > 0.0,
        "error": found.error,
    }


def main() -> None:
    benchmark(__doc__, measured, [CALAMITIES, *CARRIED], COLUMNS, seeds=10)


if __name__ == "__main__":
    main()
