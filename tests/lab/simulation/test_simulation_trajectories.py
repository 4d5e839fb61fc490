"""Ways to drive, and the exact arc."""

import math

import numpy as np
import pytest

from homeward.control.following import LOOKAHEAD
from homeward.control.goals import STAND, Belief, PointGoal
from homeward.control.limits import Limits
from homeward.estimator import Status
from homeward.geometry.frames import Pose, Twist, advance
from homeward.lab.simulation.course import Ending
from homeward.lab.simulation.scenario import Room
from homeward.lab.simulation.simulate import WAREHOUSE, load_scenario, simulate
from homeward.lab.simulation.trajectories import (
    LOOK_RATE,
    LOOKS_PER_ROUND,
    SEARCH_RADIUS,
    TURN_ACCELERATION,
    WAIT_S,
    GoalControl,
    exact,
    make_control,
)


@pytest.mark.parametrize("omega", [0.0, 1e-9, -1e-7, 1e-3, 0.7, -2.5])
def test_the_arc_is_what_fine_euler_steps_come_to(omega):
    begin, v, dt, n = Pose(0.3, -0.7, 2.0), 0.4, 1.7, 200_000
    heading = begin.heading + omega * dt * (np.arange(n) + 0.5) / n  # midpoints: second order
    x = begin.x + v * dt / n * np.cos(heading).sum()
    y = begin.y + v * dt / n * np.sin(heading).sum()
    end = advance(begin, Twist(v, omega), dt)
    assert end == pytest.approx((x, y, begin.heading + omega * dt), abs=1e-10)


def test_two_half_arcs_are_a_whole_one():
    begin, twist = Pose(1.0, 2.0, 0.4), Twist(0.5, 0.8)
    halfway = advance(begin, twist, 0.6)
    assert advance(halfway, twist, 0.6) == pytest.approx(advance(begin, twist, 1.2), abs=1e-14)


def test_a_circle_closes():
    changes = {"trajectory.omega": 0.5, "trajectory.duration": 12.57, "rates.odometry": 100}
    simulation = simulate(load_scenario("circle", changes))
    truth = simulation.drive.truth
    assert simulation.ending is Ending.TIME_UP
    # 12.57 s is 4 pi / 1000 beyond one turn: 3.6 ms at 0.125 m/s.
    assert math.hypot(truth.x[-1] - truth.x[0], truth.y[-1] - truth.y[0]) < 1e-3
    np.testing.assert_allclose(np.ptp(truth.x), 0.5, atol=1e-3)


@pytest.mark.parametrize("seed", range(5))
def test_homing_on_the_truth_arrives(seed):
    simulation = simulate(load_scenario("paper-homing", {"seed": seed}))
    assert simulation.ending is Ending.DONE
    assert 0.05 - 0.125 * 0.05 <= simulation.final_distance < 0.05


def test_homing_arrives_from_all_round():
    for theta in np.linspace(-3, 3, 5).tolist():
        for alpha in np.linspace(-3, 3, 5).tolist():
            changes = {"start.theta": theta, "start.alpha": alpha, "rates.bearings": 1}
            simulation = simulate(load_scenario("paper-homing", changes))
            assert simulation.ending is Ending.DONE
            assert simulation.final_distance < 0.05


def test_way_points_are_passed_in_order_and_corners_are_cut_a_little():
    simulation = simulate(WAREHOUSE)
    x, y = simulation.world.home.x, simulation.world.home.y
    c, s = math.cos(simulation.world.home.heading), math.sin(simulation.world.home.heading)
    truth = simulation.drive.truth
    path = np.stack([x + c * truth.x - s * truth.y, y + s * truth.x + c * truth.y], axis=-1)
    for point in WAREHOUSE.trajectory.points:
        # The chord of a right-angled corner cut at LOOKAHEAD passes it at LOOKAHEAD / sqrt(2).
        near = np.hypot(*(path - point).T) < LOOKAHEAD / math.sqrt(2)
        assert near.any()
        path = path[near.argmax() :]
    assert simulation.ending is Ending.DONE
    assert simulation.final_distance < 0.05


def test_way_points_keep_speed_and_turn_smoothly():
    odometry = {"odometry.speed_sigma": 0, "odometry.turn_sigma": 0, "odometry.turn_bias": 0}
    scales = {"odometry.speed_scale": 0, "odometry.turn_scale": 0}
    driven = simulate(load_scenario("warehouse", odometry | scales)).drive.odometry
    assert (driven.v[:-1] == 0.21).all()
    assert driven.v[-1] == driven.omega[-1] == 0.0
    assert np.abs(driven.omega).max() <= 1.0
    # The last command is to stop; the one before need not be slow.
    assert np.abs(np.diff(driven.omega[:-1])).max() <= 0.05 * TURN_ACCELERATION + 1.01e-4


def test_the_warehouse_robot_keeps_off_the_shelves():
    simulation, room = simulate(WAREHOUSE), WAREHOUSE.room
    home, truth = simulation.world.home, simulation.drive.truth
    c, s = math.cos(home.heading), math.sin(home.heading)
    fat = [(x0 - 0.4, y0 - 0.4, x1 + 0.4, y1 + 0.4) for x0, y0, x1, y1 in room.shelves]
    roomy = Room(bounds=(0.4, 0.4, 9.6, 5.6), shelves=fat)
    for x, y in zip(truth.x, truth.y, strict=True):
        assert roomy.free(home.x + c * x - s * y, home.y + s * x + c * y)


LOST = Belief(Status.WAITING, None, None)
START = Pose(1.0, 0.0, math.pi)


def homing(changes=None):
    plain = {"trajectory.law": "lyapunov"}
    return make_control(load_scenario("paper-homing", plain | (changes or {})), START)


def drives(control, t, pose):
    """Whether it speeds up; the first command of a drive is to stand."""
    return [control.twist(t + dt, exact(pose)).v > 0.0 for dt in (0.0, 0.05)][-1]


@pytest.mark.parametrize("law", ["paper", "lyapunov"])
def test_without_a_pose_the_robot_drives_an_arc(law):
    twist = homing({"trajectory.law": law}).twist(0.0, LOST)
    assert twist.v == 0.125
    assert twist.v / twist.omega == pytest.approx(SEARCH_RADIUS)


def test_the_search_widens_after_some_circles_and_begins_again_after_a_pose():
    control = homing()
    around = 2 * math.pi * SEARCH_RADIUS / 0.125
    for t, wider in ((0.0, 1), (2.99, 1), (3.01, 2), (8.99, 2), (9.01, 4), (21.01, 8)):
        assert control.twist(t * around, LOST).omega == pytest.approx(0.125 / SEARCH_RADIUS / wider)
    control.twist(22.0 * around, exact(Pose(1.0, 0.0, 0.0)))
    assert control.twist(22.0 * around + 0.5 * WAIT_S, LOST) == STAND
    assert control.twist(23.0 * around, LOST).omega == pytest.approx(0.125 / SEARCH_RADIUS)


NARROW = {"estimator": "robust", "visibility.field_of_view": 1.2}


def test_a_narrow_camera_looks_round_from_three_places_of_the_circle():
    control = homing(NARROW)
    pose, looked, dt = Pose(0.0, 0.0, 0.0), [0.0], 0.05
    for step in range(round(90.0 / dt)):
        twist = control.twist(step * dt, LOST)
        if twist.v == 0.0:
            looked[-1] += twist.omega * dt
        elif looked[-1]:
            looked.append(0.0)
        pose = advance(pose, twist, dt)
    assert len(looked) > LOOKS_PER_ROUND
    assert looked[:LOOKS_PER_ROUND] == pytest.approx([2.0 * math.pi] * 3, abs=LOOK_RATE * dt)
    # One round of three looks, and back where it began.
    drive_s = 2.0 * math.pi * SEARCH_RADIUS / 0.125
    round_s = drive_s + 3 * 2.0 * math.pi / LOOK_RATE
    control, pose = homing(NARROW), Pose(0.0, 0.0, 0.0)
    for step in range(round(round_s / dt)):
        pose = advance(pose, control.twist(step * dt, LOST), dt)
    assert math.hypot(pose.x, pose.y) < 0.05


def test_a_narrow_camera_looks_round_once_at_home_before_it_stops():
    control, there = homing(NARROW), exact(Pose(0.03, 0.0, math.pi))
    assert drives(control, 0.0, Pose(0.5, 0.0, math.pi))
    assert control.twist(1.0, there) == Twist(0.0, LOOK_RATE)
    look_s = 2.0 * math.pi / LOOK_RATE
    assert control.twist(0.9 + look_s, there) == Twist(0.0, LOOK_RATE)
    assert drives(control, 1.1 + look_s, Pose(0.2, 0.0, math.pi))
    assert control.twist(9.0 + look_s, there) is None
    assert homing(NARROW | {"estimator": "truth"}).twist(0.0, there) is None


def test_a_drive_may_begin_with_a_turn_on_the_spot():
    changes = {"trajectory.spin": -0.5, "trajectory.duration": 20.0}
    truth = simulate(load_scenario("circle", changes)).drive.truth
    turned = truth.t <= 2.0 * math.pi / 0.5
    assert np.ptp(truth.x[turned]) < 1e-9
    assert np.diff(np.unwrap(truth.heading[turned])).sum() == pytest.approx(-2.0 * math.pi, abs=0.1)
    assert np.ptp(truth.x[~turned]) > 0.1


def test_a_point_behind_is_turned_to_as_hard_as_allowed():
    changes = {"trajectory.points": [[5.0, 3.0]], "trajectory.end_at_home": False}
    scenario = load_scenario("warehouse", changes | {"trajectory.max_turn_rate": 0.7})
    start = scenario.start.in_home_frame(scenario.home.pose)
    away = Pose(start.x, start.y, start.heading + math.pi)
    control = make_control(scenario, start)
    assert abs(control.twist(0.1, exact(away)).omega) == pytest.approx(0.1 * TURN_ACCELERATION)
    assert abs(control.twist(5.0, exact(away)).omega) == 0.7


def test_unlocalised_at_home_it_has_not_arrived_and_searches():
    control, there = homing({"estimator": "ekf"}), Pose(0.03, 0.0, math.pi)
    unsure = Belief(Status.UNVERIFIED, there, np.zeros((3, 3)))
    assert drives(control, 0.0, Pose(0.2, 0.0, math.pi))
    assert control.twist(0.2, unsure) == STAND
    searching = control.twist(0.3 + WAIT_S, unsure)
    assert searching.v / searching.omega == pytest.approx(SEARCH_RADIUS)
    assert control.twist(0.4 + WAIT_S, exact(there)) is None


@pytest.mark.parametrize(
    ("changes", "drives_on"),
    [
        ({}, False),
        ({"trajectory.drives_unlocalised": True}, True),
        ({"trajectory.law": "paper"}, True),
    ],
)
def test_by_a_pose_that_is_not_localised_only_those_drive_that_are_told_to(changes, drives_on):
    control, belief = homing(changes), Belief(Status.UNVERIFIED, START, np.eye(3))
    twists = [control.twist(t, belief) for t in (0.0, 0.05, 0.1)]
    towards_home = abs(twists[-1].omega) < 1e-9
    assert towards_home == drives_on


def test_where_something_is_in_the_way_it_stands_and_does_not_search():
    goal, limits = PointGoal("home", 0.0, 0.0), Limits(patience=math.inf)
    control = GoalControl(goal, limits, blocked=(1.0, 9.0))
    assert drives(control, 0.5, START)
    assert [control.twist(t, LOST) for t in (1.0, 4.0, 8.9)] == [STAND] * 3
    assert drives(control, 9.1, START)


def test_way_points_by_an_estimate_are_driven_as_a_route():
    changes = {"estimator": "robust", "trajectory.duration": 30.0}
    scenario = load_scenario("warehouse", changes)
    control = make_control(scenario, scenario.start.in_home_frame(scenario.home.pose))
    assert isinstance(control, GoalControl)
