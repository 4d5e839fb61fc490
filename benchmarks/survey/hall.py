"""A hall with surveyed reflectors, and a vehicle that drives round it and stops at stations."""

import math
from dataclasses import dataclass

import numpy as np

from homeward.geometry.frames import Pose, Twist, advance, bearing

LONG, WIDE, SEES = 20.0, 12.0, 14.0  # size of the hall, and range of the scanner [m]
DT, EVERY = 0.1, 2  # interval of odometry [s], and number of twists per frame of bearings
SPEED, STOP_S = 0.8, 8.0
SPEED_SIGMA, TURN_SIGMA, SPEED_SCALE = 0.02, 0.005, 0.02
"""White noise of the odometry [m/s, rad/s at 1 Hz], and scale error of its speed [1]."""
STATIONS = ((0.0, 0.0), (7.0, 3.0), (-7.0, 3.0), (-7.0, -3.0), (7.0, -3.0))


@dataclass(frozen=True)
class Sample:
    """Inputs at one time."""

    t: float
    truth: Pose
    twist: tuple[float, float]  # of odometry
    seen: dict[str, float] | None  # bearings, if there is a frame
    stop: int  # number of the stop, from 0; -1 while driving


@dataclass(frozen=True)
class Hall:
    """One drive through a hall."""

    survey: dict[str, tuple[float, float]]  # surveyed positions of reflectors [m]
    moved: set[str]  # reflectors moved since
    samples: list[Sample]


def make_hall(
    seed: int, moved: int, bearing_sigma: float, survey_sigma: float, reflectors: int = 12
) -> Hall:
    """Return a drive of about three minutes from a seed."""
    rng = np.random.default_rng(seed)
    along = (np.arange(reflectors) + rng.uniform(-0.3, 0.3, reflectors)) / reflectors
    places = {f"R{i}": _on_wall(2.0 * (LONG + WIDE) * s) for i, s in enumerate(along.tolist())}
    survey = {n: tuple((p + survey_sigma * rng.normal(size=2)).tolist()) for n, p in places.items()}
    gone = set(rng.choice(list(places), moved, replace=False).tolist())
    for name in sorted(gone):
        way = rng.uniform(0, 2 * math.pi)
        places[name] = places[name] + rng.uniform(0.3, 2.0) * np.array(
            [math.cos(way), math.sin(way)]
        )
    return Hall(survey, gone, _drive(places, rng, bearing_sigma))


def _on_wall(s: float) -> np.ndarray:
    """Return the point of the walls at a distance along them [m]."""
    end = direction = np.zeros(2)
    for corner, way, length in (
        ((-LONG / 2, -WIDE / 2), (1, 0), LONG),
        ((LONG / 2, -WIDE / 2), (0, 1), WIDE),
        ((LONG / 2, WIDE / 2), (-1, 0), LONG),
        ((-LONG / 2, WIDE / 2), (0, -1), WIDE),
    ):
        end, direction = np.array(corner), np.array(way)
        if s <= length:
            break
        s -= length
    return end + s * direction


def _drive(places: dict[str, np.ndarray], rng: np.random.Generator, sigma: float) -> list[Sample]:
    """Return the samples of a drive from station to station, round twice."""
    pose, t, samples = Pose(0.0, 0.0, 0.3), 0.0, list[Sample]()

    def take(twist: Twist, stop: int) -> Pose:
        noise = rng.normal(size=2) * [SPEED_SIGMA, TURN_SIGMA] / math.sqrt(DT)
        v, omega = twist.v / (1.0 + SPEED_SCALE), twist.omega
        felt = (v + noise[0], omega + noise[1]) if v or omega else (0.0, 0.0)
        seen = None
        if len(samples) % EVERY == 0:
            near = {n: p for n, p in places.items() if math.dist(p, pose[:2]) < SEES}
            seen = {
                n: math.remainder(bearing(pose, *p) + sigma * rng.normal(), math.tau)
                for n, p in near.items()
            }
        samples.append(Sample(t, pose, felt, seen, stop))
        return advance(pose, twist, DT)

    for stop, target in enumerate(STATIONS * 2):
        while (away := math.dist(pose[:2], target)) > 0.1:
            off = math.remainder(bearing(pose, *target), math.tau)
            v = min(SPEED, away) * max(math.cos(off), 0.0)
            pose = take(Twist(max(v, 0.05), max(min(1.5 * off, 0.6), -0.6)), -1)
            t += DT
        for _ in range(round(STOP_S / DT)):
            pose = take(Twist(0.0, 0.0), stop)
            t += DT
    return samples
