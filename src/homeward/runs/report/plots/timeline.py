"""Timeline of sightings, a row per landmark, coloured by the probability of having moved."""

from __future__ import annotations

import math
from collections import Counter
from typing import Any

import numpy as np
from bokeh.models import ColumnDataSource, FixedTicker, PlainText, Range1d
from bokeh.plotting import figure

from homeward.drives.drive import Sightings
from homeward.io.naming import natural
from homeward.runs.report import words
from homeward.runs.report.palette import INK, LEVELS, MOVED, UNTESTED, colour, levels
from homeward.runs.report.plots.look import THEMED, add_hover, new_plot, runs, thin_dots
from homeward.track import Track

MAX_ROWS = 40
"""Maximum number of landmarks on the timeline."""
MAX_REJECTED = 200
"""Maximum number of rejected sightings marked per landmark."""
BINS = 800
"""Number of time steps of a row."""


def timeline(track: Track, sightings: Sightings, span: Range1d) -> figure:
    """Return the timeline; moved landmarks first, then those with the most sightings."""
    shown = _shown(track, sightings)
    plot = new_plot(60 + 19 * len(shown), "", x_range=span, y_range=Range1d(len(shown) - 0.4, -0.6))
    plot.ygrid.visible = False
    plot.xaxis.axis_label = "time [s]"
    plot.yaxis.ticker = FixedTicker(ticks=list(range(len(shown))))
    # Plain text: Bokeh would draw a name between dollar signs as a formula.
    plot.yaxis.major_label_overrides = {
        row: PlainText(words.name(i, 14)) for row, i in enumerate(shown)
    }
    _draw_presence(plot, shown, track, sightings)
    _draw_rejections(plot, shown, track)
    _mark_moves(plot, shown, track)
    return plot


def _shown(track: Track, sightings: Sightings) -> list[str]:
    """Return the ids of the rows, from the top."""
    moved = {m.landmark for m in track.landmarks if m.moved}
    seen = Counter(sightings.landmark.tolist())
    return sorted(seen, key=lambda i: (i not in moved, -seen[i], natural(i)))[:MAX_ROWS]


def _draw_presence(plot: figure, shown: list[str], track: Track, sightings: Sightings) -> None:
    """Draw a bar wherever a landmark was seen, coloured by its probability of having moved."""
    edges = np.linspace(0.0, float(track.t[-1] - track.t[0]), BINS + 1)
    if edges[-1] <= 0.0:
        return
    bars: list[tuple[Any, ...]] = []
    for row, landmark in enumerate(shown):
        t = sightings.t[sightings.landmark == landmark] - track.t[0]
        present = np.histogram(t, edges)[0] > 0
        shades = np.where(present, _levels(track, landmark, edges), -2)
        for first, last, level in runs(shades.tolist()):
            if level != -2:
                chance = f"probability of having moved: {words.percent(level / LEVELS)}"
                chance = "not tested" if level == UNTESTED else chance
                span, name = (float(edges[first]), float(edges[last])), words.name(landmark, 60)
                bars.append((row, *span, colour(level), name, chance))
    drawn = plot.hbar(
        y="row",
        left="left",
        right="right",
        height=0.5,
        fill_color="colour",
        line_color=None,
        source=_source(("row", "left", "right", "colour", "name", "chance"), bars),
    )
    add_hover(plot, "<b>@name</b> seen from @left{0.0} to @right{0.0} s<br>@chance", drawn)


def _source(names: tuple[str, ...], rows: list[tuple[Any, ...]]) -> ColumnDataSource:
    return ColumnDataSource({name: [row[k] for row in rows] for k, name in enumerate(names)})


def _levels(track: Track, landmark: str, edges: np.ndarray) -> np.ndarray:
    """Return the level of a landmark's probability of having moved in each bin of time."""
    history = track.history
    if landmark not in history.landmark:
        return np.full(edges.size - 1, UNTESTED)
    chance = history.moved_probability[:, history.landmark.index(landmark)]
    rows = history.at(edges[1:] + track.t[0])
    return levels(np.where(rows >= 0, chance[rows], np.nan))


def _draw_rejections(plot: figure, shown: list[str], track: Track) -> None:
    """Mark the sightings rejected by a gate."""
    seen = track.innovations
    ratio = seen.value / seen.sigma
    entries = seen.by_landmark()
    rejected: list[tuple[Any, ...]] = []
    for row, landmark in enumerate(shown):
        mine = entries.get(landmark, np.empty(0, int))
        mine = mine[~seen.accepted[mine]]
        mine = mine[thin_dots(np.abs(ratio[mine]), MAX_REJECTED)]
        name, when = words.name(landmark, 60), (seen.t[mine] - track.t[0]).tolist()
        rejected += [(t, row, name, r) for t, r in zip(when, ratio[mine].tolist(), strict=True)]
    ticks = plot.scatter(
        "t",
        "row",
        marker="dash",
        angle=math.pi / 2,
        size=11,
        line_color=INK,
        line_width=1.4,
        tags=[THEMED],
        source=_source(("t", "row", "name", "ratio"), rejected),
    )
    add_hover(plot, "<b>@name</b> rejected at @t{0.0} s<br>innovation @ratio{0.0} sigma", ticks)


def _mark_moves(plot: figure, shown: list[str], track: Track) -> None:
    """Mark the times at which landmarks moved during the drive."""
    moves = [
        (m.moved_at - track.t[0], shown.index(m.landmark), words.name(m.landmark, 60))
        for m in track.landmarks
        if m.landmark in shown and math.isfinite(m.moved_at)
    ]
    marks = plot.scatter(
        "t",
        "row",
        marker="diamond",
        size=12,
        fill_color="white",
        line_color=MOVED,
        line_width=1.6,
        source=_source(("t", "row", "name"), moves),
    )
    add_hover(plot, "<b>@name</b> moved at @t{0.0} s", marks)
