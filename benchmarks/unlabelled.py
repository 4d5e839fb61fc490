"""Landmarks without ids against the same drives with ids.

`python -m benchmarks.unlabelled [--kinds NAME ...] [--seeds 5] [--first 0]` prints for each kind of
drives: RMSE over that with ids, availability without and with ids, the time inside 3 sigma, the
purity of identified sightings, their share of all that are of landmarks, the time `localised` with
an error beyond 4 sigma and 0.3 m, the cost of a frame over that with ids, the moved landmarks that
were reported, less false reports, and the share localised. Simulated robots turn by 2 rad/s at
most, except in the kind "sharp turns" (up to 34 rad/s at constant speed). Real drives are MRCLAM
sets 6 and 1 without barcodes (read from HOMEWARD_DATA, else from ../shared/data); set 1 has no
ground truth, the run with ids is the reference. With ids, false bearings are left out: a detector
that reads ids has none.
"""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np

from benchmarks.measures import SURE, Figures
from benchmarks.monte_carlo import Column, Run, benchmark
from benchmarks.mrclam import HOME, data, without_ranges
from homeward.drives.drive import Drive, HomeBearing, Odometry, Sightings, Truth
from homeward.drives.importers.mrclam import read_mrclam
from homeward.drives.settings import DriveSettings
from homeward.estimator import Status
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose
from homeward.localizer.localizer import Localizer
from homeward.runs.scoring import errors, score
from homeward.sighting_keys import is_unlabelled, numbered
from homeward.track import Track
from homeward.track import run as follow

SIGMA = 0.01
ODOMETRY_HZ, FRAMES_HZ = 20.0, 5.0
SPEED = 0.5
"""Of the robot [m/s]."""


@dataclass(frozen=True)
class Scene:
    """Landmarks, path and camera of a simulated drive."""

    places: np.ndarray
    """(n, 2) [m]"""
    home: Pose
    seed: int
    size: float = 12.0
    """Side of the square that the path is in [m]."""
    reach: float = math.inf
    """Greatest distance of landmarks in view [m]."""
    field: float = math.tau
    """Field of view [rad]."""
    false: float = 0.0
    """False bearings, as a share of all."""
    missed: float = 0.2
    moved: int = 0
    """Landmarks that were elsewhere at home."""
    classes: int = 0
    with_ids: int = 0
    """The first landmarks, which have ids."""
    duration: float = 180.0
    turn_rate: float = 2.0
    """Largest turn rate [rad/s]: the robot is slower in curves."""
    carried: bool = False
    """Whether the robot is carried elsewhere in the middle of the drive."""
    path: Callable[[np.ndarray], np.ndarray] | None = None
    """Position (k, 2) at phases (k,) in a turn; None: a random loop."""


class Pair(NamedTuple):
    """The same drive without and with ids, and the landmark of each row of the former."""

    without: Drive
    with_ids: Drive
    labels: list[str]
    moved: frozenset[str] = frozenset()


def simulated(scene: Scene) -> Pair:
    """Simulate a drive."""
    rng = np.random.default_rng(scene.seed)
    path = scene.path or _loop(rng, scene.size)
    steps = round(scene.duration * ODOMETRY_HZ)
    t = np.arange(steps + 1) / ODOMETRY_HZ
    begin = rng.uniform(0, math.tau) if scene.path is None else 0.0
    phase, jump = begin + _phase(path, scene.turn_rate, t, begin), len(t) // 2
    phase[jump:] += rng.uniform(1.0, 5.0) if scene.carried else 0.0
    parts = [path(part) for part in np.split(phase, [jump])]
    p = np.concatenate(parts)
    tangents = np.concatenate([np.gradient(part, axis=0) for part in parts])
    heading = np.unwrap(np.arctan2(*tangents.T[::-1]))
    speed, rate = np.hypot(*np.diff(p, axis=0).T) * ODOMETRY_HZ, np.diff(heading) * ODOMETRY_HZ
    for twist in (speed, rate):
        twist[jump - 1] = twist[jump]  # odometry does not measure that
    scale = 1.0 + 0.01 * rng.standard_normal(2)
    v = scale[0] * speed + 0.02 * rng.standard_normal(steps)
    omega = scale[1] * rate + 0.02 * rng.standard_normal(steps)
    rows, labels, named = [], list[str](), []
    kinds = [f"class:{'abcdefgh'[i % scene.classes]}" if scene.classes else "" for i in range(99)]
    for k in range(0, steps, round(ODOMETRY_HZ / FRAMES_HZ)):
        away = scene.places - p[k]
        angle = wrap(np.arctan2(away[:, 1], away[:, 0]) - heading[k])
        seen = (np.abs(angle) < scene.field / 2) & (np.hypot(*away.T) < scene.reach)
        seen &= rng.random(len(seen)) >= scene.missed
        frame = [(i, angle[i] + SIGMA * rng.standard_normal()) for i in np.flatnonzero(seen)]
        named += [(t[k], f"L{i}", wrap(b), SIGMA) for i, b in frame]
        mean = len(frame) * scene.false / (1.0 - scene.false) if scene.false else 0.0
        frame += [(-1, b) for b in rng.uniform(-0.5, 0.5, rng.poisson(mean)) * scene.field]
        order = rng.permutation(len(frame))
        texts = [_text(frame[j][0], scene, kinds) for j in order]
        for key, j in zip(numbered(texts), order, strict=True):
            rows.append((t[k], key, float(wrap(frame[j][1])), SIGMA))
            labels.append(f"L{frame[j][0]}" if frame[j][0] >= 0 else "")
    former, moved = scene.places.copy(), rng.permutation(len(scene.places))[: scene.moved]
    turn = rng.uniform(0, math.tau, scene.moved)
    former[moved] += 1.5 * np.column_stack([np.cos(turn), np.sin(turn)])
    away = former - np.array([scene.home.x, scene.home.y])
    at_home = np.flatnonzero(np.hypot(*away.T) < scene.reach)
    stored = wrap(np.arctan2(away[:, 1], away[:, 0]) - scene.home.heading)
    stored = wrap(stored + SIGMA * rng.standard_normal(len(stored)))
    order = rng.permutation(at_home)
    keys = numbered(_text(i, scene, kinds) for i in order)
    truly = {f"L{i}": HomeBearing(float(stored[i]), SIGMA) for i in at_home}
    blind = {k: HomeBearing(float(stored[i]), SIGMA) for k, i in zip(keys, order, strict=True)}
    gone = frozenset(k for k, i in zip(keys, order, strict=True) if i in moved)
    settings = DriveSettings.model_validate(
        {"sensor": {"x": 0.0, "y": 0.0, "yaw": 0.0, "bearing_sigma": SIGMA}}
    )
    truth = Truth(t, *p.T, heading).seen_from(scene.home)
    odometry = Odometry(t[:-1], v, omega)
    of_rows = Sightings.of_rows
    with_ids = Drive("with ids", odometry, of_rows(named), truly, settings, truth)
    without = Drive("without ids", odometry, of_rows(rows), blind, settings, truth)
    return Pair(without, with_ids, labels, gone)


def _text(i: int, scene: Scene, kinds: list[str]) -> str:
    if 0 <= i < scene.with_ids:
        return f"L{i}"
    return kinds[i] if i >= 0 else (kinds[0] if scene.classes else "")


def _loop(rng: np.random.Generator, size: float) -> Callable[[np.ndarray], np.ndarray]:
    """Return a random smooth loop within a square around the origin."""
    a, b = rng.standard_normal((2, 2, 3))

    def path(phase: np.ndarray) -> np.ndarray:
        k = np.arange(1, 4)
        turned = np.asarray(phase)[:, None, None] * k
        p = (a / k * np.cos(turned) + b / k * np.sin(turned)).sum(axis=2)
        return np.asarray(p * size / 5.0)

    return path


def _phase(
    path: Callable[[np.ndarray], np.ndarray], rate: float, t: np.ndarray, begin: float
) -> np.ndarray:
    """Return the phases at which a robot of a largest turn rate [rad/s] is at times [s]."""
    fine = np.linspace(0.0, math.tau, 4001)
    step = np.diff(path(begin + fine), axis=0)
    turn = np.abs(wrap(np.diff(np.arctan2(*step.T[::-1]), append=np.arctan2(*step[0, ::-1]))))
    lasts = np.maximum(np.hypot(*step.T) / SPEED, turn / rate)
    stamps = np.concatenate([[0.0], lasts.cumsum()])
    laps, rest = np.divmod(t, stamps[-1])
    return np.asarray(math.tau * laps + np.interp(rest, stamps, fine))


def scattered(seed: int, number: int, size: float = 12.0, apart: float = 0.3) -> np.ndarray:
    """Return places (n, 2) in a square around the origin [m]."""
    rng, places = np.random.default_rng([seed, 1]), np.zeros((0, 2))
    while len(places) < number:
        new = rng.uniform(-0.6 * size, 0.6 * size, 2)
        if not len(places) or np.hypot(*(places - new).T).min() > apart:
            places = np.vstack([places, new])
    return places


def open_hall(seed: int, number: int = 25, **options: float) -> Pair:
    """A hall of landmarks in which 5 to 10 are in view."""
    places, rng = scattered(seed, number), np.random.default_rng([seed, 2])
    home = Pose(*rng.uniform(-2.0, 2.0, 2), rng.uniform(-math.pi, math.pi))
    reach = {"reach": 4.7} if "reach" not in options else {}
    return simulated(Scene(places, home, seed, **(reach | options)))  # type: ignore[arg-type]


def room(seed: int, number: int = 15, **options: float) -> Pair:
    """A room of which all landmarks are in view."""
    places, rng = scattered(seed, number, 8.0, 0.5), np.random.default_rng([seed, 2])
    home = Pose(*rng.uniform(-2.0, 2.0, 2), rng.uniform(-math.pi, math.pi))
    return simulated(Scene(places, home, seed, size=8.0, **options))  # type: ignore[arg-type]


def square(seed: int, duration: float = 180.0) -> Pair:
    """Four equal posts in a square."""
    places = np.array([[2.0, 2.0], [-2.0, 2.0], [-2.0, -2.0], [2.0, -2.0]])
    rng = np.random.default_rng([seed, 2])
    home = Pose(*rng.uniform(-1.0, 1.0, 2), rng.uniform(-math.pi, math.pi))
    return simulated(Scene(places, home, seed, size=5.0, duration=duration))


def two_rooms(seed: int, duration: float = 180.0) -> Pair:
    """Two equal rooms, of which the robot sees both before it can find home, or one of them."""
    rng = np.random.default_rng([seed, 2])
    one = np.column_stack([rng.uniform(-2.5, 2.5, 6), rng.uniform(-2.5, 2.5, 6)])
    places = np.vstack([one + np.array([x, 0.0]) for x in (-4.0, 4.0)])
    home = Pose(-4.0 + rng.uniform(-1, 1), rng.uniform(-1, 1), rng.uniform(-math.pi, math.pi))
    start = math.pi / 2 if seed % 2 else 0.0  # between the rooms, or in the middle of the other

    def path(phase: np.ndarray) -> np.ndarray:
        phase = np.asarray(phase) + start
        return np.column_stack([5.5 * np.cos(phase), 1.6 * np.sin(2.0 * phase)])

    return simulated(Scene(places, home, seed, reach=3.9, path=path, duration=duration))


def mrclam(folder: str, robots: tuple[int, ...], seed: int) -> Pair:
    """The real drive of one of some robots, without barcodes."""
    robot = robots[seed % len(robots)]
    drive = without_ranges(read_mrclam(data() / folder, robot, HOME, math.radians(0.5), 0))
    seen, rng = drive.sightings, np.random.default_rng(seed)
    names, begins = seen.landmark.astype(str), seen.begins.tolist()
    order = np.concatenate(
        [a + rng.permutation(b - a) for a, b in zip(begins, [*begins[1:], len(names)], strict=True)]
    )
    keys = np.array(
        [k for a, b in zip(begins, [*begins[1:], len(names)], strict=True)
         for k in numbered([""] * (b - a))], object,
    )  # fmt: skip
    stored = list(drive.home.values())
    home = {
        key: stored[i]
        for key, i in zip(numbered([""] * len(stored)), rng.permutation(len(stored)), strict=True)
    }
    sightings = replace(seen.rows(order), landmark=keys)
    return Pair(replace(drive, sightings=sightings, home=home), drive, names[order].tolist())


KINDS: dict[str, Callable[[int], Pair]] = {
    "360, 0 % false": open_hall,
    "360, 10 % false": partial(open_hall, false=0.1),
    "360, 20 % false": partial(open_hall, false=0.2),
    "sharp turns": partial(open_hall, turn_rate=math.inf),
    "60 landmarks": partial(open_hall, number=60, reach=3.0),
    "camera of 90": partial(open_hall, field=math.pi / 2, reach=7.0),
    "3 of 15 moved": partial(room, moved=3),
    "3 classes": partial(open_hall, number=15, classes=3, reach=6.0),
    "8 with ids": partial(open_hall, with_ids=8),
    "carried": partial(open_hall, carried=True),
    "carried, camera of 90": partial(
        open_hall, carried=True, field=math.pi / 2, reach=7.0, duration=400.0
    ),
    "square": square,
    "two rooms": two_rooms,
    "mrclam 6": partial(mrclam, "MRCLAM_Dataset6", (1, 2, 3, 4, 5)),
    "mrclam 1": partial(mrclam, "MRCLAM_Dataset1", (1, 3)),
}


COLUMNS = (
    Column("RMSE ratio", "ratio", np.nanmean, 2),
    Column("available", by=np.nanmean, digits=2),
    Column("with ids", "available_with_ids", np.nanmean, 2),
    Column("inside", by=np.nanmean),
    Column("purity", by=np.nanmean),
    Column("identified", by=np.nanmean, digits=2),
    Column("wrong [s]", "wrong", np.nanmean, 1),
    Column("worst", "wrong", np.nanmax, 1),
    Column("with ids", "wrong_with_ids", np.nanmean, 1),
    Column("cost", digits=2),  # the median: the first drive of a process pays for imports
    Column("moved found", "found", np.nanmean, 2),
    Column("localised", by=np.nanmean, digits=2),
)


def measured(run: Run) -> Figures:
    """Return the figures of a drive without and with ids."""
    return compared(KINDS[run.scenario](run.seed))


def compared(pair: Pair) -> Figures:
    """Return the figures of a drive of which both forms are run."""
    localizer, at = Localizer(pair.without.home, **pair.without.settings.robot), math.nan
    table: dict[str, Counter[str]] = defaultdict(Counter)
    stamps, keys = pair.without.sightings.t, pair.without.sightings.landmark
    row = {(t, str(k)): label for t, k, label in zip(stamps, keys, pair.labels, strict=True)}

    def look(estimate: object) -> None:
        nonlocal at
        if localizer.unlabelled is None or localizer.unlabelled.at == at:
            return
        at = localizer.unlabelled.at
        for key, name in localizer.unlabelled.names.items():
            table[name][row[at, key]] += 1

    track = follow(pair.without, localizer, on_estimate=look)
    best = follow(pair.with_ids, Localizer(pair.with_ids.home, **pair.with_ids.settings.robot))
    if track.failures:
        raise RuntimeError(f"internal error: {track.failures[0]}")
    total = sum(sum(c.values()) for c in table.values())
    pure = sum(max(c.values()) if c.most_common(1)[0][0] else 0 for c in table.values())
    rows = [label for key, label in zip(keys, pair.labels, strict=True) if is_unlabelled(str(key))]
    known = sum(c.total() - c[""] for c in table.values())
    moved = {m.landmark for m in track.landmarks if m.moved}
    named = len(moved & pair.moved) - len(moved - pair.moved)
    shares, with_ids = (score(t, None).status_shares for t in (track, best))
    ratio, inside, wrong = _accuracy(track, pair.without.truth, best)
    return {
        "ratio": ratio,
        "available": sum(shares.get(s, 0.0) for s in SURE),
        "available_with_ids": sum(with_ids.get(s, 0.0) for s in SURE),
        "inside": inside,
        "purity": pure / max(total, 1),
        "identified": known / max(sum(map(bool, rows)), 1),
        "wrong": wrong,
        "wrong_with_ids": _accuracy(best, pair.with_ids.truth, track)[2],
        "cost": float(track.update_seconds.sum() / best.update_seconds.sum()),
        "found": named / len(pair.moved) if pair.moved else None,
        "localised": shares.get(Status.LOCALISED, 0.0),
    }


def _accuracy(track: Track, truth: Truth | None, other: Track) -> tuple[float, float, float]:
    """Return the RMSE over that of another track, the time inside 3 sigma, and that wrong [s].

    The RMSE is of the times at which both are localised. Without ground truth, the other one is.
    """
    if truth is None:
        use = other.has_pose
        truth = Truth(*(a[use] for a in (other.t, other.x, other.y, other.heading)))
    status = dict(zip(track.t.tolist(), track.status, strict=True))
    ours, theirs = errors(track, truth), errors(other, truth)
    known = np.array([status[t] is Status.LOCALISED for t in ours.t.tolist()], bool)
    if not known.any():
        return math.nan, math.nan, 0.0
    weight = ours.weight[known]
    inside = float(np.average(ours.nees_position[known] < 9.0, weights=weight))
    off = (ours.nees_position[known] > 16.0) & (ours.position[known] > 0.3)
    both = np.isin(ours.t, theirs.t[np.isfinite(theirs.position)]) & known
    same = np.isin(theirs.t, ours.t[both])
    if not same.any():
        return math.nan, inside, float(weight[off].sum())
    rmse = [math.sqrt(np.average(e.position[use] ** 2, weights=e.weight[use])) for e, use in
            ((ours, both), (theirs, same))]  # fmt: skip
    return rmse[0] / max(rmse[1], 1e-9), inside, float(weight[off].sum())


def main() -> None:
    benchmark(__doc__, measured, [*KINDS], COLUMNS, seeds=5, names="kinds")


if __name__ == "__main__":
    main()
