"""A landmark seen briefly: from two places, one position explains it, unless it moved.

From one place, while the robot turned: it leaves the map with its sightings, if these do not
determine its position.
"""

import numpy as np
import pytest

from benchmarks.cost import hall_drive
from homeward.geometry.angles import wrap
from homeward.localizer.localizer import Localizer
from homeward.localizer.map.triangulation import unexplained
from homeward.localizer.settings import LocalizerSettings
from homeward.localizer.tunables import MIN_SIGHTINGS
from homeward.track import run


@pytest.mark.parametrize(("moved_m", "is_one"), [(0.0, True), (6.0, False)])
def test_one_position_explains_two_short_views_unless_the_landmark_moved(moved_m, is_one):
    x = np.concatenate([np.linspace(0.0, 0.4, 8), np.linspace(4.0, 4.4, 8)])
    cameras = np.stack([x, np.zeros(16), np.zeros(16)], axis=1)
    at_x = np.where(x < 2.0, 2.0, 2.0 + moved_m)
    bearings = np.arctan2(3.0, at_x - x) + np.random.default_rng(1).normal(0.0, 1e-3, 16)
    wrong_range = np.array([[4.0, 6.0]])  # of the first view, by its narrow baseline
    off = unexplained(cameras, wrap(bearings), np.full(16, 1e-3), wrong_range)
    assert bool(off.sum(axis=1).min() < MIN_SIGHTINGS) == is_one


def test_a_landmark_leaves_a_short_window_unless_its_sightings_determine_its_position():
    drive = hall_drive(70.0, rows=10, seed=5)
    settings = LocalizerSettings(longest_window=75)
    localizer = Localizer(drive.home, settings=settings, **drive.settings.robot)
    run(drive, localizer)
    times = drive.sightings.t[drive.sightings.landmark == "P33"]
    assert times.size == 4  # from one place; the post is 7 m away
    assert times.max() < 20.0
    assert "P33" not in localizer.chart.map.landmarks.mapped
    assert len(localizer.chart.map.landmarks.mapped) > 15
