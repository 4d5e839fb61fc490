"""Recorded drives through rendered rooms: `homeward run` with home's picture, and the map alone.

Homings steered by ground truth, and circles of a minute, with three boxes moved since home and a
person walking through. The drives are written as folders of images, and read back.

    python -m benchmarks.recorded --drives 20 --width 512
"""

import tempfile
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks import monte_carlo
from benchmarks.monte_carlo import Run
from benchmarks.render import CHI_SQUARE_4_SIGMA, IMAGES_PER_S, scenario
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
    """Return a drive read from a folder of images; None if the robot collides."""
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
    """Return for each row of a run, (n, 4): localised, with a pose, error [m], NEES."""
    track = follow(drive, make_estimator("robust", drive))
    found = np.full((track.t.size, 4), np.nan)
    found[:, 0] = [status is Status.LOCALISED for status in track.status]
    found[:, 1] = track.has_pose
    e = errors(track, drive.truth)
    found[np.searchsorted(track.t, e.t), 2:] = np.column_stack([e.position, e.nees])
    return found


def measured(width: int, run: Run) -> dict[str, np.ndarray]:
    """Return the rows of one drive from both estimators; empty if the robot collides."""
    drive = recorded(run.seed, width, run.scenario)
    if drive is None:
        return {}
    alone = Drive(**{f: getattr(drive, f) for f in Drive.__dataclass_fields__})
    return {WITHOUT: rows(alone), WITH: rows(drive)}


def main() -> None:
    options = monte_carlo.parsed(__doc__, drives=20, width=512, **monte_carlo.HARNESS)
    runs = monte_carlo.grid([HOMING, CIRCLE], ["robust"], range(options.drives))
    function = partial(measured, options.width)
    found = monte_carlo.run_all(function, runs, options.jobs, options.keep, width=options.width)
    for course in (HOMING, CIRCLE):
        done = [one for run, one in found.items() if run.scenario == course and one]
        print(f"{len(done)} {course}, {options.width}x{options.width // 4}")
        for name in (WITHOUT, WITH):
            localised, pose, position, nees = np.concatenate([m[name] for m in done]).T
            use = (localised == 1.0) & np.isfinite(nees)
            print(
                f"  {name}: localised {np.mean(localised):.0%} of the time, availability of a pose "
                f"{np.mean(pose):.0%}; while localised: RMSE "
                f"{np.sqrt(np.mean(position[use] ** 2)):.3f} m, median error "
                f"{np.median(position[use]):.4f} m, NEES {np.mean(nees[use]):.1f} (expected 3), "
                f"beyond 4 sigma {np.mean(nees[use] > CHI_SQUARE_4_SIGMA):.1%}"
            )


if __name__ == "__main__":
    main()
