"""`homeward observe`: what bearings can tell, and what they cannot."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

import typer

from homeward.cli.options import AsJson, HomeNoise, HomePose, Robot, Topics, progress, read_drive
from homeward.cli.terminal import answer, say
from homeward.errors import InputError

if TYPE_CHECKING:
    from homeward.observability.study import ModelView
    from homeward.studies.observing import DriveView, Window


def observe(
    drive: Annotated[
        str | None, typer.Argument(help="A drive folder, an MRCLAM folder, a log, or: sample.")
    ] = None,
    landmarks: Annotated[
        int | None, typer.Option(help="Of the model, when there is no drive [2].")
    ] = None,
    compass: Annotated[bool, typer.Option("--compass", help="The heading is known.")] = False,
    distances: Annotated[
        bool, typer.Option("--distances", help="The landmarks' distances from home are known.")
    ] = False,
    motion: Annotated[
        str | None,
        typer.Option(help="arc, straight, towards (a landmark), spot, still, or circle."),
    ] = None,
    unknown: Annotated[
        list[str] | None,
        typer.Option(
            help="speed-scale, turn-scale, turn-bias, lag or camera-yaw, unknown too; repeatable."
        ),
    ] = None,
    window: Annotated[
        float | None, typer.Option(help="Stretches of the drive, in seconds [30].")
    ] = None,
    robot: Robot = None,
    home: HomePose = None,
    home_noise_deg: HomeNoise = 0.0,
    topics: Topics = None,
    out: Annotated[Path, typer.Option(help="The folder to write.")] = Path("out/observe"),
    json: AsJson = False,
) -> None:
    """Say in words what bearings cannot tell apart, and draw it.

    Of a number of landmarks, or of a drive. The folder gets observe.html, the drawing as PNG and
    SVG, and observe.yaml.
    """
    of_model = {
        "landmarks": landmarks,
        "compass": compass or None,
        "distances": distances or None,
        "motion": motion,
        "unknown": unknown or None,
    }
    of_drive = {
        "window": window,
        "robot": robot,
        "home": home,
        "home-noise-deg": home_noise_deg,
        "topics": None if topics is None else str(topics),
    }
    wrong = of_drive if drive is None else of_model
    for name, value in wrong.items():
        if value:
            there = "needs a drive" if drive is None else "is for a model, not for a drive"
            raise InputError(f"--{name} {there}")
    if drive is None:
        _of_model({k: v for k, v in of_model.items() if v is not None}, out, json)
    else:
        _of_drive(drive, {k: v for k, v in of_drive.items() if v is not None}, out, json)


def _of_model(given: dict[str, Any], out: Path, json: bool) -> None:
    from homeward.observability.study import observe as observe_model
    from homeward.report.observe.page import (
        PAGE,
        SETTINGS_FILE,
        model_summary,
        same_to,
        write_model_view,
    )
    from homeward.report.output import check_output

    settings = {"landmarks": 2, **given}
    asked = {**settings, "unknown": tuple(settings.get("unknown", ()))}
    with progress("observing") as tell:
        view = observe_model(asked.pop("landmarks"), **cast(Any, asked))
        check_output(out, SETTINGS_FILE)
        tell(0.5)
        write_model_view(out, view, settings)
    if json:
        rank = view.drive.found.value if view.model is None else view.model.rank
        answer(
            {
                "summary": model_summary(view),
                "rank": rank,
                "unknowns": view.drive.unknowns if view.model is None else view.model.n,
                "not_told": [freedom.words for freedom in view.freedoms],
                "page": str(out / PAGE),
            }
        )
        return
    say(model_summary(view))
    say(_numbers(view))
    if view.family:
        members = sum(len(t.unknowns) - 1 for t in view.family)
        say(
            f"{members} other worlds drawn; in each all bearings are the same to"
            f" {same_to(view):.0e} rad."
        )
    say(f"Page: {out / PAGE}")


def _numbers(view: ModelView) -> str:
    """Return the rank and how sure it is."""
    if view.model is None:
        found = view.drive.found
        return (
            f"rank {found.value} of {view.drive.unknowns}; smallest singular value that counts"
            f" {found.singular_values[found.value - 1]:.1e} of the largest, then a gap of"
            f" {found.gap:.0e}"
        )
    m = view.model
    how = "60 digits" if m.precise else "scaled singular values"
    return (
        f"rank {m.rank} of {m.n}, by Lie derivatives up to order {m.order} ({how}; smallest that"
        f" counts {m.singular_values[m.rank - 1]:.1e} of the largest)"
    )


def _of_drive(drive: str, given: dict[str, Any], out: Path, json: bool) -> None:
    from homeward.report.observe.page import PAGE, SETTINGS_FILE, drive_summary, write_drive_view
    from homeward.report.output import check_output
    from homeward.studies.observing import WINDOW_S, check_window, observe_drive

    settings = {"drive": drive, "window": WINDOW_S, **given}
    told = (given.get("robot"), given.get("home"), settings["home-noise-deg"], given.get("topics"))
    opened = read_drive(drive, *told)
    check_window(opened, settings["window"])
    check_output(out, SETTINGS_FILE)
    with progress(f"observing {opened.name}") as tell:
        view: DriveView = observe_drive(opened, settings["window"], tell)
        write_drive_view(out, view, settings)
    if json:
        answer(
            {
                "summary": drive_summary(view),
                "whole": _window(view.whole),
                "windows": [_window(window) for window in view.windows],
                "page": str(out / PAGE),
            }
        )
        return
    say(drive_summary(view))
    say(f"Page: {out / PAGE}")


def _window(window: Window) -> dict[str, Any]:
    return {
        "begin_s": window.begin,
        "end_s": window.end,
        "sightings": window.sightings,
        "rank": window.rank,
        "unknowns": window.unknowns,
        "position_sigma_m": window.position_sigma,
        "heading_sigma_rad": window.heading_sigma,
        "weakest": window.weakest,
    }
