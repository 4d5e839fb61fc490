"""`homeward run`: a drive in, a pose with its uncertainty out."""

from __future__ import annotations

import os
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
            help="A drive folder, a folder of images, a ROS bag or MCAP file, "
            "the run.yaml of an earlier run, or: sample."
        ),
    ],
    out: Annotated[
        Path | None, typer.Option(help="The folder to write [out/NAME OF THE DRIVE].")
    ] = None,
    estimator: Annotated[
        str | None,
        typer.Option(
            help="robust (default), a name of `homeward settings`, or package.module:make; several "
            "with commas go onto one page."
        ),
    ] = None,
    start: Annotated[
        str | None,
        typer.Option(
            help="Start prior: R,THETA,ALPHA [m, rad, rad], or truth; default: drive.yaml's."
        ),
    ] = None,
    topics: shared.Topics = None,
    home_spin: shared.HomeSpin = None,
    place: shared.KnownPlace = None,
    update: Annotated[
        bool, typer.Option("--update", help="Merge the drive into the place at its end.")
    ] = False,
    store_home: Annotated[
        str | None,
        typer.Option(help="With --update: a new home of this name where the drive ends."),
    ] = None,
    home_at: Annotated[
        float | None,
        typer.Option(help="With --store-home: where the drive was then [s from its start]."),
    ] = None,
    store_route: Annotated[
        str | None,
        typer.Option(help="With --update: the way of the drive as a route of this name."),
    ] = None,
    place_home: Annotated[
        str | None, typer.Option(help="Answer in the frame of this home of the place [the first].")
    ] = None,
    when: Annotated[
        str | None, typer.Option(help="The day of the visit, YYYY-MM-DD [the drive's, else today].")
    ] = None,
    smooth: Annotated[
        bool, typer.Option("--smooth", help="Correct the whole track at the end; not causal.")
    ] = False,
    changes: shared.Changes = None,
    json: shared.AsJson = False,
) -> None:
    """Localise a robot along a drive, and write what came out.

    The folder gets estimate.csv, trajectory.tum, landmarks.csv, metrics.json, run.mcap,
    report.html and run.yaml, from which the run repeats (without the extra report no run.mcap and
    no report.html). Of several estimators it gets all that in a folder of each, and
    estimators.html with table.csv, table.md and table.tex. Where no pose was found, the exit
    status is 1.
    """
    from homeward.io.settings import nested
    from homeward.places.files import check_place, newest

    options = {
        "estimator": estimator,
        "start": _start(start),
        "home_spin": shared.spin_span(home_spin),
        "topics": None if topics is None else os.path.realpath(topics),
        "place": None if place is None else os.path.realpath(place),
        "place_home": place_home,
        "when": None if when is None else shared.day(when),
        "smooth": smooth or None,
        "settings": nested(shared.key_values(changes or [])) or None,
    }
    given: dict[str, Any] = {key: value for key, value in options.items() if value is not None}
    if update and (place is None or smooth):
        raise InputError("--update needs a --place, and no --smooth")
    if place is not None and update:
        check_place(place)  # before a run of minutes
    elif place is not None:
        newest(place)
    for option, name in (("--store-home", store_home), ("--store-route", store_route)):
        if name is not None and not update:
            raise InputError(f"{option} needs --update")
    if home_at is not None and store_home is None:
        raise InputError("--home-at needs --store-home")
    if place is None and (place_home is not None or when is not None):
        raise InputError("--place-home and --when are for a --place")
    if estimator is not None and "," in estimator:
        _run_several(drive, given, out, json)
        return
    _run(run_settings(drive, given), out, update, (store_home, home_at, store_route), json)


def _start(text: str | None) -> str | tuple[float, float, float] | None:
    return text if text in (None, "truth") else shared.three_numbers(text, "--start")


def run_settings(drive: str, given: dict[str, Any]) -> RunSettings:
    """Return the settings of a new run of a drive, or those in the run.yaml of an earlier run.

    `given` holds the options by name. A run.yaml allows none, except that `estimator` confirms
    an estimator named package.module:make: a file from elsewhere must not choose code to execute.
    """
    from homeward.drives.opening import SAMPLE
    from homeward.io.settings import validated
    from homeward.runs.single_run import RunSettings, load_run

    file = Path(drive)
    if file.suffix in (".yaml", ".yml") and is_there(file) and not os.path.isdir(file):
        earlier = load_run(file)
        confirmed = given.get("estimator") == earlier.estimator
        changed = sorted(given.keys() - ({"estimator"} if confirmed else set()))
        if changed:
            option = "--" + ("set" if "settings" in given else changed[0].replace("_", "-"))
            raise InputError(f"{option} cannot be changed: the run repeats as it was", file)
        if ":" in earlier.estimator and not confirmed:
            raise InputError(
                f"estimator: {earlier.estimator} is Python code outside homeward; to execute it, "
                f"use `homeward run {drive} --estimator {earlier.estimator}`",
                file,
            )
        return earlier
    if drive != SAMPLE or is_there(file):
        drive = os.path.realpath(file)
    return validated(RunSettings, {"drive": drive, **given})


def _output_folder(chosen: Path | None, name: str, drive: str) -> Path:
    """Return the folder to write: `chosen`, or out/NAME where that is free or has a run of `drive`.

    Else NAME-run, NAME-2, NAME-3, ...: out/NAME may hold the drive itself, or a run of another
    drive of that name.
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
            raise  # no other name would be any better
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
    from homeward.runs.report.words import route_words, visit_words
    from homeward.runs.scoring import score
    from homeward.runs.single_run import drive_path, finish, prepare
    from homeward.runs.visits import ToStore, check_update, save_visit

    store, lack = ToStore(*names), missing_extra()
    lost: HomewardError | None = None
    after: Place | None = None
    with shared.progress(f"{settings.drive}, {settings.estimator}") as tell:
        drive, estimator, complete = prepare(settings, tell)
        if update:
            check_update(complete, drive, store)
        folder = _output_folder(out, drive.name, settings.drive)
        images, unread = _images(drive_path(complete))
        track = finish(drive, estimator, complete, tell)
        summary = write_run(folder, drive, track, complete.model_dump(mode="json"), images)
        if update and settings.place is not None:
            try:
                after, reasons = save_visit(complete, drive, estimator, track, store)
                lost = HomewardError("; ".join(reasons)) if reasons else None
            except HomewardError as error:  # told below the answer, which is there nevertheless
                after, lost = None, error
    words = [summary, *([] if after is None else [visit_words(after)])]
    if after is not None and store.route in after.routes:
        words.append(route_words(after, str(store.route)))
    if json:
        told: dict[str, Any] = {"summary": "\n".join(words), "folder": str(folder)}
        told["report"] = str(folder / PAGE) if lack is None else None
        shared.answer(
            {**told, "remarks": drive.remark_lines, **_facts(track, score(track, drive.truth))}
        )
    else:
        for paragraph in words:
            shared.say(paragraph)
        shared.warn(*drive.remark_lines, *track.notes, *unread)
        if lack is None:
            shared.say(f"Report: {folder / PAGE}")
        else:
            shared.say(f"Files: {folder}")
            shared.warn(f"no page and no log: {lack}")
    if lost is not None:
        raise lost
    if not track.has_pose.any():
        raise shared.no_answer()


def _images(drive: Path) -> tuple[Images | None, list[str]]:
    """Return the camera images of a drive; None and a warning where they cannot be read."""
    from homeward.drives.images import read_images

    try:
        return read_images(drive, {}), []
    except InputError as error:
        return None, [f"run.mcap has no images: {error}"]


def _facts(track: Track, metrics: Metrics) -> dict[str, Any]:
    """Return what came out of one run as plain values."""
    landmarks = [asdict(landmark) for landmark in track.landmarks]
    return {"metrics": metrics.as_dict(), "landmarks": landmarks, "notes": track.notes}


def _run_several(drive: str, given: dict[str, Any], out: Path | None, json: bool) -> None:
    from homeward.io.writing import check_output
    from homeward.runs.report.several import PAGE, table, write_several
    from homeward.runs.single_run import run_several

    for option in ("settings", "smooth", "place"):
        if option in given:
            name = "set" if option == "settings" else option
            raise InputError(f"--{name} is for one estimator; homeward study takes it for each")
    words = [word.strip() for word in given["estimator"].split(",")]
    runs = [run_settings(drive, {**given, "estimator": word}) for word in words]
    with shared.progress(f"{drive}, {', '.join(words)}") as tell:
        outcomes = run_several(runs, tell)
        folder = out or Path("out") / f"{outcomes[0].drive.name}-estimators"
        check_output(folder, PAGE)
        write_several(folder, outcomes)
    if json:
        came = [
            {"estimator": o.run.estimator, "failure": o.failure or None}
            | ({} if o.track is None or o.metrics is None else _facts(o.track, o.metrics))
            for o in outcomes
        ]
        told = {"folder": str(folder), "page": str(folder / PAGE), "runs": came}
        shared.answer({**told, "remarks": outcomes[0].drive.remark_lines})
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
