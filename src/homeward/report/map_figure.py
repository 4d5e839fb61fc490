"""The map of a run: path, truth, uncertainty, landmarks and home."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.path import Path

from homeward.drives.drive import Truth
from homeward.estimator import LandmarkEstimate, Status
from homeward.report.canvas import (
    INK,
    MOVED,
    STATUS_COLOURS,
    WIDTH_IN,
    new_figure,
    runs,
    style,
    thin,
)
from homeward.report.words import name
from homeward.track import Track

ELLIPSES = 24
"""How many ellipses are drawn along the path."""
MOST_LABELS = 40
"""With more landmarks than this only the moved ones are named."""
Limits = tuple[float, float, float, float]
"""West, east, south and north of the map [m]."""
HOUSE = Path([(-1, -1), (1, -1), (1, 0.25), (0, 1.2), (-1, 0.25), (-1, -1)], closed=True)


def draw_map(track: Track, truth: Truth | None) -> Figure:
    """Draw the map of a run in the home frame.

    Parameters
    ----------
    track : Track
        Path, covariances and landmarks.
    truth : Truth or None
        Drawn as a thin line where there is any.
    """
    west, east, south, north = limits = _limits(track, truth)
    aspect = (north - south) / (east - west)
    with style():
        figure = new_figure(WIDTH_IN * float(np.clip(aspect, 0.35, 1.1)) + 0.7)
        axes = figure.add_subplot(aspect="equal")
        if truth is not None:
            rows = thin(truth.x)
            axes.plot(truth.x[rows], truth.y[rows], color=INK, lw=0.7, zorder=3)
        _draw_path(axes, track)
        _draw_ellipses(axes, track)
        _draw_landmarks(axes, track.landmarks, limits)
        _draw_home(axes, max(east - west, north - south))
        axes.set(xlim=(west, east), ylim=(south, north), xlabel="x [m]", ylabel="y [m]")
        figure.legend(handles=_legend(track, truth), loc="outside lower center", ncols=4)
    return figure


def undrawn(track: Track, truth: Truth | None) -> list[str]:
    """Return the ids of landmarks that have a place, but too vague or too far off for the map."""
    drawn = _drawn(track.landmarks, _limits(track, truth))
    return [m.landmark for m in track.landmarks if np.isfinite(m.x) and m not in drawn]


def _placed(landmarks: list[LandmarkEstimate]) -> list[LandmarkEstimate]:
    """Return the landmarks whose place means something: a sigma below half the distance."""
    return [
        m for m in landmarks if np.isfinite(m.x) and not m.sigma_distance > 0.5 * abs(m.distance)
    ]


def _drawn(landmarks: list[LandmarkEstimate], limits: Limits) -> list[LandmarkEstimate]:
    """Return the landmarks that stand on the map."""
    west, east, south, north = limits
    return [m for m in _placed(landmarks) if west <= m.x <= east and south <= m.y <= north]


def _limits(track: Track, truth: Truth | None) -> Limits:
    """Return the limits that hold home, the path, and the landmarks not far from them."""
    points = [np.array([[-0.5, -0.5], [0.5, 0.5]])]
    posed = np.column_stack([track.x, track.y])[track.has_pose]
    if posed.size:
        # A filter that diverged for a while must not shrink the rest to a dot.
        low, high = np.quantile(posed, [0.005, 0.995], axis=0)
        points.append(np.clip(posed, low, high))
    if truth is not None and truth.t.size:
        points.append(np.column_stack([truth.x, truth.y]))
    core = np.concatenate(points)
    centre, reach = core.mean(axis=0), 1.0 + float(np.ptp(core, axis=0).max())
    placed = _placed(track.landmarks)
    places = [(m.x, m.y) for m in placed] + [_old_place(m) for m in placed if m.moved]
    marks = np.array(places).reshape(-1, 2)
    near = marks[np.all(np.abs(marks - centre) < 1.5 * reach, axis=1)]
    everything = np.concatenate([core, near])
    low, high = everything.min(axis=0), everything.max(axis=0)
    margin = 0.06 * float((high - low).max()) + 0.1
    return low[0] - margin, high[0] + margin, low[1] - margin, high[1] + margin


def _draw_path(axes: Axes, track: Track) -> None:
    """Draw the estimated path, coloured by status."""
    x, y = (np.where(track.has_pose, a, np.nan) for a in (track.x, track.y))
    rows = np.union1d(thin(x), thin(y))
    pieces: dict[Status, list[np.ndarray]] = {}
    for first, last, status in runs([track.status[row] for row in rows]):
        # The step into a row has that row's colour; a break ends each piece.
        piece = np.column_stack([x, y])[rows[max(first - 1, 0) : last]]
        pieces.setdefault(status, []).extend([piece, np.full((1, 2), np.nan)])
    for status, parts in pieces.items():
        line = np.concatenate(parts)
        if np.isfinite(line).any():
            axes.plot(*line.T, color=STATUS_COLOURS[status], lw=2.0, zorder=4)
    posed = np.flatnonzero(track.has_pose)
    if posed.size:
        for row, fill in ((posed[0], "white"), (posed[-1], INK)):
            axes.plot(track.x[row], track.y[row], "o", ms=5, mfc=fill, mec=INK, mew=1.0, zorder=6)


def _draw_ellipses(axes: Axes, track: Track) -> None:
    """Draw 2-sigma ellipses of the position at even intervals of time."""
    posed = np.flatnonzero(track.has_pose)
    if not posed.size:
        return
    rows = np.unique(posed[np.linspace(0, posed.size - 1, ELLIPSES).astype(int)])
    circle = np.linspace(0, 2 * np.pi, 33)
    variance, directions = np.linalg.eigh(track.covariance[rows, :2, :2])
    radii = 2 * np.sqrt(np.maximum(variance, 0.0))
    unit = np.stack([np.cos(circle), np.sin(circle)])
    rims = np.einsum("nij,nj,jk->nik", directions, radii, unit)
    rims += np.column_stack([track.x[rows], track.y[rows]])[:, :, None]
    for row, (x, y) in zip(rows, rims, strict=True):
        colour = STATUS_COLOURS[track.status[row]]
        axes.fill(x, y, facecolor=colour, alpha=0.1, zorder=2)
        axes.plot(x, y, color=colour, lw=0.6, alpha=0.8, zorder=2)


def _draw_landmarks(axes: Axes, landmarks: list[LandmarkEstimate], limits: Limits) -> None:
    """Draw landmarks; an arrow leads to a moved one from where home saw it."""
    west, east, _, _ = limits
    drawn = _drawn(landmarks, limits)
    for m in drawn:
        # Near the eastern edge the name stands to the left.
        side = -1 if m.x > east - 0.2 * (east - west) else 1
        colour, marker = (MOVED, "D") if m.moved else (INK, "o")
        axes.plot(m.x, m.y, marker, ms=5 if m.moved else 4, color=colour, mew=0, zorder=5)
        if m.moved:
            _draw_move(axes, m)
        if m.moved or len(drawn) <= MOST_LABELS:
            axes.annotate(
                name(m.landmark),
                (m.x, m.y),
                xytext=(5 * side, 4),
                ha="left" if side > 0 else "right",
                in_layout=False,
                textcoords="offset points",
                color=colour,
                fontweight="bold" if m.moved else "normal",
                zorder=7,
                annotation_clip=True,
                parse_math=False,
            )


def _draw_move(axes: Axes, m: LandmarkEstimate) -> None:
    """Draw an arrow to a moved landmark from its old direction, at its present distance."""
    old = _old_place(m)
    if not np.isfinite(old).all():
        return
    axes.plot(*old, "D", ms=5, mfc="white", mec=MOVED, mew=0.9, zorder=5)
    arrow = {"arrowstyle": "-|>", "color": MOVED, "lw": 1.0, "shrinkA": 4, "shrinkB": 4}
    axes.annotate("", (m.x, m.y), old, arrowprops=arrow, zorder=5, annotation_clip=False)


def _old_place(m: LandmarkEstimate) -> tuple[float, float]:
    """Return where a moved landmark would have stood at its present distance [m]."""
    far = np.hypot(m.x, m.y)
    return far * np.cos(m.home_bearing_stored), far * np.sin(m.home_bearing_stored)


def _draw_home(axes: Axes, extent: float) -> None:
    """Draw home and its x-axis."""
    tip = (0.09 * extent, 0.0)
    arrow = {"arrowstyle": "-|>", "color": INK, "lw": 1.2, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", tip, (0.0, 0.0), arrowprops=arrow, zorder=7)
    axes.plot(0, 0, marker=HOUSE, ms=11, color=INK, mec="white", mew=0.8, zorder=8)


def _legend(track: Track, truth: Truth | None) -> list[Line2D]:
    """Return the legend's entries, those that occur only."""
    posed = {s for s, here in zip(track.status, track.has_pose, strict=True) if here}
    entries = [
        Line2D([], [], color=STATUS_COLOURS[s], lw=2.0, label=s.value) for s in Status if s in posed
    ]
    if truth is not None:
        entries.append(Line2D([], [], color=INK, lw=0.7, label="truth"))
    spot: dict[str, Any] = {"ls": "none", "color": INK}
    entries.append(Line2D([], [], marker=HOUSE, ms=8, label="home", **spot))
    if posed:
        entries.append(Line2D([], [], marker="o", mfc="white", ms=5, label="first pose", **spot))
        entries.append(Line2D([], [], marker="o", ms=5, label="last pose", **spot))
    if any(np.isfinite(m.x) and not m.moved for m in track.landmarks):
        entries.append(Line2D([], [], marker="o", ms=4, mew=0, label="landmark", **spot))
    if any(np.isfinite(m.x) and m.moved for m in track.landmarks):
        moved: dict[str, Any] = {"ls": "none", "color": MOVED, "marker": "D", "ms": 5, "mew": 0}
        entries.append(Line2D([], [], label="moved landmark", **moved))
    return entries
