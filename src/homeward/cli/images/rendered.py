"""`homeward simulate ROOM --images`: an image data set, or a robot that homes by its images."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from homeward.cli.options import progress
from homeward.cli.terminal import say

if TYPE_CHECKING:
    from homeward.drives.drive import Drive
    from homeward.estimator import Estimator
    from homeward.lab.simulation.render.room.settings import RenderScenario


def render(
    room: str,
    out: Path,
    seed: int | None,
    points: bool,
    given: dict[str, Any],
) -> None:
    """Render what a camera sees on a drive through a room, and write an image data set.

    The folder gets home.png, images.csv and the images, images.yaml, odometry.csv, truth.csv,
    drive.yaml, things.csv with what was moved since the home image, and scenario.yaml, which
    repeats it all. With an estimator the loop is closed: image in, homing out; what the front end
    saw is the drive folder drive/ in it.
    """
    from homeward.lab.simulation.files import SCENARIO
    from homeward.lab.simulation.render.drive import Eye, moved_boxes, write_rendered
    from homeward.lab.simulation.render.room.presets import load_room
    from homeward.runs.report.output import check_output, whole_folder
    from homeward.runs.report.words import describe_moved

    scenario = load_room(room, seed, given)
    eye = Eye(scenario)
    check_output(out, SCENARIO)
    with progress(f"rendering {scenario.name}") as tell, whole_folder(out, SCENARIO) as scratch:
        made = write_rendered(eye, scratch, points, _maker(scenario), tell)
    camera = made.eye.scenario.camera
    moved = moved_boxes(made.eye)
    say(
        f"{scenario.name}: {made.drive.span[1]:.1f} s, {made.images} images of "
        f"{camera.width}x{camera.height}, {len(moved)} boxes moved since home; ended "
        f"({made.ending.value}) {made.final_distance:.3f} m from home; written to {out}"
    )
    say(describe_moved(moved))


def _maker(scenario: RenderScenario) -> Callable[[Drive], Estimator] | None:
    """Return what makes the estimator that steers, or None when the truth does."""
    if scenario.estimator == "truth":
        return None
    from homeward.registry import make_estimator

    return partial(make_estimator, scenario.estimator)
