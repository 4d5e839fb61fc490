"""Unspecified odometry noise, from a tenth to ten times the default.

`python -m benchmarks.odometry_noise [--seeds 3] [--only NAME ...] [--smooth]` drives in worlds of
three sizes (a table top, a room, a hall) with multiples of the default white noise. It prints the
RMSE without given noise over that with the true noise given, and NEES (expected: 3) and
availability of both, for the last three quarters of a drive, as medians over the seeds.
"""

import math
from functools import partial

import numpy as np

from benchmarks import monte_carlo
from benchmarks.consistency.trial import Leg, Trial, scaled, trial, wandering, without
from benchmarks.lasting import figures
from benchmarks.monte_carlo import Run
from homeward.drives.settings import OdometryDefaults
from homeward.lab.simulation.scenario import OdometryErrors
from homeward.lab.simulation.simulate import Simulation, simulate
from homeward.localizer.localizer import Localizer
from homeward.localizer.smoothing import smooth
from homeward.track import run as follow

TIMES = (0.1, 0.3, 1.0, 3.0, 10.0)  # multiples of the default sigmas
SIZES = {"table top": 0.1, "room": 1.0, "hall": 10.0}
"""Scale of the worlds, relative to one with landmarks 2.5 to 5 m from home."""
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


def row(made: Trial, whole: Simulation, final: bool) -> list[float]:
    """Return the figures of one drive, with the noise not given and given."""
    found: list[float] = []
    for drive in (without(made, odometry=True).drive, made.drive):
        localizer = Localizer(drive.home, **drive.settings.robot)
        track = smooth(drive) if final else follow(drive, localizer)
        of = figures(track, drive, whole)
        found += [of.get(key, math.nan) for key in ("rmse", "nees", "pose")]
    return found


def measured(final: bool, run: Run) -> dict[str, np.ndarray]:
    """Return the row of one run, whose scenario is a size and a noise."""
    name, times = run.scenario.split(" x ")
    return {"row": np.array(row(*drive_of(SIZES[name], float(times), run.seed), final))}


def main() -> None:
    given = monte_carlo.parsed(__doc__, seeds=3, only=SIZES, smooth=False, **monte_carlo.HARNESS)
    rows = [f"{name} x {times:g}" for name in given.only for times in TIMES]
    runs = monte_carlo.grid(rows, ["robust"], range(given.seeds))
    function = partial(measured, given.smooth)
    found = monte_carlo.run_all(function, runs, given.jobs, given.keep, smooth=given.smooth)
    columns = ("RMSE ratio", "RMSE/size", "NEES", "(given)", "avail. %", "(given)")
    print(f"{'':18}" + "".join(f"{c:>11}" for c in columns))
    for name in rows:
        each = [one["row"] for run, one in found.items() if run.scenario == name]
        rmse, nees, pose, at_best, nees_given, pose_given = np.nanmedian(each, axis=0)
        size = SIZES[name.split(" x ")[0]]
        line = rmse / at_best, rmse / size, nees, nees_given, pose, pose_given
        print(f"{name:18}" + "".join(f"{v:11.3f}" for v in line))


if __name__ == "__main__":
    main()
