"""`homeward reproduce`: the paper's cases, beside its tables."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from homeward.cli.options import AsJson, Scheduler, Workers, key_values, progress, resumable
from homeward.cli.terminal import answer, say
from homeward.cli.terminal import table as print_rows
from homeward.errors import InputError

if TYPE_CHECKING:
    from homeward.studies.paper.tables import Row

IMAGE_RUNS = 10
"""Layouts per case when every sample must be rendered."""


def reproduce(
    out: Annotated[
        Path | None, typer.Option(help="The folder to write [out/paper, or out/paper-study].")
    ] = None,
    measurements: Annotated[
        Literal["model", "images"],
        typer.Option(help="Bearings from the model's equations, or from rendered panoramas."),
    ] = "model",
    runs: Annotated[
        int | None, typer.Option(help="Random layouts per case [100; images: 10; study: 10000].")
    ] = None,
    seed: Annotated[int | None, typer.Option(help="Of the first of them [0].")] = None,
    study: Annotated[
        bool,
        typer.Option(
            "--study",
            help="Instead: Cases 1, 2 and 4 over thousands of layouts, under many readings.",
        ),
    ] = False,
    scheduler: Scheduler = None,
    workers: Workers = None,
    changes: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="KEY=VALUE",
            help="Another value of a setting; repeatable. "
            "homeward settings reproduce lists them; with --study there are also varied and "
            "robust: how many layouts these parts get, and grid.KEY: what is combined.",
        ),
    ] = None,
    json: AsJson = False,
) -> None:
    """Run the paper's Cases 1 to 4 with its filters and printed parameters.

    The folder gets paper.html, with both RMSE tables beside the printed ones, what the paper
    leaves open and what was assumed; every figure as PNG; rmse.csv; and reproduce.yaml. With
    --study it gets layouts.html with the verdict, figures and layouts.csv. Either keeps finished
    blocks in it, from which a stopped command goes on.
    """
    from homeward.drives.text.settings import nested

    values = nested(key_values(changes or []))
    imaged = measurements == "images"
    if study:
        if imaged:
            raise InputError("--study has no images: leave out --measurements images")
        _study(out or Path("out/paper-study"), runs, seed, (scheduler, workers), values, json)
        return
    if imaged:
        values = {"runs": IMAGE_RUNS} | values
    values["measurements"] = measurements
    values |= {k: v for k, v in (("runs", runs), ("seed", seed)) if v is not None}
    _cases(out or Path("out/paper"), (scheduler, workers), values, json)


def _cases(
    out: Path, places: tuple[str | None, int | None], values: dict[str, Any], json: bool
) -> None:
    from homeward.drives.text.settings import validated
    from homeward.report.output import check_output
    from homeward.report.paper.page import (
        PAGE,
        SETTINGS_FILE,
        fault_rows,
        sentences,
        write_reproduction,
    )
    from homeward.studies.blocks.finish import Where, Work
    from homeward.studies.paper.layouts import open_store
    from homeward.studies.paper.reproduction import reproduce as run_cases
    from homeward.studies.paper.settings import PaperSettings
    from homeward.studies.paper.tables import rows

    where, settings = Where(*places), validated(PaperSettings, values)
    check_output(out, SETTINGS_FILE)
    store = open_store(out, SETTINGS_FILE)
    with resumable(), progress("the paper's cases") as tell:
        result = run_cases(settings, Work(store, where, tell))
        write_reproduction(out, result)

    if json:
        told = {"summary": " ".join(sentences(result)), "rows": [asdict(r) for r in rows(result)]}
        answer({**told, "runs": settings.runs, "page": str(out / PAGE)})
        return
    head = ["case", "filter", "R", "theta", "alpha", "printed: R", "theta", "alpha"]
    print_rows([head, *([row.case, row.filter, *_cells(row)] for row in rows(result))])
    if settings.measurements == "images":
        for case, asked, obtained in fault_rows(result):
            say(f"Case {case}: {asked} moved landmarks asked for, obtained {obtained}.")
    for sentence in sentences(result):
        say(sentence)
    say(
        f"RMSE of R in cm, theta and alpha in rad; medians over {settings.runs} random layouts. "
        f"Page: {out / PAGE}"
    )


def _cells(row: Row) -> list[str]:
    """Return errors beside the printed ones, where there are any."""
    printed = ["", "", ""] if row.printed is None else [f"{value:.4f}" for value in row.printed]
    return [*(f"{value:.4f}" for value in row.median), *printed]


def _study(
    out: Path,
    runs: int | None,
    seed: int | None,
    places: tuple[str | None, int | None],
    values: dict[str, Any],
    json: bool,
) -> None:
    from homeward.report.output import check_output
    from homeward.report.paper.layout_page import (
        DATA,
        PAGE,
        claim_table,
        error_table,
        headline,
        order_table,
        ratio_table,
        write_layouts,
    )
    from homeward.studies.blocks.finish import Where, Work
    from homeward.studies.blocks.store import MARKER
    from homeward.studies.paper.layouts import open_store
    from homeward.studies.paper.reproduction import layout_settings, study_layouts

    where = Where(*places)
    settings = layout_settings(values, runs, seed)
    check_output(out, MARKER)
    store = open_store(out)
    with resumable(), progress("layouts of the paper's cases") as tell:
        result = study_layouts(settings, Work(store, where, tell))
        write_layouts(out, result)
    tables = (error_table, ratio_table, order_table, claim_table)
    if json:
        told = {table.__name__.removesuffix("_table"): table(result) for table in tables}
        files = {"page": str(out / PAGE), "results": str(out / DATA)}
        answer({"summary": headline(result), "tables": told, **files})
        return
    for table in tables:
        print_rows(table(result), left=3)
        typer.echo("")
    say(f"{headline(result)} Page: {out / PAGE}; every run: {out / DATA}")
