"""Pictures that are not recognised one by one may give the direction home together."""

import math
from dataclasses import replace

import numpy as np
import pytest
from test_visual_homing import Map, compared, scene

from homeward.estimator import Status
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose, compose, to_polar
from homeward.vision.geometry.epipolar import Motion
from homeward.vision.homing.fix import DIRECTION_HOLD_S, MIN_ALIKE
from homeward.vision.homing.visual_homing import VisualHoming

SPEED, TURN = 0.25, 0.5
EVERY = 0.4
START = Pose(2.0, 2.0, 0.5)
POINTS = scene(n=24)


def refused(guess, rows=slice(0, 24, 6)):
    """Return how a picture compares with home's of which no more than a guess was made."""
    seen = compared(POINTS, Pose(0.0, 0.0, 0.0), accepted=False)
    agrees = np.zeros(len(POINTS), bool)
    agrees[rows] = True
    return replace(seen, agrees=agrees, motion=guess)


def circle(sight, guess_at, n, speed=SPEED, **given):
    """Drive an arc, a picture every 0.4 s; return time and pose at the last one."""
    pose, t = START, 0.0
    for k in range(n):
        t = EVERY * k
        sight.odometry(t, speed, TURN)
        turn, radius = TURN * t, speed / TURN
        moved = Pose(radius * math.sin(turn), radius * (1.0 - math.cos(turn)), turn)
        pose = compose(START, moved)
        sight.home(t, refused(guess_at(k, pose), **given))
    return t, pose


def right(k, pose):
    polar, rng = to_polar(pose), np.random.default_rng(k)
    return Motion(float(polar.theta + 0.03 * rng.normal()), polar.alpha + 0.03 * rng.normal())


def anything(k, pose):
    return Motion(*np.random.default_rng(k).uniform(-math.pi, math.pi, 2).tolist())


def lost():
    return VisualHoming(Map(POINTS[:0], status=Status.MAPPING))


def is_right(estimated, pose):
    """Return whether heading and direction, from where guesses were made, are right."""
    off = np.abs(wrap(np.array(to_polar(estimated)[1:]) - to_polar(pose)[1:]))
    return off[0] < 0.25 and off[1] < 0.05


@pytest.mark.parametrize("n", [MIN_ALIKE - 1, MIN_ALIKE, 12])
def test_votes_that_agree_give_the_direction(n):
    sight = lost()
    t, pose = circle(sight, right, n)
    estimate = sight.estimate(t)
    if n < MIN_ALIKE:
        assert estimate.pose is None
        return
    assert estimate.status is Status.UNVERIFIED
    assert "pictures that do not match home's agree" in estimate.reason
    assert is_right(estimate.pose, pose)
    assert 0.04 < math.sqrt(estimate.covariance[2, 2]) < 0.1
    assert sight.estimate(t + 0.4).pose.heading == pytest.approx(estimate.pose.heading + 0.4 * TURN)


def test_one_in_three_is_enough():
    sight = lost()
    t, pose = circle(sight, lambda k, pose: (anything if k % 3 else right)(k, pose), 18)
    assert is_right(sight.estimate(t).pose, pose)


def test_chance_gives_no_direction_over_a_long_drive():
    with_pose = 0
    for first in range(0, 8000, 400):
        sight = lost()

        def guess(k, pose, sight=sight, first=first):
            nonlocal with_pose
            with_pose += sight.estimate(EVERY * k).pose is not None
            return anything(first + k, pose)

        circle(sight, guess, 300)
    assert with_pose == 0


def test_what_is_guessed_now_counts_and_not_what_was_guessed_long_ago():
    sight = lost()
    t, _ = circle(sight, lambda k, pose: Motion(0.0 if k < 60 else 0.7, 0.5 + TURN * EVERY * k), 66)
    assert to_polar(sight.estimate(t).pose).theta == pytest.approx(0.7, abs=0.01)


def test_a_wild_clock_and_wild_odometry_break_nothing():
    sight = lost()
    t, pose = circle(sight, right, 12)
    for stamp, v, omega in ((t, 1e308, 1e308), (math.nan, 0.0, 0.0), (t + 3600.0, 0.2, 0.1)):
        sight.odometry(stamp, v, omega)
        sight.home(stamp, refused(right(0, pose)))
    sight.home(t, refused(Motion(math.nan, math.nan)))
    for asked in (t, math.nan, math.inf, t - 3600.0, t + 3600.0):
        said = sight.estimate(asked)
        assert said.pose is None or np.isfinite([*said.pose, *said.covariance.ravel()]).all()


def test_the_clock_may_be_set_back_for_good():
    sight = lost()
    t, _ = circle(sight, right, 12)
    sight.odometry(t + 3600.0, SPEED, TURN)  # one stamp an hour ahead
    assert sight.estimate(t + 3600.0).pose is None
    t, pose = circle(sight, right, 24)
    assert is_right(sight.estimate(t).pose, pose)


def test_from_one_place_the_same_is_guessed_again_and_again():
    sight = lost()
    t, _ = circle(sight, lambda k, pose: Motion(1.0, 0.5 + TURN * EVERY * k), 20, speed=0.0)
    assert sight.estimate(t).pose is None


def test_one_thing_is_not_believed():
    azimuth = np.arctan2(POINTS[:, 1], POINTS[:, 0])
    sight = lost()
    t, _ = circle(sight, right, 12, rows=np.argsort(azimuth)[:3])
    assert sight.estimate(t).pose is None


def test_a_hint_lapses_and_gives_way_to_a_picture_that_is_recognised():
    sight = lost()
    t, pose = circle(sight, right, 12)
    assert sight.estimate(t + DIRECTION_HOLD_S).pose is not None
    assert sight.estimate(t + DIRECTION_HOLD_S + 0.1).pose is None
    sight.home(t, compared(POINTS, pose))
    assert "home's picture gives the direction" in sight.estimate(t).reason
    one_more = Pose(pose.x, pose.y, pose.heading + TURN * EVERY)
    sight.odometry(t + EVERY, SPEED, TURN)
    sight.home(t + EVERY, refused(right(0, one_more)))
    assert sight.estimate(t + DIRECTION_HOLD_S + 0.2).pose is None  # of old guesses and this one


def test_at_home_nothing_is_guessed():
    """There pictures are recognised, and the direction is noise."""
    sight, at_home = lost(), Pose(0.02, 0.0, 0.5)
    for k in range(12):
        sight.odometry(EVERY * k, SPEED, 0.0)
        sight.home(EVERY * k, compared(POINTS, at_home, direction_sigma=0.7))
    assert sight.estimate(EVERY * 12).pose is None


def test_the_map_takes_precedence():
    sight = VisualHoming(Map(POINTS, pose=Pose(1.0, 1.0, 0.0)))
    t, _ = circle(sight, right, 12)
    assert sight.estimate(t).pose == Pose(1.0, 1.0, 0.0)


def test_pictures_that_come_late_guess_where_they_were_taken():
    """Half a second late, in a turn of 0.5 rad/s: by the newest twist all would be 0.25 rad off."""
    sight, rate, late = lost(), 20, 0.5
    radius = SPEED / TURN

    def pose(t):
        turn = TURN * t
        arc = Pose(radius * math.sin(turn), radius * (1 - math.cos(turn)), turn)
        return compose(START, arc)

    for k in range(100):
        t = k / rate
        sight.odometry(t, SPEED, TURN)
        if k % 8 == 0 and t > late:
            sight.home(t - late, refused(right(k, pose(t - late))))
    said = sight.estimate(t)
    assert said.status is Status.UNVERIFIED
    assert is_right(said.pose, pose(t))
