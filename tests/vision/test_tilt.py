"""Tilt from picture to picture: bearings are those of a camera as level as home's."""

import math

import numpy as np
import pytest

from benchmarks.rooms import room
from homeward.drives.cameras.camera import tilt_matrix, unit_vectors
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose
from homeward.lab.simulation.render.drive import Eye, panorama_of
from homeward.vision import Equirectangular, compare, extract
from homeward.vision.front_end import MIN_SIGHTINGS, FrontEnd
from homeward.vision.geometry.epipolar import AS_HOME, Motion, Tilt

JITTER = 0.03
"""[rad]"""


def directions(vectors):
    x, y, z = vectors.T
    return np.column_stack([np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))])


def some_directions(n=50):
    rng = np.random.default_rng(1)
    return np.column_stack([rng.uniform(-3.1, 3.1, n), rng.uniform(-0.8, 0.8, n)])


def turned(alpha):
    c, s = math.cos(alpha), math.sin(alpha)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def test_a_tilt_is_taken_out():
    level = some_directions()
    tilted = directions(unit_vectors(*level.T) @ tilt_matrix(0.05, -0.08))
    bearing, _ = Tilt.of(Motion(0.0, 1.0, 0.05, -0.08), np.eye(2)).level(tilted)
    np.testing.assert_allclose(bearing, level[:, 0], atol=1e-12)


def test_along_keyframes_tilts_add_up_to_that_against_home():
    first, second = Motion(0.0, 0.9, 0.04, -0.06), Motion(0.0, -2.0, -0.03, 0.05)
    seen = some_directions()
    tilt = AS_HOME.then(first, 1e-4 * np.eye(2)).then(second, 4e-4 * np.eye(2))
    whole = turned(0.9) @ tilt_matrix(0.04, -0.06) @ turned(-2.0) @ tilt_matrix(-0.03, 0.05)
    at_home = directions(unit_vectors(*seen.T) @ whole.T)[:, 0]
    heading = math.atan2(whole[1, 0], whole[0, 0])
    np.testing.assert_allclose(wrap(tilt.level(seen)[0] + heading), wrap(at_home), atol=1e-12)
    np.testing.assert_allclose(tilt.covariance, 5e-4 * np.eye(2), atol=1e-12)


def test_lean_is_the_derivative_by_roll_and_pitch():
    seen, step = some_directions(), 1e-6
    lean = AS_HOME.level(seen)[1]
    for k, way in enumerate(np.eye(2)):
        ahead, behind = (
            Tilt(tilt_matrix(*(s * step * way)), np.eye(2)).level(seen)[0] for s in (1, -1)
        )
        np.testing.assert_allclose(wrap(ahead - behind) / (2 * step), lean[:, k], atol=1e-8)


@pytest.mark.parametrize("jitter", [0.0, JITTER])
def test_bearings_of_shaken_pictures_are_those_of_level_ones(jitter):
    """From one place, turning: home's features keep their direction for any tilt of the camera."""
    made = room("attic", 0, (1.0, 3.0), 0)
    camera = made.camera.model_copy(update={"tilt_sigma": jitter})
    eye = Eye(made.model_copy(update={"camera": camera}))
    known = panorama_of(eye)
    front_end = FrontEnd(extract(eye.home_picture(), known), known)
    off = []
    for k in range(MIN_SIGHTINGS + 3):
        alpha = 0.2 * k
        glance = front_end.see(eye.look(0.0, Pose(0.0, 0.0, alpha), k + 1))
        for name, bearing in glance.bearings.items():
            if name.startswith("h"):
                there = front_end.home.azimuth[int(name[1:])] - alpha
                off.append((wrap(bearing - there), glance.sigmas[name]))
    error, sigma = np.array(off).T
    assert error.size > 50
    # Untouched, a tilt of 0.03 rad shifts them by 0.01 rad: 6 to 10 of their sigmas.
    assert np.median(np.abs(error)) < 0.002
    assert np.median(np.abs(error / sigma)) < 1.0


def test_the_tilt_of_a_pair_is_within_its_covariance():
    nees = []
    for seed in range(4):
        made = room("office", seed, (1.0, 2.0), 0)
        camera = made.camera.model_copy(update={"tilt_sigma": JITTER})
        eye = Eye(made.model_copy(update={"camera": camera}))
        robot = made.start.in_home_frame(made.home.pose)
        views = [
            extract(p, panorama_of(eye)) for p in (eye.home_picture(), eye.look(0.0, robot, 1))
        ]
        seen = compare(*views, Equirectangular(tilt_sigma=JITTER))
        assert seen.accepted
        whole = eye.home_view.rotation.T @ eye.view(robot, 1).rotation
        true = [math.atan2(whole[2, 1], whole[2, 2]), -math.asin(whole[2, 0])]
        error = np.array(seen.motion[2:4]) - true
        assert np.abs(error).max() < 0.01
        nees.append(error @ np.linalg.solve(seen.tilt_covariance, error))
    assert np.mean(nees) < 5.0  # 2 where consistent; the mean of four is beyond once in 200 times
