"""A landmark seen briefly from two places: one position explains it, unless it moved."""

import numpy as np
import pytest

from homeward.geometry.angles import wrap
from homeward.localizer.map.triangulation import unexplained
from homeward.localizer.tunables import MIN_SIGHTINGS


@pytest.mark.parametrize(("moved_m", "is_one"), [(0.0, True), (6.0, False)])
def test_one_position_explains_two_short_views_unless_the_landmark_moved(moved_m, is_one):
    x = np.concatenate([np.linspace(0.0, 0.4, 8), np.linspace(4.0, 4.4, 8)])
    cameras = np.stack([x, np.zeros(16), np.zeros(16)], axis=1)
    at_x = np.where(x < 2.0, 2.0, 2.0 + moved_m)
    bearings = np.arctan2(3.0, at_x - x) + np.random.default_rng(1).normal(0.0, 1e-3, 16)
    wrong_range = np.array([[4.0, 6.0]])  # of the first view, by its narrow baseline
    off = unexplained(cameras, wrap(bearings), np.full(16, 1e-3), wrong_range)
    assert bool(off.sum(axis=1).min() < MIN_SIGHTINGS) == is_one
