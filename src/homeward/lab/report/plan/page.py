"""What `homeward plan` leaves behind: maps, a table of the floor, and a page to look at."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import yaml
from markupsafe import Markup

from homeward.io.table import write_csv
from homeward.lab.planning.accuracy import Arcs
from homeward.lab.planning.analysis import PlanView
from homeward.lab.report.plan.figures import costliest, draw_accuracy, draw_begin, draw_hidden
from homeward.lab.report.plan.words import plan_summary, worst_pairs
from homeward.runs.report import words
from homeward.runs.report.canvas import drawn
from homeward.runs.report.files import number
from homeward.runs.report.output import whole_folder
from homeward.runs.report.template import render

SETTINGS_FILE = "plan.yaml"
"""Written last: a folder that holds it is whole output of ours; it repeats the plan."""
PAGE = "plan.html"
PAIRS = 8
"""So many pairs stand in the table."""


def write_plan(directory: Path, view: PlanView) -> None:
    """Write plan.html, maps as PNG and SVG, floor.csv, plan.yaml; errors as `whole_folder`."""
    figures = {
        "begin": (draw_begin(view), "From where homing can begin"),
        "accuracy": (draw_accuracy(view), "Least error of position and heading over the floor"),
    }
    if costliest(view):
        figures["hidden"] = (draw_hidden(view), "What hiding one landmark costs")
    with whole_folder(directory, SETTINGS_FILE) as scratch:
        drawings = {
            key: drawn(scratch, key, label, figure, vector=True)[1]
            for key, (figure, label) in figures.items()
        }
        _write_floor(scratch / "floor.csv", view)
        (scratch / PAGE).write_text(_page(view, drawings), encoding="utf-8")
        (scratch / SETTINGS_FILE).write_text(_settings(view), encoding="utf-8")


def _page(view: PlanView, drawings: dict[str, Markup]) -> str:
    common, begins = view.common, view.begins
    q = len(view.names)
    order = sorted(range(q), key=lambda i: float((view.hidden[:, i] <= 1).mean()))
    return render(
        "plan.html.j2",
        words=words,
        view=view,
        plan=view.plan,
        title=words.name(view.plan.name, 60),
        summary=plan_summary(view),
        figures=drawings,
        headline=[
            ("homing can begin", words.percent(float(begins.mean()))),
            ("with any one hidden", words.percent(float(view.safe.mean()))),
            ("with any two hidden", words.percent(float(view.pair_safe.mean()))),
            ("a moved one is noticed", words.percent(float((begins & (common >= 4)).mean()))),
            ("and named", words.percent(float((begins & (common >= 5)).mean()))),
        ],
        landmarks=[
            (
                view.names[i],
                bool(view.stored[i]),
                # Both of the same places, lest chance puts them in the wrong order.
                float((view.hidden[view.sample, i] <= 1).mean()),
                float((view.moved[:, i] <= 1).mean()),
            )
            for i in order
        ],
        pairs=[(view.names[j], view.names[i], share) for i, j, share in worst_pairs(view, PAIRS)],
        headings=len(Arcs(view.plan).headings),
        settings=_settings(view),
    )


def _settings(view: PlanView) -> str:
    tree = view.plan.model_dump(mode="json", exclude_none=True)
    return yaml.safe_dump(tree, sort_keys=False, allow_unicode=True, default_flow_style=None)


def _write_floor(file: Path, view: PlanView) -> None:
    """Write the map as CSV: empty where the pose is not told."""
    columns = np.column_stack([view.floor.points, view.position, view.heading])
    told = (np.where(yes, "yes", "no") for yes in (view.begins, view.safe))
    rows = zip(columns, view.common, *told, strict=True)
    write_csv(
        file,
        ("x", "y", "position_sigma", "heading_sigma", "landmarks", "begins", "safe"),
        ([*(number(float(f"{v:.4g}")) for v in row), *words] for row, *words in rows),
    )
