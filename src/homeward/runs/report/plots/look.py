"""Style, tools and embedding of the plots of a page.

Plots use Bokeh: its script is a quarter of plotly's, draws on a canvas, which stays fast with
thousands of points under a slider, and needs neither a network nor `eval`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, TypeVar

import numpy as np
from bokeh.core.json_encoder import serialize_json
from bokeh.document import Document
from bokeh.models import BoxZoomTool, HoverTool, PanTool, ResetTool, Span, UIElement, WheelZoomTool
from bokeh.plotting import figure
from bokeh.resources import Resources

from homeward.runs.report.palette import INK

FONT = "system-ui, 'Segoe UI', Roboto, 'Helvetica Neue', sans-serif"
TYPE = "12px"
THEMED = "ink"
"""Tag of elements in the colour of the text; the page's script adapts it to dark and light."""
CURSOR = "cursor"
"""Tag of the lines that show the slider's moment."""


def new_plot(height: int, y_label: str, **options: Any) -> figure:
    """Return an empty plot over the time of a drive, `height` in px, with zoom along the time axis.

    `options` are those of `bokeh.plotting.figure`.
    """
    drag, wheel = BoxZoomTool(dimensions="width"), WheelZoomTool(dimensions="width")
    wheel.modifiers = {"ctrl": True}
    plot = figure(
        height=height,
        sizing_mode="stretch_width",
        tools=[drag, PanTool(dimensions="width"), wheel, ResetTool()],
        active_drag=drag,
        active_scroll=wheel,
        y_axis_label=y_label,
        min_border_left=76,
        **options,
    )
    plot.xgrid.visible = False
    cursor = Span(dimension="height", line_width=1, line_color=INK, tags=[CURSOR, THEMED])
    plot.add_layout(cursor)
    return restyled(plot)


def restyled(plot: figure) -> figure:
    """Return a plot in the page's style: its font, no frame, tools only under the mouse."""
    plot.toolbar.logo = None
    plot.toolbar.autohide = True
    plot.toolbar_inner = True
    plot.background_fill_color = plot.border_fill_color = None
    plot.outline_line_color = None
    for axis in plot.axis:
        axis.axis_label_text_font = axis.major_label_text_font = FONT
        axis.axis_label_text_font_size = axis.major_label_text_font_size = TYPE
        axis.axis_label_text_font_style = "normal"
        axis.axis_line_color = axis.major_tick_line_color = axis.minor_tick_line_color = None
    return plot


def add_hover(plot: figure, tip: str, *renderers: Any, **options: Any) -> None:
    """Add a tooltip for `renderers`; Bokeh escapes the value of each ``@column``."""
    plot.add_tools(HoverTool(renderers=list(renderers), tooltips=tip, **options))


def embedded(plots: Mapping[str, UIElement], **data: Any) -> str:
    """Return plots and further data of a page as JSON: {doc, roots, ...}; roots maps ids to names.

    Bokeh numbers its models per process; here they are numbered by their order, so that the same
    plots give the same text.
    """
    document = Document()
    for plot in plots.values():
        document.add_root(plot)
    numbers: dict[str, str] = {}
    doc = _renumbered(document.to_json(deferred=False), numbers)
    roots = {numbers[plot.id]: name for name, plot in plots.items()}
    return str(serialize_json({"doc": doc, "roots": roots, **data}))


def script() -> str:
    """Return the script of Bokeh."""
    return str(Resources(mode="inline", components=["bokeh"]).js_raw[0])


def _renumbered(tree: Any, numbers: dict[str, str]) -> Any:
    """Return a tree of JSON with the ids of models replaced by numbers in order of appearance."""
    if isinstance(tree, dict):
        return {
            key: numbers.setdefault(value, f"m{len(numbers)}")
            if key == "id" and isinstance(value, str)
            else _renumbered(value, numbers)
            for key, value in tree.items()
        }
    return [_renumbered(v, numbers) for v in tree] if isinstance(tree, list | tuple) else tree


Label = TypeVar("Label")
MAX_LINE_ROWS = 1600
"""Approximate maximum number of rows of a line."""


def thin(values: np.ndarray) -> np.ndarray:
    """Return the rows that draw a line like `values`, (n,); extremes and breaks (NaN) remain."""
    if values.size <= MAX_LINE_ROWS:
        return np.arange(values.size)
    keep: set[int] = {0, values.size - 1}
    for part in np.array_split(np.arange(values.size), MAX_LINE_ROWS // 2):
        known = part[np.isfinite(values[part])]
        if known.size < part.size:
            keep.add(int(part[~np.isfinite(values[part])][0]))
        if known.size:
            keep.add(int(known[np.argmin(values[known])]))
            keep.add(int(known[np.argmax(values[known])]))
    return np.array(sorted(keep))


def thin_dots(size: np.ndarray, max_dots: int) -> np.ndarray:
    """Return at most `max_dots` rows to draw: a tenth are the largest, the others evenly spaced."""
    if size.size <= max_dots:
        return np.arange(size.size)
    largest = np.argsort(-size, kind="stable")[: max_dots // 10]
    evenly = np.linspace(0, size.size - 1, max_dots - largest.size).astype(int)
    return np.union1d(largest, evenly)


def runs(labels: Sequence[Label]) -> Iterator[tuple[int, int, Label]]:
    """Yield (first row, row after the last, label) of each run of equal labels."""
    start = 0
    for row in range(1, len(labels) + 1):
        if row == len(labels) or labels[row] != labels[start]:
            yield start, row, labels[start]
            start = row
