"""A robot found elsewhere was displaced, or landmarks in view moved together and it was not."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from homeward.geometry.angles import wrap
from homeward.geometry.se2 import sight
from homeward.localizer.recovery.monitor import Monitor
from homeward.localizer.recovery.relocalise import Displacement, at_pose

AROUND = np.linspace(0.0, math.tau, 8, endpoint=False)
PLACES = {f"L{i}": 3.0 * np.array([math.cos(a), math.sin(a)]) for i, a in enumerate(AROUND)}
HERE, ELSEWHERE = np.zeros(3), np.array([0.8, 0.4, 0.2])
SMALL = 1e-4 * np.eye(3)


def displacement(found=ELSEWHERE, odometry=HERE, uncertain=SMALL):
    """A robot that was found at a pose, and by odometry would be at another one."""
    return Displacement(at_pose(found, SMALL), at_pose(odometry, uncertain), 3.0)


def add(displaced, names, static=(), found=ELSEWHERE):
    """Add a frame of landmarks, some of them seen as from where odometry has the robot.

    `found` is the pose at which the robot was found by the newest solution of the map.
    """
    places = np.array([PLACES[name] for name in names])
    expected = sight(ELSEWHERE, places).bearing
    bearings = [
        sight(HERE if name in static else ELSEWHERE, PLACES[name]).bearing for name in names
    ]
    result = SimpleNamespace(
        eye=ELSEWHERE,
        residual=np.asarray(wrap(np.array(bearings) - expected)),
        deviation=np.full(len(names), 0.02),
    )
    smoother = SimpleNamespace(first=0, poses=found[None])
    landmarks = SimpleNamespace(
        mapped=PLACES, positions=lambda some: np.array([PLACES[name] for name in some])
    )
    gated = SimpleNamespace(result=result, fits=dict.fromkeys(names, True))
    monitor = Monitor(origin_given=False)
    monitor.displacement = displaced
    is_refuted = monitor.test_displacement(
        gated, SimpleNamespace(smoother=smoother, landmarks=landmarks)
    )
    return "moved" if is_refuted else "open" if monitor.displacement else "displaced"


def test_a_displaced_robot_is_confirmed_by_more_than_half_of_the_landmarks():
    displaced = displacement()
    assert add(displaced, ["L0", "L1", "L2", "L3"]) == "open"
    assert add(displaced, ["L0", "L1"]) == "open"  # seen before
    assert add(displaced, ["L4"]) == "open"  # one of five may be wrong
    assert add(displaced, ["L5", "L6"]) == "displaced"


def test_landmarks_that_moved_together_are_named_once_others_are_in_place():
    displaced = displacement()
    assert add(displaced, ["L0", "L1", "L2"]) == "open"
    assert add(displaced, ["L3", "L4"], static=["L3", "L4"]) == "moved"
    assert displaced.moved == ["L0", "L1", "L2"]


def test_one_landmark_that_seems_in_place_decides_nothing():
    displaced = displacement()
    add(displaced, ["L0", "L1", "L2"])
    assert add(displaced, ["L3"], static=["L3"]) == "open"
    assert add(displaced, ["L3", "L4", "L5", "L6", "L7"]) == "displaced"


def test_odometry_that_is_lost_contradicts_no_pose():
    displaced = displacement(uncertain=np.diag([1.0, 1.0, 0.3]) ** 2)
    assert add(displaced, ["L0", "L1", "L2", "L3", "L4", "L5"]) != "moved"
    assert add(displaced, ["L6", "L7"], static=["L6", "L7"]) != "moved"
    assert not displaced.is_none


@pytest.mark.parametrize(("off", "is_none"), [(0.05, True), (0.3, False)])
def test_a_robot_found_near_where_odometry_has_it_was_not_displaced(off, is_none):
    assert displacement(found=np.array([off, 0.0, 0.0])).is_none is is_none


def test_a_displacement_ends_where_the_map_finds_the_robot_where_odometry_has_it():
    """As after a camera was turned: it is known again, and explains the bearings."""
    displaced = displacement()
    assert add(displaced, ["L0", "L1", "L2"]) == "open"
    assert displaced.is_none is False
    add(displaced, ["L0", "L1", "L2"], static=["L0", "L1", "L2"], found=HERE)
    assert displaced.is_none is True


def test_the_pose_without_a_displacement_follows_the_motion_since():
    now = displacement().without(at_pose(ELSEWHERE, SMALL))
    assert now.delta == pytest.approx(HERE)
    assert now.covariance == pytest.approx(2.0 * SMALL)
    driven = np.array([ELSEWHERE[0] - math.sin(0.2), ELSEWHERE[1] + math.cos(0.2), 0.2])
    now = displacement().without(at_pose(driven, SMALL))  # 1 m to the left
    assert now.delta == pytest.approx([0.0, 1.0, 0.0])
    assert now.covariance[0, 0] == pytest.approx(3e-4)  # the heading's error times 1 m, too
