"""Pictures that are not recognised, one by one, may tell the way home together."""

import math
from dataclasses import replace

import numpy as np
import pytest
from test_home_sight import Map, compared, scene

from homeward.angles import wrap
from homeward.estimator import Status
from homeward.frames import Pose, compose, to_polar
from homeward.vision.epipolar import Motion
from homeward.vision.hints import FEWEST_ALIKE, HOLD_HINT_S
from homeward.vision.home_sight import HomeSight

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
    sight.odometry(0.0, speed, TURN)
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


def lost(points=POINTS[:0]):
    return HomeSight(Map(points, status=Status.MAPPING))


def is_right(told, pose):
    """Say whether direction and heading are: the direction is that from where guesses were made."""
    off = np.abs(wrap(np.array(to_polar(told)[1:]) - to_polar(pose)[1:]))
    return off[0] < 0.25 and off[1] < 0.05


@pytest.mark.parametrize("n", [FEWEST_ALIKE - 1, FEWEST_ALIKE, 12])
def test_guesses_that_are_alike_tell_the_way(n):
    sight = lost()
    t, pose = circle(sight, right, n)
    told = sight.estimate(t)
    if n < FEWEST_ALIKE:
        assert told.pose is None
        return
    assert told.status is Status.UNVERIFIED
    assert f"{n} pictures" in told.reason
    assert is_right(told.pose, pose)
    assert 0.04 < math.sqrt(told.covariance[2, 2]) < 0.1
    assert sight.estimate(t + 0.4).pose.heading == pytest.approx(told.pose.heading + 0.4 * TURN)


def test_one_in_three_is_enough():
    sight = lost()
    t, pose = circle(sight, lambda k, pose: (anything if k % 3 else right)(k, pose), 18)
    assert is_right(sight.estimate(t).pose, pose)


def test_chance_tells_nothing():
    for first in range(0, 2000, 100):
        sight = lost()
        t, _ = circle(sight, lambda k, pose, first=first: anything(first + k, pose), 60)
        assert sight.estimate(t).pose is None


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
    assert sight.estimate(t + HOLD_HINT_S).pose is not None
    assert sight.estimate(t + HOLD_HINT_S + 0.1).pose is None
    sight.home(t, compared(POINTS, pose))
    assert "home's picture tells the direction" in sight.estimate(t).reason
    sight.home(t + EVERY, refused(right(0, pose)))
    assert sight.estimate(t + HOLD_HINT_S + 1.0).pose is None


def test_the_map_knows_better():
    sight = HomeSight(Map(POINTS, pose=Pose(1.0, 1.0, 0.0)))
    t, _ = circle(sight, right, 12)
    assert sight.estimate(t).pose == Pose(1.0, 1.0, 0.0)
