"""Figures over time: errors or uncertainty, innovations, and who was seen when."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from homeward.drives.drive import Sightings, Truth
from homeward.estimator import LandmarkEstimate, Status
from homeward.report.canvas import (
    BLUE,
    INK,
    MOVED,
    RULE,
    STATUS_COLOURS,
    bare,
    new_figure,
    runs,
    style,
    thin,
)
from homeward.report.words import name
from homeward.scoring import errors
from homeward.track import Innovations, Track

MOST_DOTS = 1500
"""Innovations drawn, of either kind."""
MOST_ROWS = 40
"""Landmarks on the timeline."""
BINS = 800
"""Steps of time that a timeline tells apart."""


def draw_errors(track: Track, truth: Truth) -> Figure:
    """Draw the errors of x, y and heading over time, with the 3-sigma bands claimed for them.

    Parameters
    ----------
    track : Track
        Estimates and covariances.
    truth : Truth
        True poses.
    """
    judged = errors(track, truth)
    with style():
        figure = new_figure(5.2)
        strip, *panels = _panels(figure, track, 3)
        _draw_status(strip, track)
        rows = np.searchsorted(track.t, judged.t)
        for panel, values, column, scale, label in (
            (panels[0], judged.x, 0, 1.0, "x [m]"),
            (panels[1], judged.y, 1, 1.0, "y [m]"),
            (panels[2], judged.heading, 2, np.degrees(1.0), "heading [deg]"),
        ):
            error = np.full(track.t.size, np.nan)
            error[rows] = scale * values
            _draw_error(panel, track.t - track.t[0], error, 3 * scale * track.sigmas[:, column])
            panel.set_ylabel(label)
        band = Patch(facecolor=BLUE, alpha=0.18, label="±3 sigma claimed")
        line = Line2D([], [], color=INK, lw=1.0, label="error")
        _legend_below(figure, [line, band, *_status_handles(track)])
    return figure


def draw_sigmas(track: Track) -> Figure:
    """Draw the standard deviations of x, y and heading over time, for runs without truth."""
    with style():
        figure = new_figure(4.0)
        strip, position, heading = _panels(figure, track, 2)
        _draw_status(strip, track)
        t = track.t - track.t[0]
        for panel, column, scale, colour in (
            (position, 0, 1.0, BLUE),
            (position, 1, 1.0, MOVED),
            (heading, 2, np.degrees(1.0), INK),
        ):
            sigma = scale * track.sigmas[:, column]
            rows = thin(sigma)
            panel.plot(t[rows], sigma[rows], color=colour, lw=1.0)
        position.set_ylim(bottom=0)
        heading.set_ylim(bottom=0)
        position.set_ylabel("sigma [m]")
        heading.set_ylabel("sigma [deg]")
        lines = [
            Line2D([], [], color=c, lw=1.0, label=word)
            for c, word in ((BLUE, "x"), (MOVED, "y"), (INK, "heading"))
        ]
        _legend_below(figure, [*lines, *_status_handles(track)])
    return figure


def draw_innovations(track: Track) -> Figure:
    """Draw each innovation over its predicted sigma: over time, and how often."""
    seen = track.innovations
    with style():
        figure = new_figure(2.9)
        over_time, often = figure.subplots(
            1, 2, sharey=True, gridspec_kw={"width_ratios": [5, 1], "wspace": 0.02}
        )
        ratio = seen.value / seen.sigma
        reach = float(np.clip(np.quantile(np.abs(ratio), 0.995) * 1.2, 4.0, 12.0))
        over_time.axhspan(-1.96, 1.96, color=BLUE, alpha=0.10, lw=0)
        _draw_dots(over_time, seen, np.clip(ratio, -reach, reach), float(track.t[0]))
        _draw_histogram(often, ratio[seen.accepted], reach)
        over_time.set(
            ylim=(-1.04 * reach, 1.04 * reach), xlabel="time [s]", ylabel="innovation / sigma"
        )
        entries = [
            Line2D([], [], color=BLUE, marker="o", ms=3, mew=0, ls="none", label="used"),
            Line2D([], [], color=MOVED, marker="x", ms=4, ls="none", label="rejected"),
            Patch(facecolor=BLUE, alpha=0.15, label="95 % should lie here"),
        ]
        _legend_below(figure, entries)
    return figure


def draw_sightings(track: Track, sightings: Sightings) -> Figure:
    """Draw who was seen when, a row per landmark; moved ones first, then the most seen."""
    names = {m.landmark: m for m in track.landmarks}
    ids, numbers = np.unique(sightings.landmark, return_counts=True)
    moved = np.array([bool(i in names and names[i].moved) for i in ids], bool)
    shown = [str(i) for i in ids[np.lexsort((-numbers, ~moved))][:MOST_ROWS]]
    with style():
        figure = new_figure(0.95 + 0.2 * len(shown))
        axes = figure.add_subplot()
        for row, landmark in enumerate(shown):
            t = sightings.t[sightings.landmark == landmark] - track.t[0]
            colour = MOVED if landmark in names and names[landmark].moved else BLUE
            _draw_presence(axes, row, t, (0.0, float(track.t[-1] - track.t[0])), colour)
            _draw_rejections(axes, row, landmark, track)
            if landmark in names:
                _mark_move(axes, row, names[landmark], float(track.t[0]))
        axes.set_ylim(len(shown) - 0.4, -0.6)
        axes.set_yticks(range(len(shown)))
        labels = axes.set_yticklabels([name(i) for i in shown], parse_math=False)
        for landmark, label in zip(shown, labels, strict=True):
            label.set_color(MOVED if landmark in names and names[landmark].moved else INK)
        # Room for the page to enlarge the type on a phone.
        room = 0.0035 * max(len(label.get_text()) for label in labels)
        figure.set_layout_engine("constrained", rect=(room, 0.0, 1.0 - room, 1.0))
        axes.grid(False, axis="y")
        axes.set_xlabel("time [s]")
        axes.set_xlim(0.0, float(track.t[-1] - track.t[0]) or 1.0)
        _legend_below(
            figure,
            [
                Line2D([], [], color=BLUE, lw=4, solid_capstyle="butt", label="seen"),
                Line2D([], [], color=MOVED, lw=4, solid_capstyle="butt", label="seen, moved"),
                Line2D([], [], color=INK, marker="|", ms=6, ls="none", label="rejected"),
            ],
        )
    return figure


def _panels(figure: Figure, track: Track, number: int) -> list[Axes]:
    """Return a thin axes for the status and `number` panels below it, over one time."""
    ratios = [0.12] + [1.0] * number
    axes = figure.subplots(number + 1, 1, sharex=True, gridspec_kw={"height_ratios": ratios})
    axes[-1].set_xlabel("time [s]")
    axes[-1].set_xlim(0.0, float(track.t[-1] - track.t[0]) or 1.0)
    figure.align_ylabels()
    return list(axes)


def _draw_status(axes: Axes, track: Track) -> None:
    """Draw the status over time as a strip of colour; the longest of each bin shows."""
    t = track.t - track.t[0]
    at = np.linspace(0.0, t[-1], BINS + 1)
    statuses = [s for s in Status if s in track.status]
    here = np.array([[r is s for r in track.status[:-1]] for s in statuses])
    spent = [np.append(0.0, np.cumsum(rows * np.diff(t))) for rows in here]
    longest = np.argmax([np.diff(np.interp(at, t, seconds)) for seconds in spent], axis=0)
    for first, last, status in runs([statuses[i] for i in longest]):
        axes.axvspan(at[first], at[last], color=STATUS_COLOURS[status], lw=0)
    axes.set_ylim(0, 1)
    bare(axes)


def _status_handles(track: Track) -> list[Patch]:
    """Return the legend's entries of the statuses that occurred."""
    return [Patch(facecolor=STATUS_COLOURS[s], label=s.value) for s in Status if s in track.status]


def _legend_below(figure: Figure, handles: Sequence[Artist]) -> None:
    """Put a legend below everything."""
    columns = len(handles) if len(handles) <= 4 else (len(handles) + 1) // 2
    figure.legend(handles=handles, loc="outside lower center", ncols=columns)


def _draw_error(axes: Axes, t: np.ndarray, error: np.ndarray, bound: np.ndarray) -> None:
    """Draw an error in its band; a band far wider than the errors is cut off."""
    wide = thin(bound)
    axes.fill_between(
        t[wide], -bound[wide], bound[wide], color=BLUE, alpha=0.18, lw=0, edgecolor="none"
    )
    rows = thin(error)
    axes.plot(t[rows], error[rows], color=INK, lw=1.0)
    judged = np.isfinite(error)
    if judged.any():
        usual = 2.0 * float(np.median(bound[judged]))
        reach = 1.08 * max(float(np.abs(error[judged]).max()), usual, 1e-6)
        axes.set_ylim(-reach, reach)


def _draw_dots(axes: Axes, seen: Innovations, ratio: np.ndarray, start: float) -> None:
    """Draw normalised innovations as dots, rejected ones as crosses."""
    used: dict[str, Any] = {"marker": "o", "ms": 2.0, "mew": 0, "color": BLUE, "alpha": 0.5}
    rejected: dict[str, Any] = {"marker": "x", "ms": 3.5, "mew": 0.9, "color": MOVED}
    for wanted, look in ((seen.accepted, used), (~seen.accepted, rejected)):
        rows = np.flatnonzero(wanted)
        rows = rows[:: max(1, -(-rows.size // MOST_DOTS))]
        axes.plot(seen.t[rows] - start, ratio[rows], ls="none", **look)


def _draw_histogram(axes: Axes, ratio: np.ndarray, reach: float) -> None:
    """Draw how often each normalised innovation came, beside the normal density."""
    counts, edges = np.histogram(ratio, bins=48, range=(-reach, reach))
    density = counts / max(counts.sum(), 1) / (edges[1] - edges[0])
    axes.stairs(density, edges, orientation="horizontal", fill=True, color=BLUE, alpha=0.35)
    z = np.linspace(-reach, reach, 121)
    axes.plot(np.exp(-(z**2) / 2) / np.sqrt(2 * np.pi), z, color=INK, lw=1.0)
    axes.set_xticks([])
    axes.grid(False)
    axes.spines["bottom"].set_visible(False)


def _draw_presence(
    axes: Axes, row: int, t: np.ndarray, span: tuple[float, float], colour: str
) -> None:
    """Draw a bar wherever a landmark was seen, to one bin of the time shown."""
    edges = np.linspace(*span, BINS + 1)
    if span[1] <= span[0]:
        return
    present = np.histogram(t, edges)[0] > 0
    change = np.flatnonzero(np.diff(np.concatenate([[0], present.astype(int), [0]])))
    starts, ends = edges[change[::2]], edges[change[1::2]]
    x = np.column_stack([starts, ends, np.full(starts.size, np.nan)]).ravel()
    axes.plot(span, (row, row), color=RULE, lw=0.8, zorder=1)
    axes.plot(x, np.full(x.size, float(row)), color=colour, lw=5, solid_capstyle="butt", zorder=2)


def _draw_rejections(axes: Axes, row: int, landmark: str, track: Track) -> None:
    """Mark the sightings of a landmark that a gate rejected."""
    seen = track.innovations
    t = seen.t[(seen.landmark == landmark) & ~seen.accepted] - track.t[0]
    t = t[:: max(1, -(-t.size // 200))]
    axes.plot(t, np.full(t.size, float(row)), "|", color=INK, ms=6, mew=0.9, zorder=3)


def _mark_move(axes: Axes, row: int, m: LandmarkEstimate, start: float) -> None:
    """Mark when a landmark moved during the drive."""
    if np.isfinite(m.moved_at):
        axes.plot(m.moved_at - start, row, "D", ms=6, mfc="white", mec=MOVED, mew=1.2, zorder=4)
