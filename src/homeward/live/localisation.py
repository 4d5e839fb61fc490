"""Slow part of a session: homes, the estimator, and its answers.

The result depends only on the order of the messages, so that a recording repeats it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace
from typing import NamedTuple, TypeVar

import numpy as np

from homeward.control.following import RouteGoal
from homeward.control.goals import Goal
from homeward.control.start_guide import StartGuide
from homeward.drives.drive import Drive, HomeBearing, Odometry, Sightings
from homeward.drives.robot import with_camera
from homeward.drives.settings import DriveSettings, OtherCamera, Start
from homeward.errors import HomewardError, InputError, InternalError
from homeward.estimator import Estimate, Estimator, LandmarkEstimate, Status, add_frame, add_twist
from homeward.geometry.frames import Pose, between, compose, inverse, to_polar
from homeward.io.table import quoted
from homeward.live import messages as msg
from homeward.live.goal_resolution import NO_PLACE, home_pose, resolve_goal
from homeward.live.home_capture import MIN_R, NOTHING_SEEN, HomeCapture
from homeward.live.place_session import PlaceSession
from homeward.localizer.fixed_lag import FixedLag
from homeward.localizer.localizer import Localizer
from homeward.localizer.settings import LocalizerSettings
from homeward.odometry.validity import Clock
from homeward.registry import make_estimator, settings_model
from homeward.runs.report.words import count

Kind = TypeVar("Kind", msg.Answer, msg.Smoothed)
Homes = dict[str, dict[str, HomeBearing]]
"""Home bearings by the name of the home."""
DEFAULT_HOME = "home"
"""Name of a home without a given name."""
NO_HOME = "no home yet: send store_home or turn_home while the robot is there, or send home"
NEW_MAP = "the map was begun again"
MAX_HOMES = 100
"""Maximum number of homes, and of routes, in a session; one with long ids takes 0.2 MB."""
GOAL_UPDATE_S = 1.0
"""Interval at which the position of a landmark that is a goal is updated [s]."""


class Fix(NamedTuple):
    """An answer, and the pose of the robot's odometry frame that follows from it."""

    estimate: Estimate
    odom: Pose | None
    """The odometry frame in the home frame: REP 105's map to odom."""


class Localisation:
    """Homes, and an estimator for the current home, which is replaced with home or the map.

    With `estimator` None, only homes are kept, and there are no answers. New homes are added to
    `homes`, which are not used in a place that has homes.
    """

    def __init__(
        self,
        estimator: str | None,
        robot: DriveSettings,
        homes: Homes,
        place: PlaceSession | None = None,
        smoothed_lag: float | None = None,
    ) -> None:
        # The time at home applies to a recorded drive only.
        robot = robot.model_copy(update={"home": None})
        self._name, self._robot, self.homes, self.place = estimator, robot, homes, place
        self.home = DEFAULT_HOME
        """Home in whose frame answers are; in a place its first one."""
        self.goal: Goal | None = None
        """Last goal, in that frame; None before the first."""
        self._goal_message: msg.GoalMessage | None = None
        """Message that set the goal, while the goal can be reached."""
        self._last_go_home = msg.GoHome()
        """Last message that sent the robot to a home."""
        self._goal_updated = -math.inf
        """Time of the last update of a landmark that is the goal [s]."""
        self.goal_lost = ""
        """Reason why the goal cannot be reached any more, until `Session` resets it."""
        self.drive: Drive | None = None
        """Home and settings of the map; replaced whenever the map is begun again."""
        self.estimator: Estimator | None = None
        self.fix = Fix(Estimate(0.0, Status.WAITING, NO_HOME), None)
        """Last answer."""
        self._guide: StartGuide | None = None
        self._capture = HomeCapture()
        self._clock, self._newest = Clock(), -math.inf
        """Clock of all samples, and on it the newest stamp of a frame with bearings [s]."""
        self._lag = smoothed_lag
        self._late: FixedLag | None = None
        self.notes: tuple[str, ...] = ()
        """Notes of the estimator at the last call of `landmarks`; it may be busy now."""
        self.smoothed: list[msg.Smoothed] = []
        """Smoothed estimates that are not sent yet."""
        if estimator is not None:
            model = settings_model(estimator)  # fail now, not at each message
            if smoothed_lag is not None and not issubclass(model, LocalizerSettings):
                raise InputError(f"smoothed_lag: {estimator} cannot smooth; use robust")
        if place is not None and place.place is not None:
            self.homes, self.home = {}, place.place.origin
        if self.in_place or DEFAULT_HOME in homes:
            self._begin(None)

    @property
    def in_place(self) -> bool:
        """Whether the homes are those of an existing place."""
        return self.place is not None and self.place.place is not None

    @property
    def camera(self) -> Pose:
        """The given pose of the camera on the robot."""
        return self._robot.sensor.pose

    def yaw_of(self, camera: str) -> float:
        """Return the yaw of a camera on the robot [rad]; an unknown name is the first one's."""
        return self._robot.cameras.get(camera, self._robot.sensor).yaw

    def seen_from_robot(self, name: str) -> Pose | None:
        """Return the pose of a home in the robot's frame; None unless localised and known."""
        estimate = self.fix.estimate
        if estimate.pose is None or estimate.status is not Status.LOCALISED:
            return None
        try:
            there = home_pose(name, self.home, self.place)
        except InputError:
            return None
        return Pose(*map(float, between(estimate.pose, there)))

    @property
    def advice(self) -> str:
        """The motion that brings a pose soonest, in words; empty where there is a pose."""
        if self._guide is None or self.estimator is None or self.fix.estimate.pose is not None:
            return ""
        manoeuvre = self._guide.advice()
        return "" if manoeuvre is None else manoeuvre.words

    def do(self, message: msg.Input | msg.PlaceChanged, odom: Pose | None) -> msg.Output | None:
        """Process a message and return the answer; `odom` is the odometry pose at its stamp.

        `InputError` where the message cannot be processed; nothing changes then. `InternalError` at
        any other error; the map is begun again then.
        """
        try:
            out = self._do(message, odom)
            return msg.EventOut(type="event", text=out) if isinstance(out, str) else out
        except HomewardError:
            raise
        except Exception as error:  # a fault of homeward must not end a robot's session
            self._restart()
            raise InternalError(error, "the map was begun again") from error

    def _do(
        self, message: msg.Input | msg.PlaceChanged, odom: Pose | None
    ) -> msg.Output | str | None:
        if isinstance(message, msg.Cancel | msg.EStop | msg.GoalMessage):
            self._capture.end()
        match message:
            case msg.OdometryIn():
                self._capture.odometry(self._clock.read(message.t), message)
                if self.estimator is not None:
                    add_twist(self.estimator, message.t, message.v, message.omega, message.vy)
            case msg.BearingsIn():
                return self._answer(message, odom)
            case msg.SetHome(name=name) if self.place is not None and self.place.has_homes:
                return f"home {quoted(name)} is ignored: the place has its own homes"
            case msg.SetHome(name=name) | msg.StoreHome(name=name) if self._is_one_too_many(name):
                raise InputError(f"already {MAX_HOMES} homes; replace one of them by its name")
            case msg.SetHome(name=name, bearings=seen, sigmas=known):
                home = {i: HomeBearing(b, known.get(i, math.nan)) for i, b in seen.items()}
                return self._set_home(name, home)
            case msg.StoreHome(name=name) if self._adds_home(name):
                return self._store(name)
            case msg.StoreHome(name=name):
                return self._set_home(name, *self._capture.captured())
            case msg.LookRound() | msg.TurnHome():
                self._capture.begin(self._robot)
            case msg.SavePlace():
                return self._merge()
            case msg.GoHome(name=str(name)) if self.place is None and name != self.home:
                if name not in self.homes:
                    there = ", ".join(self.homes) or "none yet"
                    raise InputError(f"no home {quoted(name)}; there is {there}")
                self.home, self._goal_message = name, None
                self._begin(None)
                self._set_goal(message)
            case msg.GoHome(name=None, dock=dock):
                self._set_goal(self._last_go_home.model_copy(update={"dock": dock}))
            case msg.GoHome() | msg.GoTo() | msg.GoToLandmark() | msg.FollowRoute():
                self._set_goal(message)
            case msg.BeginRoute():
                return self._required_place().begin_route(self.fix.estimate)
            case msg.StoreRoute(name=name):
                if len(self._required_place().routes) >= MAX_HOMES:
                    raise InputError(f"already {MAX_HOMES} routes; no more can be stored")
                return self._required_place().store_route(name, self._known())
            case msg.SetStart(sigma=sigma):
                polar = to_polar(Pose(message.x, message.y, message.heading))
                R = max(polar.R, MIN_R)
                sigmas = sigma, sigma / R, message.sigma_heading
                self._begin(Start.about(polar._replace(R=R), *sigmas))
            case msg.SetExtrinsics(x=x, y=y, yaw=yaw, camera=name):
                camera = OtherCamera(x=x, y=y, yaw=yaw)
                self._robot = with_camera(self._robot, name, camera)
                self._capture.set_robot(self._robot)
                made, drive = self.estimator, self.drive
                if drive and isinstance(made, Localizer) and made.add_camera(name, camera):
                    self.drive = replace(drive, settings=with_camera(drive.settings, name, camera))
                elif drive:
                    self._begin(None)
            case msg.Reset():
                self._begin(None)
            case msg.PlaceChanged(text=text, is_error=is_error):
                self._adopt_place()
                return msg.EventOut(type="error" if is_error else "event", text=text)
        return None

    def finalise(self) -> str | None:
        """Merge the last visit into the place, if visits are merged; return the result in words.

        `HomewardError` where nothing of the whole session was merged.
        """
        if self.place is None:
            return None
        try:
            if not self.place.update:
                return None
            if not self.place.has_poses:
                raise HomewardError("the robot was never localised")
            return self._merge(is_last=True)
        except HomewardError as error:
            text = f"the last visit was not merged into the place: {error}"
            if self.place.saved:
                return text
            raise type(error)(text) from error
        finally:
            self.place.close()

    def landmarks(self) -> msg.LandmarksOut:
        """Return the estimates of all landmarks, and update `notes`."""
        self.notes = () if self.estimator is None else self.estimator.notes
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
        t = self._clock.read(message.t)
        self._capture.bearings(t, message)
        if self.estimator is None:
            return _as_message(Estimate(message.t, Status.WAITING, NO_HOME), msg.Answer)
        sample = message.t, message.bearings, message.sigmas or None
        ranges = message.ranges or None, message.range_sigmas or None
        estimate = add_frame(self.estimator, *sample, *ranges, message.camera)
        if self._guide is not None and odom is not None and not message.camera:
            self._guide.add(odom, message.bearings)
        is_new = bool(message.bearings) and t > self._newest
        if is_new:
            self._newest = t
        self.fix = Fix(estimate, self._odometry_frame(estimate, odom, is_new))
        if self._late is not None:
            late = self._late.add(estimate)
            self.smoothed += [_as_message(each, msg.Smoothed) for each in late]
        if self.place is not None:
            if t >= self._newest:
                self.place.see(message, estimate)
            if isinstance(self.estimator, Localizer) and self.drive is not None:
                self.place.share(self.estimator, self.drive, self.home, estimate)
        follows = isinstance(self._goal_message, msg.GoToLandmark)
        if follows and abs(message.t - self._goal_updated) > GOAL_UPDATE_S:
            self._goal_updated = message.t
            self._update_goal()
        return _as_message(estimate, msg.Answer)

    def _odometry_frame(self, estimate: Estimate, odom: Pose | None, is_new: bool) -> Pose | None:
        """Return the odometry frame in the home frame, after an answer to bearings.

        `odom` is the odometry pose at their stamp. Bearings that are not new (empty, late or
        repeated) change no estimate, and the answer to them is for the time of the newest sample:
        the odometry frame stays.
        """
        if estimate.pose is None:
            return None
        if not is_new:
            return self.fix.odom
        return None if odom is None else Pose(*map(float, compose(estimate.pose, inverse(odom))))

    def _adopt_place(self) -> None:
        """Use the place as other robots changed it."""
        place = self._required_place()
        before, now = place.place, place.adopt()
        if now is not None and now is not before and isinstance(self.estimator, Localizer):
            self.estimator.replace_known(now.known(place.when))
            self._update_goal()

    def _merge(self, is_last: bool = False) -> str:
        """Merge the visit into the place; return the result in words."""
        place = self._required_place()
        if self.drive is None or not isinstance(self.estimator, Localizer):
            raise InputError(NO_HOME)
        return place.merge(self.estimator, self.drive, self.home, is_last)

    def _required_place(self) -> PlaceSession:
        if self.place is None:
            raise InputError(NO_PLACE)
        return self.place

    def _set_goal(self, message: msg.GoalMessage) -> None:
        """Set the goal of a message."""
        self.goal = resolve_goal(message, self.home, self.place, self._known)
        self._goal_message = message
        if isinstance(message, msg.GoHome):
            self._last_go_home = message

    def _known(self) -> Iterable[LandmarkEstimate]:
        return () if self.estimator is None else self.estimator.landmarks()

    def _adds_home(self, name: str) -> bool:
        """Whether a home that is stored is a further one of the place."""
        begun = self.drive is not None and name != self.home
        return self.place is not None and (self.in_place or begun)

    def _store(self, name: str) -> str:
        """Store the pose of the robot as a further home of the place."""
        assert self.place is not None
        self._capture.end()  # its landmarks are in the map
        if (now := self._capture.newest) is None:
            raise InputError(NOTHING_SEEN)
        return self.place.store_home(name, self.home, now, self.fix.estimate)

    def _set_home(
        self, name: str, seen: dict[str, HomeBearing], start: Start | None = None, words: str = ""
    ) -> str:
        """Set home and begin the map again; `words` describe how home was captured."""
        if not seen:
            raise InputError(f"home {quoted(name)} has no landmarks: not stored")
        self.homes[name], self.home = seen, name
        self._begin(start)
        words = f"is stored: {words}" if words else f"has {count(len(seen), 'landmark')}"
        return f"home {quoted(name)} {words}"

    def _begin(self, start: Start | None) -> None:
        """Begin the map again."""
        self._capture.end()
        if self.place is not None:
            self.place.begin()
        if not self.in_place and self.home not in self.homes:
            raise InputError(NO_HOME)
        none = np.empty(0)
        sightings = Sightings(none, np.empty(0, object), none, none)
        robot = self._robot if start is None else self._robot.model_copy(update={"start": start})
        odometry = Odometry(none, none, none)
        home = {} if self.in_place else self.homes[self.home]
        self.drive = drive = Drive("live", odometry, sightings, home, robot)
        self._guide = StartGuide(home, self.camera) if home else None  # a place has its own map
        if self.place is not None:
            drive = self.place.known_by(drive)
            self._robot = self._robot.model_copy(update={"start": None})  # valid only once
        if self._name is not None:
            self.estimator = estimator = make_estimator(self._name, drive)
            if self._lag is not None and isinstance(estimator, Localizer):
                self._late = FixedLag(estimator, self._lag)
        self._update_goal()
        self.fix = Fix(Estimate(self.fix.estimate.t, Status.WAITING, NEW_MAP), None)

    def _restart(self) -> None:
        """Begin the map again after an error; without home and map where that fails, too."""
        self._goal_message = self.goal = None
        try:
            self._begin(None)
        except Exception:
            self.drive = self.estimator = self._late = None
            self.fix = Fix(Estimate(self.fix.estimate.t, Status.WAITING, NO_HOME), None)

    def _is_one_too_many(self, name: str) -> bool:
        """Whether a home of that name would exceed `MAX_HOMES`."""
        homes = self.homes if self.place is None else {*self.homes, *self.place.homes}
        return len(homes) >= MAX_HOMES and name not in homes

    def _update_goal(self) -> None:
        """Resolve the goal again, in a new map or with new landmark estimates."""
        if self._goal_message is None:
            return
        try:
            goal = resolve_goal(self._goal_message, self.home, self.place, self._known)
        except InputError as error:  # the home or route was stored, but not saved
            self.goal = self._goal_message = None
            self._last_go_home, self.goal_lost = msg.GoHome(), str(error)
            return
        if not isinstance(goal, RouteGoal):  # a drive along a route keeps its progress
            self.goal = goal


def _as_message(estimate: Estimate, kind: type[Kind]) -> Kind:
    pose, covariance = estimate.pose, estimate.covariance
    six = None if covariance is None else tuple(covariance[np.triu_indices(3)].tolist())
    about = {"t": estimate.t, "status": estimate.status, "reason": estimate.reason}
    return kind(**about, pose=pose, covariance=six, accuracy=estimate.accuracy)


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
