"""Maps of a plan (where homing can begin, accuracy, the cost of hidden landmarks), and its page."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import yaml
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap, LogNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.path import Path as MarkerPath
from mpl_toolkits.axes_grid1.anchored_artists import AnchoredSizeBar

from homeward.io.table import write_csv
from homeward.io.writing import whole_folder
from homeward.lab.planning.accuracy import Arcs
from homeward.lab.planning.analysis import PlanView
from homeward.runs.report import html, words
from homeward.runs.report.canvas import (
    WIDTH_IN,
    drawn,
    legend_below,
    name_mark,
    styled_figure,
    uncrowd,
)
from homeward.runs.report.files import number
from homeward.runs.report.palette import BLUE, HOUSE, INK, MUTED, SKY, VERMILLION

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
    """Draw where homing can begin."""
    classes = np.isfinite(view.score).astype(int) + view.begins + view.safe
    with styled_figure(_height(view) + 0.9) as figure:
        axes = figure.add_subplot(aspect="equal")
        colours = ListedColormap([colour for colour, _ in CLASSES])
        _image(axes, view, classes, cmap=colours, vmin=-0.5, vmax=3.5)
        _draw_place(axes, view)
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
    with styled_figure(0.5 * _height(view) + 0.8) as figure:
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
    rows = -(-max(len(worst), 1) // 3)
    with styled_figure(rows * (_height(view) / 3 + 0.35)) as figure:
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
                f"without {words.name(view.names[i])}: {100 * share:.1f} % lost", parse_math=False
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
            _label(axes, view, words.name(text), mark)
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


def _marks(view: PlanView) -> list[Line2D]:
    """Return the legend entries of marks."""
    plain: dict[str, Any] = {"ls": "none", "color": INK}
    marks = [Line2D([], [], marker=MarkerPath(HOUSE), ms=9, label="home", **plain)]
    if view.stored.any():
        marks.append(Line2D([], [], marker="*", ms=10, label="landmark", **plain))
    if not view.stored.all():
        label = "landmark not visible from home"
        marks.append(Line2D([], [], marker="*", ms=10, mfc="white", label=label, **plain))
    return marks


RIGID = 3
"""Minimum number of common landmarks for a pose."""


def plan_summary(view: PlanView) -> str:
    """Return in sentences where homing can begin, and the worst case."""
    trouble = _trouble(view)
    if trouble:
        return trouble
    limits = view.plan.limits
    begin = (
        f"Homing can begin on {words.percent(float(view.begins.mean()))} of the floor: with at"
        f" least {words.count(limits.landmarks, 'landmark')} in common with home, and errors below"
        f" {words.quantity(limits.position, 'm')} and {words.degrees(limits.heading)}."
    )
    return " ".join([begin, *_worst(view)])


def start_summary(view: PlanView) -> str:
    """Return in sentences whether homing can begin at the only place of a view, and why not."""
    limits, place = view.plan.limits, "({:g}, {:g})".format(*view.places[0])
    number, position, heading = int(view.common[0]), float(view.position[0]), float(view.heading[0])
    common = f"{words.count(number, 'landmark')} in common with home"
    if number < limits.landmarks:
        return f"Homing cannot begin at {place}: {common}, and the limit is {limits.landmarks}."
    if not np.isfinite(position):
        return f"Homing cannot begin at {place}: the pose is not observable there."
    errors = (
        f"{common}, and minimum errors of {words.quantity(position, 'm')} (limit"
        f" {words.quantity(limits.position, 'm')}) and {words.degrees(heading)} (limit"
        f" {words.degrees(limits.heading)}) after an arc of"
        f" {words.quantity(view.plan.drive.length, 'm')}."
    )
    if not view.begins[0]:
        return f"Homing cannot begin at {place}: {errors}"
    hidden = "Also with any one landmark hidden."
    if view.needed:
        names = words.listing([words.name(name) for name in view.needed])
        hidden = f"It needs each of these landmarks: {names}."
    return f"Homing can begin at {place}: {errors} {hidden}"


def _trouble(view: PlanView) -> str:
    """Return why homing can begin nowhere; empty if it can."""
    seen = int(view.stored.sum())
    if not view.names:
        return "No landmarks: homing is impossible. Add landmarks to the plan."
    if not seen:
        return "No landmark is visible from home: homing is impossible. Move home or add landmarks."
    if view.begins.any():
        return ""
    observable = np.isfinite(view.position)
    text = "Homing can begin nowhere: "
    if seen < RIGID and view.plan.landmark_sigma is None:
        circle = " (with two, home may lie anywhere on a circle through them)" if seen == 2 else ""
        return text + f"home sees only {words.count(seen, 'landmark')}, and needs three{circle}."
    common = int(view.common.max())
    if common < view.plan.limits.landmarks:
        return (
            f"{text}at most {words.count(common, 'landmark')} are visible there and from home, and"
            f" the limit is {view.plan.limits.landmarks}."
        )
    if not observable.any():
        return text + "the pose is not observable anywhere."
    return (
        f"{text}the minimum errors of {words.quantity(float(view.position.min()), 'm')} and"
        f" {words.degrees(float(view.heading.min()))} exceed the limits wherever enough landmarks"
        " are in common."
    )


def _worst(view: PlanView) -> list[str]:
    """Return the effect of a hidden landmark."""
    all_in_place = float(view.begins.mean())
    safe = float(view.safe.mean())
    parts = [f"With any one landmark hidden, {words.percent(safe)} remain."]
    costly = costliest(view)
    if costly:
        kept = float((view.hidden[:, costly[0]] <= 1).mean())
        parts.append(
            f"The most important landmark is {words.name(view.names[costly[0]])}: without it,"
            f" {words.percent(kept)} instead of {words.percent(all_in_place)}."
        )
    return parts


SETTINGS_FILE = "plan.yaml"
"""The plan; written last, so that it marks the folder as complete output."""
TEXTS = html.texts("homeward.lab.report")["plan"]
PAGE = "plan.html"


def write_plan(directory: Path, view: PlanView) -> None:
    """Write plan.html, maps as PNG and SVG, floor.csv, plan.yaml; errors as `whole_folder`."""
    figures = {
        "begin": (draw_begin(view), "Where homing can begin"),
        "accuracy": (draw_accuracy(view), "Minimum errors of position and heading over the floor"),
    }
    if costliest(view):
        figures["hidden"] = (draw_hidden(view), "Cost of hiding one landmark")
    with whole_folder(directory, SETTINGS_FILE) as scratch:
        drawings = {
            key: drawn(scratch, key, label, figure, vector="svg")[1]
            for key, (figure, label) in figures.items()
        }
        _write_floor(scratch / "floor.csv", view)
        (scratch / PAGE).write_text(_page(view, drawings), encoding="utf-8")
        (scratch / SETTINGS_FILE).write_text(_settings(view), encoding="utf-8")


def _page(view: PlanView, drawings: dict[str, Markup]) -> str:
    title = words.name(view.plan.name, 60)
    hidden = html.figure(drawings["hidden"]) if "hidden" in drawings else html.EMPTY
    return html.page(
        f"{title}: where homing can begin",
        html.header(
            f"{title}: where homing can begin",
            html.figure(drawings["begin"]),
            html.summary(plan_summary(view)),
            html.facts(_headline(view)),
        ),
        html.section(
            "Minimum pose error",
            html.figure(drawings["accuracy"]),
            html.note(TEXTS["accuracy"]),
        ),
        html.section("Importance of each landmark", hidden, *_importance(view)),
        html.section(
            "Assumptions",
            html.note(_assumptions(view)),
            html.details("The plan (homeward plan plan.yaml repeats it)", _settings(view)),
        ),
    )


def _headline(view: PlanView) -> dict[str, str]:
    """Return the main shares of the floor."""
    begins, common = view.begins, view.common
    return {
        "homing can begin": words.percent(float(begins.mean())),
        "with any one hidden": words.percent(float(view.safe.mean())),
        "a moved one is detected": words.percent(float((begins & (common >= 4)).mean())),
        "and identified": words.percent(float((begins & (common >= 5)).mean())),
    }


def _importance(view: PlanView) -> list[Markup]:
    """Return the table of what hidden landmarks cost; nothing without landmarks."""
    if not view.names:
        return []
    rows = [["Landmark", "hidden: homing can begin from", ""]]
    kept = (view.hidden <= 1).mean(axis=0)
    for i in np.argsort(kept, kind="stable").tolist():
        seen = "" if view.stored[i] else "not visible from home"
        rows.append([words.name(view.names[i], 60), f"{100 * kept[i]:.1f} %", seen])
    return [html.table("wrl", rows), html.note(TEXTS["importance"])]


def _assumptions(view: PlanView) -> str:
    drive, sigma = view.plan.drive, view.plan.landmark_sigma
    return TEXTS["assumptions"].format(
        drive=drive,
        turn=words.degrees(drive.turn),
        headings=len(Arcs(view.plan).headings),
        known=f"known to {words.quantity(sigma, 'm')}" if sigma else "unknown",
    )


def _settings(view: PlanView) -> str:
    tree = view.plan.model_dump(mode="json", exclude_none=True)
    return yaml.safe_dump(tree, sort_keys=False, allow_unicode=True, default_flow_style=None)


def _write_floor(file: Path, view: PlanView) -> None:
    """Write the map as CSV, empty where the pose is not observable."""
    columns = np.column_stack([view.places, view.position, view.heading])
    flags = (np.where(yes, "yes", "no") for yes in (view.begins, view.safe))
    rows = zip(columns, view.common, *flags, strict=True)
    write_csv(
        file,
        ("x", "y", "position_sigma", "heading_sigma", "landmarks", "begins", "safe"),
        ([*(number(float(f"{v:.4g}")) for v in row), *words] for row, *words in rows),
    )
