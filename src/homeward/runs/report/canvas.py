"""Style of the matplotlib figures, and their export as SVG and PNG.

Figures use matplotlib's objects directly, so nothing here touches pyplot's global state.
"""

from __future__ import annotations

import io
import re
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal

import matplotlib
import numpy as np
from markupsafe import Markup
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from homeward.errors import printable
from homeward.runs.report.palette import INK, MUTED, RULE

WIDTH_IN = 7.2
"""Width of every figure [inch]; the page scales it."""

GAP_IN = 0.06
"""Minimum gap between tick labels [inch]."""

_STYLE: dict[str, Any] = {
    "axes.formatter.min_exponent": 3,  # 0.06 on a logarithmic axis, not 6 x 10^-2
    "font.size": 9.0,
    "axes.labelsize": 9.0,
    "axes.labelpad": 7.0,
    "axes.edgecolor": MUTED,
    "axes.labelcolor": INK,
    "axes.linewidth": 0.6,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.formatter.useoffset": False,
    "grid.color": RULE,
    "grid.linewidth": 0.6,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "xtick.major.size": 0.0,
    "ytick.major.size": 0.0,
    "text.color": INK,
    "legend.frameon": False,
    "legend.fontsize": 9.0,
    "legend.handlelength": 1.4,
    "legend.columnspacing": 3.6,
    "lines.solid_capstyle": "round",
    "lines.linewidth": 1.2,
    "svg.fonttype": "none",
    "figure.facecolor": "white",
    "axes.facecolor": "none",
    "figure.constrained_layout.use": True,
}


@contextmanager
def style(salt: str = "homeward") -> Iterator[None]:
    """Draw in homeward's style within this block; `salt` makes ids in the SVG unique to it."""
    rc: Any = {**_STYLE, "svg.hashsalt": salt}
    with matplotlib.rc_context(rc), warnings.catch_warnings():
        # Landmarks may have any name; a missing glyph is drawn as a box.
        warnings.filterwarnings("ignore", message="Glyph .* missing from font")
        yield


def plain(label: str) -> str:
    """Escape a user's label so that matplotlib does not draw it as a formula."""
    return printable(label).replace("$", r"\$")


@contextmanager
def styled_figure(height_in: float, salt: str = "homeward") -> Iterator[Figure]:
    """Yield an empty figure of the common width, to be drawn within this block; see `style`."""
    with style(salt):
        figure = Figure(figsize=(WIDTH_IN, height_in))
        FigureCanvasAgg(figure)
        yield figure


def png(figure: Figure, dpi: float = 150) -> bytes:
    """Return a figure as PNG."""
    out = io.BytesIO()
    with style():
        figure.savefig(out, format="png", dpi=dpi, metadata={"Software": None})
    return out.getvalue()


def drawn(
    folder: Path,
    name: str,
    caption: str,
    figure: Figure,
    vector: Literal["svg", "pdf"] | None = None,
) -> tuple[str, Markup]:
    """Write a figure into a folder as PNG, and as a file of a `vector` format.

    Returns its caption, which must need no escaping, and its SVG for a page.
    """
    drawing = svg(figure, caption)
    # The PNG has the layout of the SVG: computing it again takes the most time.
    figure.set_layout_engine("none")
    (folder / f"{name}.png").write_bytes(png(figure))
    if vector == "pdf":
        figure.savefig(folder / f"{name}.pdf", metadata={"CreationDate": None})
    elif vector == "svg":
        (folder / f"{name}.svg").write_text(svg_file(drawing), encoding="utf-8")
    return caption, Markup(drawing)  # matplotlib has escaped every text


def svg(figure: Figure, label: str) -> str:
    """Return a figure as an SVG element without background, self-contained, for a page.

    `label` is the description for screen readers; it must need no escaping.
    """
    out = io.StringIO()
    with style(label):
        figure.savefig(out, format="svg", facecolor="none", metadata={"Date": None})
    text = out.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, count=1, flags=re.DOTALL)
    text = re.sub(r'<g id="[A-Za-z]+[\dA-Za-z.]*_\d+">', "<g>", text)
    # Shorten numbers in tags only, not in the figure's text.
    text = re.sub(r"<[^>]+>", lambda tag: re.sub(r"(?<=\d\.\d\d)\d+", "", tag[0]), text)
    head, body = text.split(">", 1)
    box = re.search(r'viewBox="[^"]*"', head)
    assert box is not None
    return f'<svg {box[0]} role="img" aria-label="{label}">{body}'


def svg_file(drawing: str) -> str:
    """Return an element from `svg` as the text of a file, on white."""
    head = '<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink"'
    ground = '<rect width="100%" height="100%" fill="white"/>'
    tag, body = drawing.replace("<svg", head, 1).split(">", 1)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{tag}>{ground}{body}\n'


def legend_below(figure: Figure, handles: Sequence[Artist], max_columns: int = 4) -> None:
    """Put a legend below a figure, in as many columns as fit, at most `max_columns`."""
    for columns in range(max_columns, 0, -1):
        legend = figure.legend(handles=handles, loc="outside lower center", ncols=columns)
        if legend.get_window_extent().width <= figure.bbox.width:
            return
        if columns > 1:
            legend.remove()


def uncrowd(figure: Figure) -> None:
    """Thin out ticks along x until their labels do not touch."""
    figure.draw_without_rendering()
    for axis in (axes.xaxis for axes in figure.axes):
        low, high = sorted(axis.get_view_interval())
        shown = [tick for tick in axis.get_major_ticks() if low <= tick.get_loc() <= high]
        boxes = [tick.label1.get_window_extent() for tick in shown if tick.label1.get_visible()]
        gap = figure.dpi * GAP_IN
        step = 1
        while any(a.x1 + gap > b.x0 for a, b in pairwise(boxes[::step])):
            step += 1
        if step > 1:
            kept = shown[::step]
            axis.set_ticks([t.get_loc() for t in kept], [t.label1.get_text() for t in kept])


def quantile_bar(
    axes: Axes, place: float, values: np.ndarray, colour: str, hollow: bool = False
) -> None:
    """Draw five quantiles as a thin and a thick line and a dot, or `hollow` without the thick line.

    Values are clipped to [1e-12, 1e12].
    """
    shown = np.clip(values, 1e-12, 1e12)
    axes.plot(shown[[0, 4]], (place, place), color=colour, lw=1.2, alpha=0.6)
    if not hollow:
        half = shown[[1, 3]]
        axes.plot(half, (place, place), color=colour, lw=4, solid_capstyle="butt", alpha=0.6)
    face, edge = ("white", colour) if hollow else (colour, "white")
    axes.plot(shown[2], place, "o", ms=5, color=face, mec=edge, mew=0.8)


def name_mark(
    axes: Axes, text: str, at: np.ndarray, offset: tuple[float, float], **options: Any
) -> None:
    """Write a user's label unchanged, at an `offset` [points] from a position `at` (2,)."""
    options |= {"in_layout": False, "parse_math": False}
    axes.annotate(text, (at[0], at[1]), offset, textcoords="offset points", **options)


def log_axis(axes: Axes, ticks: LogLocator) -> None:
    """Give axes a logarithmic x axis with plain numbers, and labels at major ticks only."""
    axes.set_xscale("log")
    axes.xaxis.set_major_locator(ticks)
    axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.xaxis.set_minor_formatter(NullFormatter())


def bare(axes: Axes) -> None:
    """Remove the grid, y ticks and frame of axes."""
    axes.grid(False)
    axes.set_yticks([])
    axes.spines[:].set_visible(False)
