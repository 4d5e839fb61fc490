"""`homeward plan`: from where a robot can come home, and what would help."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from homeward.cli.options import AsJson, progress
from homeward.cli.terminal import answer, say
from homeward.errors import InputError

if TYPE_CHECKING:
    from homeward.studies.planning.analysis import PlanView


def plan(
    source: Annotated[
        str, typer.Argument(metavar="PLAN", help="A YAML file, or: warehouse, an example.")
    ],
    out: Annotated[Path, typer.Option(help="The folder to write.")] = Path("out/plan"),
    json: AsJson = False,
) -> None:
    """Map from where homing can begin on a floor plan, how well, and where to add landmarks.

    The folder gets plan.html, its maps as PNG and SVG, floor.csv with every point, and plan.yaml,
    the plan with every default spelt out.
    """
    from homeward.report.output import check_output
    from homeward.report.plan.page import PAGE, SETTINGS_FILE, write_plan
    from homeward.report.plan.words import plan_summary
    from homeward.studies.planning.analysis import analyse
    from homeward.studies.planning.floor import make_floor
    from homeward.studies.planning.settings import load_plan

    settings = load_plan(source)
    try:
        make_floor(settings)
    except InputError as error:
        raise InputError(error.what, Path(source)) from error
    check_output(out, SETTINGS_FILE)
    with progress(f"planning {settings.name}") as tell:
        view = analyse(settings, tell)
        write_plan(out, view)
    if json:
        answer({"summary": plan_summary(view), **_facts(view), "page": str(out / PAGE)})
        return
    say(plan_summary(view))
    say(f"Page: {out / PAGE}")


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
