"""Figures of the paper's cases over many layouts."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator, NullFormatter

from homeward.lab.report.paper.figures import COLOURS, QUANTITIES
from homeward.lab.studies.paper.cases import DEAD_RECKONING, FILTERS, PI_HT
from homeward.lab.studies.paper.layouts import BOUND, ROBUST, STUDIED, Reading, Start
from homeward.lab.studies.paper.reproduction import LayoutStudy
from homeward.lab.studies.paper.tables import TO_PAPER_UNITS, better_shares, printed_of
from homeward.lab.studies.paper.world import CaseName
from homeward.lab.studies.study.statistics import quantiles
from homeward.runs.report.canvas import legend_below, new_figure, quantile_bar, style, uncrowd
from homeward.runs.report.palette import GREEN, INK, MUTED, SKY

ROWS = (*FILTERS, ROBUST, BOUND)
TITLES = {
    "1": "Case 1: closed loop, no fault",
    "2": "Case 2: closed loop, landmarks moved",
    "4": "Case 4: open loop, a circle, no fault",
}
ACROSS = ("initial_error", "meaning_of_Q", "disturbance")
"""Of a reading, what the rows of the grid's figure tell."""
RIVALS = ("A-EKF (one)", "PI-EKF", PI_HT, DEAD_RECKONING)
"""Whose shares the grid's figure shows."""


def errors_of(study: LayoutStudy, case: CaseName, name: str, start: Start) -> np.ndarray:
    """Return the RMSE of a filter, the robust localiser or the bound in the paper's units."""
    source = study.bounds if name in (ROBUST, BOUND) else study.grid
    outcome = source[case, study.reading(case, initial_error=start)]
    return np.asarray(outcome.of(name) * TO_PAPER_UNITS)


def draw_distributions(study: LayoutStudy) -> Figure:
    """Draw the distribution of every RMSE from each start, with the printed figures."""
    with style():
        figure = new_figure(9.0)
        panels = figure.subplots(len(STUDIED), 3, sharey=True, sharex="col")
        for row, case in zip(panels, STUDIED, strict=True):
            for k, axes in enumerate(row):
                for place, name in enumerate(ROWS):
                    for j, start in enumerate(study.starts):
                        rmse = errors_of(study, case, name, start)[:, k]
                        colour = COLOURS.get(name, SKY if name == ROBUST else GREEN)
                        values = quantiles(rmse)
                        shown = np.where(np.isfinite(values), values, 1e6)
                        quantile_bar(axes, place + 0.3 * j, shown, colour, hollow=j > 0)
                    printed = printed_of(case, name)
                    if printed is not None:
                        axes.plot(printed[k], place, "x", ms=7, mew=1.6, color=GREEN, zorder=5)
                _log_axis(axes)
                axes.grid(False, axis="y")
            row[0].set_yticks(range(len(ROWS)), ROWS)
            row[0].set_ylim(len(ROWS) - 0.2, -0.6)
            row[0].set_title(TITLES[case], loc="left", fontsize=9)
        for axes, quantity in zip(panels[-1], QUANTITIES, strict=True):
            axes.set_xlabel(f"RMSE of {quantity}")
        entries = [
            Line2D([], [], color=MUTED, marker="o", ms=5, lw=4, label="median, half: exact start"),
            Line2D([], [], color=MUTED, marker="o", ms=5, mfc="white", lw=1.2, label="start off"),
            Line2D([], [], color=GREEN, marker="x", ms=7, mew=1.6, ls="none", label="as printed"),
        ]
        legend_below(figure, entries)
        uncrowd(figure)
    return figure


def _log_axis(axes: Axes) -> None:
    axes.set_xscale("log")
    axes.xaxis.set_major_locator(LogLocator(numticks=8))
    axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.xaxis.set_minor_formatter(NullFormatter())


def draw_grid(study: LayoutStudy) -> Figure:
    """Draw the share of layouts in which each errs less than the EKF, under every reading.

    Of R, theta and alpha the quantity with the smallest share.
    """
    with style():
        rows = list(product(*(study.settings.axis(k) for k in ACROSS)))
        figure = new_figure(1.4 + 0.2 * len(rows) * len(RIVALS))
        panels = figure.subplots(len(RIVALS), 1, sharex=True)
        for axes, name in zip(panels, RIVALS, strict=True):
            columns = _columns(study)
            shares = np.array(
                [
                    [
                        better_shares(
                            study.grid[c, r._replace(**dict(zip(ACROSS, row, strict=True)))],
                            name,
                            "EKF",
                        ).min()
                        for c, r in columns
                    ]
                    for row in rows
                ]
            )
            axes.imshow(100 * shares, cmap="RdBu", vmin=0, vmax=100, aspect="auto")
            for (i, j), share in np.ndenumerate(shares):
                ink = "white" if abs(share - 0.5) > 0.35 else INK
                words = f"{100 * share:.0f}"
                axes.text(j, i, words, ha="center", va="center", fontsize=7, color=ink)
            axes.set_yticks(range(len(rows)), [_row_words(row) for row in rows], fontsize=7)
            axes.set_title(f"{name} < EKF [% of layouts]", loc="left", fontsize=9)
            axes.grid(False)
        below = [_column_words(c, r) for c, r in columns]
        panels[-1].set_xticks(range(len(below)), below, fontsize=7)
    return figure


def _columns(study: LayoutStudy) -> list[tuple[CaseName, Reading]]:
    """Return what differs along the columns: the case, its stop radius and its faults."""
    first = {case: study.reading(case) for case in STUDIED}
    return [
        (case, r)
        for case in STUDIED
        for r in study.settings.readings(case)
        if all(getattr(r, k) == getattr(first[case], k) for k in ACROSS)
    ]


def _row_words(row: tuple[Any, ...]) -> str:
    start, Q, noise = row
    words = ["exact" if not any(start) else f"{100 * start[0]:g} cm off"]
    return ", ".join([*words, "2 x 2" if Q == "input" else "n x n", *["twist noise"] * any(noise)])


def _column_words(case: CaseName, reading: Reading) -> str:
    lines = [f"Case {case}"]
    lines += [] if case == "4" else [f"{100 * reading.stop_radius:g} cm"]
    lines += [f"{reading.faults} wrong"] if case == "2" else []
    return "\n".join(lines)


FIGURES: dict[str, tuple[str, Callable[[LayoutStudy], Figure]]] = {
    "distributions": ("Every RMSE over the layouts, and the printed figures", draw_distributions),
    "grid": ("Who errs less than the EKF, under every reading", draw_grid),
}
"""File name to caption and figure, in the order of the page."""
