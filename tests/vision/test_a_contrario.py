"""Matches that agree by chance are not accepted, wherever they were looked for."""

from dataclasses import replace

import numpy as np
import pytest
from test_geometry import SIGMA, made_up, spread

from homeward.geometry.angles import wrap
from homeward.vision.features.matching import match
from homeward.vision.geometry.a_contrario import WITHIN, assess
from homeward.vision.geometry.epipolar import Motion, Pairs
from homeward.vision.geometry.ransac import estimate_motion

HEADING = 0.8


def wrong(seed, n=40):
    """Return matches of nothing, each near where a camera turned by `HEADING` would see it."""
    rng = np.random.default_rng(seed)
    home = np.column_stack([rng.uniform(-np.pi, np.pi, n), rng.uniform(-0.3, 0.3, n)])
    off = np.column_stack([rng.uniform(-WITHIN, WITHIN, n), rng.uniform(-0.3, 0.3, n)])
    now = home - [HEADING, 0.0] + off
    return Pairs.of(home, np.column_stack([wrap(now[:, 0]), now[:, 1]]), spread(n), np.zeros(n))


def test_what_was_looked_for_near_a_heading_agrees_more_easily():
    alarms = []
    for seed in range(60):
        pairs = wrong(seed)
        fit = estimate_motion(pairs, np.ones(len(pairs)), 0.005)
        acceptances = assess(fit, pairs), assess(fit, pairs, HEADING)
        assert not acceptances[1].accepted
        alarms.append([acceptance.log_false_alarms for acceptance in acceptances])
    anywhere, near = np.mean(alarms, axis=0)
    assert near > anywhere + 1.0  # five guesses alone are 0.7


@pytest.mark.parametrize("heading", [None, HEADING])
@pytest.mark.parametrize("seed", range(4))
def test_a_third_of_right_matches_is_believed(seed, heading):
    right, other = made_up(Motion(1.0, HEADING), n=20, seed=seed, noise=SIGMA), wrong(seed)
    pairs = right + other
    fit = estimate_motion(pairs, np.ones(len(pairs)), 0.005)
    assert abs(wrap(fit.motion.alpha - HEADING)) < 0.02
    assert assess(fit, pairs, heading).accepted


def unit(rows):
    rows = np.array(rows, np.float32)
    return rows / np.linalg.norm(rows, axis=1, keepdims=True)


def test_what_cannot_be_the_same_is_neither_the_match_nor_its_rival():
    a = unit([[1.0, 0.1, 0.0], [0.0, 0.2, 1.0]])
    b = unit([[1.0, 0.0, 0.0], [1.0, 0.2, 0.0], [0.0, 0.0, 1.0]])
    assert match(a, b)[0].tolist() == [[1, 2]]  # two look like the first
    possible = np.ones((2, 3), bool)
    possible[0, 1] = False
    rows, quality = match(a, b, possible=possible)
    assert rows.tolist() == [[0, 0], [1, 2]]
    assert (quality < 0.2).all()
    assert match(a, b, possible=np.zeros((2, 3), bool))[0].shape == (0, 2)
    assert possible.sum() == 5


def on_floor(pairs, floor):
    """Return pairs of which the last `floor` lie steeply below the horizon, wherever they were."""
    home, now = pairs.home.copy(), pairs.now.copy()
    for side in (home, now):
        side[-floor:, 1] = np.linspace(-0.7, -0.5, floor)
    return Pairs.of(home, now, spread(len(home)), np.zeros(len(home)))


@pytest.mark.parametrize(("floor", "accepted"), [(8, True), (16, False)])
def test_the_tiles_of_a_floor_alone_are_not_believed(floor, accepted):
    """They agree from the other side, too: other matches must decide."""
    pairs = on_floor(made_up(Motion(1.0, HEADING), n=20, seed=0, noise=SIGMA), floor)
    fit = estimate_motion(pairs, np.ones(len(pairs)), 0.005)
    fit = replace(fit, inlier=np.ones(len(pairs), bool))
    acceptance = assess(fit, pairs)
    assert acceptance.accepted == accepted
    assert ("floor" in acceptance.reason) != accepted


def test_matches_left_after_a_refit_must_still_stand_all_round():
    """Propagated matches may lead to another motion than the accepted one."""
    pairs = made_up(Motion(1.0, HEADING), n=40, seed=0, noise=SIGMA)
    acceptance = assess(estimate_motion(pairs, np.ones(len(pairs)), 0.005), pairs)
    assert acceptance.accepted
    assert acceptance.reassessed(np.ones(40, bool), pairs).accepted
    one_side = np.abs(wrap(pairs.home[:, 0])) < 0.4
    for left in (one_side, np.zeros(40, bool)):
        again = acceptance.reassessed(left, pairs)
        assert not again.accepted
        assert f"{left.sum()} of 40 matches agree" in again.reason
