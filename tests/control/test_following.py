"""Following a path: from anywhere, within its bounds, past all that comes between."""

import math

import numpy as np
import pytest

from homeward.control import following
from homeward.control.following import (
    COAST_S,
    LOOKAHEAD,
    PATIENCE_S,
    REACHED,
    RETRY_S,
    Path,
    RouteGoal,
)
from homeward.control.goals import STAND, Belief, GoalState
from homeward.control.limits import Limits
from homeward.estimator import Status
from homeward.geometry.frames import Pose, advance

DT = 0.05
CORNERS = np.array([[0.0, 0.0], [3.0, 0.0], [3.0, 2.0], [0.0, 2.0]])


class Follower:
    """A drive along a path, and its last state and reason."""

    def __init__(self, path, speed, turn_rate):
        goal = RouteGoal("round", path)
        self._follower = following.Follower(goal, Limits(speed=speed, turn_rate=turn_rate))
        self.state = self.reason = None

    @property
    def is_over(self):
        return self.state in (GoalState.ARRIVED, GoalState.FAILED)

    def twist(self, t, pose, sure=True, blocked=False):
        belief = Belief(Status.LOCALISED if sure else Status.MAPPING, pose, None)
        output = self._follower.step(t, belief, "blocked" if blocked else "")
        self.state, self.reason = output.state, output.reason
        return output.twist


def drive(follower, pose, seconds, t=0.0, **commands):
    """Follow exactly; return times, poses and twists."""
    rows = []
    while not follower.is_over and t < seconds:
        twist = follower.twist(t, pose, **commands)
        rows.append((t, *pose, *twist))
        pose, t = advance(pose, twist, DT), t + DT
        pose = pose._replace(heading=math.remainder(pose.heading, 2 * math.pi))
    return np.array(rows), pose


def off(path, points):
    """How far points (m, 2) are from a path."""
    a, b = path.points[:-1], path.points[1:]
    way = b - a
    share = ((points[:, None] - a) * way).sum(-1) / np.maximum((way**2).sum(-1), 1e-12)
    near = a + np.clip(share, 0, 1)[..., None] * way
    return np.hypot(*(near - points[:, None]).T).min(axis=0)


@pytest.mark.parametrize("turn_rate", [0.3, 1.0, 5.0])
def test_from_anywhere_to_the_end_within_the_bounds(turn_rate):
    rng = np.random.default_rng(0)
    for _ in range(12):
        start = Pose(*rng.uniform((-4, -4, -math.pi), (6, 6, math.pi)).tolist())
        follower = Follower(Path(CORNERS, [(3, 1.0, 0.0, "end")]), 0.4, turn_rate)
        rows, end = drive(follower, start, 300.0)
        assert follower.state is GoalState.ARRIVED
        assert math.dist(end[:2], CORNERS[-1]) <= REACHED
        assert abs(end.heading - 1.0) < 0.06
        v, omega = rows[:, 4:].T
        assert (v >= 0).all()
        assert v.max() <= 0.4 + 1e-12
        assert np.abs(omega).max() <= turn_rate + 1e-12


@pytest.mark.parametrize("offset", [0.3, -0.2])
def test_next_to_a_straight_path_the_error_falls_as_in_the_linear_model(offset):
    v, last = 0.3, LOOKAHEAD / 0.3
    follower = Follower(Path(np.array([[0.0, 0.0], [20.0, 0.0]])), v, 9.0)
    rows, _ = drive(follower, Pose(0.5, 0.1 * offset, 0.0), 8 * last)
    t, y = rows[:, 0], rows[:, 2]
    linear = 0.1 * offset * np.exp(-t / last) * (np.cos(t / last) + np.sin(t / last))
    np.testing.assert_allclose(y, linear, atol=0.06 * abs(0.1 * offset))


def test_along_a_circle_there_is_no_lasting_error():
    angle = np.arange(0.0, 5.0, 0.02)
    path = Path(np.column_stack([np.cos(angle), np.sin(angle)]))
    rows, _ = drive(Follower(path, 0.3, 2.0), Pose(1.0, 0.0, math.pi / 2), 12.0)
    assert off(path, rows[:, 1:3]).max() < 2e-3


def test_a_corner_without_a_stop_is_cut_by_a_decimetre():
    path = Path(np.array([[0.0, 0.0], [3.0, 0.0], [3.0, 3.0]]))
    rows, _ = drive(Follower(path, 0.4, 1.0), Pose(0.0, 0.0, 0.0), 60.0)
    assert 0.05 < off(path, rows[:, 1:3]).max() < 0.12


def test_on_the_path_on_a_stop_and_on_a_path_of_one_point_nothing_is_divided_by_zero():
    for path, start in [
        (Path(CORNERS), Pose(0.0, 0.0, 0.0)),
        (Path(CORNERS, [(1, 0.0, 0.0, "a")]), Pose(3.0, 0.0, 0.0)),
        (Path(np.array([[1.0, 1.0]])), Pose(1.0, 1.0, 0.0)),
        (Path(np.repeat(CORNERS, 3, axis=0)), Pose(1.0, 0.0, math.pi)),
    ]:
        follower = Follower(path, 0.4, 1.0)
        rows, _ = drive(follower, start, 120.0)
        assert np.isfinite(rows).all()
        assert follower.state is GoalState.ARRIVED


def test_there_and_back_in_one_aisle_is_driven_whole():
    path = Path(np.array([[0.0, 0.0], [4.0, 0.0], [0.0, 0.0]]))
    follower = Follower(path, 0.4, 1.0)
    rows, end = drive(follower, Pose(0.0, 0.0, 0.0), 120.0)
    assert follower.state is GoalState.ARRIVED
    assert rows[:, 1].max() > 4.0 - REACHED
    assert math.dist(end[:2], (0, 0)) <= REACHED
    assert path.entry(Pose(2.0, 0.1, 0.1)) == pytest.approx(2.0)  # the way that it faces
    assert path.entry(Pose(2.0, 0.1, 3.0)) == pytest.approx(6.0)


def test_the_entry_is_the_closest_point_within_what_is_asked_for():
    path = Path(CORNERS)
    assert path.entry(Pose(1.2, -0.5, 0.0)) == pytest.approx(1.2)
    assert path.entry(Pose(1.2, -0.5, 0.0), begin=2.0) == pytest.approx(2.0)
    assert path.entry(Pose(1.2, 1.9, math.pi), end=4.0) == pytest.approx(4.0)
    follower = Follower(path, 0.4, 1.0)
    rows, _ = drive(follower, Pose(1.5, -1.0, 0.0), 10.0)
    entered = rows[np.argmax(rows[:, 2] > -0.1), 1]
    assert 1.5 < entered < 1.5 + LOOKAHEAD  # at the nearest point, not at the beginning


def test_a_round_trip_begins_again_where_it_ended():
    path = Path(np.vstack([CORNERS, [[0.0, 0.0]]]))
    follower = Follower(path, 0.4, 1.0)
    rows, _ = drive(follower, Pose(0.05, 0.05, -math.pi / 2), 120.0)
    assert follower.state is GoalState.ARRIVED
    assert rows[:, 1].max() > 2.8


def test_way_points_are_visited_in_turn_each_for_its_time():
    stops = [(1, 0.0, 2.0, "a"), (2, None, 5.0, "b"), (3, math.pi, 0.0, "c")]
    follower, waited = Follower(Path(CORNERS, stops), 0.4, 1.0), {}
    t, pose = 0.0, Pose(0.0, 0.0, 0.0)
    while not follower.is_over:
        twist = follower.twist(t, pose)
        if follower.reason.startswith("waiting at way point "):
            name = follower.reason[-1]
            waited[name] = waited.get(name, 0.0) + DT
            assert math.dist(pose[:2], CORNERS["abc".index(name) + 1]) <= REACHED
        pose, t = advance(pose, twist, DT), t + DT
    assert list(waited) == ["a", "b"]
    assert waited["a"] == pytest.approx(2.0, abs=3 * DT)
    assert waited["b"] == pytest.approx(5.0, abs=3 * DT)


@pytest.mark.parametrize("by", [(0.0, 1.5), (-1.5, 0.0), (1.0, -1.2), (0.9, 2.0)])
def test_one_that_is_pushed_off_comes_back_and_skips_no_way_point(by):
    follower = Follower(Path(CORNERS, [(2, None, 1.0, "corner")]), 0.4, 1.0)
    _, pose = drive(follower, Pose(0.0, 0.0, 0.0), 5.0)
    pose = pose._replace(x=pose.x + by[0], y=pose.y + by[1])
    rows, _ = drive(follower, pose, 120.0, t=5.0)
    assert follower.state is GoalState.ARRIVED
    assert math.dist(min(rows[:, 1:3].tolist(), key=lambda p: math.dist(p, (3, 2))), (3, 2)) < 0.06
    back = off(Path(CORNERS), rows[:, 1:3])
    assert back[rows[:, 0] > 15.0].max() < 0.25


def test_waiting_at_a_way_point_takes_no_pose():
    follower = Follower(Path(CORNERS, [(1, None, 3 * PATIENCE_S, "dock")]), 0.4, 1.0)
    there = Pose(3.0, 0.0, 0.0)
    for t in np.arange(0.0, 3 * PATIENCE_S, 0.5).tolist():
        assert follower.twist(t, there if t < 1.0 else None, sure=t < 1.0) == STAND
        assert follower.reason == "waiting at way point dock"
    assert follower.twist(3 * PATIENCE_S + 1.0, there) == STAND
    assert follower.twist(3 * PATIENCE_S + 1.5, there) != STAND


def test_without_a_sure_pose_it_coasts_then_stops_and_goes_on():
    follower = Follower(Path(CORNERS), 0.4, 1.0)
    assert follower.twist(0.0, None, sure=False) == STAND  # never knew where it is
    assert follower.state is GoalState.HELD
    assert follower.twist(0.1, Pose(0.0, 0.0, 0.0)).v > 0
    assert follower.twist(COAST_S, Pose(0.5, 0.0, 0.0), sure=False).v > 0
    assert follower.twist(COAST_S + 0.2, Pose(1.2, 0.0, 0.0), sure=False) == STAND
    assert "no pose to rely on" in follower.reason
    assert follower.twist(COAST_S + 0.3, Pose(1.2, 0.0, 0.0)).v > 0


def test_blocked_it_gives_the_reason_waits_and_gives_up():
    follower, pose = Follower(Path(CORNERS), 0.4, 1.0), Pose(0.0, 0.0, 0.0)
    assert follower.twist(0.0, pose).v > 0
    assert follower.twist(0.1, pose, blocked=True) == STAND
    assert (follower.state, follower.reason) == (GoalState.HELD, "blocked")
    assert follower.twist(10.0, pose).v > 0  # free again
    follower.twist(11.0, Pose(0.4, 0.0, 0.0))
    for t in np.arange(12.0, 12.5 + PATIENCE_S, 0.5).tolist():
        assert not follower.is_over
        follower.twist(t, Pose(0.4, 0.0, 0.0), blocked=True)
    follower.twist(13.0 + PATIENCE_S, Pose(0.4, 0.0, 0.0), blocked=True)
    assert follower.state is GoalState.FAILED
    assert "blocked; no progress for 30 s" in follower.reason


def test_stuck_without_an_obstacle_it_tries_again_and_gives_up():
    follower, pose, driven, t = Follower(Path(CORNERS), 0.4, 1.0), Pose(0.0, 0.0, 0.0), [], 0.0
    while not follower.is_over and t < 200.0:
        driven.append(follower.twist(t, pose).v > 0)
        t += DT
    assert follower.state is GoalState.FAILED
    assert "did not move" in follower.reason
    assert PATIENCE_S < t < PATIENCE_S + 2 * RETRY_S
    tries = np.sum(np.diff(np.array(driven, int)) == 1)
    assert tries >= 3


def test_corners_that_differ_by_rounding_are_one():
    x = np.array([0.0, 1.0, 1.0 - 1e-16, 1.0 + 2e-16, 2.0])
    path = Path(np.column_stack([x, np.zeros(5)]))
    assert len(path.stops) == 1
    assert path.entry(Pose(0.9, 0.1, 0.0)) == pytest.approx(0.9)
