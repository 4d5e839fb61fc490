"""A place in the studio: what stood where after each of its visits, its homes and its routes.

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
from homeward.studio.messages import Asked

MARGIN_M = 0.5


class Visited:
    """What the studio shows of a place; nothing of it can be changed there."""

    now_s, version = math.inf, 1

    def __init__(self, place: Place) -> None:
        self._place = place
        self._visits = list(self._told())

    def step(self) -> None:
        """Do nothing: it was visited already."""

    def do(self, asked: Asked) -> dict[str, Any] | None:
        """Raise InputError: a place is changed by drives, and by ``homeward place``."""
        raise InputError("that is for a scene, not for a place; homeward place changes one")

    def scene(self) -> dict[str, Any]:
        """Return all visits, the oldest first."""
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
        """Return nothing: the page has all visits, and picks one."""

    def _told(self) -> Iterator[dict[str, Any]]:
        """Yield what is drawn and said of each visit."""
        place = self._place
        here: dict[str, list[float]]
        here = dict(zip(place.map.names, place.map.positions.tolist(), strict=True))
        known = {e.landmark for e in place.events if e.what == "new"}
        # Events of long ago are not kept: who has none of its coming was always here.
        at, away = {n: xy for n, xy in here.items() if n not in known}, set[str]()
        for number, visit in enumerate(place.visits, 1):
            stood, moved = dict(at), set[str]()
            for event in (e for e in place.events if e.visit == visit.number):
                _follow(event, at, away)
                if event.what == "moved":
                    moved.add(event.landmark)
            if number == len(place.visits):  # as it is mapped by all of them
                at = here
            then = replace(place, visits=place.visits[:number])
            yield {
                "number": visit.number,
                "said": f"{date(visit.when)}, {visit_words(then)}",
                "landmarks": dict(at),
                "stood": {n: stood.get(n, xy) if n in moved else xy for n, xy in at.items()},
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
        """Return the rectangle in which everything is that ever was: x, y, x, y [m]."""
        points = [np.zeros((1, 2)), *(route.poses[:, :2] for route in self._place.routes.values())]
        points += [np.array([*v["landmarks"].values()]).reshape(-1, 2) for v in self._visits]
        points += [np.array([pose[:2] for pose in v["homes"].values()]) for v in self._visits[-1:]]
        every = np.vstack(points)
        low, high = every.min(axis=0) - MARGIN_M, every.max(axis=0) + MARGIN_M
        return [*low.tolist(), *high.tolist()]


def _follow(event: Event, at: dict[str, list[float]], away: set[str]) -> None:
    """Take what an event says of where a landmark is, or that it is away."""
    if event.what == "gone":
        away.add(event.landmark)
        return
    away.discard(event.landmark)
    if event.what == "forgotten":
        at.pop(event.landmark, None)
    else:
        at[event.landmark] = [event.x, event.y]
