"""Recorded drives through rendered rooms: `homeward run` with home's picture, and the map alone.

Homings steered by the truth, and circles of a minute, three boxes moved since home, and someone
walking through; written as folders of images, and read from them.

    python -m benchmarks.recorded --drives 20 --width 512
"""

from __future__ import annotations

import tempfile
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks import monte_carlo
from benchmarks.monte_carlo import Run
from benchmarks.render import FAR_OFF, IMAGES_PER_S, scenario
from homeward.drives.drive import Drive
from homeward.errors import InputError
from homeward.estimator import Status
from homeward.lab.simulation.render.drive import Eye, write_rendered
from homeward.lab.simulation.scenario import Circle
from homeward.registry import make_estimator
from homeward.runs.scoring import errors
from homeward.track import run as follow
from homeward.vision.opencv import opencv
from homeward.vision.recorded.estimator import ImageDrive
from homeward.vision.recorded.folder import see_folder

HOMING, CIRCLE = "homings", "circles"
ROUND = Circle(speed=0.15, omega=0.27, duration=60.0)
WITH, WITHOUT = "with home's picture", "the map alone"


def recorded(number: int, width: int, course: str) -> ImageDrive | None:
    """Return a drive as it is read from a folder of images; None where it runs into something."""
    opencv().setNumThreads(1)
    made = scenario(number, width, (1.0, 4.0), moved=3)
    changes = {"rates": made.rates.model_copy(update={"bearings": IMAGES_PER_S})}
    if course == CIRCLE:
        changes["trajectory"] = ROUND
    with tempfile.TemporaryDirectory() as folder:
        try:
            write_rendered(Eye(made.model_copy(update=changes)), Path(folder))
        except InputError:
            return None
        return see_folder(folder)


def rows(drive: Drive) -> np.ndarray:
    """Return for each row of a run, (n, 4): sure or not, a pose or not, error [m], NEES."""
    track = follow(drive, make_estimator("robust", drive))
    found = np.full((track.t.size, 4), np.nan)
    found[:, 0] = [status is Status.LOCALISED for status in track.status]
    found[:, 1] = track.has_pose
    judged = errors(track, drive.truth)
    found[np.searchsorted(track.t, judged.t), 2:] = np.column_stack([judged.position, judged.nees])
    return found


def measured(width: int, run: Run) -> dict[str, np.ndarray]:
    """Return the rows of one drive by both estimators; nothing where it runs into something."""
    drive = recorded(run.seed, width, run.scenario)
    if drive is None:
        return {}
    alone = Drive(**{f: getattr(drive, f) for f in Drive.__dataclass_fields__})
    return {WITHOUT: rows(alone), WITH: rows(drive)}


def main() -> None:
    """Print every figure."""
    parser = monte_carlo.parser(__doc__, keep=True)
    parser.add_argument("--drives", type=int, default=20)
    parser.add_argument("--first", type=int, default=0, help="number of the first drive")
    parser.add_argument("--width", type=int, default=512)
    options = parser.parse_args()
    numbers = range(options.first, options.first + options.drives)
    runs = monte_carlo.grid([HOMING, CIRCLE], ["robust"], numbers)
    function = partial(measured, options.width)
    found = monte_carlo.run_all(function, runs, options.jobs, options.keep, width=options.width)
    for course in (HOMING, CIRCLE):
        done = [one for run, one in found.items() if run.scenario == course and one]
        print(f"{len(done)} {course}, {options.width}x{options.width // 4}")
        for name in (WITHOUT, WITH):
            sure, pose, position, nees = np.concatenate([m[name] for m in done]).T
            told = (sure == 1.0) & np.isfinite(nees)
            print(
                f"  {name}: localised {np.mean(sure):.0%} of the time, a pose {np.mean(pose):.0%}; "
                f"where localised RMSE {np.sqrt(np.mean(position[told] ** 2)):.3f} m, median "
                f"{np.median(position[told]):.4f} m, NEES {np.mean(nees[told]):.1f} (honest 3), "
                f"beyond 4 sigma {np.mean(nees[told] > FAR_OFF):.1%}"
            )


if __name__ == "__main__":
    main()
