"""Output of several estimators on one drive: a page, tables, and a folder of each run."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from markupsafe import Markup
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from homeward.io.naming import number, share
from homeward.io.writing import whole_folder
from homeward.runs.report import html
from homeward.runs.report.canvas import drawn, legend_below, plain, styled_figure, uncrowd
from homeward.runs.report.files import write_tables
from homeward.runs.report.folder import write_run
from homeward.runs.report.palette import CONTENDER_COLOURS, INK, MUTED
from homeward.runs.report.words import count, name
from homeward.runs.scoring import errors
from homeward.runs.single_run import Outcome

PAGE = "estimators.html"
"""Written last: a folder with this file is complete output of homeward."""
MIN_DRAWN_M = 1e-3
"""Smaller errors are drawn as this; a start prior from ground truth has none [m]."""
HEAD = ["estimator", "unavailable", "outside 3 sigma", "RMSE [m]", "median [m]", "max [m]"]
HEAD += ["heading RMSE [deg]", "NEES", "update [ms]", "moved landmarks"]


def write_several(directory: Path, outcomes: Sequence[Outcome]) -> None:
    """Write a page, tables, figures, and the folder of each run; errors as `whole_folder`."""
    ended = [o for o in outcomes if o.track is not None and o.track.t.size]
    with whole_folder(directory, PAGE) as scratch:
        drawings = []
        if ended:
            drawings = [
                drawn(scratch, "paths", "Estimated paths", draw_paths(ended)),
                drawn(scratch, "errors", "Position error over time", draw_errors(ended)),
            ]
        for outcome in ended:
            assert outcome.track is not None
            settings = outcome.run.model_dump(mode="json")
            write_run(scratch / folder_name(outcome), outcome.drive, outcome.track, settings)
        write_tables(scratch, table(outcomes), exact_table(outcomes))
        (scratch / PAGE).write_text(_page(outcomes, drawings), encoding="utf-8")


def _page(outcomes: Sequence[Outcome], drawings: Sequence[tuple[str, str]]) -> str:
    drive = outcomes[0].drive
    title = f"{count(len(outcomes), 'estimator')} on {name(drive.name, 60)}"
    rows: list[list[object]] = [list(row) for row in table(outcomes)]
    notes = []
    for row, outcome in zip(rows[1:], outcomes, strict=True):
        if outcome.failure:
            notes.append(f"Failed: {outcome.failure}")
        if outcome.track is not None:
            link = Markup('<a href="{}/report.html">{}</a>')
            row[0] = link.format(folder_name(outcome), row[0])
            notes += [f"{outcome.run.estimator}: {text}" for text in outcome.track.notes]
    texts = html.texts("homeward.runs.report")["several"]
    truth = "" if drive.truth is None else texts["truth"]
    meaning = html.note(texts["unavailable"], truth, texts["one_drive"])
    columns = "s" + "r" * (len(HEAD) - 1)
    return html.page(
        title,
        html.header(title, html.table(columns, rows), meaning),
        *map(html.note, notes),
        html.figures(drawings),
    )


def folder_name(outcome: Outcome) -> str:
    """Return the folder of a run, named after its estimator."""
    return "".join(c if c.isalnum() or c in "-_." else "_" for c in outcome.run.estimator)


def table(outcomes: Sequence[Outcome]) -> list[list[str]]:
    """Return the table of the terminal and of the page, head first."""
    rows = ((o, _numbers(o)) for o in outcomes)
    return [
        HEAD,
        *(
            [o.run.estimator, *map(share, values[:2]), *map(number, values[2:]), _moved(o)]
            for o, values in rows
        ),
    ]


def exact_table(outcomes: Sequence[Outcome]) -> list[list[object]]:
    """Return the table with unrounded numbers and the reasons of failures."""
    rows = ([o.run.estimator, *_numbers(o), _moved(o), o.failure] for o in outcomes)
    return [[*HEAD, "failure"], *rows]


def _numbers(outcome: Outcome) -> list[float]:
    """Return the numbers of one row, NaN where unknown."""
    metrics = outcome.metrics
    if metrics is None:
        return [1.0] + [math.nan] * 7
    errors_of = [math.nan] * 6
    if (a := metrics.accuracy) is not None:
        p, heading = a.position, math.degrees(a.heading.rmse)
        outside = 1.0 - a.position_inside_sigma_shares[2]
        errors_of = [outside, p.rmse, p.median, p.max, heading, a.nees_mean]
    update = metrics.update_median_s
    return [
        1.0 - (metrics.pose_share or 0.0),
        *errors_of,
        math.nan if update is None else 1e3 * update,
    ]


def _moved(outcome: Outcome) -> str:
    """Return the moved landmarks; nothing where the estimator does not detect them."""
    known = [] if outcome.track is None else outcome.track.landmarks
    if all(m.moved is None for m in known):
        return ""
    return " ".join(name(m.landmark) for m in known if m.moved) or "none"


def draw_paths(outcomes: Sequence[Outcome]) -> Figure:
    """Draw the estimated paths and ground truth; diverged paths are cut off."""
    truth = outcomes[0].drive.truth
    tracks = [o.track for o in outcomes if o.track is not None]
    with styled_figure(5.4, "paths") as figure:
        axes = figure.add_subplot()
        if truth is not None:
            axes.plot(truth.x, truth.y, color=MUTED, lw=2.4)
            axes.set(xlim=_span(truth.x), ylim=_span(truth.y))
        for j, track in enumerate(tracks):
            axes.plot(track.x, track.y, color=_colour(j), lw=0.9)
        axes.plot(0.0, 0.0, marker="*", ms=11, color=INK, ls="none")
        axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
        _legend(figure, outcomes, "ground truth" if truth is not None else "")
        uncrowd(figure)
    return figure


def draw_errors(outcomes: Sequence[Outcome]) -> Figure:
    """Draw the position error over time; without ground truth, its standard deviation."""
    with styled_figure(3.2, "errors") as figure:
        axes = figure.add_subplot()
        for j, outcome in enumerate(outcomes):
            track, truth = outcome.track, outcome.drive.truth
            assert track is not None
            if truth is not None:
                error = errors(track, truth)
                times, size = error.t, error.position
            else:
                times, size = track.t, np.hypot(track.sigmas[:, 0], track.sigmas[:, 1])
            axes.plot(times - track.t[0], np.maximum(size, MIN_DRAWN_M), color=_colour(j), lw=0.9)
        has_truth = outcomes[0].drive.truth is not None
        label = "position error [m]" if has_truth else "position sigma [m]"
        axes.set(yscale="log", xlabel="time [s]", ylabel=label)
        _legend(figure, outcomes, "")
        uncrowd(figure)
    return figure


def _legend(figure: Figure, outcomes: Sequence[Outcome], truth: str) -> None:
    entries = [Line2D([], [], color=MUTED, lw=2.4, label=truth)] if truth else []
    entries += [
        Line2D([], [], color=_colour(j), label=plain(o.run.estimator))
        for j, o in enumerate(outcomes)
    ]
    legend_below(figure, entries)


def _colour(j: int) -> str:
    return CONTENDER_COLOURS[j % len(CONTENDER_COLOURS)]


def _span(values: np.ndarray) -> tuple[float, float]:
    """Return the limits of an axis: ground truth and home, with a margin of a quarter."""
    low, high = min(float(values.min()), 0.0), max(float(values.max()), 0.0)
    margin = 0.25 * max(high - low, 1.0)
    return low - margin, high + margin
