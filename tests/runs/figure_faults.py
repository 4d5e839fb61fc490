"""Faults of figures: ticks that collide, texts that are cut."""

from itertools import combinations, pairwise

from matplotlib.axis import XAxis
from matplotlib.legend import Legend
from matplotlib.text import Text


def faults(figure):
    """Return in words which labels of ticks overlap, and which texts leave the figure."""
    figure.draw_without_rendering()
    return [*_collisions(figure), *_cut(figure)]


def _collisions(figure):
    for axis in (axis for axes in figure.axes for axis in (axes.xaxis, axes.yaxis)):
        low, high = sorted(axis.get_view_interval())
        shown = [t.label1 for t in axis.get_major_ticks() if low <= t.get_loc() <= high]
        shown = [label for label in shown if label.get_visible() and label.get_text().strip()]
        for a, b in combinations(shown, 2):
            if a.get_window_extent().overlaps(b.get_window_extent()):
                yield f"{a.get_text()!r} on {b.get_text()!r}"
        if isinstance(axis, XAxis):
            boxes = sorted(label.get_window_extent().extents.tolist() for label in shown)
            if any(b[0] - a[2] < 2 for a, b in pairwise(boxes)):
                yield f"no room between {[label.get_text() for label in shown]}"
    below = [c for c in figure.get_children() if isinstance(c, Legend)]
    labels = [a.xaxis.label for a in figure.axes if a.xaxis.label.get_text()]
    for legend in below:
        for label in labels:
            if legend.get_window_extent().overlaps(label.get_window_extent()):
                yield f"the legend on {label.get_text()!r}"


def _cut(figure):
    west, south, east, north = figure.bbox.extents
    ticks = {
        text
        for axes in figure.axes
        for axis in (axes.xaxis, axes.yaxis)
        for tick in (*axis.get_major_ticks(), *axis.get_minor_ticks())
        if not min(axis.get_view_interval()) <= tick.get_loc() <= max(axis.get_view_interval())
        for text in (tick.label1, tick.label2)
    }
    for text in figure.findobj(Text):
        if text in ticks or not text.get_visible() or not text.get_text().strip():
            continue
        if not text.axes or text.axes.get_visible():
            box = text.get_window_extent()
            inside = west - 1 <= box.x0 and box.x1 <= east + 1
            if not (inside and south - 1 <= box.y0 and box.y1 <= north + 1):
                yield f"{text.get_text()!r} is cut"
