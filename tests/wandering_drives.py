"""Drives of a robot that wanders, with odometry noise or correlated errors of a given size."""

import dataclasses
import math

import numpy as np

from benchmarks.consistency.trial import Leg, Trial, trial, wandering
from benchmarks.measures import figures, scale_of
from homeward.drives.drive import HomeBearing
from homeward.drives.settings import OdometryDefaults, OdometryNoise, Sensor
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose, bearing
from homeward.lab.simulation import scenario as sim
from homeward.lab.simulation.simulate import simulate

SPEED, TURN = 0.25, 0.3
SLOW, LEAN, WHITE = (math.radians(angle) for angle in (0.9, 0.4, 0.4))
SLOW_S, EXTENT_M = 2.0, 0.03


def with_odometry_noise(times, seed, seconds) -> Trial:
    """Return a drive whose odometry has a multiple of the default white noise."""
    usual = OdometryDefaults()
    turning = usual.turn_by_driving**2 * SPEED + usual.turn_by_turning**2 * TURN
    noise = sim.OdometryErrors(
        speed_sigma=times * usual.distance * math.sqrt(SPEED),
        turn_sigma=times * math.sqrt(turning),
    )
    course = wandering(seed, 5, 60, (0.3, 2.0), speed=SPEED, seconds=seconds, odometry=noise)
    return trial(Leg(simulate(course)))


def with_correlated_errors(seed, seconds):
    """Return a drive without given noise, and its simulation.

    Each landmark has a slow error of its bearings and of its visible centre; the camera is tilted.
    """
    whole = simulate(
        wandering(
            seed,
            7,
            80,
            (0.3, 2.5),
            speed=SPEED,
            seconds=seconds,
            landmarks=sim.Ring(count=17, distance=(1.5, 4.5)),
            visibility=sim.Visibility(probability=0.8, field_of_view=math.radians(240.0)),
            noise=sim.Noise(bearing_sigma=WHITE, home_sigma=WHITE),
            rates=sim.Rates(odometry=20.0, bearings=10.0, truth=10.0),
            odometry=sim.OdometryErrors(speed_sigma=0.005, turn_sigma=0.005),
        )
    )
    drive, world, seen = whole.drive, whole.world, whole.drive.sightings
    rng = np.random.default_rng([seed, 8])
    stamps, row = np.unique(seen.t, return_inverse=True)
    column = np.array([list(world.ids).index(n) for n in seen.landmark])
    camera, at = Pose(*np.stack(drive.truth.at(stamps))[:, row]), world.in_home_frame[column]
    slow, across = (first_order(rng, stamps, len(world.ids))[row, column] for _ in range(2))
    off = SLOW * slow + EXTENT_M / np.hypot(at[:, 0] - camera.x, at[:, 1] - camera.y) * across
    off += LEAN * np.sin(bearing(camera, *at.T))
    home = {
        n: HomeBearing(float(wrap(h.bearing + LEAN * math.sin(h.bearing))))
        for n, h in drive.home.items()
    }
    settings = drive.settings.model_copy(update={"sensor": Sensor(), "odometry": OdometryNoise()})
    seen = dataclasses.replace(seen, bearing=wrap(seen.bearing + off))
    return dataclasses.replace(drive, sightings=seen, home=home, settings=settings), whole


def first_order(rng, stamps, count):
    """Return stationary first-order processes of unit variance (k, count) at stamps (k,) [s]."""
    kept = np.exp(-np.diff(stamps, prepend=stamps[0]) / SLOW_S)
    drawn = rng.standard_normal((len(stamps), count))
    found = drawn.copy()
    for i in range(1, len(stamps)):
        found[i] = kept[i] * found[i - 1] + math.sqrt(1.0 - kept[i] ** 2) * drawn[i]
    return found


def late_figures(track, drive, whole=None):
    """Return the figures of the last three quarters of a drive, and the map's scale error [%]."""
    found = figures(track, drive.truth, after_s=0.25 * (track.t[-1] - track.t[0]))
    if whole is not None:
        places = dict(zip(whole.world.ids, whole.world.in_home_frame, strict=True))
        found["scale"] = 100.0 * (scale_of(track, places) - 1.0)
    return found
