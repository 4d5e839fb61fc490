"""Plots over the time of a drive: errors or uncertainty, and consistency."""

from __future__ import annotations

import numpy as np
from bokeh.layouts import column
from bokeh.models import BoxAnnotation, Column, ColumnDataSource, DataRange1d, Range1d
from bokeh.plotting import figure
from scipy.special import chdtri

from homeward.drives.drive import Truth
from homeward.estimator import Status
from homeward.runs.report import words
from homeward.runs.report.palette import BLUE, INK, MOVED, STATUS_COLOURS
from homeward.runs.report.plots.look import THEMED, add_hover, new_plot, runs, thin, thin_dots
from homeward.runs.scoring import errors
from homeward.track import Track

MAX_DOTS = 4000
"""Maximum number of accepted, and of rejected, innovations drawn."""
NUM_WINDOWS, MIN_SIGHTINGS = 60, 10
"""Number of windows over which the NIS is averaged, and minimum number of sightings in each."""
NORMAL_95 = 1.959963984540054
"""97.5 % quantile of the normal distribution."""
BINS = 800
"""Number of time steps of a strip."""


def time_range(track: Track) -> Range1d:
    """Return the common time axis of the plots of a page [s]."""
    return Range1d(0.0, float(track.t[-1] - track.t[0]) or 1.0, bounds="auto")


def error_plots(track: Track, truth: Truth, span: Range1d) -> Column:
    """Return the errors of x, y and heading with their 3-sigma bands."""
    scored = errors(track, truth)
    rows = np.searchsorted(track.t, scored.t)
    plots = [_status_strip(track, span)]
    for values, column_number, scale, label, unit in (
        (scored.x, 0, 1.0, "x error [m]", "m"),
        (scored.y, 1, 1.0, "y error [m]", "m"),
        (scored.heading, 2, np.degrees(1.0), "heading error [°]", "°"),
    ):
        error = np.full(track.t.size, np.nan)
        error[rows] = scale * values
        plot = new_plot(165, label, x_range=span)
        bound = 3.0 * scale * track.sigmas[:, column_number]
        _draw_error(plot, track.t - track.t[0], error, bound, unit)
        plots.append(plot)
    return _stack(plots)


def sigma_plots(track: Track, span: Range1d) -> Column:
    """Return the standard deviations of x, y and heading, for runs without ground truth."""
    plots = [_status_strip(track, span)]
    t = track.t - track.t[0]
    for columns, scale, label in (
        (((0, BLUE, "x"), (1, MOVED, "y")), 1.0, "sigma [m]"),
        (((2, BLUE, "heading"),), np.degrees(1.0), "sigma [°]"),
    ):
        plot = new_plot(190, label, x_range=span, y_range=DataRange1d(start=0))
        for number, colour, name in columns:
            sigma = scale * track.sigmas[:, number]
            rows = thin(sigma)
            line = plot.line(_tidy(t[rows]), _tidy(sigma[rows]), color=colour, line_width=1.4)
            add_hover(plot, f"{name}: $y{{0.000}}<br>at $x{{0.0}} s", line, mode="vline")
        plots.append(plot)
    return _stack(plots)


def consistency_plots(track: Track, span: Range1d) -> Column:
    """Return each innovation over its predicted sigma, and the mean NIS against its bounds.

    The mean of n squared unit normals should be between the 2.5 and the 97.5 % quantile of
    chi-square(n) over n. Rejected sightings do not count, which lowers it a little.
    """
    return _stack([_innovations(track, span), _mean_nis(track, span)])


def chi_square_interval(n: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the 95 % interval of the mean of n squared unit normals."""
    return chdtri(n, 0.975) / n, chdtri(n, 0.025) / n


def windowed_nis(track: Track) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return spans (w, 2) [s of the drive], numbers of sightings and mean NIS (w,) of windows.

    A window is a share of the drive, extended until it has `MIN_SIGHTINGS` sightings.
    """
    seen = track.innovations
    t = seen.t[seen.accepted] - track.t[0]
    nis = ((seen.value / seen.sigma) ** 2)[seen.accepted]
    every = float(track.t[-1] - track.t[0]) / NUM_WINDOWS
    starts: list[int] = [0] if t.size else []
    for row in range(MIN_SIGHTINGS, t.size - MIN_SIGHTINGS + 1):
        if row - starts[-1] >= MIN_SIGHTINGS and t[row] - t[starts[-1]] >= every:
            starts.append(row)
    first = np.array(starts, int)
    number = np.diff(first, append=t.size)
    spans = np.column_stack([t[first], t[first + number - 1]])
    return spans, number, np.add.reduceat(nis, first) / number if t.size else nis


def _stack(plots: list[figure]) -> Column:
    """Return plots below each other, with a time axis at the last only."""
    for plot in plots[:-1]:
        plot.xaxis.visible = False
    plots[-1].xaxis.axis_label = "time [s]"
    plots[-1].height += 45
    return column(*plots, sizing_mode="stretch_width", spacing=6)


def _status_strip(track: Track, span: Range1d) -> figure:
    """Return the status over time as a coloured strip; each bin shows its longest status."""
    plot = new_plot(30, "", x_range=span, y_range=Range1d(0, 1))
    plot.yaxis.visible = plot.ygrid.visible = False
    plot.toolbar_location = None
    t = track.t - track.t[0]
    at = np.linspace(0.0, t[-1], BINS + 1)
    statuses = [s for s in Status if s in track.status]
    here = np.array([[r is s for r in track.status[:-1]] for s in statuses])
    spent = [np.append(0.0, np.cumsum(rows * np.diff(t))) for rows in here]
    longest = np.argmax([np.diff(np.interp(at, t, seconds)) for seconds in spent], axis=0)
    pieces = list(runs([statuses[i] for i in longest]))
    columns = {
        "left": [at[first] for first, _, _ in pieces],
        "right": [at[last] for _, last, _ in pieces],
        "colour": [STATUS_COLOURS[status] for _, _, status in pieces],
        "status": [status.value for _, _, status in pieces],
        "reason": [_reason(track, status, at[first], at[last]) for first, last, status in pieces],
    }
    strip = plot.quad(
        left="left",
        right="right",
        bottom=0,
        top=1,
        line_color=None,
        fill_color="colour",
        source=ColumnDataSource(columns),
    )
    tip = "<b>@status</b>, @left{0.0} to @right{0.0} s<br>@reason"
    add_hover(plot, tip, strip, attachment="below")
    return plot


def _reason(track: Track, status: Status, begin: float, end: float) -> str:
    """Return the first reason of a status between two times of the drive [s]."""
    t = track.t - track.t[0]
    rows = range(*np.searchsorted(t, [begin, end]).tolist())
    return next((track.reason[row] for row in rows if track.status[row] is status), "")


def _draw_error(
    plot: figure, t: np.ndarray, error: np.ndarray, bound: np.ndarray, unit: str
) -> None:
    """Draw an error and its band; a band far wider than the errors is cut off."""
    wide = thin(bound)
    plot.varea(_tidy(t[wide]), _tidy(-bound[wide]), _tidy(bound[wide]), color=BLUE, alpha=0.18)
    rows = thin(error)
    columns = {"t": t[rows], "error": error[rows], "bound": bound[rows]}
    source = ColumnDataSource({k: _tidy(v) for k, v in columns.items()})
    line = plot.line("t", "error", source=source, color=INK, line_width=1.2, tags=[THEMED])
    tip = f"@error{{0.000}} {unit}, 3 sigma @bound{{0.000}} {unit}<br>at @t{{0.0}} s"
    add_hover(plot, tip, line, mode="vline")
    known = np.isfinite(error)
    if known.any():
        usual = 2.0 * float(np.median(bound[known]))
        reach = 1.08 * max(float(np.abs(error[known]).max()), usual, 1e-6)
        plot.y_range = Range1d(-reach, reach)


def _innovations(track: Track, span: Range1d) -> figure:
    """Return innovations over their predicted sigmas as dots, rejected ones as crosses."""
    seen = track.innovations
    ratio = seen.value / seen.sigma
    reach = float(np.clip(np.quantile(np.abs(ratio), 0.995) * 1.2, 4.0, 12.0))
    plot = new_plot(
        210, "innovation / sigma", x_range=span, y_range=Range1d(-1.04 * reach, 1.04 * reach)
    )
    plot.add_layout(
        BoxAnnotation(
            bottom=-NORMAL_95, top=NORMAL_95, fill_color=BLUE, fill_alpha=0.12, line_color=None
        )
    )
    for wanted, marker, colour, size in (
        (seen.accepted, "circle", BLUE, 3),
        (~seen.accepted, "x", MOVED, 7),
    ):
        rows = np.flatnonzero(wanted)
        rows = rows[thin_dots(np.abs(ratio[rows]), MAX_DOTS)]
        columns = {
            "t": _tidy(seen.t[rows] - track.t[0]),
            "shown": _tidy(np.clip(ratio[rows], -reach, reach)),
            "ratio": _tidy(ratio[rows]),
            "degrees": _tidy(np.degrees(seen.value[rows])),
            "landmark": [words.name(str(i)) for i in seen.landmark[rows]],
        }
        dots = plot.scatter(
            "t",
            "shown",
            marker=marker,
            size=size,
            fill_color=colour,
            line_color=colour if marker == "x" else None,
            fill_alpha=0.55,
            source=ColumnDataSource(columns),
        )
        if marker == "x":
            tip = "<b>@landmark</b> rejected at @t{0.0} s<br>@ratio{0.0} sigma, @degrees{0.0}°"
            add_hover(plot, tip, dots)
    return plot


def _mean_nis(track: Track, span: Range1d) -> figure:
    """Return the mean NIS of windows of the drive, with its 95 % interval."""
    spans, number, mean = windowed_nis(track)
    low, high = chi_square_interval(number)
    top = max(2.0, 1.1 * float(np.max(mean, initial=0.0)), 1.1 * float(np.max(high, initial=0.0)))
    plot = new_plot(150, "mean NIS", x_range=span, y_range=Range1d(0.0, top))
    inside = (mean >= low) & (mean <= high)
    columns = {
        "left": spans[:, 0],
        "right": spans[:, 1],
        "low": low,
        "high": high,
        "mean": mean,
        "number": number,
        "middle": spans.mean(axis=1),
        "colour": np.where(inside, BLUE, MOVED).tolist(),
    }
    source = ColumnDataSource(columns)
    band = plot.quad(
        left="left",
        right="right",
        bottom="low",
        top="high",
        fill_color=BLUE,
        fill_alpha=0.14,
        line_color=None,
        source=source,
    )
    plot.segment("left", "mean", "right", "mean", color="colour", line_width=2, source=source)
    plot.scatter("middle", "mean", size=5, color="colour", source=source)
    tip = "mean NIS @mean{0.00} of @number{0,0} sightings<br>expected: @low{0.00} to @high{0.00}"
    add_hover(plot, tip, band, mode="vline")
    return plot


def _tidy(values: np.ndarray) -> np.ndarray:
    """Return numbers in single precision, half the size of doubles."""
    return np.asarray(values, np.float32)
