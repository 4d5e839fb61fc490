"""A place: a map with homes, routes and a history, kept from drive to drive."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime

import numpy as np

from homeward.drives.drive import Drive, HomeBearing
from homeward.drives.landmarks import KnownLandmarks, SurveyedLandmark
from homeward.errors import InputError
from homeward.geometry.frames import Pose, position_sigma
from homeward.io.table import quoted
from homeward.places.joint_map import JointMap
from homeward.places.persistence import FORGOTTEN, LandmarkPersistence, tally, usual_rate
from homeward.places.route import Route, route_of

DAY_S = 86400.0
SEPARATOR = "+"
"""Separator of the fingerprints of a place that was merged into another."""
FIRST_DAY, LAST_DAY = -719_162.0, 2_932_896.0
"""Range of valid dates, years 1 to 9999 [days since 1970]."""
DRIFT = 0.002
"""Random walk of landmarks that are nudged [m / sqrt(day)]: after a year without a visit (4 cm), a
place is no more accurate than the map of one drive."""


def date(when: float) -> str:
    """Return a day since 1970 as a date."""
    return datetime.fromtimestamp(when * DAY_S, UTC).date().isoformat()


@dataclass(frozen=True)
class StoredHome:
    """Home bearings, and when they were stored."""

    stored: float
    """[days since 1970]"""
    seen: dict[str, HomeBearing]


@dataclass(frozen=True)
class Visit:
    """Result of one drive for a place."""

    number: int
    when: float
    """[days since 1970]"""
    drive: str
    evidence: str
    """The drive's `visit_data.fingerprint`; for a merged place, those of all its drives."""
    verdict: str
    """first, merged, or apart: not merged because it contradicts the place; counts are then 0."""
    stayed: int = 0
    moved: int = 0
    gone: int = 0
    new: int = 0
    returned: int = 0
    of: int = 0
    """Number of landmarks afterwards."""


@dataclass(frozen=True)
class Event:
    """Change of one landmark, found by a visit."""

    visit: int
    landmark: str
    what: str
    """new, moved, gone, returned or forgotten."""
    x: float
    y: float
    """Its new position; if it is gone or forgotten, the last one [m]."""


@dataclass(frozen=True)
class Place:
    """A place, in the frame of its first home."""

    name: str
    map: JointMap
    """Landmarks and homes; see `JointMap.at_home`."""
    persistence: dict[str, LandmarkPersistence]
    """Persistence of each landmark of the map."""
    homes: dict[str, StoredHome]
    """By name; the first one is the origin."""
    visits: tuple[Visit, ...] = ()
    events: tuple[Event, ...] = ()
    past: tuple[float, float] = (0.0, 0.0)
    """The `tally` of forgotten landmarks."""
    routes: dict[str, Route] = field(default_factory=dict)
    """By name."""
    together: tuple[tuple[str, ...], ...] = ()
    """Groups of landmarks that move together."""

    @property
    def origin(self) -> str:
        """Name of the first home, whose frame is the frame of the place."""
        return next(iter(self.homes))

    @property
    def when(self) -> float:
        """Day of the latest visit [days since 1970]; drives may be added in any order."""
        return max(visit.when for visit in self.visits)

    @property
    def tally(self) -> tuple[float, float]:
        """Number of changes of all landmarks, and their total time of observation [days]."""
        changes, watched = tally(self.persistence.values())
        return self.past[0] + changes, self.past[1] + watched

    @property
    def usual_rate(self) -> float:
        """Rate of changes of a landmark [1 / day]."""
        return usual_rate(*self.tally)

    @property
    def next_visit(self) -> int:
        """Number of the next visit, counted from 1."""
        return self.visits[-1].number + 1 if self.visits else 1

    @property
    def evidence(self) -> str:
        """Fingerprints of all drives that were merged."""
        merged = (v.evidence.split(SEPARATOR) for v in self.visits if v.verdict != "apart")
        return SEPARATOR.join(sorted(set[str]().union(*merged)))

    def require_new(self, name: str, evidence: str) -> None:
        """Raise `InputError` if the fingerprints of a drive or place are already in this place."""
        if not set(evidence.split(SEPARATOR)).isdisjoint(self.evidence.split(SEPARATOR)):
            raise InputError(
                f"{quoted(name)}, or a drive in it, is already in the place {quoted(self.name)}: "
                "its data would count twice",
                advice="use another drive; if it was added last, `homeward place undo` removes it",
            )

    def stays(self, when: float) -> dict[str, float]:
        """Return the probability that each landmark is where it is mapped, at `when` [days]."""
        usual = self.usual_rate
        return {name: s.stays(when, usual) for name, s in self.persistence.items()}

    def aged(self, when: float) -> JointMap:
        """Return the map with the uncertainty that it has at `when` [days]."""
        return self.map.aged(DRIFT**2 * max(when - self.when, 0.0))

    def known(self, when: float, home: str | None = None) -> KnownLandmarks:
        """Return the place as known landmarks for a localiser, at `when` [days since 1970].

        Estimates will be in the frame of `home`, by default the first; `InputError` if unknown.
        """
        there, stays = self.aged(when).in_home_frame(self.required(home)), self.stays(when)
        landmarks = {
            name: SurveyedLandmark(x=x, y=y, stays=max(stays[name], FORGOTTEN))
            for name, (x, y) in zip(there.names, there.positions.tolist(), strict=True)
        }
        n = 2 * len(there.names)
        return KnownLandmarks.remembered(landmarks, there.covariance[:n, :n])

    def visited_by(self, drive: Drive, when: float, home: str | None = None) -> Drive:
        """Return a drive with this place as known landmarks and a home of it; see `known`."""
        first = self.required(home) == self.origin
        together = (*self.together, *drive.settings.together)
        update = {"home_sensor": None, "together": together}
        settings = drive.settings.model_copy(update=update)
        if not first:
            settings = settings.model_copy(update={"start": None})
        truth = drive.truth if first else None  # ground truth is in the frame of the first home
        known = self.known(when, home)
        return replace(drive, home={}, known=known, settings=settings, truth=truth)

    def without(
        self, landmarks: Collection[str], homes: Collection[str] = (), routes: Collection[str] = ()
    ) -> Place:
        """Return the place without some landmarks, homes and routes.

        `InputError` if one of them is not in the place, or is the first home.
        """
        for name in landmarks:
            if name not in self.persistence:
                raise InputError(f"the place has no landmark {quoted(name)}")
        for home in homes:
            if self.required(home) == self.origin:
                raise InputError(
                    f"home {quoted(home)} cannot be removed: it is the origin of the place"
                )
        for route in routes:
            self.route(route)
        kept = [n for n in self.map.names if n not in landmarks]
        stay = {h: s for h, s in self.homes.items() if h not in homes}
        persistence = {n: self.persistence[n] for n in kept}
        ways = {n: r for n, r in self.routes.items() if n not in routes}
        there = self.map.marginal(kept, stay)
        return replace(self, map=there, persistence=persistence, homes=stay, routes=ways)

    def route(self, name: str) -> Route:
        """Return a route by its name; `InputError` if there is none."""
        return route_of(self.routes, name)

    def required(self, home: str | None) -> str:
        """Return `home`, or the first home for None; `InputError` if there is none."""
        if home is None:
            return self.origin
        if home not in self.homes:
            raise InputError(f"no home {quoted(home)}; the place has {', '.join(self.homes)}")
        return home

    def home_pose(self, home: str) -> Pose:
        """Return the pose of a home in the frame of the first."""
        return Pose(*self.map.mean[self.map.home_columns(home)].tolist())

    def home_sigma(self, home: str, when: float) -> float:
        """Return the position uncertainty of a home relative to the landmarks at `when` [m].

        Infinite with fewer than two landmarks, which define no frame.
        """
        if len(self.persistence) < 2:
            return np.inf
        there = self.aged(when).at_home(self.required(home))
        at = there.home_columns(home)[:2]
        return float(position_sigma(there.covariance[np.ix_(at, at)]))
