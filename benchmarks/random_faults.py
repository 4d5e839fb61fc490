"""Faults of random kinds, sizes and times in random rooms: how long is a pose wrong but localised?

`python -m benchmarks.random_faults [--seeds 10] [--first 0] [--kinds NAME ...]`: each seed is a
drive of 100 to 200 s among 5 to 30 landmarks, of which up to half have moved since home was stored,
with a camera of 62 to 360 degrees and a fault of 1 to 60 s, of a random size for each kind. The
noise is specified as it is; home bearings are from all around. The kind `none` is the control.

Columns: drives; those with a pose; those with an interval of more than 1.5 s localised and wrong
(error beyond 0.3 m and 4 sigma); the longest interval [s]; the largest such error [m]; the mean
shares localised: of the drive, and of the time after the end of the fault. Then each drive with a
wrong interval, with its settings.
"""

import math
from collections.abc import Callable
from functools import lru_cache

import numpy as np

from benchmarks.consistency.trial import wandering
from benchmarks.faults import (
    FAULTS,
    Samples,
    Scene,
    during,
    frozen,
    moved,
    noisy,
    one_wheel,
    outcome,
    renamed,
    restamped,
    samples_of,
    seen_within,
    turned,
    wheels,
)
from benchmarks.monte_carlo import Column, Figures, Run, benchmark
from homeward.lab.simulation import scenario as sim
from homeward.lab.simulation.simulate import simulate

MAX_WRONG_S = 1.5
"""Longer intervals localised and wrong count [s]."""
VIEWS = (62.0, 80.0, 120.0, 180.0, 360.0)
"""Fields of view [deg]."""
NUM_WAYPOINTS = 60
Fault = Callable[[Scene], Samples]
Random = np.random.Generator


def _factor(rng: Random, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(math.log(low), math.log(high))))


def _other_scale(rng: Random) -> float:
    """Return a factor from 0.3 to 5, but not near 1."""
    return _factor(rng, 1.3, 5.0) if rng.random() < 0.6 else _factor(rng, 0.3, 0.77)


def _sign(rng: Random) -> float:
    return float(rng.choice([-1.0, 1.0]))


def _speed_scale(rng: Random) -> Fault:
    k = _other_scale(rng)
    return during(wheels(lambda v, w: (k * v, w)))


def _turn_rate(rng: Random, stuck: bool) -> Fault:
    by = _sign(rng) * _factor(rng, 0.05, 0.5)
    return during(wheels((lambda v, w: (v, by)) if stuck else (lambda v, w: (v, w + by))))


def _same_vector(rng: Random) -> tuple[float, float]:
    by, way = _factor(rng, 0.3, 2.0), rng.uniform(-math.pi, math.pi)
    return by * math.cos(way), by * math.sin(way)


def unsized(name: str) -> Callable[[Random], Fault]:
    """Return a fault of `benchmarks.faults`, which has no size."""
    return lambda rng: FAULTS[name]


SIZED: dict[str, Callable[[Random], Fault]] = {
    "wheels count k times the way": _speed_scale,
    "one wheel counts k times": lambda rng: during(one_wheel(1.0, _other_scale(rng))),
    "turn rate is stuck": lambda rng: _turn_rate(rng, True),
    "turn rate has a bias": lambda rng: _turn_rate(rng, False),
    "bearings have more noise": lambda rng: during(noisy(_factor(rng, 0.03, 0.5))),
    "camera is frozen with noise": lambda rng: frozen(_factor(rng, 0.001, 0.05)),
    "camera is turned, for good": lambda rng: during(
        turned(_sign(rng) * _factor(rng, 0.05, 1.5)), for_good=True
    ),
    "ids are rotated": lambda rng: during(renamed(1), for_good=rng.random() < 0.5),
    "landmarks move, each by 1 m, for good": lambda rng: during(
        moved(rng.uniform(0.1, 0.5)), for_good=True
    ),
    "landmarks move together, for good": lambda rng: during(
        moved(rng.uniform(0.1, 0.5), _same_vector(rng)), for_good=True
    ),
    "stamps of bearings are late": lambda rng: during(
        restamped(_factor(rng, 0.1, 1.0), bearings_only=True)
    ),
}
"""Kinds of faults of random size."""
KINDS: dict[str, Callable[[Random], Fault]] = {
    "none": unsized("none"),
    **SIZED,
    **{
        name: unsized(name)
        for name in (
            "one wheel is dead",
            "odometry is zero",
            "odometry is reversed",
            "odometry is silent",
            "camera is silent",
            "camera loses half of the frames",
            "bearings are reversed",
            "bearings are all equal",
            "camera is frozen",
            "robot is carried",
            "samples come twice",
            "samples come in another order",
            "stamps jump by 5 s, for good",
        )
    },
}
"""All kinds."""


@lru_cache(maxsize=1)
def room(seed: int) -> tuple[Scene, str]:
    """Return the drive of a seed with the interval of its fault, and its settings in words."""
    rng = np.random.default_rng([seed, 65])
    count, view = int(rng.integers(5, 31)), float(rng.choice(VIEWS))
    num_moved = int(rng.uniform(0.0, 0.5) * count)
    seconds, sigma = rng.uniform(100.0, 200.0), _factor(rng, 0.003, 0.03)
    noise = sim.Noise(bearing_sigma=sigma, home_sigma=sigma)
    errors = sim.OdometryErrors(
        speed_sigma=_factor(rng, 0.005, 0.03),
        turn_sigma=_factor(rng, 0.005, 0.03),
        speed_scale_sigma=0.02,
        turn_scale_sigma=0.01,
    )
    course = wandering(
        seed,
        65,
        NUM_WAYPOINTS,
        (0.5, 2.0),
        speed=rng.uniform(0.2, 0.5),
        seconds=seconds,
        turned=0.5,
        landmarks=sim.Ring(count=count, distance=(2.5, 5.0)),
        moved=sim.Moved(count=num_moved),
        noise=noise,
        odometry=errors,
    )
    whole = simulate(course)
    drive = seen_within(whole.drive, math.radians(view))
    places = whole.world.in_home_frame.tolist()
    positions = dict(zip(whole.world.ids, map(tuple, places), strict=True))
    begin = float(rng.uniform(30.0, 0.7 * seconds))
    lasts = min(_factor(rng, 1.0, 60.0), seconds - begin - 10.0)
    words = (
        f"{count} landmarks, {num_moved} moved, {view:.0f} deg, {sigma:.3f} rad,"
        f" fault from {begin:.0f} s for {lasts:.0f} s of {seconds:.0f} s"
    )
    return Scene(drive, samples_of(drive), positions, begin, begin + lasts), words


def measured(run: Run) -> Figures:
    """Return the figures of a drive with a fault."""
    scene, words = room(run.seed)
    rng = np.random.default_rng([run.seed, list(KINDS).index(run.scenario)])
    found = outcome(scene, KINDS[run.scenario](rng)(scene))
    return {
        "drive": 1.0,
        "has_pose": float(found.pose > 0.0),
        "wrong": float(found.longest > MAX_WRONG_S),
        "longest": found.longest,
        "worst": found.worst,
        "localised": found.localised,
        "after": found.after,
        "words": words,
    }


COLUMNS = (
    Column("drives", "drive", np.nansum, 0),
    Column("with a pose", "has_pose", np.nansum, 0),
    Column("wrong", by=np.nansum, digits=0),
    Column("longest [s]", "longest", np.nanmax, 1),
    Column("worst [m]", "worst", np.nanmax, 1),
    Column("localised", by=np.nanmean, digits=3),
    Column("after", by=np.nanmean, digits=3),
)


def main() -> None:
    found = benchmark(__doc__, measured, [*KINDS], COLUMNS, seeds=10, names="kinds")
    for run, figures in found.items():
        if figures["wrong"]:
            at = f"{run.scenario}, seed {run.seed}"
            print(f"{at}: {figures['longest']:.1f} s; {figures['words']}")


if __name__ == "__main__":
    main()
