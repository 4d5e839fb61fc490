"""Page of a place: its map, visits, and the rates at which landmarks change."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from homeward.io.writing import write_whole
from homeward.places.place import Place, date
from homeward.runs.report import html, words
from homeward.runs.report.canvas import legend_below, plain, styled_figure, svg
from homeward.runs.report.palette import BLUE, HOUSE, INK, MUTED, ORANGE, VERMILLION
from homeward.runs.report.place_words import info_lines

MAX_LABELS = 60
"""Maximum number of landmarks whose names are drawn."""
MAX_ROWS = 200
"""Maximum number of rows of a table: landmarks with the highest rates, and the last visits."""


def write_page(file: Path, place: Place) -> None:
    """Write the page of a place; `InputError` if it cannot be written."""
    name = words.name(place.name, 60)
    first, *others = info_lines(place)
    text = html.page(
        f"{name}: map and changes of a place",
        html.header(
            f"{name}: map and changes",
            html.figure(svg(_draw_map(place), "Map of the place")),
            html.summary(first),
            *map(html.note, others),
        ),
        html.section(
            "Visits",
            html.figure(svg(_draw_visits(place), "Landmarks stayed, moved, new and gone")),
            html.table("llwlrrrrr", _visit_rows(place)),
        ),
        html.section(
            "Landmarks, by rate of changes",
            html.note(html.texts("homeward.runs.report")["place"]["rates"]),
            html.table("wrrrrr", _landmark_rows(place)),
        ),
    )
    write_whole(file, text.encode())


def _visit_rows(place: Place) -> list[list[object]]:
    """Return the last visits, the newest first."""
    numbers = ("stayed", "moved", "gone", "returned", "new")
    rows: list[list[object]] = [["Visit", "day", "drive", "result", *numbers]]
    for v in place.visits[: -MAX_ROWS - 1 : -1]:
        result = "" if v.verdict == "merged" else v.verdict
        found = (getattr(v, number) for number in numbers)
        rows.append([v.number, date(v.when), words.name(v.drive, 40), result, *found])
    return rows


def _landmark_rows(place: Place) -> list[list[object]]:
    """Return the landmarks with the highest rates of changes."""
    usual, stays = place.usual_rate, place.stays(place.when)
    sigmas = dict(zip(place.map.names, place.map.sigmas.tolist(), strict=True))
    head = ["Landmark", "probability of a change in a day", "moved", "visits that saw it there"]
    rows: list[list[object]] = [[*head, "probability in place", "position sigma [m]"]]
    known = place.persistence
    for name in sorted(known, key=lambda n: -known[n].rate(usual))[:MAX_ROWS]:
        change = words.percent(min(known[name].rate(usual), 1.0))
        seen = known[name].moved, known[name].seen
        where = words.percent(stays[name]), f"{sigmas[name]:.3f}"
        rows.append([words.name(name, 60), change, *seen, *where])
    return rows


def _draw_map(place: Place) -> Figure:
    """Draw the landmarks as estimated at the last visit, and their moves."""
    stays = place.stays(place.when)
    with styled_figure(5.2) as figure:
        axes = figure.add_subplot()
        before: dict[str, tuple[float, float]] = {}
        for event in place.events:
            if event.what == "moved" and event.landmark in before:
                xs, ys = zip(before[event.landmark], (event.x, event.y), strict=True)
                axes.plot(xs, ys, color=ORANGE, lw=0.8, alpha=0.7, zorder=1)
                axes.plot(*before[event.landmark], ".", color=ORANGE, ms=3, zorder=1)
            if event.what in ("new", "moved"):
                before[event.landmark] = event.x, event.y
            elif event.what == "forgotten":
                axes.plot(event.x, event.y, "x", color=MUTED, ms=4, zorder=1)
        for name, (x, y) in zip(place.map.names, place.map.positions.tolist(), strict=True):
            shade = 0.15 + 0.85 * stays[name]
            axes.plot(x, y, "o", color=BLUE, alpha=shade, ms=6, zorder=2)
            if len(stays) <= MAX_LABELS:
                axes.annotate(
                    plain(name[:8]), (x, y), (4, 3), textcoords="offset points", fontsize=7
                )
        for number, (route, way) in enumerate(place.routes.items(), 1):
            x, y, _ = way.poses.T
            named = number * len(x) // (len(place.routes) + 1)  # routes may overlap
            axes.plot(x, y, color=MUTED, lw=1.6, zorder=1)
            axes.annotate(plain(route), (x[named], y[named]), (5, 4), textcoords="offset points")
            for node in way.waypoints:
                axes.plot(node.x, node.y, "D", color=MUTED, ms=5, zorder=2)
        size = 0.025 * max(place.map.size, 1e-3)
        for home in place.homes:
            pose = place.home_pose(home)
            axes.fill(*(np.array(HOUSE) * size + (pose.x, pose.y)).T, color=INK, zorder=3)
            axes.annotate(plain(home), (pose.x, pose.y), (7, -9), textcoords="offset points")
        axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
        axes.set_adjustable("datalim")
        marks = [
            Line2D([], [], marker="o", ls="", color=BLUE, label="landmark (pale: may be gone)"),
            Line2D([], [], marker=".", color=ORANGE, label="earlier position"),
            Line2D([], [], marker="x", ls="", color=MUTED, label="forgotten"),
        ]
        if place.routes:
            marks.append(Line2D([], [], marker="D", color=MUTED, label="route, with way points"))
        legend_below(figure, marks)
    return figure


def _draw_visits(place: Place) -> Figure:
    """Draw the number of landmarks that stayed, moved, were gone and were new at each visit."""
    kinds = (("stayed", BLUE), ("moved", ORANGE), ("new", MUTED), ("gone", VERMILLION))
    with styled_figure(2.2) as figure:
        axes = figure.add_subplot()
        number = np.array([v.number for v in place.visits])
        bottom = np.zeros(len(number))
        for kind, colour in kinds:
            height = np.array([float(getattr(v, kind)) for v in place.visits])
            if kind == "gone":
                axes.bar(number, -height, color=colour, label=kind)
                continue
            axes.bar(number, height, bottom=bottom, color=colour, label=kind)
            bottom += height
        axes.set(xlabel="visit", ylabel="landmarks")
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.grid(False, axis="x")
        legend_below(figure, axes.get_legend_handles_labels()[0])
    return figure
