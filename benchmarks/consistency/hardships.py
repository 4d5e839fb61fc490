"""What may go wrong on a drive beside what the simulator itself does wrong.

Of a simulation where it changes what is seen, of a trial where it changes what is told.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from benchmarks.consistency.trial import Trial, now_and_then
from homeward.drives.drive import HomeBearing
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose, bearing, compose
from homeward.lab.simulation.simulate import Simulation

WALKED_M = 4.0
"""People walk to and fro in a square of so many metres to each side of home."""


def with_walkers(still: Simulation, count: int, speed: float) -> tuple[Simulation, frozenset[str]]:
    """Let landmarks be people who walk from where home saw them to one place after the other.

    Parameters
    ----------
    still : Simulation
        The drive, all of them standing.
    count : int
        How many walk.
    speed : float
        How fast [m/s].
    """
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
    """Let pairs of landmarks be taken for each other from `begin` to `end` [s]."""
    rng, seen = np.random.default_rng([right.scenario.seed, 5]), right.drive.sightings
    chosen = rng.choice(np.array(right.world.ids, object), (pairs, 2), replace=False).tolist()
    other = dict(chosen) | {b: a for a, b in chosen}
    then = (seen.t >= begin) & (seen.t < end)
    names = [other.get(n, n) if t else n for n, t in zip(seen.landmark, then, strict=True)]
    changed = replace(seen, landmark=np.array(names, object))
    return replace(right, drive=replace(right.drive, sightings=changed))


def on_a_cart(places: np.ndarray, rng: np.random.Generator, count: int) -> np.ndarray:
    """Return places (q, 2) [m] of which some that are side by side were moved as one body."""
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


def home_untold(whole: Trial) -> Trial:
    """Return the same drive with home bearings that come without a deviation."""
    home = {n: HomeBearing(b.bearing, math.nan) for n, b in whole.drive.home.items()}
    return replace(whole, drive=replace(whole.drive, home=home))


def bearings_untold(whole: Trial) -> Trial:
    """Return the same drive with no deviation of bearings told, home's included."""
    settings = whole.drive.settings
    sensor = settings.sensor.model_copy(update={"bearing_sigma": None})
    told = settings.model_copy(update={"sensor": sensor})
    whole = home_untold(whole)
    return replace(whole, drive=replace(whole.drive, settings=told))


def stalling(whole: Trial, seed: int, every_s: float, for_s: float) -> Trial:
    """Return the same drive with odometry that now and then reports zero though the robot goes on.

    Parameters
    ----------
    whole : Trial
        With sound odometry.
    seed : int
        Of when it fails.
    every_s, for_s : float
        How often in the mean, and for how long [s].
    """
    o = whole.drive.odometry
    fails = now_and_then(o.t, np.random.default_rng([seed, 6]), every_s, for_s)
    dead = replace(o, v=np.where(fails, 0.0, o.v), omega=np.where(fails, 0.0, o.omega))
    return replace(whole, drive=replace(whole.drive, odometry=dead))


def bearings_late(whole: Trial, seconds: float) -> Trial:
    """Return the same drive with bearings whose stamps are `seconds` after the pose they show.

    A pose is due at the stamps, so it lags, too, unless the drive gives `bearings_late`.
    """
    seen = whole.drive.sightings
    late = replace(whole.drive, sightings=replace(seen, t=seen.t + seconds))
    return replace(whole, drive=late, stamps=whole.stamps + seconds)
