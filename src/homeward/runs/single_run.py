"""Settings of a run and its steps: open the drive, make the estimator, run it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np

from homeward.drives.drive import Drive
from homeward.drives.folder import HOME_ADVICE
from homeward.drives.opening import (
    LOG,
    SAMPLE,
    is_image_folder,
    kind_of,
    open_drive,
    sample_drive,
)
from homeward.drives.ros.kinds import is_log
from homeward.drives.senses import OVERRIDE, require_senses
from homeward.drives.settings import Finite, NonNegative, Positive, Span, Start
from homeward.errors import HomewardError, InputError
from homeward.estimator import Estimator
from homeward.geometry.frames import Pose, to_polar
from homeward.io.checks import Field
from homeward.io.models import Strict
from homeward.io.settings import read_tree, validated
from homeward.localizer.inputs.sign_check import note_of_whole
from homeward.localizer.localizer import SCALE_NOTE, Localizer
from homeward.localizer.settings import LocalizerSettings
from homeward.registry import DEFAULT, estimator_settings, make_estimator, needs_start
from homeward.runs.scoring import Metrics, score
from homeward.track import Track
from homeward.track import run as follow

TRUTH_SIGMA = 0.05
"""Standard deviation of a start prior taken from ground truth [m and rad]."""
TRUTH_NOTE = (
    "The start prior comes from ground truth, which a robot does not have. Give --start"
    " R,THETA,ALPHA, or `start:` in drive.yaml, to run without it."
)
SMOOTH_NOTE = (
    "The track is smoothed: each pose uses the whole drive. Run without --smooth for the poses that"
    " a robot has while it drives."
)
LAG_NOTE = (
    "The track is smoothed: each pose uses the data of the next {:g} s. Run without --smooth"
    " for the poses that a robot has at once."
)
MAX_TRUTH_GAP_S = 1.0
"""Ground truth must begin within this time of the start [s]."""


class DriveChoice(Strict):
    """A drive, and the topics file of a log."""

    drive: str
    """A path, or `SAMPLE`."""
    topics: str | None = None
    """Path of the topics file of a log."""


class RunSettings(DriveChoice):
    """Everything that a run depends on: the content of run.yaml, which repeats the run."""

    robot_file: str | None = None
    """Path of the robot.yaml of the robot."""
    home_during: Span | None = None
    """When the robot was at rest at home, in the drive itself [s]."""
    home_spin: Span | None = None
    """Time span of the drive in which the robot turned on the spot at home [s]."""
    home_at: NonNegative | None = None
    """Time of the pose of the drive that is home [s]."""
    home_file: str | None = None
    """Path of a table with home bearings."""
    estimator: str = DEFAULT
    start: Literal["truth"] | tuple[Finite, Finite, Finite] | None = None
    """R [m], theta [rad], alpha [rad]; "truth": from ground truth; None: from the drive's settings,
    or if they have none and the estimator needs one, from ground truth."""
    place: str | None = None
    """Folder of a place; a new folder for the first drive in it."""
    place_version: Annotated[int, Field(ge=0)] | None = None
    """Version of the place; 0: there was none yet; None: the newest, if there is any."""
    place_home: str | None = None
    """The home of the place in whose frame poses are given; None: the first."""
    when: Finite | None = None
    """Day of the visit [days since 1970]; None: from the drive's clock, else today."""
    smooth: bool = False
    """Whether a final pass corrects the whole track; only the robust localiser can."""
    smoothed_lag: Positive | None = None
    """Delay with which each pose is smoothed [s]; only the robust localiser can."""
    settings: dict[str, Any] = {}
    """Settings of the estimator by name."""

    @property
    def is_smoothed(self) -> bool:
        """Whether the track is not causal."""
        return self.smooth or self.smoothed_lag is not None


def load_run(file: Path) -> RunSettings:
    """Read the run.yaml of an earlier run; `InputError` where the file is not one."""
    tree = read_tree(file)
    tree.pop("versions", None)
    return validated(RunSettings, tree, file)


def finish(
    drive: Drive,
    estimator: Estimator,
    run: RunSettings,
    progress: Callable[[float], None] | None = None,
) -> Track:
    """Run an estimator on a drive, both from `prepare`, and return the track."""
    notes: tuple[str, ...] = (TRUTH_NOTE,) if run.start == "truth" else ()
    if run.place is not None:
        from homeward.runs.visits import place_notes

        notes += place_notes(run, drive)
    settings = estimator_settings(run.estimator, run.settings)
    if run.is_smoothed and isinstance(settings, LocalizerSettings):
        if (lag := run.smoothed_lag) is not None:
            from homeward.localizer.fixed_lag import smooth_with_lag

            track, notes = smooth_with_lag(drive, lag, settings), (*notes, LAG_NOTE.format(lag))
        else:
            from homeward.localizer.smoothing import smooth

            track, notes = smooth(drive, settings), (*notes, SMOOTH_NOTE)
    else:
        track = follow(drive, estimator, progress)
    found = track.notes
    if run.robot_file is not None:  # `homeward tune`, which wrote it, notes the unknown scale
        found = tuple(note for note in found if note != SCALE_NOTE)
    return replace(track, notes=(*_in_its_file(found, drive_path(run)), *notes))


def _in_its_file(notes: tuple[str, ...], place: Path) -> tuple[str, ...]:
    """Return the notes of an estimator with the file that this drive has for its settings."""
    if kind_of(place) != LOG:
        return notes
    of_a_log = "`drive:` in the topics file (--topics)"
    of_a_folder = "a drive folder (`homeward convert` makes it from this log)"
    return tuple(
        note.replace("under `sensor:` in drive.yaml", f"under `sensor:` of {of_a_log}")
        .replace("in drive.yaml", f"under {of_a_log}")
        .replace("landmarks.yaml of the drive folder", f"landmarks.yaml of {of_a_folder}")
        for note in notes
    )


def prepare(
    run: RunSettings, progress: Callable[[float], None] | None = None
) -> tuple[Drive, Estimator, RunSettings]:
    """Open the drive, reporting `progress`, and make the estimator of a run.

    The returned settings contain every setting of the estimator. `InputError` where the drive
    cannot be read or has no sightings, the settings are invalid, or the estimator cannot smooth;
    `HomewardError` where no landmark was found in a folder of images.
    """
    return ready(run, opened(run, progress))


def opened(run: RunSettings, progress: Callable[[float], None] | None = None) -> Drive:
    """Open the drive of a run, reporting `progress`; errors as `prepare`."""
    settings = estimator_settings(run.estimator, run.settings)
    if run.place is not None and run.estimator != DEFAULT:
        raise InputError(f"a place is for the estimator {DEFAULT}, not {run.estimator}")
    if run.is_smoothed and not isinstance(settings, LocalizerSettings):
        raise InputError(f"{run.estimator} cannot smooth; use the estimator robust")
    visits = run.place is not None and run.place_version != 0 and _is_place(run.place)
    drive = open_drive(
        drive_path(run),
        topics=run.topics,
        robot_file=run.robot_file,
        home_spin=run.home_spin,
        home_during=run.home_during,
        home_at=run.home_at,
        home_file=run.home_file,
        home_needed=not visits,
        on_progress=progress,
    )
    require_senses(drive)
    if note := note_of_whole(drive):
        raise InputError(note.rstrip("."), advice=f"or set {OVERRIDE} to run it all the same")
    if not drive.sightings.t.size:
        raise _no_sightings(drive_path(run), drive.remark_lines)
    if not (drive.home or visits) and not (
        drive.known.surveyed_from_home and run.estimator == DEFAULT
    ):
        remedy = HOME_ADVICE
        if is_log(drive_path(run)):
            from homeward.drives.ros.settings import NAME_HOME as remedy
        from homeward.drives.home.when import with_proposal

        remedy = with_proposal(remedy, drive)
        raise InputError(f"no home bearings found: {remedy}", Path(run.drive))
    return drive


def _is_place(folder: str) -> bool:
    from homeward.places.files import is_place  # only runs in a place need it

    return is_place(Path(folder))


def ready(run: RunSettings, drive: Drive) -> tuple[Drive, Estimator, RunSettings]:
    """Return what `prepare` returns, for a drive that is open."""
    settings = estimator_settings(run.estimator, run.settings)
    if run.place is not None:
        from homeward.runs.visits import in_place, place_used

        run = run.model_copy(update=place_used(run, drive))
        drive = in_place(run, drive)
    start, drive = with_start(drive, run.estimator, run.start)
    estimator = make_estimator(run.estimator, drive, settings)
    if run.place is not None and not isinstance(estimator, Localizer):
        raise InputError(f"a place is for the estimator {DEFAULT}, on a drive without images")
    values = settings.model_dump(mode="json")
    if "engine" in values:
        # The engine that was found, not "auto": the run repeats to the last bit.
        values["engine"] = getattr(estimator, "engine", values["engine"])
    return drive, estimator, run.model_copy(update={"start": start, "settings": values})


def _no_sightings(path: Path, remarks: Iterable[str]) -> HomewardError:
    """Return the error for a drive without sightings; sound images are no input error."""
    if is_image_folder(path):
        return HomewardError("; ".join([f"{path}: no landmark was found in its images", *remarks]))
    remedy = ""
    if is_log(path):
        from homeward.drives.ros.settings import NAME_BEARINGS

        remedy = f": {NAME_BEARINGS}"
    return InputError("; ".join([f"no sightings of landmarks in it{remedy}", *remarks]), path)


def drive_path(run: RunSettings) -> Path:
    """Return the path of the drive of a run."""
    return sample_drive() if run.drive == SAMPLE else Path(run.drive)


StartChoice = Literal["truth"] | tuple[float, float, float] | None


def with_start(
    drive: Drive, estimator: str, start: StartChoice = None
) -> tuple[StartChoice, Drive]:
    """Return the source of the start prior, and the drive with that prior.

    Without `start` and without a prior in the drive, an estimator that needs one gets ground truth.
    """
    known = drive.settings.start is not None or drive.truth is None
    if start is None and not known and needs_start(estimator):
        start = "truth"
    if start is None:
        return None, drive
    settings = drive.settings.model_copy(update={"start": _start_prior(start, drive)})
    return start, replace(drive, settings=settings)


def _start_prior(start: str | tuple[float, float, float], drive: Drive) -> Start:
    """Return the start prior from numbers, or from the ground truth of a drive."""
    if isinstance(start, tuple):
        R, theta, alpha = start
        return validated(Start, {"R": R, "theta": theta, "alpha": alpha})
    if drive.truth is None:
        raise InputError(f"{drive.name}: no ground truth for --start truth; give R,THETA,ALPHA")
    first = drive.span[0]
    late = max(float(drive.truth.t[0]) - first, first - float(drive.truth.t[-1]))
    if late > MAX_TRUTH_GAP_S:
        raise InputError(
            f"{drive.name}: --start truth needs ground truth within {MAX_TRUTH_GAP_S:g} s of the"
            f" start; it is {late:.1f} s away"
        )
    x, y, heading = (float(a[0]) for a in drive.truth.at(np.array([first])))
    return Start.about(to_polar(Pose(x, y, heading)), *[TRUTH_SIGMA] * 3)


@dataclass(frozen=True)
class Outcome:
    """Result of one of several estimators."""

    run: RunSettings
    """Every setting, defaults included."""
    drive: Drive
    """The drive with the start prior of this estimator."""
    track: Track | None
    """None where the estimator failed."""
    failure: str = ""
    """Reason of the failure."""

    @property
    def metrics(self) -> Metrics | None:
        """Metrics of the track."""
        if self.track is None:
            return None
        return score(self.track, self.drive.truth, self.drive.settings.largest_sigma)


def run_several(
    runs: Sequence[RunSettings], progress: Callable[[float], None] | None = None
) -> list[Outcome]:
    """Run several estimators on one drive, which is opened once.

    The runs differ in their estimators only; `progress` receives the fraction done, in [0, 1].
    `InputError` where the drive cannot be used, two estimators are the same, or one cannot be made.
    """
    names = [run.estimator for run in runs]
    if twice := next((name for name in names if names.count(name) > 1), None):
        raise InputError(f"estimator {twice} is given twice")
    drive = opened(runs[0])
    prepared = [ready(run, drive) for run in runs]
    outcomes = []
    for done, (started, estimator, complete) in enumerate(prepared):

        def on_progress(fraction: float, done: int = done) -> None:
            if progress is not None:
                progress((done + fraction) / len(runs))

        try:
            track = finish(started, estimator, complete, on_progress)
            outcomes.append(Outcome(complete, started, track))
        except HomewardError as error:
            outcomes.append(Outcome(complete, started, None, str(error)))
    return outcomes
