"""Goals from messages."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable

from homeward.control.docking import DockGoal
from homeward.control.following import RouteGoal
from homeward.control.goals import Goal, PointGoal
from homeward.errors import InputError
from homeward.estimator import LandmarkEstimate
from homeward.geometry.frames import Pose
from homeward.io.table import quoted
from homeward.live.messages import FollowRoute, GoalMessage, GoHome, GoTo, GoToLandmark
from homeward.live.place_session import PlaceSession

NO_PLACE = "there is no place: start homeward live with --place, or the node with place"
Known = Callable[[], Iterable[LandmarkEstimate]]


def resolve_goal(message: GoalMessage, home: str, place: PlaceSession | None, known: Known) -> Goal:
    """Return the goal of a message, in the frame of `home`, which is that of the answers.

    `known` returns the landmarks of the estimator. `InputError` where there is no such home, route
    or landmark.
    """
    match message:
        case GoTo(x=x, y=y):
            return PointGoal("there", x, y)
        case GoToLandmark(name=name, standoff=standoff):
            return PointGoal(name, *_landmark(name, place, known), standoff)
        case FollowRoute(name=name):
            if place is None:
                raise InputError(NO_PLACE)
            return RouteGoal(name, place.route(name).path)
        case GoHome(name=name, dock=dock):
            there = home_pose(name or home, home, place)
            return DockGoal(name or home, there) if dock else PointGoal(name or home, *there[:2])


def home_pose(name: str, home: str, place: PlaceSession | None) -> Pose:
    """Return the pose of a home in the frame of `home`; `InputError` for one unknown there."""
    if place is not None:
        return place.home_pose(name, home)
    if name != home:
        raise InputError(f"no home {quoted(name)} in the map; it is of {quoted(home)}")
    return Pose(0.0, 0.0, 0.0)


def _landmark(name: str, place: PlaceSession | None, known: Known) -> tuple[float, float]:
    """Return the position of a landmark [m], from the estimator or else from the place."""
    for mark in known():
        if mark.landmark == name and math.isfinite(mark.x):
            return mark.x, mark.y
    if place is not None and (there := place.landmark(name)) is not None:
        return there
    raise InputError(f"no landmark {quoted(name)} in the map yet; drive until it is mapped")
