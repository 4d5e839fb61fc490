"""A place: what lasts of it from drive to drive."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field, replace

import numpy as np

from homeward.drives.drive import Drive, HomeBearing
from homeward.drives.settings import KnownLandmarks, SurveyedLandmark
from homeward.errors import InputError
from homeward.geometry.frames import Pose, position_sigma
from homeward.io.table import quoted
from homeward.places.joint_map import JointMap
from homeward.places.persistence import FORGOTTEN, Standing, tally, usual_rate
from homeward.places.route import Route, route_of

DAY_S = 86400.0
BETWEEN = "+"
"""Stands between the fingerprints of a place that was merged into another."""
FIRST_DAY, LAST_DAY = -719_162.0, 2_932_896.0
"""Days since 1970 that have a date, of the years 1 to 9999 [days]."""
NUDGED = 0.002
"""Goods are nudged: a place is no better known after a year without a visit (4 cm) than one drive
maps it [m / sqrt(day)]."""


@dataclass(frozen=True)
class StoredHome:
    """A home, as it was stored."""

    stored: float
    """When [days since 1970]."""
    seen: dict[str, HomeBearing]
    """What the camera saw there."""


@dataclass(frozen=True)
class Visit:
    """What one drive told of a place."""

    number: int
    when: float
    """[days since 1970]"""
    drive: str
    evidence: str
    """The drive's `telling.fingerprint`; of a place that was merged, those of all its drives."""
    verdict: str
    """first, merged, or apart: then the rest is zero, and nothing of it was merged."""
    stayed: int = 0
    moved: int = 0
    gone: int = 0
    new: int = 0
    returned: int = 0
    of: int = 0
    """Landmarks known afterwards."""


@dataclass(frozen=True)
class Event:
    """What a landmark did by a visit."""

    visit: int
    landmark: str
    what: str
    """new, moved, gone, returned or forgotten."""
    x: float
    y: float
    """Where it stands since, or stood [m]."""


@dataclass(frozen=True)
class Place:
    """A place; everything is where it is seen from its first home."""

    name: str
    map: JointMap
    """Landmarks and homes; see `JointMap.at_home`."""
    standings: dict[str, Standing]
    """Of each landmark of the map."""
    homes: dict[str, StoredHome]
    """By name; the first one is the origin."""
    visits: tuple[Visit, ...] = ()
    events: tuple[Event, ...] = ()
    past: tuple[float, float] = (0.0, 0.0)
    """The `tally` of landmarks that are forgotten."""
    routes: dict[str, Route] = field(default_factory=dict)
    """By name."""

    @property
    def origin(self) -> str:
        """The name of the home whose frame it is."""
        return next(iter(self.homes))

    @property
    def usual_rate(self) -> float:
        """How often a landmark changes its place [1 / day]."""
        return usual_rate(*np.add(self.past, tally(self.standings.values())).tolist())

    @property
    def next_visit(self) -> int:
        """The number of the visit that comes next, from 1."""
        return self.visits[-1].number + 1 if self.visits else 1

    @property
    def evidence(self) -> str:
        """The fingerprints of all drives that it is made of."""
        merged = (v.evidence.split(BETWEEN) for v in self.visits if v.verdict != "apart")
        return BETWEEN.join(sorted(set[str]().union(*merged)))

    def require_new(self, name: str, told: str) -> None:
        """Raise `InputError` where a drive or place, by its fingerprint, is known already."""
        if not set(told.split(BETWEEN)).isdisjoint(self.evidence.split(BETWEEN)):
            raise InputError(
                f"{quoted(name)}, or a drive of it, is in the place {quoted(self.name)} already: "
                "what it saw would count twice"
            )

    def stays(self, when: float) -> dict[str, float]:
        """Return the probability of each landmark to stand where it is mapped, at `when` [days]."""
        usual = self.usual_rate
        return {name: s.stays(when, usual) for name, s in self.standings.items()}

    def aged(self, when: float) -> JointMap:
        """Return the map as it is to be believed at `when` [days]."""
        return self.map.aged(NUDGED**2 * max(when - self.visits[-1].when, 0.0))

    def known(self, when: float, home: str | None = None) -> KnownLandmarks:
        """Return the place for a localiser, as its `known`, at `when` [days since 1970].

        Answers are in the frame of a home, by default the first; `InputError` where there is none.
        """
        there, stays = self.aged(when).seen_from_home(self.required(home)), self.stays(when)
        landmarks = {
            name: SurveyedLandmark(x=x, y=y, stays=max(stays[name], FORGOTTEN))
            for name, (x, y) in zip(there.names, there.positions.tolist(), strict=True)
        }
        n = 2 * len(there.names)
        return KnownLandmarks.remembered(landmarks, there.covariance[:n, :n])

    def visited_by(self, drive: Drive, when: float, home: str | None = None) -> Drive:
        """Return a drive that knows the place, and asks for one of its homes; see `known`."""
        first = self.required(home) == self.origin
        settings = drive.settings.model_copy(update={"home_sensor": None})
        if not first:
            settings = settings.model_copy(update={"start": None})
        truth = drive.truth if first else None  # it is in the frame of another home
        known = self.known(when, home)
        return replace(drive, home={}, known=known, settings=settings, truth=truth)

    def without(
        self, landmarks: Collection[str], homes: Collection[str] = (), routes: Collection[str] = ()
    ) -> Place:
        """Return it without some landmarks, homes and routes.

        `InputError` where it has none of such a name, or the first home is among them.
        """
        for name in landmarks:
            if name not in self.standings:
                raise InputError(f"no landmark {quoted(name)} in the place")
        for home in homes:
            if self.required(home) == self.origin:
                raise InputError(f"{quoted(home)} is the home in whose frame the place is")
        for route in routes:
            self.route(route)
        kept = [n for n in self.map.names if n not in landmarks]
        stay = {h: s for h, s in self.homes.items() if h not in homes}
        standings = {n: self.standings[n] for n in kept}
        ways = {n: r for n, r in self.routes.items() if n not in routes}
        there = self.map.only(kept, stay)
        return replace(self, map=there, standings=standings, homes=stay, routes=ways)

    def route(self, name: str) -> Route:
        """Return a route by its name, else raise `InputError`."""
        return route_of(self.routes, name)

    def required(self, home: str | None) -> str:
        """Return the name of a home, the first one's for None; else raise `InputError`."""
        if home is None:
            return self.origin
        if home not in self.homes:
            raise InputError(f"no home {quoted(home)}; there are {', '.join(self.homes)}")
        return home

    def home_pose(self, home: str) -> Pose:
        """Return the pose of a home in the frame of the first."""
        return Pose(*self.map.mean[self.map.home_columns(home)].tolist())

    def home_sigma(self, home: str, when: float) -> float:
        """Return how uncertain a home's place is for one who sees what stands now [m].

        Infinite where fewer than two landmarks are left, which hold no frame.
        """
        if len(self.standings) < 2:
            return np.inf
        there = self.aged(when).at_home(self.required(home))
        at = there.home_columns(home)[:2]
        return float(position_sigma(there.covariance[np.ix_(at, at)]))
