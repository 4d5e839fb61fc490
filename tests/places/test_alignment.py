"""The pose of a place's home in another map, by positions of landmarks in both."""

import math

import numpy as np
import pytest
from visited import new_place, room

from homeward.drives.landmarks import KnownLandmarks
from homeward.errors import InputError
from homeward.geometry.frames import Pose, compose
from homeward.places.alignment import align_place

HOME = Pose(12.0, -3.0, 2.0)
PLACES = room()
CLICK = 0.05
"""Error of a click [m]: a cell of the map."""


@pytest.fixture(scope="module")
def place():
    return new_place(PLACES, np.random.default_rng(1))


def clicked(names, seed=0, mirrored=1.0, sigma=CLICK):
    """Positions of landmarks in another map, as in landmarks.yaml."""
    rng, found = np.random.default_rng(seed), {}
    for name in names:
        x, y = PLACES[name]
        point = compose(HOME, Pose(float(x), float(y), 0.0))
        dx, dy = rng.normal(0.0, CLICK, 2)
        found[name] = {"x": float(point.x + dx), "y": float(mirrored * (point.y + dy))}
    return KnownLandmarks(sigma=sigma, landmarks=found)


def test_two_clicked_landmarks_give_the_pose_of_home_within_its_uncertainty(place):
    squared = []
    for seed in range(20):
        found = align_place(place, clicked(["L0", "L1"], seed))
        off = np.subtract(found.home, HOME)
        squared.append(off @ np.linalg.solve(found.covariance, off))
    assert np.mean(squared) == pytest.approx(3.0, abs=1.7)  # 3 sigma of the mean
    assert set(found.residuals) == {"L0", "L1"}


def test_more_landmarks_make_it_more_accurate_and_unknown_ones_are_ignored(place):
    two = align_place(place, clicked(["L0", "L1"]))
    survey = clicked(list(PLACES)[:8])
    survey.landmarks["post"] = survey.landmarks["L0"]
    many = align_place(place, survey)
    assert set(many.residuals) == set(list(PLACES)[:8])
    assert many.sigmas < two.sigmas
    assert math.dist(many.home[:2], HOME[:2]) < 0.15


def test_a_landmark_that_moved_is_named_and_a_mirrored_map_is_refused(place):
    survey = clicked(list(PLACES)[:6])
    moved = survey.landmarks["L3"]
    survey.landmarks["L3"] = moved.model_copy(update={"x": moved.x + 1.0})
    with pytest.raises(InputError, match="contradicts the place 'hall': landmark 'L3' has"):
        align_place(place, survey)
    with pytest.raises(InputError, match="y points to the left"):
        align_place(place, clicked(list(PLACES)[:6], mirrored=-1.0))


def test_one_landmark_of_the_place_is_too_few(place):
    survey = clicked(["L0", "L1"])
    survey.landmarks["post"] = survey.landmarks.pop("L1")
    with pytest.raises(InputError, match=r"has 1 landmarks? of the place 'hall'; at least 2"):
        align_place(place, survey)
