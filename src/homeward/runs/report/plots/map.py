"""Map of a run: path, ground truth, uncertainty, landmarks, home, and the slider's layers."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from bokeh.core.properties import value
from bokeh.models import (
    Arrow,
    BoxZoomTool,
    ColumnDataSource,
    DataRange1d,
    GlyphRenderer,
    NormalHead,
    PanTool,
    ResetTool,
    WheelZoomTool,
)
from bokeh.plotting import figure

from homeward.drives.drive import Truth
from homeward.estimator import LandmarkEstimate, Status
from homeward.runs.report import words
from homeward.runs.report.palette import BLUE, HOUSE, INK, MOVED, MUTED, STATUS_COLOURS
from homeward.runs.report.plots.look import FONT, THEMED, TYPE, add_hover, restyled, runs, thin
from homeward.track import Track

ELLIPSES = 24
"""Number of ellipses along the path."""
MAX_LABELS = 40
"""With more landmarks than this, only the moved ones are labelled."""
Limits = tuple[float, float, float, float]
"""West, east, south and north limits of the map [m]."""
TIP = '<b>@name</b><div style="white-space: pre-line">@details</div>'


def map_plot(track: Track, truth: Truth | None) -> figure:
    """Return the map of a run in the home frame.

    The page's script fills the data sources ``robot``, ``ellipse``, ``rays``, ``true-robot`` and
    ``landmarks`` for the slider's moment.
    """
    limits = map_limits(track, truth)
    plot = _empty()
    _draw_ellipses(plot, track)
    _draw_truth(plot, truth)
    _draw_path(plot, track)
    _draw_home(plot, limits)
    _draw_moment(plot, truth is not None)
    landmarks = _draw_landmarks(plot, track, limits)
    corners = plot.scatter(limits[:2], limits[2:], alpha=0.0, line_alpha=0.0, size=1)
    for span in (plot.x_range, plot.y_range):
        span.renderers = [corners]
    add_hover(plot, TIP, landmarks)
    return plot


def map_aspect(track: Track, truth: Truth | None) -> float:
    """Return the aspect ratio (width over height) of the map, limited to what fits a page."""
    west, east, south, north = map_limits(track, truth)
    return float(np.clip((east - west) / (north - south), 0.8, 2.2))


def undrawn(track: Track, truth: Truth | None) -> list[str]:
    """Return the ids of mapped landmarks that are too uncertain or too far away for the map."""
    drawn = _drawn(track.landmarks, map_limits(track, truth))
    return [m.landmark for m in track.landmarks if np.isfinite(m.x) and m not in drawn]


def map_limits(track: Track, truth: Truth | None) -> Limits:
    """Return limits that contain home, the path, and the landmarks near them."""
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
    positions = [(m.x, m.y) for m in placed] + [_old_position(m) for m in placed if m.moved]
    marks = np.array(positions).reshape(-1, 2)
    near = marks[np.all(np.abs(marks - centre) < 1.5 * reach, axis=1)]
    everything = np.concatenate([core, near])
    low, high = everything.min(axis=0), everything.max(axis=0)
    margin = 0.06 * float((high - low).max()) + 0.1
    west, south = (low - margin).tolist()
    east, north = (high + margin).tolist()
    return west, east, south, north


def ellipse(x: float, y: float, covariance: np.ndarray, sigmas: float) -> np.ndarray:
    """Return the outline of the ellipse of `sigmas` around (x, y) [m], shape (2, 33)."""
    circle = np.linspace(0, 2 * np.pi, 33)
    variance, directions = np.linalg.eigh(covariance[:2, :2])
    radii = sigmas * np.sqrt(np.maximum(variance, 0.0))
    rim = directions @ (radii[:, None] * np.stack([np.cos(circle), np.sin(circle)]))
    return np.asarray(rim + np.array([[x], [y]]))


def _placed(landmarks: list[LandmarkEstimate]) -> list[LandmarkEstimate]:
    """Return the landmarks with a useful position: sigma at most half the distance."""
    return [
        m for m in landmarks if np.isfinite(m.x) and not m.sigma_distance > 0.5 * abs(m.distance)
    ]


def _drawn(landmarks: list[LandmarkEstimate], limits: Limits) -> list[LandmarkEstimate]:
    """Return the landmarks inside the map."""
    west, east, south, north = limits
    return [m for m in _placed(landmarks) if west <= m.x <= east and south <= m.y <= north]


def _empty() -> figure:
    """Return the empty map with equal scales."""
    drag, wheel = PanTool(), WheelZoomTool()
    wheel.modifiers = {"ctrl": True}
    plot = figure(
        sizing_mode="stretch_both",
        match_aspect=True,
        x_range=DataRange1d(range_padding=0.0),
        y_range=DataRange1d(range_padding=0.0),
        tools=[drag, BoxZoomTool(match_aspect=True), wheel, ResetTool()],
        active_drag=drag,
        active_scroll=wheel,
        x_axis_label="x [m]",
        y_axis_label="y [m]",
    )
    return restyled(plot)


def _draw_truth(plot: figure, truth: Truth | None) -> None:
    """Draw the true path."""
    if truth is not None:
        rows = np.union1d(thin(truth.x), thin(truth.y))
        plot.line(truth.x[rows], truth.y[rows], color=INK, line_width=1, tags=[THEMED])


def _draw_path(plot: figure, track: Track) -> None:
    """Draw the estimated path, coloured by status."""
    x, y = (np.where(track.has_pose, a, np.nan) for a in (track.x, track.y))
    rows = np.union1d(thin(x), thin(y))
    pieces: dict[Status, list[np.ndarray]] = {}
    for first, last, status in runs([track.status[row] for row in rows]):
        # The step into a row has that row's colour; a break ends each piece.
        piece = np.column_stack([x, y])[rows[max(first - 1, 0) : last]]
        pieces.setdefault(status, []).extend([piece, np.full((1, 2), np.nan)])
    for status, parts in pieces.items():
        line = np.round(np.concatenate(parts), 4)
        if np.isfinite(line).any():
            plot.line(*line.T, color=STATUS_COLOURS[status], line_width=2.2, line_cap="round")
    posed = np.flatnonzero(track.has_pose)
    if posed.size:
        row = posed[0]
        plot.scatter([x[row]], [y[row]], size=7, fill_color="white", line_color=MUTED)


def _draw_ellipses(plot: figure, track: Track) -> None:
    """Draw 2-sigma ellipses of the position at even intervals of time."""
    posed = np.flatnonzero(track.has_pose)
    if not posed.size:
        return
    rows = np.unique(posed[np.linspace(0, posed.size - 1, ELLIPSES).astype(int)])
    rims = [ellipse(track.x[r], track.y[r], track.covariance[r], 2.0) for r in rows]
    plot.patches(
        [rim[0] for rim in rims],
        [rim[1] for rim in rims],
        color=[STATUS_COLOURS[track.status[row]] for row in rows],
        fill_alpha=0.10,
        line_alpha=0.45,
    )


def _draw_home(plot: figure, limits: Limits) -> None:
    """Draw home and the x-axis of the home frame."""
    west, east, south, north = limits
    extent = max(east - west, north - south)
    head = NormalHead(size=8, fill_color=INK, line_color=None, tags=[THEMED])
    plot.add_layout(
        Arrow(
            x_start=0,
            y_start=0,
            x_end=0.09 * extent,
            y_end=0,
            end=head,
            line_color=INK,
            line_width=1.5,
            tags=[THEMED],
        )
    )
    house = 0.014 * extent * np.array(HOUSE)
    plot.patch(*house.T, fill_color=INK, line_color=None, tags=[THEMED])


def _draw_moment(plot: figure, has_truth: bool) -> None:
    """Add the layers of the slider's moment; the page's script fills them."""
    nothing: dict[str, list[Any]] = {"x": [], "y": []}
    rays = ColumnDataSource({k: [] for k in ("x0", "y0", "x1", "y1", "color")}, name="rays")
    plot.segment(
        "x0", "y0", "x1", "y1", color="color", line_dash="dashed", line_width=1.3, source=rays
    )
    plot.patch(
        fill_color=BLUE,
        fill_alpha=0.25,
        line_color=BLUE,
        source=ColumnDataSource(nothing, name="ellipse"),
    )
    if has_truth:
        true = ColumnDataSource(nothing, name="true-robot")
        plot.patch(fill_color=None, line_color=INK, line_width=1.2, source=true, tags=[THEMED])
    robot = ColumnDataSource(nothing, name="robot")
    plot.patch(fill_color=BLUE, line_color="white", line_width=1.2, source=robot)


def _draw_landmarks(plot: figure, track: Track, limits: Limits) -> GlyphRenderer:
    """Draw landmarks, and an arrow to each moved one from its old position."""
    drawn = _drawn(track.landmarks, limits)
    for m in drawn:
        if m.moved and np.isfinite(_old_position(m)).all():
            _draw_move(plot, m)
    source = ColumnDataSource(_columns(drawn, track, limits), name="landmarks")
    dots = plot.scatter(
        "x",
        "y",
        marker="marker",
        size="size",
        fill_color="fill",
        line_color="line",
        line_width=1.2,
        source=source,
    )
    plot.text(
        "x",
        "y",
        text="label",
        x_offset="offset",
        text_align="side",
        y_offset=-7,
        text_font=value(FONT),
        text_font_size=TYPE,
        text_color=INK,
        source=source,
        tags=[THEMED],
    )
    return dots


def _columns(drawn: list[LandmarkEstimate], track: Track, limits: Limits) -> dict[str, list[Any]]:
    """Return the data source of the landmarks: markers, labels and tooltips."""
    west, east, _, _ = limits
    rows, none = track.innovations.by_landmark(), np.empty(0, int)
    # Near the eastern edge the label is on the left.
    left = [m.x > east - 0.15 * (east - west) for m in drawn]
    named = [m.moved or len(drawn) <= MAX_LABELS for m in drawn]
    colours = [MOVED if m.moved else MUTED if m.moved is None else BLUE for m in drawn]
    return {
        "x": [m.x for m in drawn],
        "y": [m.y for m in drawn],
        "fill": colours,
        "line": colours,
        "marker": ["diamond" if m.moved else "circle" for m in drawn],
        "size": [13 if m.moved else 8 for m in drawn],
        "label": [words.name(m.landmark) if n else "" for m, n in zip(drawn, named, strict=True)],
        "offset": [-8 if side else 8 for side in left],
        "side": ["right" if side else "left" for side in left],
        "id": [m.landmark for m in drawn],
        "name": [words.name(m.landmark, 60) for m in drawn],
        "details": ["\n".join(_details(m, track, rows.get(m.landmark, none))) for m in drawn],
    }


def _draw_move(plot: figure, m: LandmarkEstimate) -> None:
    """Draw an arrow to a moved landmark from its old position."""
    x, y = _old_position(m)
    plot.scatter([x], [y], marker="diamond", size=13, fill_color=None, line_color=MOVED)
    head = NormalHead(size=8, fill_color=MOVED, line_color=None)
    plot.add_layout(Arrow(x_start=x, y_start=y, x_end=m.x, y_end=m.y, end=head, line_color=MOVED))


def _old_position(m: LandmarkEstimate) -> tuple[float, float]:
    """Return the position in the direction of the home bearing, at the present distance [m]."""
    far = np.hypot(m.x, m.y)
    return far * np.cos(m.home_bearing_stored), far * np.sin(m.home_bearing_stored)


def _details(m: LandmarkEstimate, track: Track, rows: np.ndarray) -> list[str]:
    """Return the lines of a landmark's tooltip; `rows` are its rows of the track's innovations."""
    seen = track.innovations
    mine, rejected = rows[seen.accepted[rows]], int((~seen.accepted[rows]).sum())
    words_rejected = f"{rejected:,} rejected" if rejected else "none rejected"
    lines = [
        _moved_words(m, track),
        f"{words.count(m.sightings, 'sighting')} used, {words_rejected}",
    ]
    if mine.size:
        rms = float(np.sqrt(np.mean(seen.value[mine] ** 2)))
        nis = float(np.mean((seen.value[mine] / seen.sigma[mine]) ** 2))
        lines.append(f"innovations {words.degrees(rms)} RMS, mean NIS {nis:.2f}")
    sigma = m.sigma_distance
    spread = f", ± {words.quantity(sigma, 'm')}" if math.isfinite(sigma) else ""
    return [*lines, f"{words.quantity(m.distance, 'm')} from home{spread}"]


def _moved_words(m: LandmarkEstimate, track: Track) -> str:
    """Return whether a landmark moved, in words."""
    if math.isfinite(m.moved_at):
        return f"moved during the drive, at {words.quantity(m.moved_at - track.t[0], 's')}"
    if m.exchanged_with:
        return f"exchanged with {words.name(m.exchanged_with, 60)}"
    if m.moved is None:
        return "not tested" + (": no home bearing" if math.isnan(m.home_bearing_stored) else "")
    chance = f"(probability of having moved: {words.percent(m.moved_probability)})"
    return f"{'moved since home was stored' if m.moved else 'in place'} {chance}"
