"""Faults in the middle of a drive: how long is the pose wrong, and when is it noticed?

`python -m benchmarks.faults [--drive FOLDER] [--begin 100] [--seconds 30] [--view 360]
[--fault NAME ...]` plays the sample, or another drive with ground truth, through the localiser,
each time with one fault; its camera may see fewer degrees than that of the drive. For each: the
time with the status localised and an error of more than 0.3 m and 4 sigma, in sum and the longest
interval [s], the largest such error [m], the time from the beginning of the fault to the first
answer that is not localised [s], the share of the drive localised, and its first reason. `--list`
prints the faults.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks import monte_carlo
from homeward.drives.drive import Drive, Sightings
from homeward.drives.opening import open_drive, sample_drive
from homeward.estimator import Estimate, Status
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose, bearing, compose
from homeward.localizer.localizer import Localizer
from homeward.runs.scoring import normalised_squared

MIN_WRONG_M, MIN_WRONG_SIGMA = 0.3, 4.0
TRACK_WIDTH_M = 0.3
"""Distance of the wheels, for faults of one wheel."""


class Sample(NamedTuple):
    """A twist, or the bearings of one frame."""

    at: float
    """True time [s]."""
    stamp: float
    """Stamp that the localiser gets [s]."""
    twist: tuple[float, float] | None
    """(v [m/s], omega [rad/s]); None for bearings."""
    seen: Mapping[str, float]
    """Bearings by landmark [rad]."""


Samples = list[Sample]


class Scene(NamedTuple):
    """A drive and what a fault of its landmarks needs."""

    drive: Drive
    samples: Samples
    positions: dict[str, tuple[float, float]]
    """Of the landmarks in the home frame, as estimated without a fault [m]."""
    begin: float
    end: float
    """Interval of the fault [s]."""


class Outcome(NamedTuple):
    """What happened in a drive with a fault."""

    wrong: float
    longest: float
    worst: float
    noticed: float
    localised: float
    pose: float
    after: float
    """Shares of the drive localised and with a pose, and of the time after the fault localised."""
    reason: str


Change = Callable[[Scene, Sample, np.random.Generator], Sample | None]


def during(change: Change, for_good: bool = False) -> Callable[[Scene], Samples]:
    """Return a fault that changes, or drops, each sample in its interval."""

    def fault(scene: Scene) -> Samples:
        rng = np.random.default_rng(0)
        found: list[Sample | None] = []
        for sample in scene.samples:
            is_hit = scene.begin <= sample.at and (for_good or sample.at < scene.end)
            found.append(change(scene, sample, rng) if is_hit else sample)
        return [sample for sample in found if sample is not None]

    return fault


def wheels(law: Callable[[float, float], tuple[float, float]]) -> Change:
    """Return the change of each twist (v, omega)."""
    return lambda _, s, rng: s if s.twist is None else s._replace(twist=law(*s.twist))


def one_wheel(left: float, right: float) -> Change:
    """Return the change of twists where encoders count more or less than the wheels turn."""

    def law(v: float, omega: float) -> tuple[float, float]:
        half = 0.5 * TRACK_WIDTH_M * omega
        slow, fast = left * (v - half), right * (v + half)
        return 0.5 * (slow + fast), (fast - slow) / TRACK_WIDTH_M

    return wheels(law)


def camera(law: Callable[[dict[str, float], np.random.Generator], dict[str, float]]) -> Change:
    """Return the change of the bearings of each frame; a frame without bearings is dropped."""

    def change(_: Scene, s: Sample, rng: np.random.Generator) -> Sample | None:
        seen = law(dict(s.seen), rng) if s.twist is None else s.seen
        return s._replace(seen=seen) if seen or s.twist is not None else None

    return change


def turned(angle: float) -> Change:
    """Return the change of a camera that is turned by an angle [rad]."""
    return camera(lambda seen, rng: {n: float(wrap(b - angle)) for n, b in seen.items()})


def noisy(sigma: float) -> Change:
    """Return the change of a camera with more noise [rad]."""
    return camera(
        lambda seen, rng: {n: float(wrap(b + sigma * rng.normal())) for n, b in seen.items()}
    )


def frozen(jitter: float) -> Callable[[Scene], Samples]:
    """Return the fault of a camera that repeats its last image, with some noise [rad]."""

    def fault(scene: Scene) -> Samples:
        last = [s.seen for s in scene.samples if s.twist is None and s.at < scene.begin][-1]
        repeat = camera(lambda _, rng: {n: b + jitter * rng.normal() for n, b in last.items()})
        return during(repeat)(scene)

    return fault


def renamed(rotate: int) -> Change:
    """Return the change of ids: each landmark has the id of another one."""

    def change(scene: Scene, s: Sample, _: np.random.Generator) -> Sample:
        names = sorted(scene.positions)
        other = dict(zip(names, names[rotate:] + names[:rotate], strict=True))
        return s._replace(seen={other.get(n, n): b for n, b in s.seen.items()})

    return change


def moved(share: float, by: tuple[float, float] | None = None) -> Change:
    """Return the change by landmarks that are moved, by one vector [m] or each by its own."""

    def change(scene: Scene, s: Sample, _: np.random.Generator) -> Sample:
        if s.twist is not None or scene.drive.truth is None:
            return s
        names = sorted(scene.positions)
        names = names[: round(share * len(names))]
        robot = Pose(*map(float, scene.drive.truth.at(s.at)))
        eye = Pose(*map(float, compose(robot, scene.drive.settings.sensor.pose)))
        seen = dict(s.seen)
        for k, name in enumerate(names):
            if name in seen:
                x, y = scene.positions[name]
                dx, dy = by or (math.cos(2.4 * k), math.sin(2.4 * k))
                seen[name] += float(bearing(eye, x + dx, y + dy) - bearing(eye, x, y))
        return s._replace(seen={n: float(wrap(b)) for n, b in seen.items()})

    return change


def kidnapped(scene: Scene) -> Samples:
    """Return the samples without those of the interval; later stamps follow at once."""
    gap = scene.end - scene.begin
    before = [s for s in scene.samples if s.at < scene.begin]
    return before + [s._replace(stamp=s.stamp - gap) for s in scene.samples if s.at >= scene.end]


def restamped(by: float, bearings_only: bool = False) -> Change:
    """Return the change of stamps by a time [s]."""

    def change(_: Scene, s: Sample, rng: np.random.Generator) -> Sample:
        return s if bearings_only and s.twist is not None else s._replace(stamp=s.stamp + by)

    return change


def twice(scene: Scene) -> Samples:
    """Return the samples with each of the interval repeated."""
    pairs = ([s, s] if scene.begin <= s.at < scene.end else [s] for s in scene.samples)
    return [s for pair in pairs for s in pair]


def swapped(scene: Scene) -> Samples:
    """Return the samples with every tenth one of the interval after the next one."""
    found = list(scene.samples)
    for k in range(0, len(found) - 1, 10):
        if scene.begin <= found[k].at < scene.end:
            found[k], found[k + 1] = found[k + 1], found[k]
    return found


def nothing(*_: object) -> None:
    """Drop a sample."""


def only(is_twist: bool, change: Change) -> Change:
    """Return a change of twists only, or of bearings only."""
    return lambda scene, s, rng: change(scene, s, rng) if (s.twist is None) != is_twist else s


CHANGES: dict[str, Change] = {
    **{
        f"wheels count {k} times the way": wheels(lambda v, w, k=k: (k * v, w))
        for k in (0.3, 0.5, 1.5, 2.0, 3.0, 5.0)
    },
    "one wheel counts 0.3 times": one_wheel(1.0, 0.3),
    "one wheel counts 3 times": one_wheel(1.0, 3.0),
    "one wheel is dead": one_wheel(1.0, 0.0),
    "odometry is zero": wheels(lambda v, w: (0.0, 0.0)),
    "odometry is reversed": wheels(lambda v, w: (-v, -w)),
    "odometry is silent": only(True, nothing),
    "turn rate is stuck": wheels(lambda v, w: (v, 0.2)),
    "turn rate has a bias of 0.1 rad/s": wheels(lambda v, w: (v, w + 0.1)),
    "camera is silent": only(False, nothing),
    "camera loses half of the frames": only(
        False, lambda _, s, rng: s if rng.random() < 0.5 else None
    ),
    "bearings have noise of 0.3 rad": noisy(0.3),
    "bearings are reversed": camera(lambda seen, _: {n: -b for n, b in seen.items()}),
    "bearings are all equal": camera(lambda seen, _: dict.fromkeys(seen, 0.3)),
}
"""Faults that change each sample of their interval, also in `benchmarks.closed_loop`."""
FAULTS: dict[str, Callable[[Scene], Samples]] = {
    "none": lambda scene: scene.samples,
    **{name: during(change) for name, change in CHANGES.items()},
    "camera is frozen": frozen(0.0),
    "camera is frozen, noise 0.002 rad": frozen(0.002),
    "camera is frozen, noise 0.02 rad": frozen(0.02),
    **{
        f"camera is turned by {a} rad, for good": during(turned(a), for_good=True)
        for a in (0.1, 0.3, 1.0)
    },
    "ids are rotated": during(renamed(1)),
    "ids are rotated, for good": during(renamed(1), for_good=True),
    "half of the landmarks move, each by 1 m, for good": during(moved(0.5), for_good=True),
    "half of the landmarks move by the same 1 m, for good": during(
        moved(0.5, (0.8, 0.6)), for_good=True
    ),
    "robot is carried": kidnapped,
    "samples come twice": twice,
    "samples come in another order": swapped,
    "stamps jump by 5 s, for good": during(restamped(5.0), for_good=True),
    "stamps jump by -5 s, for good": during(restamped(-5.0), for_good=True),
    "stamps of bearings are 0.5 s late": during(restamped(0.5, bearings_only=True)),
    "stamps of bearings jump by 5 s, for good": during(
        restamped(5.0, bearings_only=True), for_good=True
    ),
}


def samples_of(drive: Drive) -> Samples:
    """Return the twists and frames of a drive by time."""
    o = drive.odometry
    samples = [
        Sample(t, t, (v, w), {})
        for t, v, w in zip(o.t.tolist(), o.v.tolist(), o.omega.tolist(), strict=True)
    ]
    samples += [Sample(t, t, None, seen) for t, seen, _ in drive.sightings.stamps()]
    return sorted(samples, key=lambda s: (s.at, s.twist is None))


def scene_of(drive: Drive, begin: float, seconds: float) -> Scene:
    """Return the scene of a fault that begins some time after the drive did [s]."""
    samples = samples_of(drive)
    localizer = Localizer(drive.home, **drive.settings.robot)
    for _ in played(localizer, samples):
        pass
    found = localizer.landmarks()
    positions = {m.landmark: (m.x, m.y) for m in found if math.isfinite(m.x + m.y)}
    start = float(drive.odometry.t[0])
    return Scene(drive, samples, positions, start + begin, start + begin + seconds)


def played(localizer: Localizer, samples: Samples) -> Iterator[tuple[float, Estimate]]:
    """Yield the true time and the answer of each frame."""
    for s in samples:
        if s.twist is not None:
            localizer.odometry(s.stamp, *s.twist)
        elif s.seen:
            yield s.at, localizer.bearings(s.stamp, s.seen)


def seen_within(drive: Drive, view: float) -> Drive:
    """Return a drive whose camera has a field of view [rad]."""
    seen = drive.sightings
    rows = [
        row
        for row in zip(
            seen.t.tolist(), seen.landmark, seen.bearing.tolist(), seen.sigma.tolist(), strict=True
        )
        if abs(row[2]) <= 0.5 * view
    ]
    return replace(drive, sightings=Sightings.of_rows(rows))


def outcome(scene: Scene, samples: Samples) -> Outcome:
    """Return what happens in a drive with these samples."""
    truth = scene.drive.truth
    assert truth is not None
    localizer = Localizer(scene.drive.home, **scene.drive.settings.robot)
    answers = list(played(localizer, samples))
    times = np.array([t for t, _ in answers])
    seconds = np.minimum(np.diff(times, append=times[-1:]), 1.0)
    nowhere = np.full(2, np.nan), np.eye(2)
    found = [
        nowhere if a.covariance is None else (a.pose[:2], a.covariance[:2, :2]) for _, a in answers
    ]
    poses, covariances = (np.array(part) for part in zip(*found, strict=True))
    error = np.nan_to_num(poses - np.stack(truth.at(times)[:2], axis=1))
    off, deviations = np.hypot(*error.T), np.sqrt(normalised_squared(error, covariances))
    localised = np.array([answer.status is Status.LOCALISED for _, answer in answers])
    wrong = localised & (off > MIN_WRONG_M) & (deviations > MIN_WRONG_SIGMA)
    longest = interval = 0.0
    for is_wrong, step in zip(wrong.tolist(), seconds.tolist(), strict=True):
        interval = interval + step if is_wrong else 0.0
        longest = max(longest, interval)
    after = np.flatnonzero(~localised & (times >= scene.begin))
    noticed = float(times[after[0]] - scene.begin) if after.size else math.inf
    return Outcome(
        float(seconds[wrong].sum()),
        longest,
        float(off[wrong].max(initial=0.0)),
        noticed,
        _share(seconds, localised),
        _share(seconds, np.array([answer.pose is not None for _, answer in answers])),
        _share(seconds[times >= scene.end], localised[times >= scene.end]),
        answers[after[0]][1].reason if after.size else "",
    )


def _share(seconds: np.ndarray, use: np.ndarray) -> float:
    """Return the share of the time that is used; NaN where there is none."""
    return float(seconds[use].sum() / seconds.sum()) if seconds.size else math.nan


def row(name: str, found: Outcome) -> str:
    """Return a row of the table."""
    noticed = f"{found.noticed:.1f}" if math.isfinite(found.noticed) else "never"
    wrong = f"{found.wrong:.1f} | {found.longest:.1f} | {found.worst:.1f}"
    return f"| {name} | {wrong} | {noticed} | {100 * found.localised:.0f} % | {found.reason} |"


def main() -> None:
    options = monte_carlo.parsed(
        __doc__, drive="", begin=100.0, seconds=30.0, view=360.0, fault=FAULTS, list=False
    )
    if options.list:
        print("\n".join(FAULTS))
        return
    drive = open_drive(Path(options.drive) if options.drive else sample_drive())
    drive = seen_within(drive, math.radians(options.view))
    scene = scene_of(drive, options.begin, options.seconds)
    print("| fault | wrong [s] | longest [s] | worst [m] | noticed [s] | localised | reason |")
    print("|---|---|---|---|---|---|---|")
    for name in options.fault:
        print(row(name, outcome(scene, FAULTS[name](scene))), flush=True)


if __name__ == "__main__":
    main()
