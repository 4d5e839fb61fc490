"""Figures of the paper's cases over many layouts."""

from __future__ import annotations

import textwrap
from collections.abc import Callable

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator, LogLocator, NullFormatter

from homeward.report.canvas import legend_below, new_figure, style, uncrowd
from homeward.report.palette import BLUE, GREEN, INK, MUTED, SKY, VERMILLION
from homeward.report.paper_figures import COLOURS, QUANTITIES
from homeward.studies.paper.cases import FILTERS
from homeward.studies.paper.layout_study import CLAIMED, LayoutStudy, order_share
from homeward.studies.paper.layouts import BASE, BOUND, ROBUST, STUDIED, VARIANTS
from homeward.studies.paper.search import FAMILIES
from homeward.studies.paper.tables import PRINTED, TO_PAPER_UNITS
from homeward.studies.paper.world import CaseName

BY_CHANCE = 1 / 6
"""Share of any order of three by chance."""
ROWS = (*FILTERS, ROBUST, BOUND)
TITLES = {"2": "Case 2: closed loop, landmarks moved", "4": "Case 4: open loop, a circle, no fault"}
_QUANTITY_COLOURS = (BLUE, VERMILLION, GREEN)


def errors_of(study: LayoutStudy, case: CaseName, name: str) -> np.ndarray:
    """Return the RMSE of a filter, the robust localiser or the bound in the paper's units."""
    outcome = study.robust[case] if name in (ROBUST, BOUND) else study.main[case]
    return np.asarray(outcome.of(name) * TO_PAPER_UNITS)


def draw_distributions(study: LayoutStudy) -> Figure:
    """Draw the distribution of every RMSE, with the printed figures."""
    with style():
        figure = new_figure(5.0)
        panels = figure.subplots(len(STUDIED), 3, sharey=True, sharex="col")
        for row, case in zip(panels, STUDIED, strict=True):
            for k, axes in enumerate(row):
                for place, name in enumerate(ROWS):
                    rmse = errors_of(study, case, name)[:, k]
                    colour = COLOURS.get(name, SKY if name == ROBUST else GREEN)
                    _bar(axes, place, rmse[~np.isnan(rmse)], colour)
                    printed = PRINTED[case].get(name.split(" ")[0])
                    if printed is not None:
                        axes.plot(printed[k], place, "x", ms=7, mew=1.6, color=GREEN, zorder=5)
                _log_axis(axes)
                axes.grid(False, axis="y")
            row[0].set_yticks(range(len(ROWS)), ROWS)
            row[0].set_ylim(len(ROWS) - 0.4, -0.6)
            row[0].set_title(TITLES[case], loc="left", fontsize=9)
        for axes, quantity in zip(panels[-1], QUANTITIES, strict=True):
            axes.set_xlabel(f"RMSE of {quantity}")
        entries = [
            Line2D([], [], color=MUTED, marker="o", ms=5, lw=0, label="median"),
            Line2D([], [], color=MUTED, lw=4, label="half of the layouts"),
            Line2D([], [], color=MUTED, lw=1.2, label="90 %"),
            Line2D([], [], color=GREEN, marker="x", ms=7, mew=1.6, ls="none", label="as printed"),
        ]
        legend_below(figure, entries)
        uncrowd(figure)
    return figure


def _bar(axes: Axes, place: float, values: np.ndarray, colour: str) -> None:
    quantiles = np.quantile(values, [0.05, 0.25, 0.5, 0.75, 0.95], method="inverted_cdf")
    shown = np.where(np.isfinite(quantiles), quantiles, 1e6)
    axes.plot(shown[[0, 4]], (place, place), color=colour, lw=1.2, alpha=0.6)
    axes.plot(shown[[1, 3]], (place, place), color=colour, lw=4, solid_capstyle="butt", alpha=0.6)
    axes.plot(shown[2], place, "o", ms=5, color=colour, mec="white", mew=0.8)


def _log_axis(axes: Axes) -> None:
    axes.set_xscale("log")
    axes.xaxis.set_major_locator(LogLocator(numticks=8))
    axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.xaxis.set_minor_formatter(NullFormatter())


def draw_order(study: LayoutStudy) -> Figure:
    """Draw in what share of the layouts PI-EKF < A-EKF < EKF, for each variant."""
    with style():
        figure = new_figure(1.1 + 0.25 * len(VARIANTS))
        panels = figure.subplots(1, len(STUDIED), sharey=True, sharex=True)
        for axes, case in zip(panels, STUDIED, strict=True):
            axes.axvline(100 * BY_CHANCE, color=INK, lw=0.9, ls="--")
            for place, name in enumerate(VARIANTS):
                if name == BASE:
                    axes.axhspan(place - 0.5, place + 0.5, color=MUTED, alpha=0.12, lw=0)
                for k, colour in enumerate(_QUANTITY_COLOURS):
                    share = 100 * order_share(study.varied[name, case], CLAIMED, k)
                    at = place + 0.2 * (k - 1)
                    axes.plot(share, at, "o", ms=5, mew=0, color=colour)
            axes.set_title(textwrap.fill(TITLES[case], 30), loc="left", fontsize=9)
            axes.set(xlabel="layouts with\nPI-EKF < A-EKF < EKF [%]")
            axes.set_xlim(-1, 1.05 * axes.get_xlim()[1])
            axes.grid(False, axis="y")
        panels[0].set_yticks(range(len(VARIANTS)), tuple(VARIANTS))
        panels[0].set_ylim(len(VARIANTS) - 0.4, -0.6)
        entries = [
            Line2D([], [], color=colour, marker="o", ms=5, ls="none", label=quantity.split(" ")[0])
            for colour, quantity in zip(_QUANTITY_COLOURS, QUANTITIES, strict=True)
        ]
        entries.append(Line2D([], [], color=INK, lw=0.9, ls="--", label="by chance"))
        legend_below(figure, entries)
        uncrowd(figure)
    return figure


def draw_search(study: LayoutStudy) -> Figure:
    """Draw what the product of Pi and M costs, and what the best gains are worth."""
    with style():
        figure = new_figure(3.2)
        left, right = figure.subplots(1, 2, width_ratios=[3, 2], sharey=True)
        for case, colour in zip(STUDIED, (VERMILLION, BLUE), strict=True):
            printed = sorted(
                (float(t.Pi), t.chosen_by)
                for t in study.search.tried
                if t.family == FAMILIES[0] and t.case == case and isinstance(t.Pi, float)
            )
            left.plot(*zip(*printed, strict=True), color=colour, label=f"Case {case}", marker=".")
            best = [b for b in study.search.best if b.tried.case == case]
            places = [FAMILIES.index(b.tried.family) for b in best]
            right.plot(places, [b.cost for b in best], "o", ms=7, mew=0, color=colour)
        left.axvline(0.05, color=GREEN, lw=1.0, ls=":", label="as printed: 0.05")
        for axes in (left, right):
            axes.axhline(1.0, color=INK, lw=0.9, label="EKF")
        left.set(xscale="log", yscale="log", xlabel="Pi times M, as printed")
        left.set_ylabel("errors over the EKF's")
        left.yaxis.set_major_locator(FixedLocator((0.3, 0.5, 0.7, 0.8, 1, 1.25, 1.5, 2, 3, 5)))
        left.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
        left.yaxis.set_minor_formatter(NullFormatter())
        words = ("best product\nas printed", "best free Pi,\nM ones", "best free Pi,\nM own")
        right.set_xticks(range(len(FAMILIES)), words)
        right.set_xlim(-0.5, len(FAMILIES) - 0.5)
        right.grid(False, axis="x")
        figure.legend(*left.get_legend_handles_labels(), loc="outside lower center", ncols=4)
    return figure


FIGURES: dict[str, tuple[str, Callable[[LayoutStudy], Figure]]] = {
    "distributions": ("Every RMSE over the layouts, and the printed figures", draw_distributions),
    "order": ("In what share of the layouts the claimed order holds", draw_order),
    "search": ("The best Pi and M, judged on layouts that had no part in the choice", draw_search),
}
"""File name to caption and figure, in the order of the page."""
