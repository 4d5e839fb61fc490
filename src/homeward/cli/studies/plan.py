"""`homeward plan`: from where a robot can drive home, and what would help."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

import typer

from homeward.cli.options import AsJson, Topics, progress, show
from homeward.cli.studies.observability import observe_model, observe_recording
from homeward.errors import InputError

if TYPE_CHECKING:
    from homeward.lab.planning.analysis import PlanView


def plan(
    source: Annotated[
        str | None, typer.Argument(metavar="[PLAN]", help="A YAML file, or: warehouse, an example.")
    ] = None,
    landmarks: Annotated[
        int | None,
        typer.Option(help="Instead of a floor plan: analyse observability with N landmarks."),
    ] = None,
    compass: Annotated[
        bool, typer.Option("--compass", help="With --landmarks: the heading is known.")
    ] = False,
    distances: Annotated[
        bool, typer.Option("--distances", help="With --landmarks: distances from home are known.")
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
            help="With --landmarks: speed-scale, turn-scale, turn-bias, lag or camera-yaw is "
            "unknown, too; repeatable."
        ),
    ] = None,
    drive: Annotated[
        str | None,
        typer.Option(help="Instead of a floor plan: analyse observability along this drive."),
    ] = None,
    window: Annotated[
        float | None, typer.Option(help="With --drive: stretches of the drive, in seconds [30].")
    ] = None,
    topics: Topics = None,
    out: Annotated[
        Path | None, typer.Option(help="The folder to write [out/plan, or out/observe].")
    ] = None,
    json: AsJson = False,
) -> None:
    """Map from where homing can begin on a floor plan, how well, and where to add landmarks.

    The folder gets plan.html, its maps as PNG and SVG, floor.csv with every point, and plan.yaml,
    the plan with every default spelt out. With --landmarks or --drive it gets observe.html, which
    states what bearings determine and what not, its drawing as PNG and SVG, and observe.yaml.
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
    if chosen is of_model:
        observe_model(_given(of_model), out or Path("out/observe"), json)
    elif chosen is of_drive:
        observe_recording(_given(of_drive), out or Path("out/observe"), json)
    else:
        _plan(cast(str, source), out or Path("out/plan"), json)


def _given(options: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in options.items() if value is not None}


def _analysis(source: str | None, *analyses: dict[str, Any]) -> dict[str, Any] | None:
    """Return the options of the analysis that was chosen by its first one; None: a floor plan."""
    firsts = [next(iter(options)) for options in analyses]
    chosen = [o for o, first in zip(analyses, firsts, strict=True) if o[first] is not None]
    if len(chosen) + (source is not None) != 1:
        raise InputError("give one of PLAN, --landmarks N and --drive DRIVE")
    for options, first in zip(analyses, firsts, strict=True):
        if options not in chosen and (others := _given(options)):
            raise InputError(f"--{next(iter(others))} needs --{first}")
    return chosen[0] if chosen else None


def _plan(source: str, out: Path, json: bool) -> None:
    from homeward.io.writing import check_output
    from homeward.lab.planning.analysis import analyse
    from homeward.lab.planning.floor import make_floor
    from homeward.lab.planning.settings import load_plan
    from homeward.lab.report.plan.page import PAGE, SETTINGS_FILE, plan_summary, write_plan

    settings = load_plan(source)
    try:
        make_floor(settings)
    except InputError as error:
        raise InputError(error.what, Path(source)) from error
    check_output(out, SETTINGS_FILE)
    with progress(f"planning {settings.name}") as tell:
        view = analyse(settings, tell)
        write_plan(out, view)
    facts = {"summary": plan_summary(view), **_facts(view), "page": out / PAGE}
    show(json, facts, plan_summary(view), f"Page: {out / PAGE}")


def _facts(view: PlanView) -> dict[str, Any]:
    """Return what is known as plain values."""
    landmarks = [
        {"landmark": name, "seen_from_home": bool(seen), "share_without": float(left)}
        for name, seen, left in zip(
            view.names, view.stored, (view.hidden <= 1).mean(axis=0), strict=True
        )
    ]
    advice = view.advice
    further = [
        {"x": float(x), "y": float(y), "share": float(share), "safe_share": float(safe)}
        for (x, y), share, safe in zip(
            advice.places, advice.share[1:], advice.safe[1:], strict=True
        )
    ]
    return {
        "share": float(view.begins.mean()),
        "safe_share": float(view.safe.mean()),
        "landmarks": landmarks,
        "further": further,
    }
