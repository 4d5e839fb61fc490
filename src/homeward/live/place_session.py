"""Place of a session, and the visits that are merged into it.

A visit is the session since the last begin of the map: by a reset, a start, or the session's begin.
Each save merges the whole visit into the place as it was before the visit, so that nothing counts
twice.
"""

from __future__ import annotations

import math
import time
from array import array
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np

from homeward.control.following import LOOKAHEAD
from homeward.drives.drive import Drive, HomeBearing, Samples, last_of_equal, table
from homeward.errors import HomewardError, InputError
from homeward.estimator import Estimate, LandmarkEstimate, Status
from homeward.geometry.frames import Pose, position_sigma
from homeward.io.table import quoted
from homeward.live.messages import BearingsIn, PlaceChanged
from homeward.localizer.localizer import Localizer
from homeward.localizer.tunables import VERIFIED
from homeward.places import files
from homeward.places.joint_map import JointMap
from homeward.places.place import DAY_S, Place, StoredHome
from homeward.places.route import Route, map_of_estimates, route_of, taught_along
from homeward.places.visit_data import VisitData, collect_visit_along, require_name
from homeward.places.visiting import first_place, merged, why_apart
from homeward.registry import DEFAULT
from homeward.runs.report.place_words import visit_words
from homeward.runs.report.words import count

COLUMNS = 5
"""Columns of an answer: stamp, pose, and the position's sigma, NaN unless localised."""
READ_ONLY = (
    "the place is read-only: start homeward live with --update, or the node with place_update"
)


class PlaceSession:
    """Place of a session, and the data of its current visit.

    `place` is a name where the first visit creates the place. `when` is the day of the session
    [days since 1970]. With `update`, visits are merged and, if there is a `folder`, written to it
    after its newest `version`.
    """

    def __init__(
        self,
        place: Place | str,
        when: float,
        update: bool,
        folder: Path | None = None,
        version: int = 0,
    ) -> None:
        self.place = place if isinstance(place, Place) else None
        self.name = place if isinstance(place, str) else place.name
        self.when, self.update = when, update
        self.saved = False
        """Whether any visit was merged."""
        self._folder, self._version = folder, version
        self._after = self.place
        self.begin()

    def begin(self) -> None:
        """Begin a new visit; visits merged before remain in the place."""
        self.place = self._after
        self._is_merged = False
        """Whether the newest version that this session wrote contains a part of this visit."""
        self._samples, self._poses = Samples(), array("d")
        self._stored: dict[str, tuple[StoredHome, Estimate]] = {}
        self._routes: dict[str, tuple[Route, JointMap]] = {}
        self._taught_from = 0
        """Index in `_poses` of the begin of the route that is being taught."""

    @property
    def has_homes(self) -> bool:
        """Whether the place has homes, including those of merged visits."""
        return self._after is not None

    @property
    def has_poses(self) -> bool:
        """Whether this visit has any pose."""
        return bool(self._poses)

    @property
    def homes(self) -> tuple[str, ...]:
        """Homes of the place and of this visit."""
        return (*(self.place.homes if self.place is not None else ()), *self._stored)

    def known_by(self, drive: Drive) -> Drive:
        """Return a drive as a visit to the place, in the frame of its first home."""
        return drive if self.place is None else self.place.visited_by(drive, self.when)

    def home_pose(self, name: str, first: str) -> Pose:
        """Return the pose of a home in the frame of `first`; `InputError` for an unknown home."""
        if name == first:
            return Pose(0.0, 0.0, 0.0)
        if name in self._stored and (pose := self._stored[name][1].pose) is not None:
            return pose
        if self.place is None or name not in self.place.homes:
            there = ", ".join((first, *(n for n in self.homes if n != first)))
            raise InputError(f"no home {quoted(name)} in the place; there are {there}")
        return self.place.home_pose(name)

    def see(self, message: BearingsIn, estimate: Estimate) -> None:
        """Add bearings and the answer to them."""
        if not self.update:
            return
        with_ranges = message.sigmas, message.ranges, message.range_sigmas, message.camera
        self._samples.add_bearings(message.t, message.bearings, *with_ranges)
        if estimate.pose is not None:
            self._poses.extend((message.t, *estimate.pose, localised_sigma(estimate)))

    def store_home(self, name: str, first: str, seen: BearingsIn, estimate: Estimate) -> str:
        """Store the robot's pose as a home of the place, from the next merge on; return a report.

        `InputError` where the robot is not localised, the name is taken, or the place is read-only.
        """
        require_name("home", name, (first, *self.homes))
        self._require_localised(estimate, f"home {quoted(name)} cannot be stored")
        bearings = {n: HomeBearing(b, camera=seen.camera) for n, b in seen.bearings.items()}
        self._stored[name] = StoredHome(self.when, bearings), replace(estimate, innovations=())
        return f"home {quoted(name)} stored, {count(len(seen.bearings), 'landmark')} in view"

    @property
    def routes(self) -> dict[str, Route]:
        """Routes of the place and of this visit."""
        known = {} if self.place is None else self.place.routes
        return known | {name: route for name, (route, _) in self._routes.items()}

    def route(self, name: str) -> Route:
        """Return a route of the place or of this visit, in the frame of the answers."""
        return route_of(self.routes, name)

    def landmark(self, name: str) -> tuple[float, float] | None:
        """Return the position of a landmark in the frame of the first home [m], if mapped."""
        if self.place is None or name not in self.place.persistence:
            return None
        x, y = self.place.map.positions[self.place.map.names.index(name)].tolist()
        return x, y

    def begin_route(self, estimate: Estimate) -> str:
        """Begin to teach a route at the robot's pose; return a report.

        `InputError` where the robot is not well localised, or the place is read-only.
        """
        self._require_localised(estimate, "the route cannot begin")
        if (sigma := localised_sigma(estimate)) > LOOKAHEAD:
            raise InputError(
                f"the route cannot begin: position sigma is {sigma:.2f} m, at most {LOOKAHEAD:g} m"
                " is needed"
            )
        self._taught_from = len(self._poses)
        return "the route begins here"

    def _require_localised(self, estimate: Estimate, consequence: str) -> None:
        """Raise `InputError` where the place is read-only, or the robot is not localised."""
        if not self.update:
            raise InputError(READ_ONLY)
        if estimate.status is not Status.LOCALISED:
            status = f"the status is {estimate.status.value}, not {Status.LOCALISED.value}"
            raise InputError(f"{consequence}: {status}: {estimate.reason}")

    def store_route(self, name: str, landmarks: Iterable[LandmarkEstimate]) -> str:
        """Store the path since the begin of the route as a route of the place; return a report.

        `landmarks` are those of the estimator. `HomewardError` where the robot was not localised on
        the path or did not move, the name is taken, or the place is read-only.
        """
        if not self.update:
            raise InputError(READ_ONLY)
        require_name("route", name, self.routes)
        rows = table(self._poses[self._taught_from :], COLUMNS)
        t, *poses, sigmas = last_of_equal(rows[np.isfinite(rows[:, -1])]).T
        route = taught_along(t, np.column_stack(poses), sigmas, self.when)
        self._routes[name] = route, map_of_estimates(landmarks)
        stops = count(len(route.waypoints), "way point")
        return f"route {name} is taught: {route.length:.1f} m, {stops}"

    def subscribe(self, on_change: Callable[[PlaceChanged], None]) -> None:
        """Call `on_change`, on any thread, when other robots changed the place."""

    def adopt(self) -> Place | None:
        """Use the place as other robots changed it, and return it."""
        return self.place

    def share(self, localizer: Localizer, drive: Drive, home: str, estimate: Estimate) -> None:
        """Send the visit so far to the merger of the place, if there is one and it is time."""

    def close(self) -> None:
        """End the connection to the other robots, if there is one."""

    def _with_stored(self, visit: VisitData) -> VisitData:
        """Return a visit with the homes and routes that were stored on it."""
        return replace(visit, homes=dict(self._stored), routes=dict(self._routes))

    def merge(self, localizer: Localizer, drive: Drive, home: str, is_last: bool = False) -> str:
        """Merge the current visit into the place, and write it; return the result in words.

        `localizer` received the visit; `drive` has its home and settings; answers are in the frame
        of `home`; `is_last` at the end of the session. `HomewardError` where there is too little
        to keep, or the place cannot be written; nothing is changed then.
        """
        if not self.update:
            raise InputError(READ_ONLY)
        drive = replace(drive, sightings=self._samples.sightings())
        stamps = drive.sightings.t[drive.sightings.begins]
        rows = last_of_equal(table(self._poses, COLUMNS))
        poses = np.full((stamps.size, 4), np.nan)
        known = np.isin(stamps, rows[:, 0])
        poses[known] = rows[np.searchsorted(rows[:, 0], stamps[known]), 1:]
        visit = collect_visit_along(localizer, drive, poses, self.when, home)
        require_enough(visit.map)
        visit = self._with_stored(visit)
        after = self._save(localizer, visit, home)
        self._after, self.saved = after, True
        before = self.place if after.visits[-1].verdict == "apart" else None
        why = "" if before is None else why_apart(before, visit)
        lost = "".join(f" The {words}." for words in visit.not_stored(after))
        return visit_words(after, why) + lost

    def _save(self, localizer: Localizer, visit: VisitData, home: str) -> Place:
        """Merge the visit into the place, write it, and return it."""

        def with_visit(known: Place) -> Place:
            self.place = known
            return merged(known, visit)

        if self.place is not None and self._folder is not None and not self._is_merged:
            after, self._version = files.update_place(self._folder, with_visit)
        else:
            if self.place is None:
                after = first_place(self.name, localizer, visit, home)
            else:
                after = merged(self.place, visit)
            if self._folder is not None:
                self._version = self._save_again(after, self._folder)
        self._is_merged = True
        return after

    def _save_again(self, after: Place, folder: Path) -> int:
        """Replace the version from an earlier save of this visit; return the version."""
        try:
            return files.save_place(after, folder, self._version)
        except files.PlaceChangedError as error:
            if not self._is_merged:
                raise
            raise files.PlaceChangedError(
                f"{error.what}, and contains this visit up to its last save; "
                "reset the map to save the rest as a new visit",
                error.file,
            ) from error


def localised_sigma(estimate: Estimate) -> float:
    """Return the position sigma in the worst direction [m]; NaN if not localised."""
    if estimate.status is not Status.LOCALISED or estimate.covariance is None:
        return math.nan
    return float(position_sigma(estimate.covariance))


def open_place(folder: Path, update: bool, estimator: str = DEFAULT) -> PlaceSession:
    """Return the place in a folder for a session of today; with `update` it may be a new one.

    `InputError` where there is no place, it is damaged, or the estimator cannot use places.
    """
    require_default(estimator)
    when = time.time() / DAY_S
    if update:
        files.check_place(folder)
        if not files.is_place(folder):
            return PlaceSession(folder.resolve().name, when, update, folder)
    version = files.newest(folder)
    return PlaceSession(files.load_place(folder, version), when, update, folder, version)


def require_default(estimator: str) -> None:
    """Raise `InputError` if an estimator cannot use places."""
    if estimator != DEFAULT:
        raise InputError(f"a place is for the estimator {DEFAULT}, not {estimator}")


def require_enough(own: JointMap) -> None:
    """Raise `HomewardError` if the map of a visit has too few landmarks to be merged."""
    if len(own.names) < VERIFIED:
        raise HomewardError(
            f"{count(len(own.names), 'landmark')} mapped on this visit, {VERIFIED} are "
            "needed: drive further"
        )
