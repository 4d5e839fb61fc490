"""The place of a session: what is known of it, and what each visit tells it.

A visit is what came since the map was begun last: by a reset, a start, or when the session began.
Whenever it is merged, it is merged whole into the place as it was before it, so that nothing counts
twice however often it is saved.
"""

from __future__ import annotations

import math
import time
from array import array
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from homeward.control.following import LOOKAHEAD
from homeward.drives.drive import Drive, Samples, last_of_equal, table
from homeward.errors import HomewardError, InputError
from homeward.estimator import Estimate, LandmarkEstimate, Status
from homeward.geometry.frames import Pose, position_sigma
from homeward.io.table import quoted
from homeward.live.messages import BearingsIn
from homeward.localizer.localizer import Localizer
from homeward.localizer.tunables import VERIFIED
from homeward.places import files
from homeward.places.joint_map import JointMap
from homeward.places.place import DAY_S, Place
from homeward.places.route import Route, map_of_estimates, route_of, taught_along
from homeward.places.visit_data import VisitData, collect_visit_along, require_name
from homeward.places.visiting import first_place, merged
from homeward.registry import DEFAULT
from homeward.runs.report.words import count, visit_words

COLUMNS = 5
"""Of what is kept of an answer: stamp, pose, and how uncertain its place is if it is localised."""
READ_ONLY = "the place is left as it is: homeward live --update, or place_update of the node"


class PlaceSession:
    """The place of a session, and what its visits add to it.

    `place` is a name where the first visit makes a new one. `when` is the day of the session [days
    since 1970]. With `update`, visits are merged and, if there is a `folder`, written to it after
    its newest `version`.
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
        """Begin a visit: nothing was seen on it yet, and what was merged before stays."""
        self.place = self._after
        self._is_merged = False
        """Whether a part of this visit is in the newest version that this session wrote."""
        self._samples, self._poses = Samples(), array("d")
        self._stored: dict[str, tuple[Estimate, Mapping[str, float]]] = {}
        self._routes: dict[str, tuple[Route, JointMap]] = {}
        self._taught_from = 0
        """How many answers came before the route that is being taught."""

    @property
    def has_homes(self) -> bool:
        """Whether it has homes, as it was or by what was merged since."""
        return self._after is not None

    @property
    def has_poses(self) -> bool:
        """Whether the robot knew on this visit where it was."""
        return bool(self._poses)

    @property
    def homes(self) -> tuple[str, ...]:
        """The homes that there are, and will be after this visit."""
        return (*(self.place.homes if self.place is not None else ()), *self._stored)

    def known_by(self, drive: Drive) -> Drive:
        """Return a drive as it knows the place, in the frame of its first home."""
        return drive if self.place is None else self.place.visited_by(drive, self.when)

    def home_pose(self, name: str, first: str) -> Pose:
        """Return where a home is in the frame of the `first`; `InputError` where there is none."""
        if name == first:
            return Pose(0.0, 0.0, 0.0)
        if name in self._stored and (pose := self._stored[name][0].pose) is not None:
            return pose
        if self.place is None or name not in self.place.homes:
            there = ", ".join((first, *(n for n in self.homes if n != first)))
            raise InputError(f"no home {quoted(name)} in the place; there are {there}")
        return self.place.home_pose(name)

    def see(self, message: BearingsIn, estimate: Estimate) -> None:
        """Take what was seen, and the answer to it."""
        if not self.update:
            return
        self._samples.add_bearings(message.t, message.bearings, message.sigmas)
        if estimate.pose is not None:
            self._poses.extend((message.t, *estimate.pose, _sigma(estimate)))

    def store_home(self, name: str, first: str, seen: BearingsIn, estimate: Estimate) -> str:
        """Store a home where the robot is, and say so; it is one of the place after this visit.

        `InputError` where the robot is not localised, the name is taken, or nothing is merged.
        """
        require_name("home", name, (first, *self.homes))
        self._require_localised(estimate, f"home {quoted(name)} cannot be stored by")
        self._stored[name] = replace(estimate, innovations=()), dict(seen.bearings)
        return f"home {quoted(name)} is here, {count(len(seen.bearings), 'landmark')} in sight"

    @property
    def routes(self) -> dict[str, Route]:
        """The routes that there are, and will be after this visit."""
        known = {} if self.place is None else self.place.routes
        return known | {name: route for name, (route, _) in self._routes.items()}

    def route(self, name: str) -> Route:
        """Return a route of the place or of this visit, in the frame of the answers."""
        return route_of(self.routes, name)

    def landmark(self, name: str) -> tuple[float, float] | None:
        """Return where the place has a landmark, in the frame of its first home [m]."""
        if self.place is None or name not in self.place.persistence:
            return None
        x, y = self.place.map.positions[self.place.map.names.index(name)].tolist()
        return x, y

    def begin_route(self, estimate: Estimate) -> str:
        """Begin to teach a route where the robot is, and say so.

        `InputError` where the robot is not well localised, or nothing is merged.
        """
        self._require_localised(estimate, "a route cannot begin with")
        if (sigma := _sigma(estimate)) > LOOKAHEAD:
            raise InputError(
                f"a route cannot begin with a robot that knows where it is to {sigma:.2f} m only"
            )
        self._taught_from = len(self._poses)
        return "a route begins here"

    def _require_localised(self, estimate: Estimate, words: str) -> None:
        """Raise `InputError` where visits are not merged, or the robot is not localised."""
        if not self.update:
            raise InputError(READ_ONLY)
        if estimate.status is not Status.LOCALISED:
            raise InputError(f"{words} a robot that is {estimate.status.value}: {estimate.reason}")

    def store_route(self, name: str, landmarks: Iterable[LandmarkEstimate]) -> str:
        """Store the path since the route began, and say so; it is one of the place from then on.

        `landmarks` are those of the estimator. `HomewardError` where the robot was not localised on
        its way, or led nowhere, or the name is taken, or nothing is merged.
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

    def merge(self, localizer: Localizer, drive: Drive, home: str) -> str:
        """Merge the visit so far into the place, and write that; return what it told, in words.

        `localizer` received the visit; `drive` has its home and settings; answers are in the frame
        of `home`. `HomewardError` where there is too little to be kept, or it cannot be written:
        nothing is changed then.
        """
        if not self.update:
            raise InputError(READ_ONLY)
        drive = replace(drive, sightings=self._samples.sightings())
        stamps, rows = np.unique(drive.sightings.t), last_of_equal(table(self._poses, COLUMNS))
        poses = np.full((stamps.size, 3), np.nan)
        poses[np.isin(stamps, rows[:, 0])] = rows[np.isin(rows[:, 0], stamps), 1:4]
        told = collect_visit_along(localizer, drive, poses, self.when, home)
        if len(told.map.names) < VERIFIED:
            raise HomewardError(
                f"{count(len(told.map.names), 'landmark')} mapped on this visit, and it takes "
                f"{VERIFIED} to know a place: drive further"
            )
        for name, (answer, seen) in self._stored.items():
            told = told.store_home(name, answer, seen)
        told = replace(told, routes=dict(self._routes))
        after = self._save(localizer, told, home)
        lost = [f" Home {name} was not stored." for name in self._stored if name not in after.homes]
        lost += [f" Route {n} was not stored." for n in self._routes if n not in after.routes]
        self._after, self.saved = after, True
        return visit_words(after) + "".join(lost)

    def _save(self, localizer: Localizer, told: VisitData, home: str) -> Place:
        """Merge the measurements of the visit into the place, write it, and return it."""

        def with_visit(known: Place) -> Place:
            self.place = known
            return merged(known, told)

        if self.place is not None and self._folder is not None and not self._is_merged:
            after, self._version = files.update_place(self._folder, with_visit)
        else:
            if self.place is None:
                after = first_place(self.name, localizer, told, home)
            else:
                after = merged(self.place, told)
            if self._folder is not None:
                self._version = self._save_again(after, self._folder)
        self._is_merged = True
        return after

    def _save_again(self, after: Place, folder: Path) -> int:
        """Replace what an earlier save of this visit wrote; return the version."""
        try:
            return files.save_place(after, folder, self._version)
        except files.PlaceChangedError as error:
            if not self._is_merged:
                raise
            raise files.PlaceChangedError(
                f"{error.what}, and holds this visit up to its last save; "
                "reset the map to save the rest as a new visit",
                error.file,
            ) from error


def _sigma(estimate: Estimate) -> float:
    """Return how uncertain a place is along the worst direction [m]; NaN if not localised."""
    if estimate.status is not Status.LOCALISED or estimate.covariance is None:
        return math.nan
    return float(position_sigma(estimate.covariance))


def open_place(folder: Path, update: bool, estimator: str = DEFAULT) -> PlaceSession:
    """Return the place in a folder for a session of today, or, to be updated, perhaps a new one.

    `InputError` where there is none, or it is damaged, or the folder has something else, or the
    estimator cannot use places.
    """
    if estimator != DEFAULT:
        raise InputError(f"a place is for the estimator {DEFAULT}, not {estimator}")
    when = time.time() / DAY_S
    if update:
        files.check_place(folder)
        if not files.is_place(folder):
            return PlaceSession(folder.resolve().name, when, update, folder)
    version = files.newest(folder)
    return PlaceSession(files.load_place(folder, version), when, update, folder, version)
