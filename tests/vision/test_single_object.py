"""An object that the result depends on is reported, and enlarges the covariance."""

import math

import numpy as np
import pytest

from homeward.drives.cameras.camera import unit_vectors
from homeward.vision.geometry.a_contrario import assess, covariance_factor, dominant_object, explain
from homeward.vision.geometry.epipolar import Motion, Pairs
from homeward.vision.geometry.ransac import estimate_motion

SIGMA = 0.002


def seen(directions, distance, alpha=0.7):
    """Return pairs of points in directions (n, 2) from home, seen from 1 m along x, turned."""
    rng = np.random.default_rng(0)
    points = distance[:, None] * unit_vectors(*directions.T) - [1.0, 0.0, 0.0]
    x, y, z = points.T
    now = np.column_stack([np.arctan2(y, x) - alpha, np.arctan2(z, np.hypot(x, y))])
    now += SIGMA * rng.standard_normal(now.shape)
    spread = np.tile(SIGMA**2 * np.eye(2), (len(now), 1, 1))
    return Pairs.of(directions, now, spread, np.log(distance / np.linalg.norm(points, axis=1)))


def scattered(n, seed=1):
    rng = np.random.default_rng(seed)
    return np.column_stack([rng.uniform(-3.1, 3.1, n), rng.uniform(-0.4, 0.4, n)])


def answer(directions):
    rng = np.random.default_rng(2)
    pairs = seen(directions, rng.uniform(2.0, 5.0, len(directions)))
    fit = estimate_motion(pairs, np.arange(len(pairs)) / len(pairs), 0.002)
    acceptance = assess(fit, pairs)
    return fit, pairs, acceptance, dominant_object(fit, pairs)


@pytest.mark.parametrize("elevation", [0.2, 1.3])
def test_an_object_with_many_of_the_matches_is_reported_and_costs(elevation):
    """A chandelier overhead lies in many directions, and is one thing all the same."""
    rng = np.random.default_rng(3)
    middle = np.array([[0.8, elevation]])
    around = unit_vectors(*middle.T) + rng.uniform(-0.15, 0.15, (30, 3))
    x, y, z = around.T
    thing = np.column_stack([np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))])
    fit, pairs, acceptance, on_it = answer(np.vstack([thing, scattered(5)]))
    assert on_it[:30].sum() > 25
    assert not on_it[30:].any()
    assert covariance_factor(on_it, fit) > 3.0
    said = explain(acceptance, on_it, pairs)
    assert "on one object" in said
    assert ("overhead" in said) == (elevation > math.radians(45.0))


def test_matches_all_round_cost_nothing():
    fit, pairs, acceptance, on_it = answer(scattered(35))
    assert acceptance.accepted
    assert not on_it.any()
    assert covariance_factor(on_it, fit) == 1.0
    assert explain(acceptance, on_it, pairs) == acceptance.reason


def test_an_object_with_many_matches_costs_nothing_if_the_others_suffice():
    near = np.column_stack([np.linspace(0.5, 0.9, 60), np.tile([0.0, 0.2, -0.2], 20)])
    fit, _, _, on_it = answer(np.vstack([near, scattered(40)]))
    assert fit.inlier.sum() > 80
    assert not on_it.any()
    assert Motion(*fit.motion).alpha == pytest.approx(0.7, abs=0.01)
