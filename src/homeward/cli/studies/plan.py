"""`homeward plan`: homing accuracy on a floor plan, and observability of landmarks or a drive."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

import typer

from homeward.cli.options import (
    AsJson,
    Topics,
    no_answer,
    numbers,
    progress,
    read_drive,
    show,
)
from homeward.errors import InputError, naming_file

if TYPE_CHECKING:
    from homeward.lab.observability.study import ModelView
    from homeward.lab.planning.analysis import PlanView
    from homeward.lab.studies.observing import DriveView, Window


def plan(
    source: Annotated[
        str | None, typer.Argument(metavar="[PLAN]", help="A YAML file, or the example: warehouse.")
    ] = None,
    start: Annotated[
        str | None,
        typer.Option(
            "--from",
            metavar="X,Y",
            help="With PLAN: only report whether homing can begin at this place [m]. Writes no "
            "files; exit status 1 if it cannot begin.",
        ),
    ] = None,
    landmarks: Annotated[
        int | None,
        typer.Option(help="Instead of a floor plan: observability with this number of landmarks."),
    ] = None,
    compass: Annotated[
        bool, typer.Option("--compass", help="With --landmarks: the heading is known.")
    ] = False,
    distances: Annotated[
        bool,
        typer.Option(
            "--distances", help="With --landmarks: distances of the landmarks from home are known."
        ),
    ] = False,
    motion: Annotated[
        str | None,
        typer.Option(
            help="With --landmarks: arc, straight, towards (a landmark), spot, still, or circle."
        ),
    ] = None,
    unknown: Annotated[
        list[str] | None,
        typer.Option(
            help="With --landmarks: add an unknown: speed-scale, turn-scale, turn-bias, lag or "
            "camera-yaw; repeatable."
        ),
    ] = None,
    drive: Annotated[
        str | None,
        typer.Option(help="Instead of a floor plan: observability along this drive."),
    ] = None,
    window: Annotated[
        float | None, typer.Option(help="With --drive: length of the time windows [s] [30].")
    ] = None,
    topics: Topics = None,
    out: Annotated[
        Path | None, typer.Option(help="The folder to write [out/plan, or out/observe].")
    ] = None,
    json: AsJson = False,
) -> None:
    """Map where homing can begin on a floor plan, and its accuracy.

    The folder gets plan.html, its maps as PNG and SVG, floor.csv with every point, and plan.yaml,
    the plan with all defaults. With --landmarks or --drive it gets observe.html, which lists the
    quantities that bearings determine, its figure as PNG and SVG, and observe.yaml.
    """
    of_model = {
        "landmarks": landmarks,
        "compass": compass or None,
        "distances": distances or None,
        "motion": motion,
        "unknown": unknown or None,
    }
    of_drive = {"drive": drive, "window": window, "topics": None if topics is None else str(topics)}
    chosen = _analysis(source, of_model, of_drive)
    if start is not None and chosen is not None:
        raise InputError("--from needs PLAN")
    if chosen is of_model:
        observe_model(_given(of_model), out or Path("out/observe"), json)
    elif chosen is of_drive:
        observe_recording(_given(of_drive), out or Path("out/observe"), json)
    elif start is not None:
        _start(cast(str, source), start, json)
    else:
        _plan(cast(str, source), out or Path("out/plan"), json)


def _given(options: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in options.items() if value is not None}


def _analysis(source: str | None, *analyses: dict[str, Any]) -> dict[str, Any] | None:
    """Return the options of the analysis that its first option selects; None: a floor plan."""
    firsts = [next(iter(options)) for options in analyses]
    chosen = [o for o, first in zip(analyses, firsts, strict=True) if o[first] is not None]
    if len(chosen) + (source is not None) != 1:
        raise InputError("give exactly one of PLAN, --landmarks N and --drive DRIVE")
    for options, first in zip(analyses, firsts, strict=True):
        if options not in chosen and (others := _given(options)):
            raise InputError(f"--{next(iter(others))} needs --{first}")
    return chosen[0] if chosen else None


def _plan(source: str, out: Path, json: bool) -> None:
    from homeward.io.writing import check_output
    from homeward.lab.planning.analysis import analyse
    from homeward.lab.planning.floor import make_floor
    from homeward.lab.planning.settings import load_plan
    from homeward.lab.report.plan import PAGE, SETTINGS_FILE, plan_summary, write_plan

    settings = load_plan(source)
    with naming_file(Path(source)):
        make_floor(settings)
    check_output(out, SETTINGS_FILE)
    with progress(f"planning {settings.name}") as on_progress:
        view = analyse(settings, on_progress)
        write_plan(out, view)
    facts = {"summary": plan_summary(view), **_facts(view), "page": out / PAGE}
    show(json, facts, plan_summary(view), f"Page: {out / PAGE}")


def _start(source: str, start: str, json: bool) -> None:
    from homeward.lab.planning.analysis import analyse
    from homeward.lab.planning.settings import load_plan
    from homeward.lab.report.plan import start_summary

    (x, y), settings = numbers(start, "--from", 2), load_plan(source)
    with naming_file(Path(source)):
        view = analyse(settings, place=(x, y))
    facts = {
        "summary": start_summary(view),
        "begins": bool(view.begins[0]),
        "landmarks": int(view.common[0]),
        "position_sigma": float(view.position[0]),
        "heading_sigma": float(view.heading[0]),
        "not_without": view.needed if view.begins[0] else (),
    }
    show(json, facts, start_summary(view))
    if not view.begins[0]:
        raise no_answer()


def _facts(view: PlanView) -> dict[str, Any]:
    """Return the result as plain values."""
    landmarks = [
        {"landmark": name, "seen_from_home": bool(seen), "share_without": float(left)}
        for name, seen, left in zip(
            view.names, view.stored, (view.hidden <= 1).mean(axis=0), strict=True
        )
    ]
    return {
        "share": float(view.begins.mean()),
        "safe_share": float(view.safe.mean()),
        "landmarks": landmarks,
    }


def observe_model(given: dict[str, Any], out: Path, json: bool) -> None:
    """Report and draw the unobservable quantities with a number of landmarks."""
    from homeward.io.writing import check_output
    from homeward.lab.observability.study import observe
    from homeward.lab.report import observe as page

    options = {**given, "unknown": tuple(given.get("unknown", ()))}
    with progress("analysing observability") as on_progress:
        view = observe(options.pop("landmarks"), **cast(Any, options))
        check_output(out, page.SETTINGS_FILE)
        on_progress(0.5)
        page.write_model_view(out, view, given)
    model = view.model
    facts = {
        "summary": page.model_summary(view),
        "rank": view.drive.rank.value if model is None else model.rank,
        "unknowns": len(view.drive.truth) if model is None else model.n,
        "undetermined": [freedom.words for freedom in view.freedoms],
        "page": out / page.PAGE,
    }
    lines = [page.model_summary(view), _numbers(view)]
    if view.family:
        members = sum(len(t.unknowns) - 1 for t in view.family)
        lines.append(
            f"{members} other worlds drawn that give the same bearings to"
            f" {page.same_to(view):.0e} rad."
        )
    show(json, facts, *lines, f"Page: {out / page.PAGE}")


def _numbers(view: ModelView) -> str:
    """Return the rank, and the singular values that decide it."""
    if view.model is None:
        found = view.drive.rank
        return (
            f"rank {found.value} of {len(view.drive.truth)}; smallest nonzero singular value"
            f" {found.singular_values[found.value - 1]:.1e} of the largest, then a gap of"
            f" {found.gap:.0e}"
        )
    m = view.model
    return (
        f"rank {m.rank} of {m.n}, from Lie derivatives up to order {m.order} (scaled singular"
        f" values; smallest nonzero {m.singular_values[m.rank - 1]:.1e} of the largest)"
    )


def observe_recording(given: dict[str, Any], out: Path, json: bool) -> None:
    """Report and draw the unobservable quantities in time windows of a drive."""
    from homeward.io.writing import check_output
    from homeward.lab.report import observe as page
    from homeward.lab.studies.observing import WINDOW_S, check_window, observe_drive

    settings = {"window": WINDOW_S, **given}
    opened = read_drive(given["drive"], given.get("topics"))
    check_window(opened, settings["window"])
    check_output(out, page.SETTINGS_FILE)
    with progress(f"analysing observability of {opened.name}") as on_progress:
        view: DriveView = observe_drive(opened, settings["window"], on_progress)
        page.write_drive_view(out, view, settings)
    facts = {
        "summary": page.drive_summary(view),
        "whole": _window(view.whole),
        "windows": [_window(window) for window in view.windows],
        "page": out / page.PAGE,
    }
    show(json, facts, page.drive_summary(view), f"Page: {out / page.PAGE}")


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
