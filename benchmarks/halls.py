"""Long drives in halls of posts: how often there is a pose, how far off, and how often it is wrong.

`python -m benchmarks.halls [--seeds 4] [--rows 24] [--seconds 1500] [--turn-noise 0.02]` drives on
the lanes of halls with `--rows` by `--rows` posts, of which a camera of 60 degrees sees four at a
time; the turn rate of the odometry has white noise of `--turn-noise` rad/s/sqrt(Hz).
Such drives are chaotic, so compare versions by many seeds. "Wrong" is the share of the time with a
localised or coasting pose that is more than 4 sigma off, and "unsolved" that of the solutions of
the window that did not converge.
"""

from unittest.mock import patch

import numpy as np

from benchmarks.cost import hall_drive
from benchmarks.measures import figures
from benchmarks.monte_carlo import Column, Figures, Run, benchmark
from homeward.localizer.localizer import Localizer
from homeward.localizer.map.smoother import Smoother
from homeward.track import run as follow

COLUMNS = (
    *(Column(head, by=np.nanmean, digits=2) for head in ("pose", "sure")),
    Column("RMSE [m]", "rmse", np.nanmean, 2),
    Column("NEES", "nees_position", np.nanmean, 1),
    Column("inside 3 sigma", "inside3", np.nanmean, 2),
    *(Column(head, by=np.nanmean) for head in ("wrong", "unsolved")),
)


def measured(run: Run, rows: int, seconds: float, turn_noise: float) -> Figures:
    """Return the figures of the drive of a seed."""
    drive, converged = hall_drive(seconds, rows, run.seed, turn_noise), list[bool]()

    def solve(smoother: Smoother, original=Smoother.solve) -> None:
        original(smoother)
        converged.append(smoother.converged)

    with patch.object(Smoother, "solve", solve):
        track = follow(drive, Localizer(drive.home, **drive.settings.robot))
    return figures(track, drive.truth) | {"unsolved": converged.count(False) / len(converged)}


def main() -> None:
    given = {"rows": 24, "seconds": 1500.0, "turn_noise": 0.02}
    benchmark(__doc__, measured, ["hall"], COLUMNS, seeds=4, **given)


if __name__ == "__main__":
    main()
