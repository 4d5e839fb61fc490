"""Runs as validated settings: a drive, one estimator or several, and a start prior."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from homeward.drives.drive import Drive
from homeward.drives.folder import HOME
from homeward.drives.opening import SAMPLE, is_image_folder, open_drive, sample_drive
from homeward.drives.ros.log import is_log
from homeward.drives.ros.settings import NAME_BEARINGS, NAME_HOME
from homeward.drives.settings import Finite, Span, Start
from homeward.errors import HomewardError, InputError
from homeward.estimator import Estimator
from homeward.geometry.frames import Pose, to_polar
from homeward.io.keys import Strict
from homeward.io.settings import read_tree, validated
from homeward.localizer.localizer import Localizer
from homeward.localizer.settings import LocalizerSettings
from homeward.localizer.smoothing import smooth
from homeward.places.files import is_place
from homeward.registry import DEFAULT, estimator_settings, make_estimator, needs_start
from homeward.runs.scoring import Metrics, score
from homeward.runs.visits import in_place, place_used
from homeward.track import Track
from homeward.track import run as follow

TRUTH_SIGMA = 0.05
"""Of a start prior taken from the truth [m and rad]."""
TRUTH_NOTE = "The start prior was taken from the truth: this run was told where it began."
SMOOTH_NOTE = "The track was smoothed over the whole drive: it knows at each time what came later."
PLACE_NOTE = "Poses are those of the place's home; what the drive saw at a home was not asked for."
TRUTH_NEAR_S = 1.0
"""The truth must know the start at least this nearly [s]."""


class DriveChoice(Strict):
    """A drive, and the topics of a log."""

    drive: str
    """A path, or `SAMPLE`."""
    topics: str | None = None
    """For a log: the path of a YAML file that names its topics."""


class RunSettings(DriveChoice):
    """Everything that a run depends on; run.yaml holds it, and a run repeats from it."""

    home_spin: Span | None = None
    """From when until when the robot turned on the spot at home, in the drive itself [s]."""
    estimator: str = DEFAULT
    start: Literal["truth"] | tuple[Finite, Finite, Finite] | None = None
    """R [m], theta [rad], alpha [rad]; "truth" takes them from the drive's truth; None from the
    drive's settings, or where these say nothing and the estimator needs one, from its truth."""
    place: str | None = None
    """The folder of a place that is known; a new one for the first drive of it."""
    place_version: Annotated[int, Field(ge=0)] | None = None
    """Of the place; 0: there was none yet; None: the newest, if there is any."""
    place_home: str | None = None
    """The home of the place in whose frame answers are; None: the first."""
    when: Finite | None = None
    """The day of the visit [days since 1970]; None: as the drive's clock says, else today."""
    smooth: bool = False
    """Whether a final pass corrects the whole track; only the robust localiser can."""
    settings: dict[str, Any] = {}
    """Of the estimator, by name."""


def load_run(file: Path) -> RunSettings:
    """Read the run.yaml of an earlier run; `InputError` where it is none."""
    tree = read_tree(file)
    tree.pop("versions", None)
    return validated(RunSettings, tree, file)


def finish(
    drive: Drive,
    estimator: Estimator,
    run: RunSettings,
    progress: Callable[[float], None] | None = None,
) -> Track:
    """Return the track of a run, its three parts as from `prepare`."""
    notes = (TRUTH_NOTE,) if run.start == "truth" else ()
    if run.place_version:
        notes = (*notes, PLACE_NOTE)
    settings = estimator_settings(run.estimator, run.settings)
    if run.smooth and isinstance(settings, LocalizerSettings):
        track, notes = smooth(drive, settings), (*notes, SMOOTH_NOTE)
    else:
        track = follow(drive, estimator, progress)
    return replace(track, notes=(*track.notes, *notes))


def prepare(
    run: RunSettings, progress: Callable[[float], None] | None = None
) -> tuple[Drive, Estimator, RunSettings]:
    """Open the drive, reporting `progress`, and make the estimator of a run.

    The run that is returned has every setting of the estimator spelt out. `InputError` where the
    drive cannot be read or has no sightings, the settings do not fit, or the estimator cannot
    smooth; `HomewardError` where no landmark was found in a folder of images.
    """
    return ready(run, opened(run, progress))


def opened(run: RunSettings, progress: Callable[[float], None] | None = None) -> Drive:
    """Open the drive of a run, telling `progress`; errors as `prepare`."""
    settings = estimator_settings(run.estimator, run.settings)
    if run.place is not None and run.estimator != DEFAULT:
        raise InputError(f"a place is for the estimator {DEFAULT}, not {run.estimator}")
    if run.smooth and not isinstance(settings, LocalizerSettings):
        raise InputError(f"{run.estimator} cannot smooth; the estimator robust can")
    drive = open_drive(
        drive_path(run), topics=run.topics, home_spin=run.home_spin, on_progress=progress
    )
    if not drive.sightings.t.size:
        raise _saw_nothing(drive_path(run), drive.remark_lines)
    visits = run.place is not None and run.place_version != 0 and is_place(Path(run.place))
    if not (drive.home or visits) and not (
        drive.known.surveyed_from_home and run.estimator == DEFAULT
    ):
        way = NAME_HOME if is_log(drive_path(run)) else f"{HOME} has no rows"
        raise InputError(f"nothing in it tells what the camera saw at home: {way}", Path(run.drive))
    return drive


def ready(run: RunSettings, drive: Drive) -> tuple[Drive, Estimator, RunSettings]:
    """Return what `prepare` does, of a drive that is open."""
    settings = estimator_settings(run.estimator, run.settings)
    run = run.model_copy(update=place_used(run, drive))
    drive = in_place(run, drive)
    start, drive = with_start(drive, run.estimator, run.start)
    estimator = make_estimator(run.estimator, drive, settings)
    if run.place is not None and not isinstance(estimator, Localizer):
        raise InputError(f"a place is for the estimator {DEFAULT}, on a drive without images")
    spelt = settings.model_dump(mode="json")
    if "engine" in spelt:
        # The engine that was found, not "auto": the run repeats to the last bit.
        spelt["engine"] = getattr(estimator, "engine", spelt["engine"])
    update = {"start": start, "settings": spelt}
    complete = run.model_copy(update=update)
    return drive, estimator, complete


def _saw_nothing(path: Path, remarks: Iterable[str]) -> HomewardError:
    """Return the error of a drive without sightings; good pictures may show nothing of home."""
    if is_image_folder(path):
        return HomewardError("; ".join([f"{path}: no landmark was found in its images", *remarks]))
    way = f": {NAME_BEARINGS}" if is_log(path) else ""
    return InputError("; ".join([f"no sightings of landmarks in it{way}", *remarks]), path)


def drive_path(run: RunSettings) -> Path:
    """Return where the drive of a run is."""
    return sample_drive() if run.drive == SAMPLE else Path(run.drive)


StartChoice = Literal["truth"] | tuple[float, float, float] | None


def with_start(
    drive: Drive, estimator: str, start: StartChoice = None
) -> tuple[StartChoice, Drive]:
    """Return where the start prior comes from, and the drive with it.

    Where none is asked for and the drive has none, an estimator that needs one gets the truth's.
    """
    known = drive.settings.start is not None or drive.truth is None
    if start is None and not known and needs_start(estimator):
        start = "truth"
    if start is None:
        return None, drive
    told = drive.settings.model_copy(update={"start": _start_prior(start, drive)})
    return start, replace(drive, settings=told)


def _start_prior(start: str | tuple[float, float, float], drive: Drive) -> Start:
    """Return the start prior that was asked for."""
    if isinstance(start, tuple):
        R, theta, alpha = start
        return validated(Start, {"R": R, "theta": theta, "alpha": alpha})
    if drive.truth is None:
        raise InputError(f"{drive.name}: it has no truth to take the start from")
    first = drive.span[0]
    late = max(float(drive.truth.t[0]) - first, first - float(drive.truth.t[-1]))
    if late > TRUTH_NEAR_S:
        raise InputError(f"{drive.name}: its truth is {late:.1f} s away from the start")
    x, y, heading = (float(a[0]) for a in drive.truth.at(np.array([first])))
    return Start.about(to_polar(Pose(x, y, heading)), *[TRUTH_SIGMA] * 3)


@dataclass(frozen=True)
class Outcome:
    """What came of one estimator."""

    run: RunSettings
    """With every setting spelt out."""
    drive: Drive
    """With the start prior that this estimator had."""
    track: Track | None
    """None where it failed."""
    failure: str = ""
    """Why."""

    @property
    def metrics(self) -> Metrics | None:
        """Of the track."""
        return None if self.track is None else score(self.track, self.drive.truth)


def run_several(
    runs: Sequence[RunSettings], progress: Callable[[float], None] | None = None
) -> list[Outcome]:
    """Run several estimators over one drive, which is opened once.

    The runs differ in their estimators only; `progress` receives the fraction done, in [0, 1].
    `InputError` where the drive cannot be used, two estimators are the same, or one cannot be made.
    """
    words = [run.estimator for run in runs]
    if twice := next((word for word in words if words.count(word) > 1), None):
        raise InputError(f"{twice}: named twice")
    drive = opened(runs[0])
    prepared = [ready(run, drive) for run in runs]
    outcomes = []
    for done, (told, estimator, complete) in enumerate(prepared):

        def tell(fraction: float, done: int = done) -> None:
            if progress is not None:
                progress((done + fraction) / len(runs))

        try:
            track = finish(told, estimator, complete, tell)
            outcomes.append(Outcome(complete, told, track))
        except HomewardError as error:
            outcomes.append(Outcome(complete, told, None, str(error)))
    return outcomes
