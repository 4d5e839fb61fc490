"""`homeward run`: localise a robot in a recorded drive."""

from __future__ import annotations

import os
import shlex
from collections.abc import Sequence
from dataclasses import asdict
from itertools import chain, count
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from homeward.cli import options as shared
from homeward.cli.options import table as print_rows
from homeward.errors import HomewardError, InputError
from homeward.io.reading import is_there

if TYPE_CHECKING:
    from homeward.drives.images import Images
    from homeward.places.place import Place
    from homeward.runs.scoring import Metrics
    from homeward.runs.single_run import Outcome, RunSettings
    from homeward.track import Track


def run(
    drive: Annotated[
        str,
        typer.Argument(
            help="A drive folder, a folder of images, a log (ROS bag, MCAP, .wpilog), "
            "the run.yaml of an earlier run, or: sample."
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            help="The folder to write [out/NAME; out/NAME-run if that folder has other contents]."
        ),
    ] = None,
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
    robot_file: Annotated[
        Path | None,
        typer.Option(help="The robot.yaml of the robot, written by homeward tune."),
    ] = None,
    home: shared.Home = None,
    place: shared.KnownPlace = None,
    update: Annotated[
        bool, typer.Option("--update", help="Merge the drive into the place after the run.")
    ] = False,
    store_home: Annotated[
        str | None,
        typer.Option(
            help="With --update: store the end of the drive, or its pose at --home at:T, as a home "
            "with this name."
        ),
    ] = None,
    store_route: Annotated[
        str | None,
        typer.Option(help="With --update: store the path as a route with this name."),
    ] = None,
    place_home: Annotated[
        str | None,
        typer.Option(help="Home whose frame the poses use [the first home of the place]."),
    ] = None,
    when: Annotated[
        str | None, typer.Option(help="Day of the visit, YYYY-MM-DD [the drive's, else today].")
    ] = None,
    smooth: Annotated[
        bool, typer.Option("--smooth", help="Smooth the track over the whole drive (not causal).")
    ] = False,
    smoothed_lag: Annotated[
        float | None,
        typer.Option(help="Smooth each pose with data of this many seconds after it."),
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
    from homeward.io.settings import nested

    chosen = shared.home_choice(home)
    stored_at = chosen.pop("home_at", None) if store_home else None
    if "home_file" in chosen:
        chosen["home_file"] = os.path.realpath(chosen["home_file"])
    options = {
        "estimator": estimator,
        "start": _start(start),
        **chosen,
        "topics": None if topics is None else os.path.realpath(topics),
        "robot_file": None if robot_file is None else os.path.realpath(robot_file),
        "place": None if place is None else os.path.realpath(place),
        "place_home": place_home,
        "when": None if when is None else shared.day(when),
        "smooth": smooth or None,
        "smoothed_lag": smoothed_lag,
        "settings": nested(shared.key_values(changes or [])) or None,
    }
    given: dict[str, Any] = {key: value for key, value in options.items() if value is not None}
    is_smoothed = smooth or smoothed_lag is not None
    if smooth and smoothed_lag is not None:
        raise InputError("--smooth and --smoothed-lag exclude each other; choose one")
    if update and (place is None or is_smoothed):
        raise InputError("--update needs --place, and does not work with a smoothed track")
    if place is not None:  # fail before a run of minutes
        from homeward.places.files import check_place, newest

        if update:
            check_place(place)
        else:
            newest(place)
    for option, name in (("--store-home", store_home), ("--store-route", store_route)):
        if name is not None and not update:
            raise InputError(f"{option} needs --update")
    if place is None and (place_home is not None or when is not None):
        raise InputError("--place-home and --when need --place")
    if estimator is not None and "," in estimator:
        _run_several(drive, given, out, json)
        return
    names = store_home, stored_at, store_route
    _run(run_settings(drive, given), out, update, names, json)


def _start(text: str | None) -> str | tuple[float, float, float] | None:
    return text if text in (None, "truth") else shared.three_numbers(text, "--start")


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
            names = {"settings": "set", **{k: "home" for k in given if k.startswith("home_")}}
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


def _run(
    settings: RunSettings,
    out: Path | None,
    update: bool,
    names: tuple[str | None, float | None, str | None],
    json: bool,
) -> None:
    from homeward.runs.report.folder import PAGE, missing_extra, write_run
    from homeward.runs.scoring import score
    from homeward.runs.single_run import drive_path, finish, prepare

    missing = missing_extra()
    lost: HomewardError | None = None
    after: Place | None = None
    with shared.progress(f"{settings.drive}, {settings.estimator}") as on_progress:
        drive, estimator, complete = prepare(settings, on_progress)
        if update:
            from homeward.runs.visits import ToStore, check_update, save_visit

            store = ToStore(*names)
            check_update(complete, drive, store)
        folder = _output_folder(out, drive.name, settings.drive)
        images, unread = _images(drive_path(complete))
        track = finish(drive, estimator, complete, on_progress)
        summary = write_run(folder, drive, track, complete.model_dump(mode="json"), images)
        if update and settings.place is not None:
            try:
                after, reasons = save_visit(complete, drive, estimator, track, store)
                lost = HomewardError("; ".join(reasons)) if reasons else None
            except HomewardError as error:  # raised after the summary is printed
                after, lost = None, error
    words = [summary]
    if after is not None:
        from homeward.runs.report.place_words import route_words, visit_words

        words.append(visit_words(after))
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
            shared.say(f"Next: {_next(settings)}")
    if lost is not None:
        raise lost
    if not track.has_pose.any():
        raise shared.no_answer()


def _next(settings: RunSettings) -> str:
    """Return the next command on the way to a robot: its calibration, then the robot itself."""
    given = {"--robot-file": settings.robot_file, "--topics": settings.topics}
    words = [f" {option} {shlex.quote(file)}" for option, file in given.items() if file]
    if settings.robot_file is not None:
        return f"homeward live --tcp 7707{words[0]}"
    return f"homeward tune {shlex.quote(settings.drive)}{''.join(words)}"


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

    for option in ("settings", "smooth", "smoothed_lag", "place"):
        if option in given:
            name = "set" if option == "settings" else option.replace("_", "-")
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
            shared.warn(f"{outcome.run.estimator}: {line}" if line in notes else line)
    shared.say(f"Page: {page}")
