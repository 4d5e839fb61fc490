"""Maps of consistency and errors over the settings of an estimator's grid."""

from __future__ import annotations

import math
import textwrap
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure

from homeward.io.naming import number
from homeward.lab.studies.study.plan import Contender
from homeward.lab.studies.study.results import Results
from homeward.lab.studies.study.statistics import quantiles
from homeward.runs.report.canvas import styled_figure, uncrowd
from homeward.runs.report.palette import BLUE, INK, VERMILLION

GOOD_TO_BAD = LinearSegmentedColormap.from_list("good", (BLUE, "#ffffff", VERMILLION))
SHOWN: dict[str, dict[str, str]] = {
    "a-ekf": {
        "nees": "consistency: median NEES (3 if consistent)",
        "moved_bearing_error": "convergence: remaining error of a wrong home bearing [rad]",
        "position_rmse": "accuracy: position RMSE [m]",
    },
    "pi-ekf": {
        "position_bias": "bias: mean position error [m]",
        "position_oscillation": "oscillation around it [m]",
        "position_rmse": "accuracy: position RMSE [m]",
    },
}
"""Estimator to quantities and titles; others have RMSE and NEES."""
WORDS = {
    "parameter_sigma": "√P0: parameter_sigma [rad]",
    "parameter_walk": "√Qd: parameter_walk [rad/√s]",
    "parameters": "number of parameters",
    "proportional": "Pi: proportional",
    "integral_gain": "M: integral_gain",
}
"""Settings with their names in the paper."""
DECADES = {"moved_bearing_error": 1.5}
"""Ratio to the EKF at full colour, in powers of ten; 0.5 otherwise."""
OTHERS = {"position_rmse": "position RMSE [m]", "nees": "median NEES (3 if consistent)"}


@dataclass(frozen=True)
class SettingsGrid:
    """Settings of one estimator on a grid of two or three dimensions."""

    name: str
    caption: str
    estimator: str
    axes: tuple[str, ...]
    """Two or three settings: across, up, and from panel to panel."""
    contenders: range
    """Indices of the contenders on the grid."""


def grids(results: Results) -> list[SettingsGrid]:
    """Return the grids of two or three settings; only the first scenario is drawn."""
    found, first = [], 0
    for k, entry in enumerate(results.plan.study.estimators):
        sizes, name = [len(values) for values in entry.grid.values()], entry.estimator
        members = range(first, first + math.prod(sizes))
        first = members.stop
        if 2 <= len(sizes) <= 3 and min(sizes) > 1:
            caption = f"{entry.label or name} over {', '.join(entry.grid)}"
            found.append(SettingsGrid(f"{k}_{name}", caption, name, tuple(entry.grid), members))
    return found


def draw_maps(results: Results, grid: SettingsGrid) -> Figure:
    """Draw a row of maps for each quantity; blue is better than the EKF, red is worse.

    For the NEES, blue is 3. Every cell has the median over the runs.
    """
    shown = SHOWN.get(grid.estimator, OTHERS)
    members = [results.plan.contenders[j] for j in grid.contenders]
    across, up = (_values(members, key) for key in grid.axes[:2])
    pages = _values(members, grid.axes[2]) if len(grid.axes) == 3 else [None]
    size = min(8.0, 100 / (len(across) * len(pages)))
    with styled_figure(0.5 + (0.65 + 0.27 * len(up)) * len(shown)) as figure:
        panels = figure.subplots(len(shown), len(pages), squeeze=False, sharex=True, sharey=True)
        for row, (quantity, words) in zip(panels, shown.items(), strict=True):
            reference = _reference(results, quantity)
            for axes, page in zip(row, pages, strict=True):
                cells = _cells(results, grid, quantity, (across, up), page)
                _draw_map(axes, cells, quantity, reference, size)
                axes.set_title(" ", fontsize=9)  # keeps room for the title
                axes.set_xticks(range(len(across)), [_word(v) for v in across])
                axes.set_yticks(range(len(up)), [_word(v) for v in up])
                axes.grid(False)
                axes.spines[:].set_visible(False)
            suffix = "" if np.isnan(reference) else f"; EKF: {number(reference)}"
            title = row[0].text(0.0, 1.05, words + suffix, transform=row[0].transAxes)
            title.set_in_layout(False)  # otherwise the first column gets its width
        figure.supylabel(WORDS.get(grid.axes[1], grid.axes[1]), fontsize=9)
        figure.supxlabel(WORDS.get(grid.axes[0], grid.axes[0]), fontsize=9)
        if grid.axes[2:]:
            for axes, page in zip(panels[-1], pages, strict=True):
                words = f"{WORDS.get(grid.axes[2], grid.axes[2])}: {_word(page)}"
                axes.set_xlabel(textwrap.fill(words, 72 // len(pages)))
        uncrowd(figure)
    return figure


def _values(members: list[Contender], key: str) -> list[Any]:
    """Return the values of a setting in the order of the study."""
    found: list[Any] = []
    for member in members:
        if member.point[key] not in found:
            found.append(member.point[key])
    return found


def _cells(
    results: Results,
    grid: SettingsGrid,
    quantity: str,
    sides: tuple[list[Any], list[Any]],
    page: Any,
) -> np.ndarray:
    """Return the medians over the runs, (up, across)."""
    across, up = sides
    cells = np.full((len(up), len(across)), np.nan)
    for j in grid.contenders:
        point = results.plan.contenders[j].point
        if page is None or point[grid.axes[2]] == page:
            at = up.index(point[grid.axes[1]]), across.index(point[grid.axes[0]])
            cells[at] = _median(results, quantity, j)
    return cells


def _median(results: Results, quantity: str, j: int) -> float:
    return float(quantiles(results.run[quantity][0, j])[2])


def _reference(results: Results, quantity: str) -> float:
    """Return the median of the EKF, if the study has one."""
    for j, contender in enumerate(results.plan.contenders):
        if contender.estimator == "ekf" and not contender.point:
            return _median(results, quantity, j)
    return float("nan")


def _draw_map(axes: Axes, cells: np.ndarray, quantity: str, reference: float, size: float) -> None:
    """Colour cells by their ratio to the reference, with numbers of a size [pt]."""
    if quantity == "nees":
        worse = np.abs(np.log10(np.maximum(cells, 1e-3) / 3.0)) - np.log10(2.0)
    else:
        middle = reference if np.isfinite(reference) else float(np.nanmedian(cells))
        worse = np.log10(np.maximum(cells, 1e-9) / max(middle, 1e-9))
    worse = np.clip(worse / DECADES.get(quantity, 0.5), -1.0, 1.0)
    shown = np.where(np.isnan(worse), 0.0, worse)
    norm = Normalize(-1.2, 1.2)
    axes.imshow(shown, cmap=GOOD_TO_BAD, norm=norm, aspect="auto", origin="lower")
    for (y, x), value in np.ndenumerate(cells):
        colour = "white" if abs(shown[y, x]) > 0.66 else INK
        axes.text(x, y, _number(value), ha="center", va="center", fontsize=size, color=colour)


def _number(value: float) -> str:
    """Return a number as text that fits into a cell."""
    if np.isnan(value):
        return ""
    if value < 9.5e-4:
        return f"{value:.0e}".replace("e-0", "e-")
    return f"{value:.2g}" if value < 99.5 else f"{value:.0f}" if value < 999.5 else "> 999"


def _word(value: Any) -> str:
    if isinstance(value, (list, tuple)):
        return str(len(value))
    return f"{value:g}" if isinstance(value, (int, float)) else str(value)
