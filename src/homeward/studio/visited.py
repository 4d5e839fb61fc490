"""A place in the studio: its landmarks after each visit, its homes and its routes.

Everything is in the frame of the place's first home.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from homeward.errors import InputError
from homeward.places.place import Event, Place
from homeward.runs.report.words import date, info_lines, visit_words
from homeward.studio.messages import Request

MARGIN_M = 0.5


class Visited:
    """View of a place, which cannot be changed in the studio."""

    now_s, version = math.inf, 1

    def __init__(self, place: Place) -> None:
        self._place = place
        self._visits = list(self._drawn_visits())

    def step(self) -> None:
        """Do nothing: a place has no time to play."""

    def do(self, request: Request) -> dict[str, Any] | None:
        """Raise InputError: only drives and ``homeward place`` change a place."""
        raise InputError("a place cannot be changed in the studio; use homeward place")

    def scene(self) -> dict[str, Any]:
        """Return all visits, oldest first."""
        first = self._place.home_pose(self._place.origin)
        return {
            "type": "scene",
            "mode": "place",
            "begun": 1,
            "name": self._place.name,
            "extent": self._extent(),
            "room": None,
            "home": [*first],
            "path": [],
            "estimators": [],
            "lines": info_lines(self._place),
            "visits": self._visits,
        }

    def picture(self) -> None:
        """Return nothing: the page has all visits."""

    def _drawn_visits(self) -> Iterator[dict[str, Any]]:
        """Yield the drawing and the description of each visit."""
        place = self._place
        here: dict[str, list[float]]
        here = dict(zip(place.map.names, place.map.positions.tolist(), strict=True))
        known = {e.landmark for e in place.events if e.what == "new"}
        # Old events are not stored: a landmark without a "new" event was always here.
        at, away = {n: xy for n, xy in here.items() if n not in known}, set[str]()
        for number, visit in enumerate(place.visits, 1):
            previous, moved = dict(at), set[str]()
            for event in (e for e in place.events if e.visit == visit.number):
                _follow(event, at, away)
                if event.what == "moved":
                    moved.add(event.landmark)
            if number == len(place.visits):  # the map of all visits
                at = here
            then = replace(place, visits=place.visits[:number])
            yield {
                "number": visit.number,
                "text": f"{date(visit.when)}, {visit_words(then)}",
                "landmarks": dict(at),
                "previous": {n: previous.get(n, xy) if n in moved else xy for n, xy in at.items()},
                "stored": sorted(at.keys() - away),
                "homes": {
                    name: [*place.home_pose(name)]
                    for name, home in place.homes.items()
                    if home.stored <= visit.when
                },
                "routes": {
                    name: {
                        "way": route.poses[:, :2].tolist(),
                        "points": {n.waypoint: [n.x, n.y] for n in route.waypoints},
                    }
                    for name, route in place.routes.items()
                    if route.taught <= visit.when
                },
            }

    def _extent(self) -> list[float]:
        """Return the rectangle around everything in all visits: x, y, x, y [m]."""
        points = [np.zeros((1, 2)), *(route.poses[:, :2] for route in self._place.routes.values())]
        points += [np.array([*v["landmarks"].values()]).reshape(-1, 2) for v in self._visits]
        points += [np.array([pose[:2] for pose in v["homes"].values()]) for v in self._visits[-1:]]
        every = np.vstack(points)
        low, high = every.min(axis=0) - MARGIN_M, every.max(axis=0) + MARGIN_M
        return [*low.tolist(), *high.tolist()]


def _follow(event: Event, at: dict[str, list[float]], away: set[str]) -> None:
    """Update the positions and the missing landmarks from an event."""
    if event.what == "gone":
        away.add(event.landmark)
        return
    away.discard(event.landmark)
    if event.what == "forgotten":
        at.pop(event.landmark, None)
    else:
        at[event.landmark] = [event.x, event.y]
