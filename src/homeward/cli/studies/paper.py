"""`homeward study paper` and `homeward study layouts`: the paper's cases, next to its tables."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from homeward.cli.options import answer, progress, resumable, say
from homeward.cli.options import table as print_rows

if TYPE_CHECKING:
    from homeward.lab.studies.blocks.finish import Where
    from homeward.lab.studies.paper.reproduction import Row

IMAGE_RUNS = 10
"""Layouts per case when every sample must be rendered."""


def paper(out: Path, where: Where, values: dict[str, Any], json: bool) -> None:
    """Run the paper's Cases 1 to 4 with its filters and printed parameters."""
    from homeward.io.settings import validated
    from homeward.io.writing import check_output
    from homeward.lab.report.paper import page
    from homeward.lab.studies.blocks.finish import StudyBlocks
    from homeward.lab.studies.paper.layouts import open_store
    from homeward.lab.studies.paper.reproduction import reproduce as run_cases
    from homeward.lab.studies.paper.reproduction import rows
    from homeward.lab.studies.paper.settings import PaperSettings

    if values.get("measurements") == "images":
        values = {"runs": IMAGE_RUNS} | values
    settings = validated(PaperSettings, values)
    check_output(out, page.SETTINGS_FILE)
    store = open_store(out, page.SETTINGS_FILE)
    with resumable(), progress("the paper's cases") as tell:
        result = run_cases(settings, StudyBlocks(store, where, tell))
        page.write_reproduction(out, result)

    if json:
        told = {
            "summary": " ".join(page.sentences(result)),
            "rows": [asdict(r) for r in rows(result)],
        }
        answer({**told, "runs": settings.runs, "page": str(out / page.PAGE)})
        return
    head = ["case", "filter", "R", "theta", "alpha", "printed: R", "theta", "alpha"]
    print_rows([head, *([row.case, row.filter, *_cells(row)] for row in rows(result))])
    if settings.measurements == "images":
        for case, asked, obtained in page.fault_rows(result):
            say(f"Case {case}: {asked} moved landmarks asked for, obtained {obtained}.")
    for sentence in page.sentences(result):
        say(sentence)
    say(
        f"RMSE of R in cm, theta and alpha in rad; medians over {settings.runs} random layouts. "
        f"Page: {out / page.PAGE}"
    )


def _cells(row: Row) -> list[str]:
    """Return errors beside the printed ones, where there are any."""
    printed = ["", "", ""] if row.printed is None else [f"{value:.4f}" for value in row.printed]
    return [*(f"{value:.4f}" for value in row.median), *printed]


def layouts(out: Path, where: Where, values: dict[str, Any], json: bool) -> None:
    """Run Cases 1, 2 and 4 over thousands of layouts, under many readings of the paper."""
    from homeward.io.writing import check_output
    from homeward.lab.report.paper import layout_page as page
    from homeward.lab.studies.blocks.finish import StudyBlocks
    from homeward.lab.studies.blocks.store import MARKER
    from homeward.lab.studies.paper.layouts import open_store
    from homeward.lab.studies.paper.reproduction import layout_settings, study_layouts

    settings = layout_settings(values, values.pop("runs", None), values.pop("seed", None))
    check_output(out, MARKER)
    store = open_store(out)
    with resumable(), progress("layouts of the paper's cases") as tell:
        result = study_layouts(settings, StudyBlocks(store, where, tell))
        page.write_layouts(out, result)
    tables = (page.error_table, page.ratio_table, page.order_table, page.claim_table)
    if json:
        told = {table.__name__.removesuffix("_table"): table(result) for table in tables}
        files = {"page": str(out / page.PAGE), "results": str(out / page.DATA)}
        answer({"summary": page.headline(result), "tables": told, **files})
        return
    for table in tables:
        print_rows(table(result), left=3)
        typer.echo("")
    say(f"{page.headline(result)} Page: {out / page.PAGE}; every run: {out / page.DATA}")
