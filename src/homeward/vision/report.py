"""Report of a comparison of two panoramas: text, picture and files."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from homeward.io.table import write_csv
from homeward.io.writing import whole_folder
from homeward.runs.report.canvas import WIDTH_IN, bare, png, styled_figure
from homeward.runs.report.files import number
from homeward.runs.report.palette import BLUE, INK, MUTED, VERMILLION
from homeward.vision.comparison import Comparison
from homeward.vision.features.detection import Features

Images = tuple[np.ndarray, np.ndarray]
"""Panoramas at home and now, uint8 (height, width)."""
Views = tuple[Features, Features]
RESULT, MATCHES, PICTURE = "comparison.json", "matches.csv", "comparison.png"
MAX_LINES = 60
"""Maximum number of matches joined by a line: more would hide the images."""


def describe(seen: Comparison) -> str:
    """Return heading change and direction home as text."""
    if not seen.accepted:
        return f"No answer: {seen.acceptance.reason}."
    heading = f"Heading change: {_turn(seen.heading)} +- {_deg(seen.heading_sigma)}."
    if seen.has_direction:
        home = f"Home lies {_turn(seen.home_direction)} of the camera's axis"
        home += f" +- {_deg(seen.home_direction_sigma)}."
    else:
        home = "Direction home unknown: home is too near, or too few features agree."
    text = f"{heading} {home} {seen.acceptance.reason[0].upper()}{seen.acceptance.reason[1:]}."
    if moved := int(seen.moved.sum()):
        text += f" {moved} more are on objects that were probably moved."
    return text


def write_comparison(directory: Path, seen: Comparison, images: Images, views: Views) -> None:
    """Write comparison.json, matches.csv and comparison.png, all or none.

    In `images` and `views`, home's comes first. Raises `InputError` if the folder contains anything
    but an earlier comparison, or cannot be written.
    """
    with whole_folder(directory, RESULT) as scratch:
        _write_matches(scratch / MATCHES, seen)
        (scratch / PICTURE).write_bytes(png(picture(seen, images, views), dpi=200))
        text = json.dumps(as_dict(seen), indent=2, allow_nan=False)
        (scratch / RESULT).write_text(text + "\n", encoding="utf-8")


def as_dict(seen: Comparison) -> dict[str, object]:
    """Return the result as numbers, units in the keys; unknown values are absent."""
    values: dict[str, object] = {
        "accepted": seen.accepted,
        "reason": seen.acceptance.reason,
        "log10_false_alarms": seen.acceptance.log_false_alarms,
        "matches": len(seen.pairs),
        "agreeing": int(seen.agrees.sum()),
        "moved": int(seen.moved.sum()),
    }
    if seen.accepted:
        values |= {"heading_change_rad": seen.heading, "heading_sigma_rad": seen.heading_sigma}
    if seen.has_direction:
        values |= {
            "direction_home_rad": seen.home_direction,
            "direction_home_sigma_rad": seen.home_direction_sigma,
            "direction_from_home_rad": seen.direction,
            "direction_from_home_sigma_rad": seen.direction_sigma,
        }
    return values


def picture(seen: Comparison, images: Images, views: Views) -> Figure:
    """Draw the two panoramas, home above, and their matches."""
    height, width = images[0].shape
    below = 1.25 * height
    with styled_figure(WIDTH_IN * (below + height) / width + 0.5) as figure:
        axes = figure.add_subplot()
        bare(axes)
        axes.set_xticks([])
        for image, top, words in zip(images, (0.0, below), ("home", "now"), strict=True):
            place = (-0.5, width - 0.5, top + height - 0.5, top - 0.5)
            axes.imshow(image, cmap="gray", vmin=0, vmax=255, extent=place)
            axes.text(0, top - 0.02 * height, words, va="bottom", color=INK)
        agree = f"of {len(seen.pairs)} agree" + ("" if seen.accepted else " (not enough)")
        _draw_matches(axes, seen, views, below, ~seen.agrees & ~seen.moved, MUTED, "outliers")
        _draw_matches(axes, seen, views, below, seen.agrees, BLUE if seen.accepted else INK, agree)
        _draw_matches(axes, seen, views, below, seen.moved, VERMILLION, "on moved objects")
        if seen.has_direction:
            _mark_home(axes, seen, views[1], below)
        axes.set_xlim(-0.5, width - 0.5)
        axes.set_ylim(below + height, -0.15 * height)
        axes.set_aspect("equal")
        if len(seen.pairs):
            axes.legend(loc="upper center", bbox_to_anchor=(0.5, 0.0), ncols=3)
    return figure


def _draw_matches(
    axes: Axes,
    seen: Comparison,
    views: Views,
    below: float,
    chosen: np.ndarray,
    colour: str,
    words: str,
) -> None:
    """Draw one kind of matches: a ring at each end, and lines for some of them."""
    n = int(chosen.sum())
    if not n:
        return
    home, now = seen.home_row[chosen], seen.now_row[chosen]
    x = np.stack([views[0].column[home], views[1].column[now]])
    y = np.stack([views[0].row[home], views[1].row[now] + below])
    axes.plot(
        x.ravel(),
        y.ravel(),
        linestyle="none",
        marker="o",
        markersize=2.5,
        markerfacecolor="none",
        markeredgewidth=0.5,
        color=colour,
        label=f"{n} {words}",
    )
    some = np.unique(np.linspace(0, n - 1, min(n, MAX_LINES)).astype(int))
    if colour != MUTED:
        axes.plot(x[:, some], y[:, some], color=colour, linewidth=0.4, alpha=0.6)


def _mark_home(axes: Axes, seen: Comparison, now: Features, top: float) -> None:
    """Mark the direction home in the panorama now."""
    height, width = now.shape
    column = (now.axis - seen.home_direction / (2 * math.pi)) * width % width
    axes.plot([column, column], [top - 0.5, top + height - 0.5], color=VERMILLION, linewidth=0.9)
    axes.text(column, top - 0.02 * height, "home", ha="center", va="bottom", color=VERMILLION)


def _write_matches(file: Path, seen: Comparison) -> None:
    """Write the matches: bearings [rad], sigma of the bearing now, and classification."""
    classes = np.where(seen.agrees, "agrees", np.where(seen.moved, "moved", "no"))
    rows = zip(
        seen.home_row.tolist(),
        seen.pairs.home[:, 0].tolist(),
        seen.pairs.now[:, 0].tolist(),
        seen.pairs.sigma.tolist(),
        classes.tolist(),
        strict=True,
    )
    write_csv(
        file,
        ("landmark", "home_bearing", "bearing", "sigma", "verdict"),
        ((f"h{i}", *map(number, values), label) for i, *values, label in rows),
    )


def _turn(angle: float) -> str:
    return f"{abs(math.degrees(angle)):.2f} deg to the {'left' if angle >= 0 else 'right'}"


def _deg(angle: float) -> str:
    return f"{math.degrees(angle):.2f} deg"
