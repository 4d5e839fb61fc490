"""What `homeward reproduce` leaves behind: figures, and a page beside the paper's tables."""

from __future__ import annotations

from pathlib import Path

import yaml
from markupsafe import Markup

from homeward.report.canvas import drawn
from homeward.report.output import whole_folder
from homeward.report.paper_figures import QUANTITIES, figures_of
from homeward.report.template import render
from homeward.report.versions import versions
from homeward.studies.paper.cases import Reproduction
from homeward.studies.paper.tables import (
    PRINTED,
    TO_PAPER_UNITS,
    ordering_share,
    printed_order,
    rows,
)

SETTINGS_FILE = "reproduce.yaml"
"""Written last: a folder that holds it is a whole reproduction of ours."""
PAGE = "paper.html"


def write_reproduction(directory: Path, result: Reproduction) -> None:
    """Write the page, every figure as PNG, rmse.csv with every run, and reproduce.yaml.

    Raises
    ------
    InputError
        When the folder holds something else, or cannot be written.
    """
    settings = result.settings.model_dump(mode="json")
    with whole_folder(directory, SETTINGS_FILE) as scratch:
        figures = [
            drawn(scratch, name, caption, draw(result))
            for name, (caption, draw) in figures_of(result).items()
        ]
        (scratch / "rmse.csv").write_text(_every_run(result), encoding="utf-8")
        (scratch / PAGE).write_text(_page(result, figures), encoding="utf-8")
        text = yaml.safe_dump({**settings, "versions": versions()}, sort_keys=False)
        (scratch / SETTINGS_FILE).write_text(text, encoding="utf-8")


def _page(result: Reproduction, figures: list[tuple[str, Markup]]) -> str:
    table = rows(result)
    return render(
        "paper.html.j2",
        figures=figures,
        printed_rows=[row for row in table if row.case in ("2", "4")],
        other_rows=[row for row in table if row.case not in ("2", "4")],
        shares=[
            (case, quantity.split(" ")[0], printed_order(case, k), ordering_share(result, case, k))
            for case in PRINTED
            for k, quantity in enumerate(QUANTITIES)
        ],
        quantities=QUANTITIES,
        printed=result.settings.printed,
        assumed=result.settings.assumed,
        images=None if result.settings.measurements == "model" else result.settings.images,
        runs=result.settings.runs,
        seed=result.settings.seed,
        settings=yaml.safe_dump(result.settings.model_dump(mode="json"), sort_keys=False),
        versions=versions(),
    )


def _every_run(result: Reproduction) -> str:
    """Return case, filter, run and RMSE in the paper's units as CSV."""
    lines = ["case,filter,run,R_cm,theta_rad,alpha_rad,final_distance_m"]
    for case, by_filter in result.rmse.items():
        for name, rmse in by_filter.items():
            distances = result.final_distance[case][name]
            for k, (errors, distance) in enumerate(
                zip(rmse * TO_PAPER_UNITS, distances, strict=True)
            ):
                numbers = ",".join(f"{v:.6g}" for v in (*errors, distance))
                lines.append(f"{case},{name},{k},{numbers}")
    return "\n".join(lines) + "\n"
