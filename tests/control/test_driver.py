"""Driver: arrives from anywhere within limits, stops on faults and doubts; one for all robots."""

import math

import numpy as np
import pytest

from homeward.control.driver import AFTERWARDS_S, LOST_S, Driver
from homeward.control.following import Path, RouteGoal
from homeward.control.goals import STAND, Belief, GoalState, PointGoal, TurnGoal
from homeward.control.limits import Limits
from homeward.control.watchdog import CLEARED_S, DrivingTime, Fault
from homeward.estimator import Status
from homeward.geometry.frames import Pose, Twist, advance
from homeward.lab.simulation.trajectories import GoalControl
from homeward.live.messages import GoHome
from homeward.live.session import Session
from homeward.live.settings import LiveSettings

DT = 0.02
HOME = PointGoal("home", 0.0, 0.0)
SLACK = 1e-9


def belief(pose, status=Status.LOCALISED, sigma=0.01):
    return Belief(status, pose, sigma**2 * np.eye(3))


def drive(driver, pose, seconds=120.0):
    """Drive exactly; return twists (n, 2) and the last pose."""
    twists, t = [], 0.0
    while driver.active and t < seconds:
        twist = driver.command(t, belief(pose))
        twists.append(twist)
        pose, t = advance(pose, twist, DT), t + DT
    return np.array(twists), pose


@pytest.mark.parametrize("turn_rate", [0.3, 1.0])
@pytest.mark.parametrize("bearing", [0.0, 0.5, math.pi / 2, math.pi, -2.5])
@pytest.mark.parametrize("distance", [0.04, 0.3, 3.0])
def test_it_arrives_within_the_radius_from_any_pose_within_all_limits(turn_rate, bearing, distance):
    limits, driver = Limits(turn_rate=turn_rate), Driver(Limits(turn_rate=turn_rate))
    driver.go(0.0, HOME)
    start = Pose(distance * math.cos(2.0), distance * math.sin(2.0), 2.0 + math.pi + bearing)
    twists, end = drive(driver, start)
    assert driver.state is GoalState.ARRIVED
    assert math.hypot(end.x, end.y) < limits.radius
    v, omega = twists.T
    assert v.min() >= 0.0
    assert v.max() <= limits.speed + SLACK
    assert np.abs(omega).max() <= turn_rate + SLACK
    # The last command stops the robot at once.
    assert np.abs(np.diff(v[:-1], prepend=0.0)).max(initial=0.0) <= limits.acceleration * DT + SLACK
    turns = np.abs(np.diff(omega[:-1], prepend=0.0)).max(initial=0.0)
    assert turns <= limits.turn_acceleration * DT + SLACK


def test_the_papers_law_keeps_its_speed_and_needs_no_limits_of_acceleration():
    limits = Limits(speed=0.125, turn_rate=4.0, acceleration=math.inf, turn_acceleration=math.inf)
    driver = Driver(limits)
    driver.go(0.0, HOME._replace(law="paper"))
    twists, end = drive(driver, Pose(-1.0, 0.2, 2.0))
    assert driver.state is GoalState.ARRIVED
    assert (twists[:-1, 0] == 0.125).all()
    assert math.hypot(end.x, end.y) < limits.radius


DOUBTS = {
    "no pose": lambda pose: Belief(Status.WAITING, None, None),
    "not localised": lambda pose: belief(pose, Status.UNVERIFIED),
    "too uncertain": lambda pose: belief(pose, sigma=0.3),
}


@pytest.mark.parametrize("why", [*DOUBTS, "no odometry"])
def test_it_stops_on_a_doubt_or_a_fault_goes_on_after_it_and_gives_up_at_last(why):
    limits, pose = Limits(search=0.0), Pose(-2.0, 0.0, 0.0)
    driver, faults = Driver(limits), () if why in DOUBTS else (Fault("no odometry for 0.15 s"),)
    doubted = DOUBTS.get(why, belief)
    driver.go(0.0, HOME)
    for t in np.arange(0.0, 2.0, DT).tolist():
        assert driver.command(t, belief(pose)) is not None
    assert driver.state is GoalState.DRIVING
    late = limits.coast if why == "not localised" else 0.0
    assert driver.command(2.0 + late + DT, doubted(pose), faults) == STAND
    assert why in driver.reason
    assert driver.is_lost == (why in DOUBTS)
    back = 2.0 + late + 2 * DT + CLEARED_S
    assert driver.command(back, belief(pose)).v > 0.0
    for t in np.arange(back + late + DT, back + late + limits.patience, 0.5).tolist():
        assert driver.command(t, doubted(pose), faults) == STAND
        assert driver.state is GoalState.HELD
    end = back + 2 * late + limits.patience + 1.0
    assert driver.command(end, doubted(pose), faults) == STAND
    assert driver.state is GoalState.FAILED
    assert driver.command(end + AFTERWARDS_S + DT, belief(pose)) is None


@pytest.mark.parametrize("why", DOUBTS)
def test_a_robot_that_lost_its_pose_rests_then_turns_once_round_and_gives_up_at_last(why):
    limits, pose = Limits(coast=0.0), Pose(-2.0, 0.0, 0.0)
    driver, doubted = Driver(limits), DOUBTS[why]
    driver.go(0.0, HOME)
    driver.command(0.0, belief(pose))
    t, turned, began = DT, 0.0, math.inf
    while driver.active:
        twist = driver.command(t, doubted(pose))
        assert twist.v == 0.0
        if twist.omega:
            began = min(began, t)
            assert "turning to find it" in driver.reason
        turned, t = turned + twist.omega * DT, t + DT
    assert began == pytest.approx(LOST_S, abs=5 * DT)
    assert turned == pytest.approx(math.tau, abs=0.1)
    assert driver.state is GoalState.FAILED
    assert why in driver.reason
    assert t == pytest.approx(began + math.tau / limits.search + limits.patience, abs=0.5)


@pytest.mark.parametrize("why", DOUBTS)
def test_a_robot_that_finds_its_pose_while_it_turns_drives_on(why):
    driver, pose = Driver(Limits(coast=0.0)), Pose(-2.0, 0.0, 0.0)
    driver.go(0.0, HOME)
    for t in np.arange(0.0, 10.0, DT).tolist():
        twist = driver.command(t, belief(pose) if t < 1.0 or t > 5.0 else DOUBTS[why](pose))
    assert driver.state is GoalState.DRIVING
    assert twist.v > 0.0


def test_a_robot_that_was_never_localised_does_not_turn():
    driver = Driver(Limits())
    driver.go(0.0, HOME)
    for t in np.arange(0.0, 9.0, DT).tolist():
        assert driver.command(t, Belief(Status.MAPPING, None, None)) == STAND


def test_it_has_not_arrived_where_it_is_not_localised():
    driver, there = Driver(Limits()), Pose(0.01, 0.0, 0.0)
    driver.go(0.0, HOME)
    driver.command(0.0, belief(Pose(1.0, 0.0, math.pi)))
    assert driver.command(DT, belief(there, Status.UNVERIFIED)) == STAND
    assert (driver.state, driver.is_lost) == (GoalState.HELD, True)
    assert driver.command(2 * DT, belief(there)) == STAND
    assert driver.state is GoalState.ARRIVED


def test_a_turn_needs_no_home_and_ends_once_round():
    driver, pose, t, turned = Driver(Limits()), Pose(3.0, 1.0, 2.0), 0.0, 0.0
    driver.go(0.0, TurnGoal())
    while driver.active:
        twist = driver.command(t, Belief(Status.WAITING, pose, None))
        assert twist.v == 0.0
        pose, t, turned = advance(pose, twist, DT), t + DT, turned + twist.omega * DT
    assert driver.state is GoalState.TURNED
    assert math.tau < turned < 1.1 * math.tau


@pytest.mark.parametrize(
    "goal", [HOME, RouteGoal("round", Path(np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 1.0]])))]
)
def test_the_simulator_and_a_live_session_command_the_same_for_the_same_estimates(goal):
    rng = np.random.default_rng(3)
    limits = Limits(patience=100.0)
    simulated, session = GoalControl(goal, limits), Session(LiveSettings(limits=limits))
    session.receive(GoHome(), 0.0)
    list(session.process())  # refused, for there is no home: the goal is set by hand
    session._refused, session.localisation.goal = "", goal
    command = {}
    session.belief = lambda now: command["belief"]
    session.faults, session._blind = lambda now: (), lambda now: None
    session._unseen.add = lambda *_: None
    pose, commands = Pose(-1.0, 0.4, 2.5), []
    for k in range(2000):
        t = k * DT
        status = Status.UNVERIFIED if 100 <= k < 200 or k % 97 == 1 else Status.LOCALISED
        noisy = Pose(*(np.array(pose) + rng.normal(0.0, 0.005, 3)).tolist())
        command["belief"] = belief(noisy, status)
        live, twist = session.tick(t), simulated.twist(t, command["belief"])
        if twist is None:
            assert live.state == "arrived"
            break
        assert (live.v, live.omega) == twist
        commands.append(twist)
        pose = advance(pose, twist, DT)
    assert twist is None
    assert len({*commands}) > 50


def test_a_robot_that_moves_sideways_drives_straight_home_and_keeps_its_heading():
    """Its speed and its acceleration are within the limits as vectors."""
    limits = Limits(speed=0.3, sideways=0.15)
    driver, pose, t, path = Driver(limits), Pose(2.0, 1.0, 1.1), 0.0, [(2.0, 1.0)]
    speeds = [(0.0, 0.0)]
    driver.go(0.0, HOME)
    while driver.active and t < 60.0:
        twist = driver.command(t, belief(pose))
        speeds.append((twist.v, driver.vy))
        pose, t = advance(pose, twist, DT, driver.vy), t + DT
        path.append(pose[:2])
    assert driver.state is GoalState.ARRIVED
    assert pose.heading == pytest.approx(1.1)
    v, vy = np.array(speeds).T
    assert np.hypot(v / 0.3, vy / 0.15).max() <= 1.0 + SLACK
    changes = np.hypot(np.diff(v), np.diff(vy))[:-1]  # the last command stops it at once
    assert changes.max() <= limits.acceleration * DT + SLACK
    off_line = np.array(path) @ np.array([1.0, -2.0]) / math.sqrt(5.0)
    assert np.abs(off_line).max() < 0.02
    assert driver.vy == 0.0


def test_a_route_is_driven_sideways_where_the_robot_can():
    limits = Limits(sideways=0.25)
    driver, pose, t = Driver(limits), Pose(0.0, 0.0, 0.4), 0.0
    driver.go(0.0, RouteGoal("the path", Path(np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]]))))
    while driver.active and t < 60.0:
        twist = driver.command(t, belief(pose))
        assert twist.omega == 0.0
        pose, t = advance(pose, twist, DT, driver.vy), t + DT
    assert driver.state is GoalState.ARRIVED
    assert math.dist(pose[:2], (1.0, 1.0)) < 0.06


def test_sideways_motion_counts_as_driving_for_the_watchdog():
    time = DrivingTime(0.0)
    time.add(1.0, Twist(0.0, 0.5))
    time.add(1.0, Twist(0.0, 0.5), 0.2)
    assert time.seconds == 1.0
