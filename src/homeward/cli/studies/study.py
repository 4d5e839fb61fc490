"""`homeward study`: estimators x scenarios x runs."""

from __future__ import annotations

from dataclasses import asdict
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from homeward.cli.options import (
    AsJson,
    Scheduler,
    Workers,
    answer,
    key_values,
    no_answer,
    progress,
    resumable,
    say,
    show,
    warn,
)
from homeward.cli.options import table as print_rows
from homeward.errors import InputError

if TYPE_CHECKING:
    from homeward.lab.studies.blocks.finish import Where
    from homeward.lab.studies.paper.map_settings import MapSettings

PAPER = ("paper", "layouts")
"""Studies of the paper's cases."""


def study(
    study: Annotated[
        str,
        typer.Argument(
            help="A YAML file, or one that ships: paper, layouts (the paper's cases), peers, "
            "a-ekf-tuning, pi-ekf-tuning, a-ekf-map, pi-ekf-map."
        ),
    ],
    out: Annotated[
        Path | None, typer.Option(help="The folder to write [out/NAME OF THE STUDY].")
    ] = None,
    runs: Annotated[int | None, typer.Option(help="Another number than the study's.")] = None,
    seed: Annotated[int | None, typer.Option(help="Another seed than the study's.")] = None,
    options: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="KEY=VALUE",
            help="paper and layouts: another value of a setting; repeatable. homeward settings "
            "paper lists them (measurements=images renders panoramas); layouts has also varied, "
            "robust and grid.KEY.",
        ),
    ] = None,
    scheduler: Scheduler = None,
    workers: Workers = None,
    json: AsJson = False,
) -> None:
    """Run a Monte Carlo study: every estimator in every scenario, many times.

    The folder gets results.nc (netCDF: errors of every run, over time too), study.html, its table
    as CSV, Markdown and LaTeX, every figure as PNG, study.yaml, and the finished blocks; stopped,
    the same command goes on from them. By default all processors of this machine work. Where every
    run failed, the exit status is 1. Needs the extra scale.

    `paper` runs the paper's Cases 1 to 4 with its printed parameters and writes paper.html with
    both RMSE tables next to the printed ones. `layouts` runs Cases 1, 2 and 4 over thousands of
    layouts, under many readings of the paper, and writes layouts.html with the verdict.

    A map (a YAML file with the key map) runs a paper's filter over two of its numbers, in a GPU
    where there is one, and leaves map.png and map.csv; --runs is that of all cells together.
    """
    from homeward.io.settings import nested
    from homeward.io.writing import check_output
    from homeward.lab.report.study.page import DATA, PAGE, headline, write_study
    from homeward.lab.studies.blocks.finish import StudyBlocks, Where
    from homeward.lab.studies.blocks.store import MARKER, store_of
    from homeward.lab.studies.paper.map_settings import load_map
    from homeward.lab.studies.study.plan import make_plan
    from homeward.lab.studies.study.results import run_study
    from homeward.lab.studies.study.settings import load_study
    from homeward.lab.studies.study.summary import failures, lines

    where = Where(scheduler, workers)
    changes = {key: value for key, value in (("runs", runs), ("seed", seed)) if value is not None}
    folder = out or Path("out") / Path(study).stem
    if study in PAPER:
        from homeward.cli.studies import paper

        values = nested(key_values(options or [])) | changes
        (paper.paper if study == "paper" else paper.layouts)(folder, where, values, json)
        return
    if options:
        raise InputError(f"--set is for {' and '.join(PAPER)}; write it into the study's YAML file")
    if settings := load_map(study, changes):
        _map(settings, folder, where, json)
        return
    for package in ("xarray", "h5netcdf"):  # not to be missed at the end
        import_module(package)
    plan = make_plan(load_study(study, changes))
    check_output(folder, MARKER)
    store = store_of(plan.study, folder)
    with resumable(), progress(plan.study.name) as tell:
        results = run_study(plan, StudyBlocks(store, where, tell))
        rows = write_study(folder, results)
    if json:
        told = {"summary": headline(results) + ".", "lines": [asdict(x) for x in lines(results)]}
        files = {"page": str(folder / PAGE), "results": str(folder / DATA)}
        answer({**told, "failures": failures(results), **files})
    else:
        print_rows(rows)
        say(headline(results) + ".")
        for reason, number in failures(results).items():
            warn(f"{number} failed: {reason}")
        say(f"Page: {folder / PAGE}; results: {folder / DATA}")
    if results.failed.sum() == results.number:
        raise no_answer()


def _map(settings: MapSettings, folder: Path, where: Where, as_json: bool) -> None:
    from homeward.io.writing import check_output
    from homeward.lab.report.paper.map import FIGURE, TABLE, headline, write_map
    from homeward.lab.studies.blocks.finish import StudyBlocks, Where
    from homeward.lab.studies.blocks.store import MARKER, store_of
    from homeward.lab.studies.paper.map import run_map, with_engine

    settings = with_engine(settings)
    check_output(folder, MARKER)
    store = store_of(settings, folder)
    if settings.engine == "cuda" and where == Where():
        where = Where(workers=1)  # one process feeds a GPU
    with resumable(), progress(settings.name) as tell:
        results = run_map(settings, StudyBlocks(store, where, tell))
        write_map(folder, results)
    facts = {"summary": headline(results), "figure": folder / FIGURE, "table": folder / TABLE}
    words = f"Map: {folder / FIGURE}; every cell: {folder / TABLE}"
    show(as_json, facts, headline(results), words)
