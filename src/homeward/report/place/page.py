"""The page of a place: what stood where over its visits, and what moves often."""

from __future__ import annotations

from pathlib import Path

from markupsafe import Markup

from homeward.drives.text.files import naming
from homeward.places.place import Place
from homeward.report import words
from homeward.report.canvas import svg
from homeward.report.place.figures import draw_map, draw_visits
from homeward.report.place.words import date, info_lines
from homeward.report.template import render

MOST_ROWS = 200
"""Landmarks and visits in a table: the most restless, and the last."""


def write_page(file: Path, place: Place) -> None:
    """Write the page of a place; `InputError` where that cannot be written."""
    when, usual = place.visits[-1].when, place.usual_rate
    stays = place.stays(when)
    sigmas = dict(zip(place.map.names, place.map.sigmas.tolist(), strict=True))
    restless = sorted(place.standings, key=lambda n: -place.standings[n].rate(usual))
    html = render(
        "place.html.j2",
        words=words,
        place=place,
        date=date,
        lines=info_lines(place),
        figures={
            "map": Markup(svg(draw_map(place), "The place as seen from above")),
            "visits": Markup(svg(draw_visits(place), "What each visit found")),
        },
        landmarks=[
            (n, place.standings[n], stays[n], place.standings[n].rate(usual), sigmas[n])
            for n in restless[:MOST_ROWS]
        ],
        visits=place.visits[: -MOST_ROWS - 1 : -1],
    )
    with naming(file, "cannot be written"):
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(html, encoding="utf-8")
