"""`homeward plan`: from where a robot can come home, and what would help."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from homeward.cli.options import progress
from homeward.cli.terminal import say
from homeward.errors import InputError


def plan(
    source: Annotated[
        str, typer.Argument(metavar="PLAN", help="A YAML file, or: warehouse, an example.")
    ],
    out: Annotated[Path, typer.Option(help="The folder to write.")] = Path("out/plan"),
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
    say(plan_summary(view))
    say(f"Page: {out / PAGE}")
