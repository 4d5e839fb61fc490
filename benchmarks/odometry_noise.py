"""Unspecified odometry noise, from a tenth to ten times the default.

`python -m benchmarks.odometry_noise [--seeds 3] [--only NAME ...] [--smooth]` drives in worlds of
three sizes (a table top, a room, a hall) with multiples of the default white noise. It prints the
RMSE without given noise over that with the true noise given, and NEES (expected: 3) and
availability of both, for the last three quarters of a drive, as medians over the seeds.
"""

import math

from benchmarks.consistency.trial import Leg, Trial, scaled, trial, wandering, without
from benchmarks.lasting import figures
from benchmarks.measures import Figures
from benchmarks.monte_carlo import Column, Run, benchmark
from homeward.drives.settings import OdometryDefaults
from homeward.lab.simulation.scenario import OdometryErrors
from homeward.lab.simulation.simulate import Simulation, simulate
from homeward.localizer.localizer import Localizer
from homeward.localizer.smoothing import smooth as smoothed
from homeward.track import run as follow

TIMES = (0.1, 0.3, 1.0, 3.0, 10.0)  # multiples of the default sigmas
SIZES = {"table top": 0.1, "room": 1.0, "hall": 10.0}
"""Scale of the worlds, relative to one with landmarks 2.5 to 5 m from home."""
COLUMNS = [
    Column(head)
    for head in ("RMSE ratio", "RMSE / size", "NEES", "availability", "NEES given", "avail. given")
]
SPEED, TURN, DRIVE_S = 0.25, 0.3, 240.0
"""Speed and yaw rate in that world [m/s, rad/s], and duration [s]."""
DEFAULTS = OdometryDefaults()


def noise(times: float, size: float) -> OdometryErrors:
    """Return a multiple of the default white noise, before the world is scaled to its size."""
    turning = DEFAULTS.turn_by_driving**2 * SPEED * size + DEFAULTS.turn_by_turning**2 * TURN
    along = DEFAULTS.distance * math.sqrt(SPEED * size) / size
    return OdometryErrors(speed_sigma=times * along, turn_sigma=times * math.sqrt(turning))


def drive_of(
    size: float, times: float, seed: int, seconds: float = DRIVE_S
) -> tuple[Trial, Simulation]:
    scenario = wandering(
        seed, 5, 60, (0.3, 2.0), speed=SPEED, seconds=seconds, odometry=noise(times, size)
    )
    whole = simulate(scenario)
    return scaled(trial(Leg(whole)), size), whole


def row(made: Trial, whole: Simulation, smooth: bool) -> list[float]:
    """Return RMSE, NEES and availability of one drive, with the noise not given and given."""
    found: list[float] = []
    for drive in (without(made, odometry=True).drive, made.drive):
        localizer = Localizer(drive.home, **drive.settings.robot)
        track = smoothed(drive) if smooth else follow(drive, localizer)
        of = figures(track, drive, whole)
        found += [of.get(key, math.nan) for key in ("rmse", "nees", "pose")]
    return found


def measured(run: Run, smooth: bool) -> Figures:
    """Return the figures of one run, whose scenario is a size and a noise."""
    size, times = run.scenario.split(" x ")
    made = drive_of(SIZES[size], float(times), run.seed)
    found = row(*made, smooth)
    figures = dict(zip((c.head for c in COLUMNS[2:]), (*found[1:3], *found[4:]), strict=True))
    return figures | {"RMSE ratio": found[0] / found[3], "RMSE / size": found[0] / SIZES[size]}


def main() -> None:
    rows = [f"{name} x {times:g}" for name in SIZES for times in TIMES]
    benchmark(__doc__, measured, rows, COLUMNS, seeds=3, smooth=False)


if __name__ == "__main__":
    main()
