"""Faults of a drive in addition to those of the simulator.

Those that change sightings apply to a simulation, those that change logs or settings to a trial.
"""

import math
from dataclasses import replace

import numpy as np

from benchmarks.consistency.trial import Trial, spells
from homeward.drives.drive import HomeBearing
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose, bearing, compose
from homeward.lab.simulation.simulate import Simulation

WALKED_M = 4.0  # half side of the square around home in which people walk [m]


def with_walkers(still: Simulation, count: int, speed: float) -> tuple[Simulation, frozenset[str]]:
    """Replace `count` landmarks by people who walk at a speed [m/s] from where home saw them."""
    rng, seen = np.random.default_rng([still.scenario.seed, 4]), still.drive.sightings
    assert still.drive.truth is not None
    ids, places = np.array(still.world.ids), still.world.in_home_frame
    camera = compose(Pose(*still.drive.truth.at(seen.t)), still.scenario.sensor.pose)
    turned = np.zeros(seen.t.size)
    walkers = rng.choice(ids.size, count, replace=False)
    for i in walkers:
        stops = np.vstack([places[i], rng.uniform(-WALKED_M, WALKED_M, (100, 2))])
        far = np.concatenate([[0.0], np.hypot(*np.diff(stops, axis=0).T).cumsum()])
        x, y = (np.interp(speed * seen.t, far, column) for column in stops.T)
        off = bearing(camera, x, y) - bearing(camera, *places[i])
        turned += np.where(seen.landmark == ids[i], off, 0.0)
    changed = replace(seen, bearing=np.asarray(wrap(seen.bearing + turned)))
    walks = replace(still, drive=replace(still.drive, sightings=changed))
    return walks, frozenset(ids[walkers].tolist())


def with_swapped_ids(right: Simulation, pairs: int, begin: float, end: float) -> Simulation:
    """Swap the ids of pairs of landmarks from `begin` to `end` [s]."""
    rng, seen = np.random.default_rng([right.scenario.seed, 5]), right.drive.sightings
    chosen = rng.choice(np.array(right.world.ids, object), (pairs, 2), replace=False).tolist()
    other = dict(chosen) | {b: a for a, b in chosen}
    then = (seen.t >= begin) & (seen.t < end)
    names = [other.get(n, n) if t else n for n, t in zip(seen.landmark, then, strict=True)]
    changed = replace(seen, landmark=np.array(names, object))
    return replace(right, drive=replace(right.drive, sightings=changed))


def on_a_cart(places: np.ndarray, rng: np.random.Generator, count: int) -> np.ndarray:
    """Return positions (q, 2) [m]; some neighbouring ones were moved as one rigid body."""
    first = int(rng.integers(len(places)))
    load = (first + np.arange(count)) % len(places)
    turn, shift = rng.uniform(-0.6, 0.6), rng.uniform(0.5, 1.5)
    way = rng.uniform(-math.pi, math.pi)
    c, s = math.cos(turn), math.sin(turn)
    middle = places[load].mean(axis=0)
    moved = places.copy()
    moved[load] = (places[load] - middle) @ np.array([[c, s], [-s, c]]) + middle
    moved[load] += shift * np.array([math.cos(way), math.sin(way)])
    return moved


def without_home_sigma(whole: Trial) -> Trial:
    """Return the same drive with home bearings of unspecified sigma."""
    home = {n: HomeBearing(b.bearing, math.nan) for n, b in whole.drive.home.items()}
    return replace(whole, drive=replace(whole.drive, home=home))


def without_bearing_sigma(whole: Trial) -> Trial:
    """Return the same drive with bearings of unspecified sigma, home's included."""
    sensor = whole.drive.settings.sensor.model_copy(update={"bearing_sigma": None})
    settings = whole.drive.settings.model_copy(update={"sensor": sensor})
    whole = without_home_sigma(whole)
    return replace(whole, drive=replace(whole.drive, settings=settings))


def stalling(whole: Trial, seed: int, every_s: float, for_s: float) -> Trial:
    """Return the same drive with odometry that sometimes reports zero; times as in `spells`."""
    o = whole.drive.odometry
    fails = spells(o.t, np.random.default_rng([seed, 6]), every_s, for_s)
    dead = replace(o, v=np.where(fails, 0.0, o.v), omega=np.where(fails, 0.0, o.omega))
    return replace(whole, drive=replace(whole.drive, odometry=dead))


def bearings_late(whole: Trial, seconds: float) -> Trial:
    """Return the same drive with bearings stamped `seconds` too late.

    Poses are evaluated at the stamps, so they lag, too, unless the drive has `bearings_late`.
    """
    seen = whole.drive.sightings
    late = replace(whole.drive, sightings=replace(seen, t=seen.t + seconds))
    return replace(whole, drive=late, stamps=whole.stamps + seconds)
