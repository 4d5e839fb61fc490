"""Odometry of which nothing is told, from ten times better to ten times worse than is usual.

`python -m benchmarks.odometry_noise [--seeds 3] [--only NAME ...] [--smooth]` drives worlds of
three sizes (a table top, a room, a hall) with an odometry whose white noise is so many times that
which is believed of one of which nothing is known. It prints RMSE when nothing is told, over that
when the truth is told, NEES of both (3 is honest), and the shares of time with a pose, of the last
three quarters of a drive, as medians over the seeds.
"""

from __future__ import annotations

import argparse
import math

import numpy as np

from benchmarks.consistency.trial import Leg, Trial, random_way, scaled, trial, untold
from benchmarks.lasting import figures
from homeward.drives.odometry_noise import OdometryDefaults
from homeward.localizer.localizer import Localizer
from homeward.localizer.smoothing import smooth
from homeward.simulation.scenario import (
    Noise,
    OdometryErrors,
    Rates,
    Ring,
    Scenario,
    StartPose,
    Visibility,
    Waypoints,
)
from homeward.simulation.simulate import Simulation, simulate
from homeward.track import run

TIMES = (0.1, 0.3, 1.0, 3.0, 10.0)
"""So many times the usual deviations."""
SIZES = {"table top": 0.1, "room": 1.0, "hall": 10.0}
"""Worlds, over one in which landmarks are 2.5 to 5 m from home."""
SPEED, TURN, DRIVE_S = 0.25, 0.3, 240.0
"""How the robot drives in that one [m/s, rad/s], and how long [s]."""
USUAL = OdometryDefaults()


def noise(times: float, size: float) -> OdometryErrors:
    """Return white noise of so many times the usual, before the world is scaled to its size."""
    turning = USUAL.turn_by_driving**2 * SPEED * size + USUAL.turn_by_turning**2 * TURN
    along = USUAL.distance * math.sqrt(SPEED * size) / size
    return OdometryErrors(speed_sigma=times * along, turn_sigma=times * math.sqrt(turning))


def drive_of(size: float, times: float, seed: int) -> tuple[Trial, Simulation]:
    """Return a random way among landmarks, and what it was made of."""
    points, direction = random_way([seed, 5], 60, 0.3, 2.0)
    whole = simulate(
        Scenario(
            name="odometry-noise",
            seed=seed,
            landmarks=Ring(count=12, distance=(2.5, 5.0)),
            visibility=Visibility(probability=0.8),
            noise=Noise(bearing_sigma=0.01, home_sigma=0.01),
            rates=Rates(odometry=20.0, bearings=5.0, truth=10.0),
            odometry=noise(times, size),
            start=StartPose(x=points[0][0], y=points[0][1], heading=direction, prior=False),
            trajectory=Waypoints(speed=SPEED, duration=DRIVE_S, points=points[1:]),
        )
    )
    return scaled(trial(Leg(whole)), size), whole


def row(made: Trial, whole: Simulation, final: bool) -> list[float]:
    """Return the figures of one drive: untold and told."""
    found: list[float] = []
    for drive in (untold(made, odometry=True).drive, made.drive):
        localizer = Localizer(drive.home, **drive.settings.robot)
        track = smooth(drive) if final else run(drive, localizer)
        of = figures(track, drive, whole)
        found += [of.get(key, math.nan) for key in ("rmse", "nees", "pose")]
    return found


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--only", nargs="+", choices=[*SIZES], default=[*SIZES])
    parser.add_argument("--times", nargs="+", type=float, default=TIMES)
    parser.add_argument("--smooth", action="store_true")
    given = parser.parse_args()
    columns = ("ratio", "RMSE/size", "NEES", "told", "pose %", "told")
    print(f"{'':18}" + "".join(f"{c:>10}" for c in columns))
    for name in given.only:
        for times in given.times:
            size = SIZES[name]
            each = [row(*drive_of(size, times, s), given.smooth) for s in range(given.seeds)]
            rmse, nees, pose, at_best, nees_told, pose_told = np.nanmedian(each, axis=0)
            line = rmse / at_best, rmse / size, nees, nees_told, pose, pose_told
            print(f"{name:10} x {times:<5g}" + "".join(f"{v:10.3f}" for v in line), flush=True)


if __name__ == "__main__":
    main()
