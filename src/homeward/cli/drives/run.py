"""`homeward run`: localise a robot in a recorded drive."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import asdict
from itertools import chain, count
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer
from typer.core import TyperCommand

from homeward.cli import options as shared
from homeward.cli.options import table as print_rows
from homeward.errors import HomewardError, InputError, as_typed
from homeward.io.naming import command
from homeward.io.reading import is_there

if TYPE_CHECKING:
    from homeward.drives.images import Images
    from homeward.runs.scoring import Metrics
    from homeward.runs.single_run import Outcome, RunSettings
    from homeward.runs.visits import ToStore
    from homeward.track import Track


ROBOT_FILE = Path("robot.yaml")
"""The file that `homeward tune` writes."""
WHOLE_DRIVE = "whole"
"""Value of ``--smooth`` without a number."""


class RunCommand(TyperCommand):
    """Command whose option ``--smooth`` may have no value."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the words after the name of the command."""
        for k, word in enumerate(args):
            follows = "".join(args[k + 1 : k + 2])
            if word == "--smooth" and not follows[:1].isdigit():
                args = [*args[:k], f"--smooth={WHOLE_DRIVE}", *args[k + 1 :]]
        return super().parse_args(ctx, args)


COMMAND = RunCommand
"""Class of the command, instead of typer's."""


def run(
    drive: Annotated[
        str,
        typer.Argument(
            help="A drive folder, a folder of images, a log (ROS bag, MCAP, .wpilog), "
            "the run.yaml of an earlier run, or: sample."
        ),
    ],
    out: shared.RunFolder = None,
    estimator: Annotated[
        str | None,
        typer.Option(
            help="robust (default), another name from `homeward settings`, or package.module:make; "
            "several, separated by commas, are compared on one page."
        ),
    ] = None,
    start: Annotated[
        str | None,
        typer.Option(
            help="Start prior: R,THETA,ALPHA [m, rad, rad], or truth (ground truth) [drive.yaml]."
        ),
    ] = None,
    topics: shared.Topics = None,
    robot_file: shared.RobotFile = None,
    home: shared.Home = None,
    place: shared.KnownPlace = None,
    place_home: shared.PlaceHome = None,
    when: shared.When = None,
    smooth: Annotated[
        str | None,
        typer.Option(
            metavar="[SECONDS]",
            help="Smooth the track over the whole drive, or each pose with data of this many "
            "seconds after it (not causal).",
        ),
    ] = None,
    changes: shared.Changes = None,
    json: shared.AsJson = False,
) -> None:
    """Localise a robot in a recorded drive, and write poses, landmarks, metrics and a report.

    The folder gets estimate.csv, trajectory.tum, landmarks.csv, metrics.json, run.mcap, report.html
    and run.yaml, which repeats the run (without the extra report, no run.mcap and no report.html).
    Several estimators get a folder each, and estimators.html with table.csv, table.md and
    table.tex. Exit status 1 if no pose was found.
    """
    options = {
        "estimator": estimator,
        "start": _start(start),
        "smooth": (smooth == WHOLE_DRIVE) or None,
        "smoothed_lag": None if smooth in (None, WHOLE_DRIVE) else shared.seconds(smooth),
        **common_options(topics, robot_file, place, place_home, when, changes),
        **home_options(shared.home_choice(home)),
    }
    given: dict[str, Any] = {key: value for key, value in options.items() if value is not None}
    if place is not None:  # fail before a run of minutes
        from homeward.places.files import newest

        newest(place)
    elif place_home is not None or when is not None:
        raise InputError("--place-home and --when need --place")
    if estimator is not None and "," in estimator:
        _run_several(drive, given, out, json)
        return
    run_one(run_settings(drive, given), out, json)


def common_options(
    topics: Path | None,
    robot_file: Path | None,
    place: Path | None,
    place_home: str | None,
    when: str | None,
    changes: list[str] | None,
) -> dict[str, Any]:
    """Return options that `run` and `place add` share, as in `RunSettings`; None: not given."""
    from homeward.io.settings import nested

    files = {"topics": topics, "robot_file": robot_file, "place": place}
    return {
        **{name: None if file is None else os.path.realpath(file) for name, file in files.items()},
        "place_home": place_home,
        "when": None if when is None else shared.day(when),
        "settings": nested(shared.key_values(changes or [])) or None,
    }


def home_options(chosen: shared.HomeChoice) -> dict[str, Any]:
    """Return the option `Home` as in `RunSettings`."""
    if "home_file" in chosen:
        return {"home_file": os.path.realpath(chosen["home_file"])}
    return dict(chosen)


def _start(text: str | None) -> str | tuple[float, ...] | None:
    return text if text in (None, "truth") else shared.numbers(text, "--start", 3)


def run_settings(drive: str, given: dict[str, Any]) -> RunSettings:
    """Return the settings of a new run of a drive, or those in the run.yaml of an earlier run.

    `given` holds the options by name. A run.yaml allows none, except that `estimator` confirms
    an estimator named package.module:make: a file from elsewhere must not choose code to execute.
    """
    from homeward.drives.opening import SAMPLE
    from homeward.io.settings import validated
    from homeward.plugins import require_confirmed
    from homeward.runs.single_run import RunSettings, load_run

    file = Path(drive)
    if file.suffix in (".yaml", ".yml") and is_there(file) and not os.path.isdir(file):
        earlier = load_run(file)
        confirmed = given.get("estimator") == earlier.estimator
        changed = sorted(given.keys() - ({"estimator"} if confirmed else set()))
        if changed:
            names = {"settings": "set", "smoothed_lag": "smooth"}
            names |= {key: "home" for key in given if key.startswith("home_")}
            option = "--" + names.get(changed[0], changed[0].replace("_", "-"))
            raise InputError(
                f"{option} cannot be changed when a run.yaml is repeated; run the drive itself",
                file,
            )
        named = [("estimator", earlier.estimator, "--estimator ")]
        require_confirmed(named, (earlier.estimator,) if confirmed else (), file)
        return earlier
    if drive != SAMPLE or is_there(file):
        drive = os.path.realpath(file)
    return validated(RunSettings, {"drive": drive, **given})


def _output_folder(chosen: Path | None, name: str, drive: str) -> Path:
    """Return the folder to write: `chosen`, or the first of out/NAME, out/NAME-run, out/NAME-2, ...

    that does not exist or contains a run of `drive`. Others may contain the drive itself, or a run
    of another drive with that name.
    """
    from homeward.io.settings import read_tree
    from homeward.io.writing import check_output
    from homeward.runs.report.folder import SETTINGS_FILE

    if chosen is not None:
        check_output(chosen, SETTINGS_FILE)
        return chosen
    ends = chain(("", "-run"), (f"-{number}" for number in count(2)))
    for folder in (Path("out") / f"{name}{end}" for end in ends):
        try:
            check_output(folder, SETTINGS_FILE)
        except InputError:
            if is_there(folder):
                continue
            raise  # no other name would help
        run = folder / SETTINGS_FILE
        if not is_there(run) or read_tree(run).get("drive") == drive:
            break
    return folder


def run_one(
    settings: RunSettings, out: Path | None, json: bool, store: ToStore | None = None
) -> None:
    """Run an estimator, write the files and print the result.

    With `store`, the drive is merged into the place afterwards, and its home and route are stored.
    """
    from homeward.runs.report.folder import PAGE, missing_extra, write_run
    from homeward.runs.scoring import score
    from homeward.runs.single_run import drive_path, finish, prepare

    missing = missing_extra()
    lost: HomewardError | None = None
    words = list[str]()
    with shared.progress(f"{as_typed(settings.drive)}, {settings.estimator}") as on_progress:
        drive, estimator, complete = prepare(settings, on_progress)
        if store is not None:
            from homeward.runs.visits import check_update

            check_update(complete, drive, store)
        folder = _output_folder(out, drive.name, settings.drive)
        images, unread = _images(drive_path(complete))
        track = finish(drive, estimator, complete, on_progress)
        words.append(write_run(folder, drive, track, complete.model_dump(mode="json"), images))
        if store is not None:
            from homeward.runs.report.place_words import route_words, visit_words
            from homeward.runs.visits import save_visit

            try:
                after, why_apart, reasons = save_visit(complete, drive, estimator, track, store)
            except HomewardError as error:  # raised after the summary is printed
                lost = error
            else:
                lost = HomewardError("; ".join(reasons)) if reasons else None
                words.append(visit_words(after, why_apart))
                if store.route in after.routes:
                    words.append(route_words(after, str(store.route)))
    if json:
        facts: dict[str, Any] = {"summary": "\n".join(words), "folder": str(folder)}
        facts["report"] = str(folder / PAGE) if missing is None else None
        shared.answer(
            {
                **facts,
                "remarks": drive.remark_lines,
                **_facts(track, score(track, drive.truth, drive.settings.largest_sigma)),
            }
        )
    else:
        for paragraph in words:
            shared.say(paragraph)
        shared.warn(*drive.remark_lines, *track.notes, *unread)
        if missing is None:
            shared.say(f"Report: {folder / PAGE}")
        else:
            shared.say(f"Files: {folder}")
            shared.warn(f"no report.html and no run.mcap: {missing}")
        if track.has_pose.any() and lost is None:
            shared.say(f"Next: {_following(settings, is_stored=store is not None)}")
    if lost is not None:
        raise lost
    if not track.has_pose.any():
        raise shared.no_answer()


def _following(settings: RunSettings, is_stored: bool) -> str:
    """Return the next command after a run with a pose; `is_stored`: after a visit to a place."""
    robot: tuple[object, ...] = ()
    if settings.robot_file is not None:
        robot = ("--robot-file", settings.robot_file)
    if settings.place is not None and not is_stored:
        return again("place", "add", settings.place, settings=settings, options=robot)
    if settings.place is not None and not robot:
        return command("place", "view", settings.place)
    if robot:
        place = () if settings.place is None else ("--place", settings.place)
        return command("live", "--tcp", "7707", *robot, *place)
    file = shared.unused(ROBOT_FILE)
    return again("tune", settings=settings, options=() if file == ROBOT_FILE else ("--out", file))


def again(*name: object, settings: RunSettings, options: Sequence[object] = ()) -> str:
    """Return a command to type for the drive of a run, with its topics file and its home."""
    inputs: list[object] = [] if settings.topics is None else ["--topics", settings.topics]
    for kind in ("file", "during", "spin", "at"):
        if (value := getattr(settings, f"home_{kind}")) is not None:
            text = value if kind == "file" else ",".join(f"{t:g}" for t in np.atleast_1d(value))
            inputs += ["--home", text if kind == "file" else f"{kind}:{text}"]
    return command(*name, settings.drive, *inputs, *options)


def _images(drive: Path) -> tuple[Images | None, list[str]]:
    """Return the camera images of a drive, or None and a warning."""
    from homeward.drives.images import read_images

    try:
        return read_images(drive, {}), []
    except InputError as error:
        return None, [f"run.mcap has no images: {error}"]


def _facts(track: Track, metrics: Metrics) -> dict[str, Any]:
    """Return the results of one run as plain values."""
    landmarks = [asdict(landmark) for landmark in track.landmarks]
    return {"metrics": metrics.as_dict(), "landmarks": landmarks, "notes": track.notes}


def _run_several(drive: str, given: dict[str, Any], out: Path | None, json: bool) -> None:
    from homeward.io.writing import check_output
    from homeward.runs.report.several import PAGE, table, write_several
    from homeward.runs.single_run import run_several

    names_of = {"settings": "set", "smoothed_lag": "smooth"}
    for option in ("settings", "smooth", "smoothed_lag", "place"):
        if option in given:
            name = names_of.get(option, option)
            raise InputError(
                f"--{name} works with one estimator only; a study file of homeward study takes it"
                " for each"
            )
    names = [name.strip() for name in given["estimator"].split(",")]
    runs = [run_settings(drive, {**given, "estimator": name}) for name in names]
    with shared.progress(f"{drive}, {', '.join(names)}") as on_progress:
        outcomes = run_several(runs, on_progress)
        folder = out or Path("out") / f"{outcomes[0].drive.name}-estimators"
        check_output(folder, PAGE)
        write_several(folder, outcomes)
    if json:
        results = [
            {"estimator": o.run.estimator, "failure": o.failure or None}
            | ({} if o.track is None or o.metrics is None else _facts(o.track, o.metrics))
            for o in outcomes
        ]
        facts = {"folder": str(folder), "page": str(folder / PAGE), "runs": results}
        shared.answer({**facts, "remarks": outcomes[0].drive.remark_lines})
    else:
        _say_several(outcomes, table(outcomes), folder / PAGE)
    if not any(o.track is not None and o.track.has_pose.any() for o in outcomes):
        raise shared.no_answer()


def _say_several(outcomes: Sequence[Outcome], rows: list[list[str]], page: Path) -> None:
    print_rows(rows, left=1)
    shared.warn(*outcomes[0].drive.remark_lines)
    for outcome in outcomes:
        notes = () if outcome.track is None else outcome.track.notes
        for line in filter(None, (outcome.failure, *notes)):
            is_named = line not in notes or line.startswith(f"{outcome.run.estimator} ")
            shared.warn(line if is_named else f"{outcome.run.estimator}: {line}")
    shared.say(f"Page: {page}")
