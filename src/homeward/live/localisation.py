"""The slow side of a session: homes, the estimator, and what it answers.

The order of the messages alone decides what comes of them, so that a recording repeats it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from homeward.control.goals import Goal, RouteGoal
from homeward.drives.drive import Drive, HomeBearing, Odometry, Sightings
from homeward.drives.settings import DriveSettings, Start
from homeward.errors import HomewardError, InputError, InternalError
from homeward.estimator import Estimate, Estimator, LandmarkEstimate, Status
from homeward.geometry.frames import Pose, compose, inverse, to_polar
from homeward.io.table import quoted
from homeward.live import messages as msg
from homeward.live.looking import NEAREST_M, Looking
from homeward.live.sending import NO_PLACE, resolve_goal
from homeward.live.visiting import PlaceSession
from homeward.localizer.localizer import Localizer
from homeward.registry import make_estimator, settings_model
from homeward.runs.report.words import count

Homes = dict[str, dict[str, HomeBearing]]
"""Home bearings by the name of the home."""
FIRST = "home"
"""The name of a home that nobody named."""
NO_HOME = "no home yet: store_home or turn_home while the robot is there, or send one"
ANEW = "the map was begun anew"
MAX_HOMES = 100
"""Homes, and routes, that a session keeps; one of long ids takes 0.2 MB."""
AIM_S = 1.0
"""It is found so often where a landmark is that the robot is sent to [s]."""


class Fix(NamedTuple):
    """An answer, and where the robot's odometry frame lies by it."""

    estimate: Estimate
    odom: Pose | None
    """The odometry frame in the home frame: REP 105's map to odom."""


class Localisation:
    """Home, and an estimator for it, made anew when home or the map is.

    `estimator` None: only homes are kept, and nothing is answered. `homes` are added to; in a place
    that has homes they are not used.
    """

    def __init__(
        self,
        estimator: str | None,
        robot: DriveSettings,
        homes: Homes,
        place: PlaceSession | None = None,
    ) -> None:
        # When a drive was at home is no word for one that is not over.
        robot = robot.model_copy(update={"home": None})
        self._name, self._robot, self.homes, self.place = estimator, robot, homes, place
        self.home = FIRST
        """In whose frame answers are; in a place its first one."""
        self.goal: Goal | None = None
        """Where the robot was sent last, in that frame; None before it was."""
        self._sent: msg.Departure | None = None
        """By what, as long as it can go there."""
        self._homeward = msg.GoHome()
        """The home that it was sent to last."""
        self._aimed = -math.inf
        """When it was found last where a landmark is that it is sent to [s]."""
        self.goal_lost = ""
        """Why it cannot go there any more, until somebody has taken that."""
        self.drive: Drive | None = None
        """Home and settings of the map; another one whenever the map is begun anew."""
        self.estimator: Estimator | None = None
        self.fix = Fix(Estimate(0.0, Status.WAITING, NO_HOME), None)
        """The last one."""
        self._looking = Looking()
        if estimator is not None:
            settings_model(estimator)  # whether there is one is not to be said of each message
        if place is not None and place.place is not None:
            self.homes, self.home = {}, place.place.origin
        if self.in_place or FIRST in homes:
            self._begin(None)

    @property
    def in_place(self) -> bool:
        """Whether homes are those of a place that is known."""
        return self.place is not None and self.place.place is not None

    def do(self, message: msg.Input, odom: Pose | None) -> msg.Output | None:
        """Process a message, and return the answer to it; `odom` is the odometry pose at its stamp.

        `InputError` where it cannot be done; nothing is changed then. `InternalError` at any other
        error; the map is begun again then.
        """
        try:
            return self._do(message, odom)
        except HomewardError:
            raise
        except Exception as error:  # a fault of homeward must not end a robot's session
            self._restart()
            raise InternalError(error, "the map was begun again") from error

    def _do(self, message: msg.Input, odom: Pose | None) -> msg.Output | None:
        if isinstance(message, msg.Cancel | msg.EStop | msg.Departure):
            self._looking.end()
        match message:
            case msg.OdometryIn():
                self._looking.odometry(message)
                if self.estimator is not None:
                    self.estimator.odometry(message.t, message.v, message.omega)
            case msg.BearingsIn():
                return self._answer(message, odom)
            case msg.SetHome(name=name) if self.place is not None and self.place.has_homes:
                text = f"home {quoted(name)} is not looked at: the place knows its homes"
                return msg.EventOut(type="event", text=text)
            case msg.SetHome(name=name) | msg.StoreHome(name=name) if self._is_one_too_many(name):
                raise InputError(
                    f"{MAX_HOMES} homes are kept already; store home under one of their names"
                )
            case msg.SetHome(name=name, bearings=seen, sigmas=known):
                home = {i: HomeBearing(b, known.get(i, math.nan)) for i, b in seen.items()}
                return self._new(name, home)
            case msg.StoreHome(name=name) if self._adds_home(name):
                return self._store(name)
            case msg.StoreHome(name=name):
                return self._new(name, *self._looking.here())
            case msg.LookRound() | msg.TurnHome():
                self._looking.begin(self._robot)
            case msg.SavePlace():
                return msg.EventOut(type="event", text=self._merge())
            case msg.GoHome(name=str(name)) if self.place is None and name != self.home:
                if name not in self.homes:
                    there = ", ".join(self.homes) or "none yet"
                    raise InputError(f"no home {quoted(name)}; there is {there}")
                self.home, self._sent = name, None
                self._begin(None)
                self._send(message)
            case msg.GoHome(name=None):
                self._send(self._homeward)
            case msg.GoHome() | msg.GoTo() | msg.GoToLandmark() | msg.FollowRoute():
                self._send(message)
            case msg.BeginRoute():
                text = self._required_place().begin_route(self.fix.estimate)
                return msg.EventOut(type="event", text=text)
            case msg.StoreRoute(name=name):
                if len(self._required_place().routes) >= MAX_HOMES:
                    raise InputError(f"{MAX_HOMES} routes are kept already; no more can be stored")
                text = self._required_place().store_route(name, self._known())
                return msg.EventOut(type="event", text=text)
            case msg.StartIn(sigma=sigma):
                polar = to_polar(Pose(message.x, message.y, message.heading))
                R = max(polar.R, NEAREST_M)
                sigmas = sigma, sigma / R, message.sigma_heading
                self._begin(Start.about(polar._replace(R=R), *sigmas))
            case msg.MountIs(x=x, y=y, yaw=yaw):
                sensor = self._robot.sensor.model_copy(update={"x": x, "y": y, "yaw": yaw})
                self._robot = self._robot.model_copy(update={"sensor": sensor})
                if self.drive is not None:
                    self._begin(None)
            case msg.Reset():
                self._begin(None)
        return None

    def conclude(self) -> str | None:
        """Merge the last visit into the place, if visits are merged; return what it told, in words.

        `HomewardError` where nothing of the whole session was merged.
        """
        if self.place is None or not self.place.update:
            return None
        try:
            if not self.place.has_poses:
                raise HomewardError("the robot did not know where it was")
            return self._merge()
        except HomewardError as error:
            text = f"the last visit was not merged into the place: {error}"
            if self.place.saved:
                return text
            raise type(error)(text) from error

    def landmarks(self) -> msg.LandmarksOut:
        """Return what is known of all landmarks."""
        return msg.LandmarksOut(
            landmarks=tuple(
                msg.LandmarkOut(
                    landmark=m.landmark,
                    x=_finite(m.x),
                    y=_finite(m.y),
                    moved_probability=_finite(m.moved_probability),
                )
                for m in self._known()
            )
        )

    def _answer(self, message: msg.BearingsIn, odom: Pose | None) -> msg.Answer:
        self._looking.bearings(message)
        if self.estimator is None:
            return _said(Estimate(message.t, Status.WAITING, NO_HOME))
        estimate = self.estimator.bearings(message.t, message.bearings, message.sigmas or None)
        frame = None
        if estimate.pose is not None and odom is not None:
            frame = Pose(*map(float, compose(estimate.pose, inverse(odom))))
        self.fix = Fix(estimate, frame)
        if self.place is not None:
            self.place.see(message, estimate)
        if isinstance(self._sent, msg.GoToLandmark) and abs(message.t - self._aimed) > AIM_S:
            self._aimed = message.t
            self._find_goal()
        return _said(estimate)

    def _merge(self) -> str:
        """Merge the visit into the place; return what it told."""
        place = self._required_place()
        if self.drive is None or not isinstance(self.estimator, Localizer):
            raise InputError(NO_HOME)
        return place.merge(self.estimator, self.drive, self.home)

    def _required_place(self) -> PlaceSession:
        if self.place is None:
            raise InputError(NO_PLACE)
        return self.place

    def _send(self, message: msg.Departure) -> None:
        """Send the robot where a message says."""
        self.goal = resolve_goal(message, self.home, self.place, self._known)
        self._sent = message
        if isinstance(message, msg.GoHome):
            self._homeward = message

    def _known(self) -> Iterable[LandmarkEstimate]:
        return () if self.estimator is None else self.estimator.landmarks()

    def _adds_home(self, name: str) -> bool:
        """Return whether a home that is stored is one more of the place."""
        begun = self.drive is not None and name != self.home
        return self.place is not None and (self.in_place or begun)

    def _store(self, name: str) -> msg.EventOut:
        """Store one more home of the place, where the robot is."""
        assert self.place is not None
        self._looking.end()  # its landmarks are in the map
        if (now := self._looking.newest) is None:
            raise InputError("home cannot be stored: nothing is seen")
        text = self.place.store_home(name, self.home, now, self.fix.estimate)
        return msg.EventOut(type="event", text=text)

    def _new(
        self, name: str, seen: dict[str, HomeBearing], start: Start | None = None, words: str = ""
    ) -> msg.EventOut:
        """Take a home, and begin the map anew; words say how it was found."""
        if not seen:
            raise InputError(f"home {quoted(name)} has no landmarks: nothing is stored")
        self.homes[name], self.home = seen, name
        self._begin(start)
        said = f"is stored: {words}" if words else f"has {count(len(seen), 'landmark')}"
        return msg.EventOut(type="event", text=f"home {quoted(name)} {said}")

    def _begin(self, start: Start | None) -> None:
        """Begin the map anew."""
        self._looking.end()
        if self.place is not None:
            self.place.begin()
        if not self.in_place and self.home not in self.homes:
            raise InputError(NO_HOME)
        none = np.empty(0)
        sightings = Sightings(none, np.empty(0, object), none, none)
        told = self._robot if start is None else self._robot.model_copy(update={"start": start})
        odometry = Odometry(none, none, none)
        home = {} if self.in_place else self.homes[self.home]
        self.drive = drive = Drive("live", odometry, sightings, home, told)
        if self.place is not None:
            drive = self.place.known_by(drive)
            self._robot = self._robot.model_copy(update={"start": None})  # it was there but once
        if self._name is not None:
            self.estimator = make_estimator(self._name, drive)
        self._find_goal()
        self.fix = Fix(Estimate(self.fix.estimate.t, Status.WAITING, ANEW), None)

    def _restart(self) -> None:
        """Begin the map again after an error; without a home and a map where that fails, too."""
        self._sent = self.goal = None
        try:
            self._begin(None)
        except Exception:
            self.drive = self.estimator = None
            self.fix = Fix(Estimate(self.fix.estimate.t, Status.WAITING, NO_HOME), None)

    def _is_one_too_many(self, name: str) -> bool:
        """Return whether a home of that name is one more than are kept."""
        homes = self.homes if self.place is None else {*self.homes, *self.place.homes}
        return len(homes) >= MAX_HOMES and name not in homes

    def _find_goal(self) -> None:
        """Find where the robot was sent, in a map that is begun anew or that knows more."""
        if self._sent is None:
            return
        try:
            goal = resolve_goal(self._sent, self.home, self.place, self._known)
        except InputError as error:  # it was stored, and not saved
            self.goal = self._sent = None
            self._homeward, self.goal_lost = msg.GoHome(), str(error)
            return
        if not isinstance(goal, RouteGoal):  # a drive along a route goes on where it was
            self.goal = goal


def _said(estimate: Estimate) -> msg.Answer:
    pose, covariance = estimate.pose, estimate.covariance
    six = None if covariance is None else tuple(covariance[np.triu_indices(3)].tolist())
    return msg.Answer(
        t=estimate.t, status=estimate.status, reason=estimate.reason, pose=pose, covariance=six
    )


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
