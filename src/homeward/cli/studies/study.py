"""`homeward study`: Monte Carlo studies of estimators, and the cases of the paper."""

from __future__ import annotations

from dataclasses import asdict
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from homeward.cli import options as shared
from homeward.cli.options import table as print_rows
from homeward.errors import InputError

if TYPE_CHECKING:
    from homeward.lab.studies.blocks.finish import Where
    from homeward.lab.studies.paper.reproduction import Row

PAPER = ("paper", "layouts")
"""Studies of the paper's cases."""


def study(
    study: Annotated[
        str,
        typer.Argument(
            help="A YAML file, or an included study: paper, layouts (the paper's cases), peers, "
            "a-ekf-tuning, pi-ekf-tuning."
        ),
    ] = "",
    out: Annotated[
        Path | None, typer.Option(help="The folder to write [out/NAME OF THE STUDY].")
    ] = None,
    runs: Annotated[int | None, typer.Option(help="Number of runs [the study's].")] = None,
    seed: Annotated[int | None, typer.Option(help="Random seed [the study's].")] = None,
    options: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="KEY=VALUE",
            help="paper and layouts: value of a setting; repeatable. `homeward settings paper` "
            "lists the keys (measurements=images renders panoramas); layouts also has varied, "
            "robust and grid.KEY.",
        ),
    ] = None,
    execute: Annotated[
        list[str] | None,
        typer.Option(
            metavar="PACKAGE.MODULE:NAME",
            help="Estimator or law of the YAML file that is your own Python code, and may be "
            "executed; repeatable.",
        ),
    ] = None,
    scheduler: shared.Scheduler = None,
    workers: shared.Workers = None,
    json: shared.AsJson = False,
) -> None:
    """Run a Monte Carlo study: every estimator in every scenario, many times.

    The folder gets results.nc (netCDF: errors of every run, also over time), study.html, its table
    as CSV, Markdown and LaTeX, every figure as PNG and PDF, study.yaml, and the finished blocks.
    After an interruption, the same command continues from them. Uses all processors by default.
    Exit status 1 if every run failed. Needs the extra scale.

    `paper` runs the paper's Cases 1 to 4 with its printed parameters and writes paper.html with
    both RMSE tables next to the printed ones. `layouts` runs Cases 1, 2 and 4 over thousands of
    layouts, under many interpretations of the paper, and writes layouts.html with the result.
    """
    from homeward.io.reading import shipped_or_file
    from homeward.io.settings import nested
    from homeward.io.writing import check_output
    from homeward.lab.report.study.page import DATA, PAGE, headline, write_study
    from homeward.lab.studies.blocks.finish import StudyBlocks, Where
    from homeward.lab.studies.blocks.store import MARKER, store_of
    from homeward.lab.studies.study.plan import load_study, make_plan
    from homeward.lab.studies.study.results import run_study
    from homeward.lab.studies.study.summary import failures, lines

    if study not in PAPER:
        shipped_or_file(study, "studies", PAPER)
    where = Where(scheduler, workers)
    changes = {key: value for key, value in (("runs", runs), ("seed", seed)) if value is not None}
    folder = out or Path("out") / Path(study).stem
    if study in PAPER:
        if execute:
            raise InputError(f"--execute is not for {' and '.join(PAPER)}")
        values = nested(shared.key_values(options or [])) | changes
        (paper if study == "paper" else layouts)(folder, where, values, json)
        return
    if options:
        raise InputError(
            f"--set is only for {' and '.join(PAPER)}; put the setting into the study's YAML file"
        )
    for package in ("xarray", "h5netcdf"):  # fail now, not after the study
        import_module(package)
    plan = make_plan(load_study(study, changes, execute or ()))
    check_output(folder, MARKER)
    store = store_of(plan.study, folder)
    with shared.resumable(), shared.progress(plan.study.name) as on_progress:
        results = run_study(plan, StudyBlocks(store, where, on_progress))
        rows = write_study(folder, results)
    if json:
        facts = {"summary": headline(results) + ".", "lines": [asdict(x) for x in lines(results)]}
        files = {"page": str(folder / PAGE), "results": str(folder / DATA)}
        shared.answer({**facts, "failures": failures(results), **files})
    else:
        print_rows(rows)
        shared.say(headline(results) + ".")
        for reason, number in failures(results).items():
            shared.warn(f"{number} failed: {reason}")
        shared.say(f"Page: {folder / PAGE}; results: {folder / DATA}")
    if results.failed.sum() == results.number:
        raise shared.no_answer()


IMAGE_RUNS = 10
"""Number of layouts per case when every sample must be rendered."""


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
    with shared.resumable(), shared.progress("the paper's cases") as on_progress:
        result = run_cases(settings, StudyBlocks(store, where, on_progress))
        page.write_reproduction(out, result)

    if json:
        facts = {
            "summary": " ".join(page.sentences(result)),
            "rows": [asdict(r) for r in rows(result)],
        }
        shared.answer({**facts, "runs": settings.runs, "page": str(out / page.PAGE)})
        return
    head = ["case", "filter", "R", "theta", "alpha", "printed: R", "theta", "alpha"]
    print_rows([head, *([row.case, row.filter, *_cells(row)] for row in rows(result))])
    if settings.measurements == "images":
        for case, requested, obtained in page.fault_rows(result):
            shared.say(f"Case {case}: {requested} moved landmarks requested, {obtained} obtained.")
    for sentence in page.sentences(result):
        shared.say(f"- {sentence}")
    shared.say(
        f"RMSE of R in cm, theta and alpha in rad; medians over {settings.runs} random layouts. "
        f"Page: {out / page.PAGE}"
    )


def _cells(row: Row) -> list[str]:
    """Return the cells of a row: errors, and the printed ones where the paper has them."""
    printed = ["", "", ""] if row.printed is None else [f"{value:.4f}" for value in row.printed]
    return [*(f"{value:.4f}" for value in row.median), *printed]


def layouts(out: Path, where: Where, values: dict[str, Any], json: bool) -> None:
    """Run Cases 1, 2 and 4 over thousands of layouts, under many interpretations of the paper."""
    from homeward.io.writing import check_output
    from homeward.lab.report.paper import layout_page as page
    from homeward.lab.report.paper.claims import deciding_table
    from homeward.lab.studies.blocks.finish import StudyBlocks
    from homeward.lab.studies.blocks.store import MARKER
    from homeward.lab.studies.paper.layouts import open_store
    from homeward.lab.studies.paper.reproduction import layout_settings, study_layouts

    settings = layout_settings(values, values.pop("runs", None), values.pop("seed", None))
    check_output(out, MARKER)
    store = open_store(out)
    with shared.resumable(), shared.progress("layouts of the paper's cases") as on_progress:
        result = study_layouts(settings, StudyBlocks(store, where, on_progress))
        page.write_layouts(out, result)
    tables = (
        page.error_table,
        page.ratio_table,
        page.order_table,
        deciding_table,
        page.claim_table,
    )
    if json:
        values = {table.__name__.removesuffix("_table"): table(result) for table in tables}
        files = {"page": str(out / page.PAGE), "results": str(out / page.DATA)}
        shared.answer({"summary": page.headline(result), "tables": values, **files})
        return
    for table in tables:
        print_rows(table(result), left=3)
        typer.echo("")
    shared.say(f"{page.headline(result)} Page: {out / page.PAGE}; every run: {out / page.DATA}")
