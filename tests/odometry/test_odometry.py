"""History of twists: late ones, validity, and dead reckoning online and of a recording."""

import math

import numpy as np
import pytest

from homeward.drives.drive import Odometry
from homeward.geometry.frames import Pose
from homeward.odometry.history import TwistHistory, dead_reckoning_unwrapped
from homeward.odometry.validity import TWIST_VALIDITY_S


def history(order, omega=0.5, every=0.1):
    twists = TwistHistory()
    for k in order:
        twists.add(every * k, 0.2, omega)
    return twists


@pytest.mark.parametrize("order", [range(10), [0, 3, 1, 2, 5, 4, 9, 8, 7, 6]])
def test_the_heading_does_not_depend_on_the_order_in_which_twists_came(order):
    assert history(order).heading(0.95) == pytest.approx(0.5 * 0.95)
    assert history(order).heading(0.35) == pytest.approx(0.5 * 0.35)


def test_a_twist_holds_no_longer_than_is_promised():
    assert history(range(1)).heading(100.0) == pytest.approx(0.5 * TWIST_VALIDITY_S)


def test_a_twist_of_the_same_stamp_replaces_the_other():
    twists = history(range(3))
    twists.add(0.2, 0.2, 2.0)
    assert twists.before(5.0).omega == 2.0
    assert len(twists.table) == 3


def test_before_the_first_there_is_none():
    assert not TwistHistory()
    assert TwistHistory().newest == -math.inf
    assert TwistHistory().heading(1.0) == 0.0
    assert history(range(3)).before(-1.0) is None


def test_what_is_forgotten_is_not_needed_for_later_headings():
    twists = history(range(100))
    twists.forget(8.0)
    assert twists.table[0, 0] == pytest.approx(7.9)
    assert twists.before(8.05).t == pytest.approx(8.0)
    assert twists.heading(9.95) == pytest.approx(0.5 * 9.95)


def test_the_history_is_where_dead_reckoning_of_a_recording_is():
    t, omega, vy = 0.1 * np.arange(60), np.linspace(-1.0, 2.0, 60), np.linspace(0.3, -0.5, 60)
    twists = TwistHistory()
    for k in np.random.default_rng(0).permutation(60):
        twists.add(float(t[k]), 0.3, float(omega[k]), vy=float(vy[k]))
    at = np.linspace(0.0, 8.0, 50)
    expected = dead_reckoning_unwrapped(Odometry(t, np.full(60, 0.3), omega, vy), at)
    poses = np.array([twists.pose(now) for now in at.tolist()])
    np.testing.assert_allclose(poses, np.stack(expected, axis=1), atol=1e-12)


def test_wheel_motion_counts_whatever_its_direction():
    twists = TwistHistory()
    for t, v, omega in ((0.0, 0.5, 0.1), (1.0, -0.5, -0.1), (2.0, 0.0, 0.0), (2.5, math.nan, 0.0)):
        twists.add(t, v, omega)
    assert twists.driven(5.0).since(twists.driven(0.5)) == pytest.approx((1.5, 0.75, 0.15))
    assert twists.path(5.0) == pytest.approx(0.0)


def test_sideways_motion_counts_as_motion_ahead_does():
    twists, at = TwistHistory(), np.linspace(0.0, math.pi, 21).tolist()
    for t in np.random.default_rng(0).permutation(at[:-1]).tolist():
        twists.add(t, 0.0, -1.0, vy=2.0)  # the robot faces the centre of its circle
    assert twists.pose(at[-1]) == pytest.approx((4.0, 0.0, -math.pi))
    assert twists.reckoned(at[-1]) == pytest.approx((-math.pi, 0.0, 2.0 * math.pi))
    assert twists.driven(at[-1]) == pytest.approx((math.pi, 2.0 * math.pi, math.pi))
    assert twists.mean(2.0, 1.0) == pytest.approx((0.0, 2.0, -1.0))
    for k in range(7):
        twists.add(4.0 + 0.1 * k, 0.0, 0.0, vy=0.06)
    assert twists.at(4.6).moves
    path = twists.driven(4.7).path
    twists.add(4.7, 0.5, 0.0, vy=math.nan)
    assert twists.driven(9.0).path == path
    assert twists.unknown_time(5.7) == pytest.approx(1.0)


def test_a_reported_pose_replaces_the_dead_reckoned_one_and_later_twists_go_on_from_it():
    twists = TwistHistory()
    twists.add(0.0, 1.0, 0.0, Pose(5.0, 1.0, math.pi))
    twists.add(0.4, 1.0, 0.0)
    twists.add(0.6, 1.0, 0.0, Pose(0.0, 0.0, 0.1 - math.pi))
    twists.add(0.2, 0.0, 0.0)
    assert twists.pose(0.5) == pytest.approx((4.7, 1.0, math.pi))
    assert twists.pose(0.6) == pytest.approx((0.0, 0.0, 0.1 + math.pi))  # beyond a turn


def test_a_twist_that_replaces_the_only_one_goes_on_from_there():
    twists = history(range(100))
    twists.forget(9.9)
    there = twists.pose(9.9)
    twists.add(9.9, 0.0, 0.0)
    assert twists.pose(20.0) == there
