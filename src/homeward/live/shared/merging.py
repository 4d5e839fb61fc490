"""The place of a server: visits on disk, and their merge with the place.

The folder of the place contains all visits that ended. Each visit in progress is a file in its
subfolder `live`, and is merged again whenever it grows, so that nothing counts twice.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from homeward.errors import HomewardError, InputError
from homeward.io.reading import naming
from homeward.io.writing import remove_abandoned, write_whole
from homeward.live.messages import line_of
from homeward.live.shared.messages import VisitMessage, parse_request, visit_of
from homeward.localizer.tunables import INLIER
from homeward.places import files
from homeward.places.place import DAY_S, Place
from homeward.places.visit_data import VisitData
from homeward.places.visiting import MIN_STAYED_SHARE, kept_apart, merged
from homeward.runs.report.place_words import visit_words

LIVE = "live"
"""Subfolder of a place with the visits in progress."""
ABANDONED_S = 3600.0
"""A visit without a message for this time has ended [s]."""
SCALE_SIGMA = 0.3
"""Standard deviation of the scale of a visit, large enough to ignore it: one robot with a wrong
wheel radius would scale the place of all [1]."""
QUARANTINED = "this visit contradicts the place and is not merged: other robots do not use it"

_Position = tuple[np.ndarray, float]
"""Position of a landmark in the place (2,) and its standard deviation [m]."""

RESET = "reset the map to begin another visit"


@dataclass(frozen=True)
class LiveVisit:
    """Newest version of a visit in progress."""

    data: VisitData
    seen: Mapping[str, float]
    """When each landmark was last seen where the visit has it, on the server's clock [s since
    1970]; only of its own map: a robot that saw a landmark from one place only has no position."""
    received: float
    """[s since 1970]"""
    changes: frozenset[tuple[str, str]] | None
    """Its changes of the place, such as (moved, landmark); None if it contradicts the place."""
    positions: Mapping[str, _Position]
    """Positions of its landmarks (2,) in the place [m], and their standard deviations [m]."""
    unconfirmed: frozenset[str]
    """Landmarks that its earlier version did not change in this way, or not to this position: a
    landmark seen from few places may be mapped wrongly for some seconds. They are ignored."""


class SharedPlace:
    """A place in a folder, and the visits in progress; `InputError` where there is no place."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.place = folder, files.load_place(folder)
        self.visits: dict[str, LiveVisit] = {}
        self._began = time.time()
        with naming(folder / LIVE, "cannot be read"):
            (folder / LIVE).mkdir(exist_ok=True)
            for written in (folder, folder / LIVE):
                remove_abandoned(written)  # of a server that was killed
            saved = sorted((folder / LIVE).glob("*.json"), key=lambda f: f.stat().st_mtime)
        for file in saved:
            with naming(file, "cannot be read"):
                message, when = parse_request(file.read_bytes()), file.stat().st_mtime
            assert isinstance(message, VisitMessage)
            if self._is_merged(message.visit):  # the server was killed before it deleted the file
                file.unlink()
            else:
                self._set(message, when, is_confirmed=True)
                if message.ended:
                    self.end(message.visit)

    @property
    def state(self) -> object:
        """Value that changes when robots need the place again."""
        changes = {
            name: frozenset(c for c in visit.changes or () if c[1] not in visit.unconfirmed)
            for name, visit in self.visits.items()
        }
        return self.place.next_visit, {name: some for name, some in changes.items() if some}

    def add(self, message: VisitMessage, now: float) -> str:
        """Replace the version of a visit, on disk, too; return the result if it ended.

        `now` [s since 1970]. `InputError` where the visit is damaged or cannot be written.
        """
        if self._is_merged(message.visit):
            return "the visit has ended, and the place contains it up to then; " + RESET
        visit_of(message, now / DAY_S)
        write_whole(self._file(message.visit), line_of(message).encode())
        self._set(message, now, message.ended and message.visit not in self.visits)
        return self.end(message.visit) if message.ended else ""

    def end_abandoned(self, now: float) -> list[str]:
        """Merge the visits that send nothing any more; return the results in words."""
        late = [n for n, v in self.visits.items() if now - v.received > ABANDONED_S]
        return [f"visit {name} is silent, and ended: {self.end(name)}" for name in late]

    def end(self, name: str) -> str:
        """Merge a visit into the place, on disk; return the result in words.

        `HomewardError` where the place cannot be written; the visit is kept then.
        """
        visit = self.visits[name]
        data = self._without_older_sightings().get(name, visit.data)
        try:
            self.place, _ = files.update_place(self.folder, lambda place: _with(place, data))
        except (InputError, np.linalg.LinAlgError) as error:
            if isinstance(error, InputError) and error.file is not None:
                raise  # the disk
            result = f"the visit was not merged into the place: {error}"
        else:
            result = visit_words(self.place)
            lost = {**data.homes, **data.routes}.keys() - {*self.place.homes, *self.place.routes}
            result += "".join(f" {n} was not stored." for n in sorted(lost))
        del self.visits[name]
        self._file(name).unlink(missing_ok=True)
        return result

    def with_all(self) -> Place:
        """Return the place with all visits."""
        return _with_all(self.place, self._without_older_sightings())

    def without_each(self) -> dict[str, Place]:
        """Return for each visit the place without it."""
        return _without_each(self.place, self._without_older_sightings())

    def _without_older_sightings(self) -> dict[str, VisitData]:
        """Return the visits that agree with the place, without changes that are not confirmed.

        A landmark of the place that moved is only in the visit that saw it last, and in those that
        agree with its position. A visit that only finds that it has moved, and has no certain
        position, decides nothing if another one has a position.
        """
        agreeing = {name: v for name, v in self.visits.items() if v.changes is not None}
        moved = {
            n
            for v in agreeing.values()
            for what, n in v.changes or ()
            if what != "new" and n not in v.unconfirmed
        }
        here = _positions(self.place)
        last = {n: (self._seen_in_place(n), here.get(n)) for n in moved}
        located = set[str]()
        for visit in agreeing.values():
            for n in moved & visit.seen.keys() & visit.positions.keys() - visit.unconfirmed:
                if visit.seen[n] > last[n][0]:
                    last[n] = visit.seen[n], visit.positions[n]
                    located.add(n)
        found = {}
        for name, visit in agreeing.items():
            older = {
                n
                for n, (t, there) in last.items()
                if (visit.seen.get(n, 0.0) < t and not _agree(visit.positions.get(n), there))
                or (n in located and n not in visit.positions)
            }
            own = visit.data.map.marginal({*visit.data.map.names} - older - visit.unconfirmed)
            found[name] = replace(visit.data, map=own)
        return found

    def _seen_in_place(self, landmark: str) -> float:
        """Return when a visit that ended since the server began tested a landmark [s]."""
        persistence = self.place.persistence.get(landmark)
        t = 0.0 if persistence is None else persistence.last * DAY_S
        return t if self._began < t <= time.time() else 0.0

    def _set(self, message: VisitMessage, now: float, is_confirmed: bool) -> None:
        """Replace the version of a visit, and compare it with the place."""
        data = replace(visit_of(message, now / DAY_S), scale_sigma=SCALE_SIGMA)
        seen = {n: now - message.ages[n] for n in data.map.names if n in message.ages}
        changes, at = None, dict[str, _Position]()
        with suppress(HomewardError, np.linalg.LinAlgError):
            after = _with(self.place, data)
            if after.visits[-1].verdict != "apart":
                changes, at = _changes(self.place, after), _positions(after)
                at = {n: at[n] for n in data.map.names if n in at}
        new = frozenset[str]()
        if changes and not is_confirmed:
            before = self.visits.get(message.visit)
            earlier = (before.changes if before is not None else None) or frozenset()
            was = before.positions if before is not None else {}
            new = frozenset(
                n
                for what, n in changes
                if (what, n) not in earlier or not _agree(at.get(n), was.get(n))
            )
        self.visits[message.visit] = LiveVisit(data, seen, now, changes, at, new)

    def _is_merged(self, visit: str) -> bool:
        return any(v.drive == visit for v in self.place.visits)

    def _file(self, visit: str) -> Path:
        return self.folder / LIVE / f"{visit}.json"


def is_same(before: Place, now: Place) -> bool:
    """Return whether two places have the same landmarks at the same positions, homes and routes."""
    if before.map.names != now.map.names or {*before.homes} != {*now.homes}:
        return False
    if {*before.routes} != {*now.routes}:
        return False
    off = np.hypot(*(now.map.positions - before.map.positions).T)
    return bool((off <= before.map.sigmas).all()) and _gone(before) == _gone(now)


def _gone(place: Place) -> set[str]:
    return {name for name, p in place.persistence.items() if p.stands < 0.5}


def _changes(before: Place, after: Place) -> frozenset[tuple[str, str]]:
    return frozenset((e.what, e.landmark) for e in after.events if e.visit >= before.next_visit)


def _positions(place: Place) -> dict[str, _Position]:
    """Return positions (2,) [m] and standard deviations [m] of the landmarks of a place."""
    each = zip(place.map.positions, place.map.sigmas.tolist(), strict=True)
    return dict(zip(place.map.names, each, strict=True))


def _agree(one: _Position | None, other: _Position | None) -> bool:
    """Return whether two positions of a landmark agree, or both are unknown."""
    if one is None or other is None:
        return one is other
    off = np.hypot(*(one[0] - other[0]))
    return bool(off <= INLIER * np.hypot(one[1], other[1]))


def _with(place: Place, data: VisitData) -> Place:
    """Return a place with a visit, without its homes and routes whose names are taken.

    A visit that distorts the place is kept apart: it moves most of the landmarks that stayed by
    more than their standard deviation explains. A robot's own map may be distorted for a moment.
    """
    homes = {n: home for n, home in data.homes.items() if n not in place.homes}
    routes = {n: route for n, route in data.routes.items() if n not in place.routes}
    after = merged(place, replace(data, homes=homes, routes=routes))
    changed = {n for _, n in _changes(place, after)}
    was, now = _positions(place), _positions(after)
    agree = [_agree(was[n], now[n]) for n in was.keys() & now.keys() - changed]
    return after if sum(agree) >= MIN_STAYED_SHARE * len(agree) else kept_apart(place, data)


def _with_all(place: Place, visits: Mapping[str, VisitData]) -> Place:
    for data in visits.values():
        with suppress(HomewardError, np.linalg.LinAlgError):
            after = _with(place, data)
            place = after if after.visits[-1].verdict != "apart" else place
    return place


def _without_each(place: Place, visits: Mapping[str, VisitData]) -> dict[str, Place]:
    """Return a place with all visits but one, for each; n log n merges."""
    names = list(visits)
    if len(names) < 2:
        return dict.fromkeys(names, place)
    halves = [{n: visits[n] for n in some} for some in (names[::2], names[1::2])]
    found = dict[str, Place]()
    for mine, others in (halves, halves[::-1]):
        found |= _without_each(_with_all(place, others), mine)
    return found
