"""Maps of a plan: where homing can begin, accuracy, and the cost of hidden landmarks."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap, LogNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.path import Path as MarkerPath
from mpl_toolkits.axes_grid1.anchored_artists import AnchoredSizeBar

from homeward.lab.planning.analysis import PlanView
from homeward.runs.report.canvas import (
    WIDTH_IN,
    legend_below,
    name_mark,
    new_figure,
    style,
    uncrowd,
)
from homeward.runs.report.palette import BLUE, GREEN, HOUSE, INK, MUTED, SKY, VERMILLION
from homeward.runs.report.words import name

NOWHERE = "#d5d9dd"
WEAK = "#f3d9a4"
CLASSES = (
    (NOWHERE, "too few landmarks"),
    (WEAK, "error above the limits"),
    (SKY, "homing can begin"),
    (BLUE, "also with any one landmark hidden"),
)
"""Colours of the map, from worst to best."""
MAX_NAMES = 40
MULTIPLES = 6
"""Number of landmarks with a small map of the cost of hiding them."""


def draw_begin(view: PlanView) -> Figure:
    """Draw where homing can begin, and the best places for further landmarks."""
    classes = np.isfinite(view.score).astype(int) + view.begins + view.safe
    with style():
        figure = new_figure(_height(view) + 0.9)
        axes = figure.add_subplot(aspect="equal")
        colours = ListedColormap([colour for colour, _ in CLASSES])
        _image(axes, view, classes, cmap=colours, vmin=-0.5, vmax=3.5)
        _draw_place(axes, view)
        _draw_advice(axes, view)
        _draw_scale(axes, view)
        entries: list[Any] = [Patch(color=colour, label=label) for colour, label in CLASSES]
        legend_below(figure, [*entries, *_marks(view)], 3)
        uncrowd(figure)
    return figure


def draw_accuracy(view: PlanView) -> Figure:
    """Draw the minimum errors of position and heading, with the limits as lines."""
    limits = view.plan.limits
    panels = (
        (view.position, limits.position, "minimum position error [m]"),
        (np.degrees(view.heading), np.degrees(limits.heading), "minimum heading error [°]"),
    )
    with style():
        figure = new_figure(0.5 * _height(view) + 0.8)
        for axes, (values, limit, label) in zip(figure.subplots(1, 2), panels, strict=True):
            axes.set_aspect("equal")
            shown = np.where(np.isfinite(values), values, np.nan)
            norm = LogNorm(limit / 10, limit * 10, clip=True)
            image = _image(axes, view, shown, cmap="viridis_r", norm=norm)
            grid = view.floor.image(np.where(np.isfinite(values), values, 1e9))
            if min(grid.shape) > 1 and np.nanmin(grid) < limit < np.nanmax(grid):
                axes.contour(view.floor.x, view.floor.y, grid, [limit], colors=INK, linewidths=0.9)
            _draw_place(axes, view, names=False)
            _draw_scale(axes, view)
            figure.colorbar(image, ax=axes, label=label, location="bottom", shrink=0.9, pad=0.02)
        uncrowd(figure)
    return figure


def draw_hidden(view: PlanView) -> Figure:
    """Draw the cost of hiding a landmark, for the most important ones."""
    worst = costliest(view)[:MULTIPLES]
    with style():
        rows = -(-max(len(worst), 1) // 3)
        figure = new_figure(rows * (_height(view) / 3 + 0.35))
        panels = np.atleast_1d(figure.subplots(rows, 3, squeeze=False).ravel())
        for axes in panels[len(worst) :]:
            axes.set_axis_off()
        for axes, i in zip(panels, worst, strict=False):
            axes.set_aspect("equal")
            lost = view.begins & ~(view.hidden[:, i] <= 1)
            colours = ListedColormap([NOWHERE, SKY, VERMILLION])
            _image(axes, view, view.begins + 1 * lost, cmap=colours, vmin=-0.5, vmax=2.5)
            _draw_place(axes, view, names=False)
            axes.set(xticks=[], yticks=[], xlabel="", ylabel="")
            axes.plot(*view.marks[i], "*", ms=11, color=VERMILLION, mec="white", zorder=9)
            share = float(lost.mean())
            axes.set_title(
                f"without {name(view.names[i])}: {100 * share:.1f} % lost", parse_math=False
            )
            axes.title.set_fontsize(8.5)
        _draw_scale(panels[0], view, below=True)
    return figure


def costliest(view: PlanView) -> list[int]:
    """Return the landmarks whose hiding has a cost, the most important first."""
    kept = (view.hidden <= 1).mean(axis=0)
    order = [int(i) for i in np.argsort(kept, kind="stable")]
    return [i for i in order if kept[i] < view.begins.mean()]


def _height(view: PlanView) -> float:
    """Return the height of a map of the whole width [inch]."""
    west, south, east, north = view.floor.outline.bounds
    return WIDTH_IN * float(np.clip((north - south) / (east - west), 0.25, 1.4))


def _image(axes: Axes, view: PlanView, values: np.ndarray, **options: Any) -> Any:
    west, south, east, north = view.floor.outline.bounds
    axes.grid(False)
    axes.spines[:].set_visible(False)
    axes.set(xlabel="x [m]", ylabel="y [m]")
    return axes.imshow(
        view.floor.image(values),
        origin="lower",
        extent=(west, east, south, north),
        interpolation="nearest",
        zorder=1,
        **options,
    )


def _draw_place(axes: Axes, view: PlanView, names: bool = True) -> None:
    """Draw walls, shelves, landmarks and home."""
    axes.plot(*view.floor.outline.exterior.xy, color=INK, lw=1.6, zorder=4)
    for shelf in view.floor.shelves:
        axes.fill(*shelf.exterior.xy, color=MUTED, lw=0, zorder=3)
    for text, mark, stored in zip(view.names, view.marks, view.stored, strict=True):
        size = 10 if names else 6
        face = INK if stored else "white"
        axes.plot(*mark, "*", ms=size, color=face, mec=INK, mew=0.6, zorder=6, clip_on=False)
        if names and len(view.names) <= MAX_NAMES:
            _label(axes, view, name(text), mark)
    home = view.plan.home
    axes.plot(home.x, home.y, marker=HOUSE, ms=12 if names else 7, color=INK, mec="white", zorder=8)
    west, south, east, north = view.floor.outline.bounds
    margin = 0.02 * max(east - west, north - south)
    axes.set(xlim=(west - margin, east + margin), ylim=(south - margin, north + margin))


def _draw_scale(axes: Axes, view: PlanView, below: bool = False) -> None:
    """Draw a scale bar of a round length at the right, above or below the map."""
    west, _, east, _ = view.floor.outline.bounds
    # The largest of 1, 2, 5, 10, ... up to a quarter of the map; the factor 0.5 allows for rounding
    # of the power of ten.
    power = 10.0 ** np.floor(np.log10((east - west) / 4))
    length = max(k * power for k in (0.5, 1, 2, 5) if k * power <= (east - west) / 4)
    bar = AnchoredSizeBar(
        axes.transData,
        length,
        f"{length:g} m",
        loc="upper right" if below else "lower right",
        bbox_to_anchor=(1.0, 0.0 if below else 1.0),
        bbox_transform=axes.transAxes,
        frameon=False,
        size_vertical=0.004 * (east - west),
        color=INK,
        label_top=not below,
    )
    axes.add_artist(bar)


def _label(axes: Axes, view: PlanView, text: str, place: np.ndarray) -> None:
    """Write a landmark's name on the side of the floor."""
    west, _, east, north = view.floor.outline.bounds
    left = place[0] > east - 0.2 * (east - west)
    below = place[1] > north - 0.1 * (east - west)
    offset = (-6 if left else 6, -11 if below else 4)
    name_mark(axes, text, place, offset, ha="right" if left else "left", zorder=7)


def _draw_advice(axes: Axes, view: PlanView) -> None:
    white: dict[str, Any] = {"color": "white", "fontsize": 8, "fontweight": "bold", "zorder": 10}
    for k, (x, y) in enumerate(view.advice.places, start=1):
        axes.plot(x, y, "o", ms=13, color=GREEN, mec="white", zorder=9, clip_on=False)
        axes.annotate(str(k), (x, y), ha="center", va="center", **white)


def _marks(view: PlanView) -> list[Line2D]:
    """Return the legend entries of marks."""
    plain: dict[str, Any] = {"ls": "none", "color": INK}
    marks = [Line2D([], [], marker=MarkerPath(HOUSE), ms=9, label="home", **plain)]
    if view.stored.any():
        marks.append(Line2D([], [], marker="*", ms=10, label="landmark", **plain))
    if not view.stored.all():
        label = "landmark not visible from home"
        marks.append(Line2D([], [], marker="*", ms=10, mfc="white", label=label, **plain))
    if len(view.advice.places):
        label = "best places for more, in order"
        marks.append(Line2D([], [], marker="o", ms=10, color=GREEN, ls="none", label=label))
    return marks
