"""Robots that follow their odometry late and as a first-order lag."""

import math

import numpy as np
import pytest
from rig import START, Wheels, ring

from homeward.drives.drive import HomeBearing
from homeward.drives.settings import DriveSettings, OdometryNoise, Sensor
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose, Twist, advance, bearing
from homeward.localizer.localizer import Localizer
from homeward.localizer.motions import CALIBRATION, DELAY, NC, TIME_CONSTANT
from homeward.localizer.reference.motion import settled
from homeward.odometry.history import TwistHistory

DT = 0.01
SIGMA = 0.01
NOTHING = OdometryNoise()


def commands(seconds, seed=0):
    """Twists of a robot that drives straight and turns in place by turns, (n, 2)."""
    rng = np.random.default_rng(seed)
    twists = []
    while len(twists) * DT < seconds:
        length = int(rng.uniform(0.8, 2.5) / DT)
        twists += length * [(rng.choice([0.0, 0.2, 0.3]), rng.choice([-0.8, 0.0, 0.8]))]
    return np.array(twists[: int(seconds / DT)])


def followed(twists, delay, time_constant):
    """Return the twists of a robot that follows commands with a delay and a lag, (n, 2)."""
    shift = round(delay / DT)
    late = np.concatenate([np.zeros((shift, 2)), twists])[: len(twists)]
    if not time_constant:
        return late
    keep, out = math.exp(-DT / time_constant), np.zeros_like(late)
    for k in range(1, len(late)):
        out[k] = keep * out[k - 1] + (1.0 - keep) * late[k - 1]
    return out


def path(twists, start):
    """Return the pose after each twist."""
    poses = [start]
    for v, omega in twists.tolist():
        poses.append(advance(poses[-1], Twist(v, omega), DT))
    return poses


def drive(delay, time_constant, seconds=90.0, given=NOTHING):
    """Drive a robot among landmarks; return its localiser, and errors of its poses (n, 2).

    Positions [m], and NEES of the pose `delay` later: then the bearings are what is stamped late.
    """
    marks, rng = ring(10), np.random.default_rng(1)
    home = {
        n: HomeBearing(math.atan2(y, x) + 0.005 * rng.normal(), 0.005)
        for n, (x, y) in marks.items()
    }
    settings = DriveSettings(sensor=Sensor(bearing_sigma=SIGMA), odometry=given)
    localizer, twists = Localizer(home, **settings.robot), commands(seconds)
    poses, off = path(followed(twists, delay, time_constant), START), []
    for k, (v, omega) in enumerate(twists.tolist()):
        if k % 2 == 0:
            localizer.odometry(k * DT, v, omega)
        if k % 20 == 0:
            seen = {
                n: wrap(bearing(poses[k], *at) + SIGMA * rng.normal()) for n, at in marks.items()
            }
            answer = localizer.bearings(k * DT, seen)
            if answer.pose is not None:
                later = np.subtract(answer.pose, poses[min(k + round(delay / DT), len(poses) - 1)])
                later[2] = wrap(later[2])
                nees = later @ np.linalg.solve(answer.covariance, later)
                off.append((math.dist(answer.pose[:2], poses[k][:2]), nees))
    return localizer, np.array(off)


@pytest.mark.parametrize(("delay", "time_constant"), [(0.0, 0.25), (0.2, 0.0), (0.0, 0.0)])
def test_delay_and_time_constant_of_a_robot_are_estimated(delay, time_constant):
    localizer, off = drive(delay, time_constant)
    found = localizer.chart.map.smoother.state.calibration[[DELAY, TIME_CONSTANT]]
    assert found.sum() == pytest.approx(delay + time_constant, abs=0.02)
    assert found == pytest.approx([delay, time_constant], abs=0.07)
    assert np.sqrt(np.mean(off[len(off) // 2 :, 0] ** 2)) < 0.04


def test_a_pose_covers_both_stamps_where_odometry_and_bearings_differ():
    """Nothing shows which of them is right, unless the delay is given."""
    _, unknown = drive(0.2, 0.0, 40.0)
    assert np.mean(unknown[:, 1] < 11.3) > 0.97  # 99 % of chi-square(3)
    assert np.quantile(unknown[:, 1], 0.9) > 2.0
    _, known = drive(0.2, 0.0, 40.0, OdometryNoise(delay_sigma=0.2))
    assert np.mean(known[:, 1] < 11.3) < 0.6


def test_a_given_time_constant_is_corrected_where_the_map_contradicts_it():
    given = OdometryNoise(time_constant=0.4, time_constant_sigma=0.2)
    localizer, _ = drive(0.0, 0.2, 40.0, given)
    estimate = localizer.chart.map.smoother.state.calibration[TIME_CONSTANT]
    assert estimate == pytest.approx(0.2, abs=0.05)


def test_with_a_given_time_constant_the_map_is_right_from_the_start():
    given = OdometryNoise(time_constant=0.3, time_constant_sigma=0.02, delay_sigma=0.02)
    (_, known), (_, unknown) = drive(0.0, 0.3, 25.0, given), drive(0.0, 0.3, 25.0)
    assert np.median(known[:20, 0]) < 0.8 * np.median(unknown[:20, 0])


@pytest.mark.parametrize("time_constant", [0.05, 0.2, 0.4])
def test_the_motion_of_a_lagging_robot_is_that_of_its_filtered_twists(time_constant):
    twists, wheels = np.concatenate([np.zeros((10, 2)), commands(6.0, seed=5)]), Wheels()
    for k, twist in enumerate(twists.tolist()):
        wheels.add(k * DT, *twist)
    calibration = np.zeros(len(CALIBRATION))
    calibration[TIME_CONSTANT] = time_constant
    poses = path(followed(twists, 0.0, time_constant), Pose(0.0, 0.0, 0.0))
    for begin, end in ((0.0, 1.0), (1.3, 2.1), (2.5, 5.5)):
        a, b = (poses[round(t / DT)] for t in (begin, end))
        motion = wheels.between(begin, end, calibration)
        c, s = math.cos(a.heading), math.sin(a.heading)
        ahead = c * (b.x - a.x) + s * (b.y - a.y), c * (b.y - a.y) - s * (b.x - a.x)
        assert motion.delta == pytest.approx([*ahead, b.heading - a.heading], abs=0.02)


def test_the_twist_of_a_lagging_robot_approaches_the_command():
    twists = TwistHistory()
    for k in range(300):
        on = float(k >= 100)
        twists.add(k * DT, 0.5 * on, -1.0 * on, vy=-0.3 * on)
    for after in (0.1, 0.2, 0.4):
        (v, vy, omega), _ = settled(twists.table, 1.0 + after, 0.2)
        assert v == pytest.approx(0.5 * -math.expm1(-after / 0.2), abs=0.025)
        assert vy == pytest.approx(-0.6 * v)
        assert omega == pytest.approx(math.expm1(-after / 0.2), abs=0.05)


@pytest.mark.parametrize("vy", [0.0, 0.2])
def test_a_robot_that_lags_moves_alike_with_no_turn_and_with_hardly_any(vy):
    """It still has to make its time constant times its twist, of a chord without a bend."""
    found, calibration = [], np.zeros(NC)
    calibration[TIME_CONSTANT] = 0.3
    for omega in (0.0, 1e-9):
        wheels = Wheels()
        for k in range(40):
            wheels.add(0.1 * k, 0.5 if k > 10 else 0.1, omega, vy if k > 10 else 0.0)
        found.append(wheels.between(0.5, 3.0, calibration).delta)
    assert found[0] == pytest.approx(found[1], abs=1e-6)
    assert found[0][0] == pytest.approx(0.6 * 0.1 + 1.9 * 0.5 - 0.3 * 0.4, abs=0.02)
