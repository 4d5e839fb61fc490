"""What `homeward study` leaves behind: a page, figures, and one netCDF file."""

from __future__ import annotations

from pathlib import Path

import yaml
from markupsafe import Markup

from homeward.lab.report.study.figures import (
    MOST_PANELS,
    MOST_ROWS,
    OVER_TIME,
    OVERVIEW,
    below,
    figures,
    note_below,
)
from homeward.lab.studies.blocks.store import MARKER
from homeward.lab.studies.study.results import Results, write_netcdf
from homeward.lab.studies.study.summary import Summary, exact_table, failures, summary, table
from homeward.runs.report.canvas import drawn
from homeward.runs.report.files import write_tables
from homeward.runs.report.output import whole_folder
from homeward.runs.report.template import render
from homeward.runs.report.words import count, listing

PAGE, DATA = "study.html", "results.nc"


def write_study(directory: Path, results: Results) -> list[list[str]]:
    """Write the page, its table, figures as PNG, and results as netCDF, all or nothing.

    Return the table, for the terminal; errors as `whole_folder`.
    """
    with whole_folder(directory, MARKER) as scratch:
        pictures = [
            (name, *drawn(scratch, _file(name), caption, figure))
            for name, caption, figure in figures(results)
        ]
        write_netcdf(results, scratch / DATA)
        found = summary(results)
        rows = table(found)
        write_tables(scratch, rows, exact_table(found), left=2)
        (scratch / PAGE).write_text(_page(results, found, rows, pictures), encoding="utf-8")
    return rows


def headline(results: Results) -> str:
    """Say in a sentence what was computed."""
    plan, study = results.plan, results.plan.study
    loop = "each steering its own drives" if study.loop == "closed" else "on drives of the truth"
    failed = int(results.failed.sum())
    told = f"{failed:,} of {results.number:,} runs failed" if failed else "no run failed"
    fixed = any(case.runs < study.runs for case in plan.cases)
    return (
        f"{count(len(plan.contenders), 'estimator')} in {count(len(plan.cases), 'scenario')}: "
        f"{told}, of {count(study.runs, 'run')} each"
        f"{' (one where nothing is random)' if fixed else ''}, {loop}"
    )


def _page(
    results: Results,
    found: Summary,
    rows: list[list[str]],
    pictures: list[tuple[str, str, Markup]],
) -> str:
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
        package="homeward.lab.report",
        title=plan.study.name,
        headline=headline(results),
        closed=found.closed,
        first=found.first,
        home_radius=plan.study.home_radius,
        rows=rows,
        figures=[picture for _, *picture in pictures],
        over_time=OVER_TIME in names,
        cut=listing(cut) if cut else "",
        below=note_below(below(results)),
        failures=failures(results),
        settings=yaml.safe_dump(settings, sort_keys=False, default_flow_style=None),
    )


def _file(name: str) -> str:
    return "".join(c if c.isalnum() or c in "-_" else "_" for c in name)
