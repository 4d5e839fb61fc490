"""Docking: to the pose of a home, heading included."""

import itertools
import math

import numpy as np
import pytest

from benchmarks.docking import dock
from homeward.control.docking import MAX_ATTEMPTS, STAGING_M, DockGoal, Docking, Phase
from homeward.control.goals import Belief, GoalState
from homeward.control.limits import Limits
from homeward.estimator import Status
from homeward.geometry.frames import Pose, Twist, advance, between

DT = 0.05
DEFAULT = Limits()
ORIGIN = Pose(0.0, 0.0, 0.0)


def docked(start, at=ORIGIN, wrong=lambda t, pose: 0.0, seconds=120.0, limits=DEFAULT):
    """Dock by a pose that is `wrong` in y by so much; return the last output and all true poses."""
    robot, twist, vy = start, Twist(0.0, 0.0), 0.0
    controller, poses = DockGoal("the dock", at).controller(limits), [start]
    for k in range(round(seconds / DT)):
        pose = robot._replace(y=robot.y + wrong(k * DT, robot))
        belief = Belief(Status.LOCALISED, pose, 1e-6 * np.eye(3))
        output = controller.step(k * DT, belief, "")
        if output.state is not GoalState.DRIVING:
            return output, poses
        twist, vy = limits.accelerated(twist, output.twist, DT, (vy, output.vy))
        robot = advance(robot, twist, DT, vy)
        poses.append(robot)
    return output, poses


@pytest.mark.parametrize("at", [Pose(0.0, 0.0, 0.0), Pose(3.0, -2.0, 2.5)])
@pytest.mark.parametrize("seed", range(6))
def test_a_robot_with_the_right_pose_docks_from_anywhere(at, seed):
    rng = np.random.default_rng(seed)
    start = Pose(*map(float, rng.uniform([-3.0, -3.0, -math.pi], [1.0, 3.0, math.pi])))
    output, poses = docked(start, at)
    off = between(at, poses[-1])
    assert output.state is GoalState.ARRIVED, output.reason
    assert math.hypot(off.x, off.y) < 0.008
    assert abs(math.remainder(off.heading, math.tau)) < math.radians(0.7)


SWERVE = Limits(sideways=0.25)


@pytest.mark.parametrize("at", [Pose(0.0, 0.0, 0.0), Pose(3.0, -2.0, 2.5)])
@pytest.mark.parametrize("seed", range(6))
def test_a_robot_that_moves_sideways_docks_from_anywhere(at, seed):
    rng = np.random.default_rng(seed)
    start = Pose(*map(float, rng.uniform([-3.0, -3.0, -math.pi], [1.0, 3.0, math.pi])))
    output, poses = docked(start, at, limits=SWERVE)
    off = between(at, poses[-1])
    assert output.state is GoalState.ARRIVED, output.reason
    assert math.hypot(off.x, off.y) < 0.008
    assert abs(math.remainder(off.heading, math.tau)) < math.radians(0.7)


def test_a_robot_that_moves_sideways_drives_straight_to_the_dock():
    start = Pose(-1.5, 1.2, -2.5)
    _, poses = docked(start, limits=SWERVE)
    path = sum(math.dist(a[:2], b[:2]) for a, b in itertools.pairwise(poses))
    assert path < 1.02 * math.hypot(start.x, start.y)
    assert len(poses) < len(docked(start)[1])


def test_it_enters_along_the_axis():
    _, poses = docked(Pose(-0.3, 1.5, -2.0))
    entering = [p for p in poses[-200:] if -0.2 < p.x < 0.0]
    assert entering
    assert max(abs(p.y) for p in entering) < 0.02
    assert max(p.x for p in poses[-200:]) < 0.01


def test_an_offset_that_shows_at_the_dock_makes_it_enter_again():
    """The pose has an error of 3 cm to the side until the robot is at the dock."""
    been = []

    def wrong(t, pose):
        been.extend([pose] * (pose.x > -0.01))
        return 0.0 if been else 0.03

    output, poses = docked(Pose(-1.0, 0.0, 0.0), wrong=wrong)
    assert output.state is GoalState.ARRIVED
    assert abs(poses[-1].y) < 0.008
    reached = next(k for k, p in enumerate(poses) if p.x > -0.01)
    assert min(p.x for p in poses[reached:]) < -0.4 * STAGING_M


def test_a_pose_too_inaccurate_to_tell_makes_it_turn_round_and_enter_again():
    controller, robot = DockGoal("the dock", ORIGIN).controller(Limits()), Pose(-0.6, 0.0, 0.0)
    accurate, inaccurate = 1e-6 * np.eye(3), np.diag([0.02**2, 0.02**2, 1e-6])
    headings, output = [], None
    while output is None or output.state is GoalState.DRIVING:
        has_turned = np.ptp(np.unwrap(headings or [0.0])) > 6.2
        belief = Belief(Status.LOCALISED, robot, accurate if has_turned else inaccurate)
        output = controller.step(len(headings) * DT, belief, "")
        robot = advance(robot, output.twist, DT)
        headings.append(robot.heading)
    assert output.state is GoalState.ARRIVED, output.reason
    assert has_turned
    assert math.hypot(robot.x, robot.y) < 0.008


def test_it_gives_up_where_the_pose_is_never_right():
    output, _ = docked(
        Pose(-1.0, 0.0, 0.0), wrong=lambda t, _: 0.04 * math.sin(3.0 * t), seconds=400.0
    )
    assert output.state is GoalState.FAILED
    assert f"after {MAX_ATTEMPTS} attempts" in output.reason


def test_it_stops_for_a_hindrance_and_does_not_arrive_unverified():
    controller = DockGoal("the dock", ORIGIN).controller(Limits())
    belief = Belief(Status.UNVERIFIED, ORIGIN, 1e-6 * np.eye(3))
    held = controller.step(0.0, belief, "emergency stop")
    assert (held.state, held.reason) == (GoalState.HELD, "emergency stop")
    outputs = [controller.step(0.1 * k, belief, "") for k in range(600)]
    assert GoalState.ARRIVED not in {output.state for output in outputs}


def test_with_six_tags_of_which_one_was_moved_it_is_within_a_centimetre_and_a_degree():
    """The short form of `benchmarks.docking`."""
    assert dock(1).succeeded


def twist_at(pose, phase, limits=None):
    """Return what the controller commands at a pose in the dock's frame, in a phase."""
    controller = Docking(DockGoal("the dock", ORIGIN), limits or Limits())
    controller.phase = phase
    return controller.step(0.0, Belief(Status.LOCALISED, pose, 1e-6 * np.eye(3)), "").twist


@pytest.mark.parametrize(("x", "enters"), [(-0.45, True), (-1.5, True), (-0.35, False)])
def test_it_enters_from_half_to_twice_the_staging_distance(x, enters):
    twist = twist_at(Pose(x, 0.0, 0.0), Phase.STAGING)
    assert (twist.v > 0.0 and abs(twist.omega) < 1e-9) is enters


def test_it_looks_round_at_half_its_turn_rate():
    twist = twist_at(Pose(-0.5, 0.0, 0.0), Phase.LOOKING, Limits(turn_rate=0.4))
    assert twist == (0.0, 0.2)
