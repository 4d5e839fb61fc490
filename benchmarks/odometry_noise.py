"""Odometry of which nothing is told, from ten times better to ten times worse than is usual.

`python -m benchmarks.odometry_noise [--seeds 3] [--only NAME ...] [--smooth]` drives worlds of
three sizes (a table top, a room, a hall) with an odometry whose white noise is so many times that
which is believed of one of which nothing is known. It prints RMSE when nothing is told, over that
when the truth is told, NEES of both (3 is honest), and the shares of time with a pose, of the last
three quarters of a drive, as medians over the seeds.
"""

from __future__ import annotations

import math
from functools import partial

import numpy as np

from benchmarks import monte_carlo
from benchmarks.consistency.trial import Leg, Trial, scaled, trial, untold, wandering
from benchmarks.lasting import figures
from benchmarks.monte_carlo import Run
from homeward.drives.settings import OdometryDefaults
from homeward.lab.simulation.scenario import OdometryErrors
from homeward.lab.simulation.simulate import Simulation, simulate
from homeward.localizer.localizer import Localizer
from homeward.localizer.smoothing import smooth
from homeward.track import run as follow

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


def drive_of(
    size: float, times: float, seed: int, seconds: float = DRIVE_S
) -> tuple[Trial, Simulation]:
    """Return a random way among landmarks, and what it was made of."""
    scenario = wandering(
        seed, 5, 60, (0.3, 2.0), speed=SPEED, seconds=seconds, odometry=noise(times, size)
    )
    whole = simulate(scenario)
    return scaled(trial(Leg(whole)), size), whole


def row(made: Trial, whole: Simulation, final: bool) -> list[float]:
    """Return the figures of one drive, with the noise not specified and specified."""
    found: list[float] = []
    for drive in (untold(made, odometry=True).drive, made.drive):
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
    """Print the table."""
    parser = monte_carlo.parser(__doc__, seeds=3, keep=True)
    parser.add_argument("--only", nargs="+", choices=[*SIZES], default=[*SIZES])
    parser.add_argument("--times", nargs="+", type=float, default=TIMES)
    parser.add_argument("--smooth", action="store_true")
    given = parser.parse_args()
    rows = [f"{name} x {times:g}" for name in given.only for times in given.times]
    runs = monte_carlo.grid(rows, ["robust"], range(given.first, given.first + given.seeds))
    function = partial(measured, given.smooth)
    found = monte_carlo.run_all(function, runs, given.jobs, given.keep, smooth=given.smooth)
    columns = ("ratio", "RMSE/size", "NEES", "told", "pose %", "told")
    print(f"{'':18}" + "".join(f"{c:>10}" for c in columns))
    for name in rows:
        each = [one["row"] for run, one in found.items() if run.scenario == name]
        rmse, nees, pose, at_best, nees_told, pose_told = np.nanmedian(each, axis=0)
        size = SIZES[name.split(" x ")[0]]
        line = rmse / at_best, rmse / size, nees, nees_told, pose, pose_told
        print(f"{name:18}" + "".join(f"{v:10.3f}" for v in line))


if __name__ == "__main__":
    main()
