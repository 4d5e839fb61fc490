"""Robots to which bad things happen: is a pose found again, and is it never a confident lie.

`python -m benchmarks.kidnapped calamities [--seeds 200]` lets kidnappings, blackouts, outliers,
gaps and swapped ids happen in the first half minute of a drive and an honest minute follow, and
compares with that minute taken alone. `python -m benchmarks.kidnapped hall [--seeds 10]` carries
a robot through a large hall, of which it sees a part at a time.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from homeward.drives.drive import HomeBearing
from homeward.drives.settings import Sensor
from homeward.estimator import Estimate, Status
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose, bearing
from homeward.localizer.localizer import Localizer

DT, EVERY = 0.1, 2
"""Odometry comes so often [s], and bearings with every so many twists."""
SIGMA, SPEED_SIGMA, TURN_SIGMA = 0.01, 0.01, 0.01
"""Noise of bearings [rad] and of twists [m/s, rad/s, at 1 Hz]."""
BAD_S, HONEST_S = 30.0, 60.0
"""How long things go wrong, and how long all is well then [s]."""
LATE_S = 10.0
"""Answers are judged in the last seconds of a drive [s]."""
WRONG_SIGMAS = 4.0
"""A pose is wrong that is farther off [standard deviations]."""

START = Pose(0.5, 0.3, 0.0)

Marks = dict[str, tuple[float, float]]
Bearings = dict[str, float]


class Sample(NamedTuple):
    """What reaches the estimator at one time: a twist, and at some times bearings."""

    t: float
    truth: Pose
    twist: tuple[float, float] | None
    seen: Bearings | None


@dataclass
class World:
    """A robot that wanders among landmarks, and what it says of itself."""

    marks: Marks
    rng: np.random.Generator
    reach: float
    """It wanders within so far of `middle` [m]."""
    speed: float
    sight: float = math.inf
    """It sees so far [m]."""
    half_view: float = math.pi
    """It sees to both sides of its axis so far [rad]."""
    middle: tuple[float, float] = (0.0, 0.0)
    pose: Pose = START
    t: float = 0.0
    target: tuple[float, float] = (0.0, 0.0)
    """Where it is driving to [m]."""

    def home(self) -> dict[str, HomeBearing]:
        """Return what the camera saw at home, the origin."""
        near = {n: p for n, p in self.marks.items() if math.hypot(*p) < self.sight}
        noise = self.rng.normal(size=len(near)) * SIGMA
        return {
            n: HomeBearing(float(wrap(math.atan2(y, x) + e)), SIGMA)
            for (n, (x, y)), e in zip(near.items(), noise.tolist(), strict=True)
        }

    def look(self) -> Bearings:
        """Return what the camera sees now."""
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
        """Wander on; `spoil` may change what is seen, and without `feel` odometry is silent."""
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
        """Return the speed and the turn rate that lead to the next place."""
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
    """What came of a drive."""

    pose: float
    """Share of its last seconds with a pose [1]."""
    lies: float
    """Share of its last seconds localised, and wrong [1]."""
    status: Status
    error: float
    """Of the last pose [m]."""


def replay(localizer: Localizer, samples: list[Sample]) -> Outcome:
    """Feed samples to a localiser."""
    answers: list[tuple[float, Estimate, Pose]] = []
    for t, truth, twist, seen in samples:
        if twist is not None:
            localizer.odometry(t, *twist)
        if seen is not None:
            answers.append((t, localizer.bearings(t, seen), truth))
    late = [(a, truth) for t, a, truth in answers if t > samples[-1].t - LATE_S]
    last, truth = late[-1]
    off = math.nan
    if last.pose is not None:
        off = math.hypot(last.pose.x - truth.x, last.pose.y - truth.y)
    found = sum(a.pose is not None for a, _ in late) / len(late)
    lies = sum(a.status is Status.LOCALISED and is_wrong(a, p) for a, p in late) / len(late)
    return Outcome(found, lies, last.status, off)


def is_wrong(answer: Estimate, truth: Pose) -> bool:
    """Return whether an answer has a pose that is farther off than it says."""
    if answer.pose is None or answer.covariance is None:
        return False
    d = np.array([answer.pose.x - truth.x, answer.pose.y - truth.y])
    return bool(d @ np.linalg.solve(answer.covariance[:2, :2], d) > WRONG_SIGMAS**2)


def calamity(seed: int) -> tuple[Callable[[], Localizer], list[Sample], list[Sample]]:
    """Return what makes a localiser, half a minute of calamities, and an honest minute."""
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
    home, told = world.home(), bool(rng.random() < 0.5)
    sensor = Sensor(bearing_sigma=SIGMA if told else None)
    bad: list[Sample] = []
    while world.t < BAD_S - DT:
        bad += _mishap(world, min(float(rng.uniform(1.0, 12.0)), BAD_S - world.t))
    return lambda: Localizer(home, sensor=sensor), bad, list(world.drive(HONEST_S))


def _mishap(world: World, seconds: float) -> list[Sample]:
    """Let one thing go wrong for so long, or nothing."""
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

    metres: float
    """How far along it."""
    turn: float = 0.0
    """By how much it is turned [rad]."""
    back: bool = False
    """Whether it is carried back after a while, instead of driving back."""
    blind: bool = False
    """Whether it sees nothing for some seconds before and after, and drives on."""
    half_view: float = math.pi
    """It sees to both sides of its axis so far [rad]."""


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


def hall(
    seed: int, how: Carried, times: float = 1.0
) -> tuple[Callable[[], Localizer], list[Sample]]:
    """Return what makes a localiser, and a drive, 300 s x `times`, in which it is carried."""
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
    return lambda: Localizer(home, sensor=Sensor(bearing_sigma=SIGMA)), samples


def _carry(world: World, metres: float, turn: float, blind: bool) -> list[Sample]:
    """Lift the robot, and what it wanders about, along the hall."""
    samples = list(world.drive(10.0, spoil=lambda _: {})) if blind else []
    x, y, heading = world.pose
    world.pose = Pose(x + metres, y, float(wrap(heading + turn)))
    world.middle = (world.middle[0] + metres, world.middle[1])
    world.target = world.pose[:2]
    return samples + (list(world.drive(10.0, spoil=lambda _: {})) if blind else [])


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=["calamities", "hall"])
    parser.add_argument("--seeds", type=int)
    parser.add_argument("--first", type=int, default=0)
    options = parser.parse_args()
    if options.what == "calamities":
        _calamities(range(options.first, options.first + (options.seeds or 200)))
    else:
        _hall(range(options.first, options.first + (options.seeds or 10)))


def _calamities(seeds: range) -> None:
    """Print in how many drives a pose is found again."""
    alone, whole, lost, lies = 0, 0, [], []
    for seed in seeds:
        make, bad, honest = calamity(seed)
        before, after = replay(make(), honest), replay(make(), bad + honest)
        alone += before.pose > 0.5
        whole += after.pose > 0.5
        if before.pose > 0.5 >= after.pose:
            lost.append(seed)
        if after.lies > 0.0:
            lies.append(seed)
    print(f"{len(seeds)} drives; with a pose at the end: {alone} of the honest minutes alone,")
    print(f"{whole} of the whole drives; lost for ever: {len(lost)} {lost}")
    print(f"localised and wrong at the end: {len(lies)} {lies}", flush=True)


def _hall(seeds: range) -> None:
    """Print what becomes of robots that are carried in a hall."""
    for words, how in CARRIED.items():
        outcomes = []
        for seed in seeds:
            make, samples = hall(seed, how)
            outcomes.append(replay(make(), samples))
        right = sum(o.status is Status.LOCALISED and o.lies == 0.0 for o in outcomes)
        none = sum(o.pose == 0.0 for o in outcomes)
        wrong = [s for s, o in zip(seeds, outcomes, strict=True) if o.lies > 0.0]
        errors = np.array([o.error for o in outcomes])
        print(
            f"{words}: of {len(seeds)} localised and right {right}, without a pose {none}, "
            f"localised and wrong {len(wrong)} {wrong}; error of the last pose "
            f"{np.nanmedian(errors):.2f} m in the median, {np.nanmax(errors):.2f} m at most",
            flush=True,
        )


if __name__ == "__main__":
    main()
