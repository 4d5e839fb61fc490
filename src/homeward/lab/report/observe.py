"""Page and drawing of `homeward plan --landmarks` and `--drive`: observability."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from homeward.io.writing import whole_folder
from homeward.lab.observability.lie import printed_matrix, rank_table
from homeward.lab.observability.scene import Scene
from homeward.lab.observability.study import ModelView, Trace, observe_motions
from homeward.lab.observability.words import in_words
from homeward.lab.studies.observing import DriveView
from homeward.runs.report import html, words
from homeward.runs.report.canvas import drawn, name_mark, styled_figure
from homeward.runs.report.files import write_settings
from homeward.runs.report.palette import BLUE, HOUSE, INK, MUTED, ORANGE, SKY
from homeward.runs.report.words import name

GHOSTS = 7
"""Number of other homes on each curve."""
WORST_M = 3.0
"""Upper limit of the colours of a map [m]."""
BEST_M = 0.03
MAP_IN = 5.3
"""Width of the map of a drive without scale and colour bar [inch]."""
COLOURS = "viridis_r"
TEXTS = html.texts("homeward.lab.report")["observe"]


def draw_family(view: ModelView) -> Figure:
    """Draw a drive with landmarks, and other homes and landmarks with the same bearings."""
    scene, q = view.drive, len(view.drive.names)
    with styled_figure(5.8) as figure:
        axes = figure.add_subplot(aspect="equal")
        for trace in view.family:
            _draw_trace(axes, trace, q)
        for mark in scene.landmarks[scene.stored]:
            axes.plot(*zip(scene.home[:2], mark, strict=True), color=MUTED, lw=0.7, ls=":")
        axes.plot(*scene.poses[:, :2].T, color=BLUE, lw=2.4, zorder=5)
        _draw_arrow(axes, scene.poses[-1], 0.12 * scene.length, BLUE)
        axes.plot(*scene.poses[0, :2], "o", ms=5, mfc="white", mec=BLUE, mew=1.2, zorder=6)
        axes.plot(*scene.landmarks.T, "*", ms=13, color=INK, mec="white", zorder=6)
        if q <= 12:
            for text, mark in zip(scene.names, scene.landmarks, strict=True):
                name_mark(axes, name(text), mark, (7, 4), annotation_clip=True, zorder=8)
        _draw_home(axes, scene.home, scene.length)
        _limit(axes, view)
        axes.set(xlabel="x [m], the robot's first pose is the origin", ylabel="y [m]")
        _legend(figure, axes, view)
    return figure


def _draw_trace(axes: Axes, trace: Trace, q: int) -> None:
    """Draw a curve of homes with some of them, and curves of landmarks that move."""
    homes = trace.homes
    if np.ptp(homes[:, :2], axis=0).max() > 1e-6:
        axes.plot(*homes[:, :2].T, color=ORANGE, lw=1.6, zorder=2)
    for k in np.unique(np.linspace(0, len(homes) - 1, GHOSTS).astype(int)):
        axes.plot(*homes[k, :2], marker=HOUSE, ms=8, color=ORANGE, mec="white", alpha=0.9, zorder=4)
        _draw_arrow(axes, homes[k], 0.22, ORANGE)
    for path in np.moveaxis(trace.landmarks(q), 1, 0):
        if np.ptp(path, axis=0).max() > 1e-6:
            axes.plot(*path.T, color=SKY, lw=1.2, zorder=1)


def _draw_home(axes: Axes, home: np.ndarray, length: float) -> None:
    _draw_arrow(axes, home, 0.16 * length, INK)
    axes.plot(*home[:2], marker=HOUSE, ms=12, color=INK, mec="white", zorder=7)


def _draw_arrow(axes: Axes, pose: np.ndarray, size: float, colour: str) -> None:
    tip = pose[0] + size * np.cos(pose[2]), pose[1] + size * np.sin(pose[2])
    arrow = {"arrowstyle": "-|>", "color": colour, "lw": 1.0, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", tip, (pose[0], pose[1]), arrowprops=arrow, annotation_clip=True, zorder=4)


def _limit(axes: Axes, view: ModelView) -> None:
    """Set the limits to the scene and the near part of the family."""
    scene = view.drive
    real = np.vstack([scene.home[None, :2], scene.landmarks, scene.poses[:, :2]])
    centre, reach = real.mean(axis=0), 1.3 * float(np.ptp(real, axis=0).max())
    homes = [t.homes[:, :2] for t in view.family]
    near = [h[np.abs(h - centre).max(axis=1) < reach] for h in homes]
    everything = np.vstack([real, *near])
    low, high = everything.min(axis=0), everything.max(axis=0)
    margin = 0.08 * float((high - low).max()) + 0.1
    axes.set(xlim=(low[0] - margin, high[0] + margin), ylim=(low[1] - margin, high[1] + margin))


def _legend(figure: Figure, axes: Axes, view: ModelView) -> None:
    axes.plot([], [], color=BLUE, lw=2.4, label="robot's path")
    axes.plot([], [], "*", ms=11, color=INK, ls="none", label="landmark")
    axes.plot([], [], marker=HOUSE, ms=9, color=INK, ls="none", label="home")
    moves = [np.ptp(t.homes, axis=0).max() > 1e-6 for t in view.family]
    if any(moves):
        label = "other homes with the same bearings"
        axes.plot([], [], marker=HOUSE, ms=8, color=ORANGE, label=label)
    q = len(view.drive.names)
    if any(np.ptp(t.landmarks(q), axis=0).max() > 1e-6 for t in view.family):
        axes.plot([], [], color=SKY, label="their landmarks")
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=3)


def draw_drive_view(view: DriveView) -> Figure:
    """Draw the path coloured by the position error of each window, and that error over time."""
    scene, path = view.scene, view.scene.poses[:, :2]
    drawn = np.vstack([np.zeros((1, 2)), path, _near(scene)])
    low, high = drawn.min(axis=0), drawn.max(axis=0)
    extent = float((high - low).max())
    margin = 0.05 * extent + 0.2
    low, high = low - margin, high + margin
    # The height fits the map.
    height = MAP_IN * float(np.clip((high - low)[1] / (high - low)[0], 0.3, 1.2))
    norm = LogNorm(BEST_M, WORST_M, clip=True)
    with styled_figure(height + 2.6) as figure:
        top, bottom = figure.subplots(2, 1, height_ratios=[height, 1.7])
        top.set_aspect("equal")
        middles = np.array([(w.begin + w.end) / 2 for w in view.windows])
        sigmas = np.array([w.position_sigma for w in view.windows])
        nearest = np.searchsorted((middles[1:] + middles[:-1]) / 2, view.t)
        lines = LineCollection(
            list(np.stack([path[:-1], path[1:]], axis=1)),
            cmap=COLOURS,
            norm=norm,
            lw=2.2,
        )
        lines.set_array(np.minimum(sigmas, WORST_M)[nearest[:-1]])
        top.add_collection(lines)
        for text, place, stored in zip(scene.names, scene.landmarks, scene.stored, strict=True):
            top.plot(*place, "*", ms=9, color=INK if stored else MUTED, mec="white", zorder=5)
            name_mark(top, name(text), place, (7, 4), annotation_clip=True, zorder=8)
        _draw_home(top, np.zeros(3), 0.5 * extent)
        top.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), xlabel="x [m]", ylabel="y [m]")
        figure.colorbar(lines, ax=top, label="minimum position\nerror [m]", shrink=0.8, pad=0.02)
        _draw_time(bottom, view, middles, sigmas)
    return figure


def _draw_time(axes: Axes, view: DriveView, t: np.ndarray, sigmas: np.ndarray) -> None:
    known = np.isfinite(sigmas)
    axes.plot(t, np.where(known, sigmas, np.nan), color=BLUE, marker="o", ms=3)
    for k in np.flatnonzero(~known):
        w = view.windows[k]
        axes.axvspan(w.begin, w.end, color=ORANGE, alpha=0.25, lw=0)
    axes.set(
        yscale="log", xlabel="time [s]", ylabel="position [m]", xlim=(0.0, float(view.t[-1]) or 1.0)
    )
    if not known.any():
        axes.set_ylim(BEST_M, WORST_M)


def _near(scene: Scene) -> np.ndarray:
    """Return the landmarks near the path, shape (k, 2)."""
    centre = scene.poses[:, :2].mean(axis=0)
    reach = 2.0 + 1.5 * float(np.ptp(scene.poses[:, :2], axis=0).max())
    return np.asarray(scene.landmarks[np.abs(scene.landmarks - centre).max(axis=1) < reach])


SETTINGS_FILE = "observe.yaml"
"""Written last; marks the folder as complete output."""
PAGE = "observe.html"
FIGURE = "observe"


def write_model_view(directory: Path, view: ModelView, settings: dict[str, Any]) -> None:
    """Write observe.html, observe.png, observe.svg and observe.yaml; errors as `whole_folder`."""
    members = sum(len(t.unknowns) - 1 for t in view.family)
    text = TEXTS["family"].format(members, same_to(view)) if view.family else ""
    label = "Worlds with equal bearings"
    heads = f"Observability: {view.drive.title}", label if view.family else "The drive"
    drawing = label, draw_family(view)
    _write(directory, heads, model_summary(view), drawing, [html.note(text)], settings)


def write_drive_view(directory: Path, view: DriveView, settings: dict[str, Any]) -> None:
    """Write the same files for a drive."""
    sigmas = map(words.degrees, (view.bearing_sigma, view.home_sigma))
    text = TEXTS["windows"].format(settings["window"], view.path_from, *sigmas)
    missing = view.unplaced
    unplaced = TEXTS["unplaced"].format(words.listing(missing, 20)) if missing else ""
    parts = [html.note(text, unplaced), html.table("rrrrrrw", _window_rows(view))]
    title = f"Observability of {words.name(view.name, 60)}"
    drawing = "The path, coloured by the minimum position error", draw_drive_view(view)
    heads = title, "Observability of the pose in each window"
    _write(directory, heads, drive_summary(view), drawing, parts, settings)


def _window_rows(view: DriveView) -> list[list[object]]:
    head = ["from [s]", "to", "landmarks", "rank", "position", "heading"]
    rows: list[list[object]] = [[*head, "unobservable or weakest direction"]]
    for w in view.windows:
        position, heading = w.position_sigma, w.heading_sigma
        rows.append(
            [
                *(f"{w.begin:.0f}", f"{w.end:.0f}", len(w.landmarks), f"{w.rank} of {w.unknowns}"),
                words.quantity(position, "m") if position < 1e6 else "",
                words.degrees(heading) if heading < 3 else "",
                "; ".join(w.weakest),
            ]
        )
    return rows


def model_summary(view: ModelView) -> str:
    """Return the unobservable directions in a few sentences."""
    if view.model is not None:
        m, given = view.model, view.model.scene
        known = {"a compass": given.compass, "known distances": given.distances}
        extra = "".join(f" and {name}" for name, is_known in known.items() if is_known)
        marks = words.count(len(given.names), "landmark")
        head = f"With {marks}{extra}, bearings determine {m.rank} of the {m.n}"
        head += " dimensions of the state."
    else:
        d = view.drive
        head = (
            f"{d.title[0].upper()}{d.title[1:]}: {d.rank.value} of {len(d.truth)} unknowns are"
            " observable."
        )
    if not view.freedoms:
        return f"{head} Everything is observable."
    return " ".join([head, *(f"{f.words[0].upper()}{f.words[1:]}." for f in view.freedoms)])


def drive_summary(view: DriveView) -> str:
    """Return in a few sentences how well a drive determines home, and where not."""
    blind = [w for w in view.windows if not np.isfinite(w.position_sigma)]
    known = [w for w in view.windows if np.isfinite(w.position_sigma)]
    whole = view.whole
    text = f"All bearings together do not determine the pose: {'; '.join(whole.weakest)}."
    if np.isfinite(whole.position_sigma):
        text = (
            "Minimum error of the pose relative to home from all bearings together:"
            f" {words.quantity(whole.position_sigma, 'm')}, {words.degrees(whole.heading_sigma)}."
        )
    parts = [text]
    if known:
        middle = float(np.median([w.position_sigma for w in known]))
        worst = max(known, key=lambda w: w.position_sigma)
        parts.append(
            f"In single windows its median is {words.quantity(middle, 'm')}. The worst window is"
            f" {worst.begin:.0f} to {worst.end:.0f} s"
            f" (±{words.quantity(worst.position_sigma, 'm')}: {'; '.join(worst.weakest)})."
        )
    if blind:
        parts.append(
            f"In {len(blind)} of {len(view.windows)} windows the bearings do not determine the"
            f" pose. The first is {blind[0].begin:.0f} to {blind[0].end:.0f} s:"
            f" {'; '.join(blind[0].weakest)}."
        )
    return " ".join(parts)


def same_to(view: ModelView) -> float:
    """Return the largest difference of any measurement between members of the family."""
    return max((t.difference for t in view.family), default=0.0)


def _write(
    directory: Path,
    heads: tuple[str, str],
    summary: str,
    drawing: tuple[str, Figure],
    parts: list[Markup],
    settings: dict[str, Any],
) -> None:
    """Write a page with a section of the figure and its own `parts`, and those of all pages.

    `heads` are the title and the heading of that section.
    """
    title, heading = heads
    with whole_folder(directory, SETTINGS_FILE) as scratch:
        _, figure = drawn(scratch, FIGURE, *drawing, vector="svg")
        head = html.header(title, html.summary(summary))
        own = html.section(heading, html.figure(figure), *parts)
        text = html.page(title, head, own, _landmark_numbers(), _motions(), _matrix())
        (scratch / PAGE).write_text(text, encoding="utf-8")
        write_settings(scratch / SETTINGS_FILE, settings)


def _landmark_numbers() -> Markup:
    head = "landmarks q", "state n", "rank, bearings", "and a compass", "and known distances"
    rows: list[Sequence[object]] = [head]
    for q, n, *ranks in rank_table():
        rows.append([q, n, *(f"{r} of {n}, all" if r == n else f"{r} of {n}" for r in ranks)])
    table = html.table("rrrrr", rows)
    return html.section("Required number of landmarks", table, html.note(TEXTS["numbers"]))


def _motions() -> Markup:
    rows = [["Drive", "rank", "Unobservable"]]
    for scene in observe_motions():
        found = scene.rank
        free = "; ".join(freedom.words for freedom in in_words(scene, found.null)) or "nothing"
        rows.append([scene.title, f"{found.value} of {len(scene.truth)}", free])
    table = html.table("lrw", rows)
    return html.section("Observability by motion", table, html.note(TEXTS["motions"]))


def _matrix() -> Markup:
    entries = printed_matrix()
    head = "Entry", "derivative by", "correct formula", "at the paper's start", "the model"
    rows: list[Sequence[object]] = [(*head, "printed")]
    for e in entries:
        result = "correct" if e.right else "wrong sign"
        rows.append([e.name, e.by, e.formula, f"{e.value:.6f}", f"{e.exact:.6f}", result])
    wrong = [k for k, e in enumerate(entries) if not e.right]
    table, rows_text = html.table("llwrrl", rows, wrong), html.paragraph(TEXTS["matrix"])
    note = html.note(TEXTS["model"])
    return html.section("The printed observability matrix", rows_text, table, note)
