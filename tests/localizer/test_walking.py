"""Landmarks that may walk: what tells them from standing ones, and what is done meanwhile."""

import math

import numpy as np
import pytest

from homeward.angles import wrap
from homeward.localizer.home.observation import counted_for
from homeward.localizer.map.walking import walking_probabilities, walks
from homeward.localizer.tunables import WALKS

SIGMA = 0.01


def way(turns, seconds=6.0):
    """Times (m,) and places (m, 2) of a camera that goes straight on, or in a bend."""
    t = np.arange(0.0, seconds, 0.2)
    heading = 0.5 * t if turns else np.zeros(t.size)
    step = 0.3 * 0.2 * np.column_stack([np.cos(heading), np.sin(heading)])
    return t, np.concatenate([np.zeros((1, 2)), np.cumsum(step, axis=0)[:-1]])


def judged(place, velocity, turns, noise=None):
    """What a static place that fits best leaves of a landmark's sight lines, and its verdict."""
    t, eyes = way(turns)
    off = place + t[:, None] * velocity - eyes
    lines = np.arctan2(off[:, 1], off[:, 0]) + (0.0 if noise is None else SIGMA * noise)
    at = np.array(place, float)
    for _ in range(50):
        d = at - eyes
        by_place = np.column_stack([-d[:, 1], d[:, 0]]) / (d**2).sum(axis=1)[:, None]
        residual = wrap(lines - np.arctan2(d[:, 1], d[:, 0]))
        at = at + 0.5 * np.linalg.lstsq(by_place, residual, rcond=None)[0]
    of = np.zeros(t.size, int)
    return walks(residual / SIGMA, by_place / SIGMA, t, of, 1, 0.2), at


def test_one_that_keeps_its_way_is_told_from_one_that_stands_once_the_robot_turns():
    place, velocity = np.array([2.0, 3.0]), np.array([-0.2, 0.0])
    straight, bend = (judged(place, velocity, turns)[0].log_factor[0] for turns in (False, True))
    assert abs(straight) < 5.0  # it goes against the robot: nothing can tell
    assert bend > 20.0


def test_how_far_one_that_walks_is_off_is_in_what_is_said_of_it():
    place = np.array([2.0, 3.0])
    for velocity in ([-0.2, 0.0], [0.1, 0.0]):
        found, seems = judged(place, np.array(velocity), False)
        off = seems - place
        assert np.hypot(*off) > 0.5
        assert off @ np.linalg.solve(found.moment[0], off) < 4.0


def test_the_evidence_is_that_of_the_two_models():
    """Bayes factors by dense Gaussian densities, the place being vague in both."""
    rng = np.random.default_rng(2)
    t, eyes = way(True, 3.0)
    d = np.array([2.0, 3.0]) - eyes
    by_place = np.column_stack([-d[:, 1], d[:, 0]]) / (d**2).sum(axis=1)[:, None] / SIGMA
    residual, speed, vague = rng.normal(size=t.size), 0.2, 1e4
    standing = np.eye(t.size) + vague * by_place @ by_place.T
    walking = standing + speed**2 * (t[:, None] * by_place) @ (t[:, None] * by_place).T

    def log_density(covariance):
        square = residual @ np.linalg.solve(covariance, residual)
        return -0.5 * (square + np.linalg.slogdet(covariance)[1])

    found = walks(residual, by_place, t, np.zeros(t.size, int), 1, speed)
    expected = log_density(walking) - log_density(standing)
    assert found.log_factor[0] == pytest.approx(expected, abs=1e-2)


def test_where_many_walk_one_of_whom_nothing_is_known_is_doubted_too():
    nothing = walking_probabilities(np.zeros(12))
    stands = walking_probabilities(np.array([-8.0] * 11 + [0.0]))
    crowd = walking_probabilities(np.array([20.0] * 6 + [-8.0] * 5 + [0.0]))
    assert np.allclose(nothing, nothing[0])
    assert nothing[0] < 0.1
    assert stands[-1] < 2.0 * WALKS
    assert 0.4 < crowd[-1] < 0.7
    assert crowd[:6].min() > 0.999
    assert crowd[6:11].max() < 0.01


def test_a_place_that_may_be_wrong_counts_by_the_information_of_either_case():
    stands = np.array([[[0.04, 0.01], [0.01, 0.09]]] * 3)
    astray = np.array([[[1.0, 0.3], [0.3, 2.0]]] * 3)
    found = counted_for(stands, np.array([0.0, 0.3, 1.0]), astray)
    assert np.allclose(found[0], stands[0])
    assert np.allclose(found[2], stands[2] + astray[2])
    either = 0.7 * np.linalg.inv(stands[1]) + 0.3 * np.linalg.inv(stands[1] + astray[1])
    assert np.allclose(np.linalg.inv(found[1]), either)


def test_sight_lines_from_one_place_say_nothing():
    by_place = np.tile([-30.0, 20.0], (8, 1))
    found = walks(np.zeros(8), by_place, np.zeros(8), np.zeros(8, int), 2, 0.3)
    assert np.isfinite(found.moment).all()
    assert np.allclose(found.log_factor, 0.0)
    assert math.isfinite(found.log_factor[1])  # that was not seen at all
