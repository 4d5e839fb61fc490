"""`homeward reproduce`: the paper's cases, beside its tables."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from homeward.cli.options import key_values, progress


def reproduce(
    out: Annotated[Path, typer.Option(help="The folder to write.")] = Path("out/paper"),
    runs: Annotated[int | None, typer.Option(help="Random layouts per case [100].")] = None,
    seed: Annotated[int | None, typer.Option(help="Of the first of them [0].")] = None,
    changes: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            help="KEY=VALUE, as in assumed.bearing_sigma=0.05, assumed.fault=[0.1,0.2], "
            "assumed.initial_error=[0,0,0], assumed.meaning_of_Q=state, "
            "assumed.meaning_of_R=deviation or assumed.stop_radius=0.02; repeatable.",
        ),
    ] = None,
) -> None:
    """Run the paper's Cases 1 to 4 with its filters and printed parameters.

    The folder gets paper.html, with both RMSE tables beside the printed ones, what the paper
    leaves open and what was assumed; every figure as PNG; rmse.csv; and reproduce.yaml.
    """
    from homeward.drives.settings import nested, validated
    from homeward.report.output import check_output
    from homeward.report.paper_page import PAGE, SETTINGS_FILE, write_reproduction
    from homeward.studies.paper.cases import reproduce as run_cases
    from homeward.studies.paper.settings import PaperSettings
    from homeward.studies.paper.tables import rows

    values = nested(key_values(changes or []))
    values |= {k: v for k, v in (("runs", runs), ("seed", seed)) if v is not None}
    settings = validated(PaperSettings, values)
    check_output(out, SETTINGS_FILE)
    with progress("the paper's cases") as tell:
        result = run_cases(settings, tell)
        write_reproduction(out, result)

    typer.echo(f"{'case':14} {'filter':11}       R  theta  alpha   printed: R  theta  alpha")
    for row in rows(result):
        ours = "{:8.4f} {:.4f} {:.4f}".format(*row.median)
        printed = "     {:8.4f} {:.4f} {:.4f}".format(*row.printed) if row.printed else ""
        typer.echo(f"{row.case:14} {row.filter:11}{ours}{printed}")
    typer.echo(
        f"RMSE of R in cm, theta and alpha in rad; medians over {settings.runs} random layouts. "
        f"Page: {out / PAGE}"
    )
