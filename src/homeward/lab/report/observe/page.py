"""Page and drawing of `homeward plan --landmarks` and `--drive`: observability."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from homeward.lab.observability.paper import printed_matrix, rank_table
from homeward.lab.observability.study import ModelView, observe_motions
from homeward.lab.report.observe.figures import draw_drive_view, draw_family
from homeward.lab.studies.observing import DriveView
from homeward.runs.report import words
from homeward.runs.report.canvas import drawn
from homeward.runs.report.output import whole_folder
from homeward.runs.report.template import render
from homeward.runs.report.versions import write_settings

SETTINGS_FILE = "observe.yaml"
"""Written last: a folder that holds it is whole output of ours."""
PAGE = "observe.html"
FIGURE = "observe"


def write_model_view(directory: Path, view: ModelView, settings: dict[str, Any]) -> None:
    """Write observe.html, observe.png, observe.svg and observe.yaml; errors as `whole_folder`."""
    values = {
        "title": f"What bearings tell: {view.drive.title}",
        "summary": model_summary(view),
        "view": view,
        "drive": None,
        "members": sum(len(t.unknowns) - 1 for t in view.family),
        "difference": same_to(view),
    }
    label = "Worlds in which all bearings are the same"
    _write(directory, draw_family(view), label, values, settings)


def write_drive_view(directory: Path, view: DriveView, settings: dict[str, Any]) -> None:
    """Write the same of a drive."""
    values = {
        "title": f"What the bearings of {words.name(view.name, 60)} tell",
        "summary": drive_summary(view),
        "view": None,
        "drive": view,
        "window": settings["window"],
    }
    label = "The path, coloured by how well its bearings tell home"
    _write(directory, draw_drive_view(view), label, values, settings)


def model_summary(view: ModelView) -> str:
    """Say in a few sentences what cannot be told."""
    if view.model is not None:
        m = view.model
        known = [
            w for w, yes in (("a compass", m.compass), ("known distances", m.distances)) if yes
        ]
        extra = f" and {' and '.join(known)}" if known else ""
        head = f"With {words.count(m.landmarks, 'landmark')}{extra}, bearings tell {m.rank} of the"
        head += f" {m.n} dimensions of the state."
    else:
        d = view.drive
        head = (
            f"{d.title[0].upper()}{d.title[1:]}: {d.found.value} of {d.unknowns} unknowns are told."
        )
    if not view.freedoms:
        return f"{head} Nothing is left open."
    return " ".join([head, *(f"{f.words[0].upper()}{f.words[1:]}." for f in view.freedoms)])


def drive_summary(view: DriveView) -> str:
    """Say in a few sentences how well a drive tells home, and where not."""
    blind = [w for w in view.windows if not np.isfinite(w.position_sigma)]
    told = [w for w in view.windows if np.isfinite(w.position_sigma)]
    whole = view.whole
    text = f"All its bearings together do not tell the pose: {'; '.join(whole.weakest)}."
    if np.isfinite(whole.position_sigma):
        text = (
            "All its bearings together place the robot relative to home to"
            f" {words.quantity(whole.position_sigma, 'm')} and {words.degrees(whole.heading_sigma)}"
            " at best."
        )
    parts = [text]
    if told:
        middle = float(np.median([w.position_sigma for w in told]))
        worst = max(told, key=lambda w: w.position_sigma)
        parts.append(
            f"Stretch by stretch it is {words.quantity(middle, 'm')} in the median; weakest are"
            f" {worst.begin:.0f} to {worst.end:.0f} s, where {'; '.join(worst.weakest)}"
            f" by ±{words.quantity(worst.position_sigma, 'm')}."
        )
    if blind:
        parts.append(
            f"In {len(blind)} of {len(view.windows)} stretches the bearings do not tell the pose:"
            f" first from {blind[0].begin:.0f} to {blind[0].end:.0f} s, where"
            f" {'; '.join(blind[0].weakest)}."
        )
    return " ".join(parts)


def same_to(view: ModelView) -> float:
    """Return the largest difference of any measurement between members of the family."""
    return max((t.difference for t in view.family), default=0.0)


def _write(
    directory: Path, figure: Figure, label: str, values: dict[str, Any], settings: dict[str, Any]
) -> None:
    with whole_folder(directory, SETTINGS_FILE) as scratch:
        page = render(
            "observe.html.j2",
            **values,
            words=words,
            figure=drawn(scratch, FIGURE, label, figure, vector=True)[1],
            table=rank_table(),
            motions=observe_motions(),
            entries=printed_matrix(),
        )
        (scratch / PAGE).write_text(page, encoding="utf-8")
        write_settings(scratch / SETTINGS_FILE, settings)
