"""What `homeward study` leaves behind: a page, figures, and one netCDF file."""

from __future__ import annotations

from pathlib import Path

import yaml
from markupsafe import Markup

from homeward.report.below_bound import note_below
from homeward.report.canvas import drawn
from homeward.report.output import whole_folder
from homeward.report.study.figures import (
    MOST_PANELS,
    MOST_ROWS,
    OVER_TIME,
    OVERVIEW,
    below,
    figures,
)
from homeward.report.template import render
from homeward.report.versions import versions
from homeward.report.words import count, listing
from homeward.studies.study.results import MARKER, Results, write_netcdf
from homeward.studies.study.summary import failures, table

PAGE, DATA = "study.html", "results.nc"


def write_study(directory: Path, results: Results) -> None:
    """Write the page, every figure as PNG, and the results as netCDF, all or nothing.

    Raises
    ------
    InputError
        When the folder holds something else, or cannot be written.
    """
    with whole_folder(directory, MARKER) as scratch:
        pictures = [
            (name, *drawn(scratch, _file(name), caption, figure))
            for name, caption, figure in figures(results)
        ]
        write_netcdf(results, scratch / DATA)
        (scratch / PAGE).write_text(_page(results, pictures), encoding="utf-8")


def headline(results: Results) -> str:
    """Say in a sentence what was computed."""
    plan, study = results.plan, results.plan.study
    loop = "each steering its own drives" if study.loop == "closed" else "on drives of the truth"
    failed = int(results.failed.sum())
    told = "none failed" if not failed else f"{failed:,} of {results.failed.size:,} runs failed"
    return (
        f"{count(len(plan.contenders), 'estimator')} in {count(len(plan.cases), 'scenario')}, "
        f"{count(study.runs, 'run')} of each, {loop}; {told}"
    )


def _page(results: Results, pictures: list[tuple[str, str, Markup]]) -> str:
    plan = results.plan
    names = [name for name, _, _ in pictures]
    cut = []
    if OVER_TIME in names and len(plan.cases) > MOST_PANELS:
        cut.append(f"figures over time show the first {MOST_PANELS} scenarios")
    if OVERVIEW in names and len(plan.cases) * len(plan.contenders) > MOST_ROWS:
        cut.append(f"the overview shows the first {MOST_ROWS} rows of the table")
    settings = plan.study.model_dump(mode="json", by_alias=True, exclude_none=True)
    return render(
        "study.html.j2",
        title=plan.study.name,
        headline=headline(results),
        closed=plan.study.loop == "closed",
        home_radius=plan.study.home_radius,
        rows=table(results),
        figures=[picture for _, *picture in pictures],
        over_time=OVER_TIME in names,
        cut=listing(cut) if cut else "",
        below=note_below(below(results)),
        failures=failures(results),
        settings=yaml.safe_dump(settings, sort_keys=False, default_flow_style=None),
        versions=versions(),
    )


def _file(name: str) -> str:
    return "".join(c if c.isalnum() or c in "-_" else "_" for c in name)
