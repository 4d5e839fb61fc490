"""The particle filter against the posterior on a grid, and against chance."""

import numpy as np
import pytest
from lab.model_by_hand import scene

from homeward.geometry.angles import wrap
from homeward.geometry.frames import Polar, Pose, bearing, to_polar
from homeward.lab.filters.backend import Setup
from homeward.lab.filters.particle import ParticleFilter, _sight
from homeward.lab.model import home_anchored_bearing

Q, SIGMA = 3, 0.1
DENSITY = np.array([0.05**2, 0.1**2])


def make(particles=20_000, known=True, sigmas=(0.3, 0.5, 0.5), gate=np.inf, outliers=1e-9, seed=0):
    """Return a filter whose landmarks are two metres from home, `known` to it or not."""
    home = np.array([0.2, 2.4, -1.9])
    setup = Setup(Polar(0.7, -0.5, 0.4), np.array(sigmas), home, SIGMA, DENSITY, gate, 1)
    home_sigma = np.full(Q, 1e-6 if known else 0.01)
    own = ParticleFilter(setup, home_sigma, (0.5, 0.5), particles, outliers, seed)
    belief = own.start()
    if known:
        belief.spread[1, 1] = 1e-12
    return own, belief, 2 * np.stack([np.cos(home), np.sin(home)], axis=1)


def test_it_has_the_posterior_that_a_grid_has():
    own, belief, landmarks = make(200_000)
    true = Pose(0.75, -0.15, 0.1)
    seen = {i: float(bearing(true, *landmarks[i])) + 0.05 * (i - 1) for i in range(Q)}
    found, covariance = own.pose(own.update(belief, seen, {})[0])

    R, theta, alpha = np.meshgrid(
        np.linspace(0.01, 1.9, 90), np.linspace(-2.5, 1.5, 110), np.linspace(-2, 2.8, 110)
    )
    x, y = R * np.cos(theta), R * np.sin(theta)
    prior = ((R - 0.7) / 0.3) ** 2 + ((theta + 0.5) / 0.5) ** 2 + ((alpha - 0.4) / 0.5) ** 2
    off = [wrap(seen[i] - bearing(Pose(x, y, alpha), *landmarks[i])) / SIGMA for i in range(Q)]
    weight = np.exp(-0.5 * (prior + sum(o**2 for o in off)))
    weight /= weight.sum()
    grid = np.stack([v.ravel() for v in (x, y, alpha)])
    mean = grid @ weight.ravel()
    spread = np.cov(grid, aweights=weight.ravel(), ddof=0)
    sigma = np.sqrt(np.diag(spread))
    np.testing.assert_allclose((np.array(found) - mean) / sigma, 0.0, atol=0.05)
    np.testing.assert_allclose((covariance - spread) / np.outer(sigma, sigma), 0.0, atol=0.05)


def test_motion_spreads_with_its_noise():
    own, belief, _ = make(sigmas=(1e-9, 1e-9, 1e-9))
    after = own.predict(belief, 0.5, (0.4, 0.0))
    along = after.pose[0] * np.cos(0.4) + after.pose[1] * np.sin(0.4)
    assert along.std() == pytest.approx(np.sqrt(DENSITY[0] * 0.5), rel=0.03)
    assert after.pose[2].std() == pytest.approx(np.sqrt(DENSITY[1] * 0.5), rel=0.03)


def test_slopes_of_a_sighting():
    rng = np.random.default_rng(0)
    pose, mark, step = rng.normal(size=(3, 4)), rng.uniform(0.2, 0.9, (2, 4, Q)), 1e-6
    for k in range(2):
        high, low = mark.copy(), mark.copy()
        high[k] += step
        low[k] -= step
        at = Pose(*(p[:, None] for p in pose))
        numeric = wrap(home_anchored_bearing(at, *high) - home_anchored_bearing(at, *low))
        np.testing.assert_allclose(_sight(pose, mark)[1][k], numeric / (2 * step), atol=1e-6)


def test_the_same_belief_draws_the_same_and_another_seed_something_else():
    own, belief, _ = make(100)
    again = make(100)[0]
    assert np.array_equal(
        own.predict(belief, 0.1, None).pose, again.predict(again.start(), 0.1, None).pose
    )
    assert not np.array_equal(make(100, seed=1)[1].pose, belief.pose)


def test_a_start_that_is_hardly_known_is_found():
    landmarks, _, _, stored = scene(7, 3)
    true = Pose(-0.5, 0.6, 1.0)
    polar, sigmas = Polar(*np.add(to_polar(true), [0.3, 0.5, -0.6])), np.array([0.3, 0.6, 0.6])
    setup = Setup(polar, sigmas, stored, 0.05, DENSITY / 25, 11.0, 1)
    own = ParticleFilter(setup, np.full(7, 0.01), (0.5, 0.5), 2000, 0.01)
    belief, rng, pose = own.start(), np.random.default_rng(1), np.array(true)
    for k in range(150):
        seen = {i: float(bearing(Pose(*pose), *landmarks[i])) for i in range(7)}
        belief, _ = own.update(belief, {i: b + 0.05 * rng.normal() for i, b in seen.items()}, {})
        turn = 0.6 if k < 75 else -0.6
        pose += 0.05 * np.array([0.2 * np.cos(pose[2]), 0.2 * np.sin(pose[2]), turn])
        belief = own.predict(belief, 0.05, (0.2, turn))
    found, _ = own.pose(belief)
    off = np.array([found.x - pose[0], found.y - pose[1], wrap(found.heading - pose[2])])
    assert np.hypot(*off[:2]) < 0.25
    assert abs(off[2]) < 0.15
    assert belief.weight.sum() == pytest.approx(1.0)
