"""The bearing of a tag's middle from its corners, and its deviation."""

import numpy as np
import pytest

from homeward.drives.cameras.camera import (
    angles,
    sizes_of,
    tag_bearings,
    tag_ranges,
    tilt_matrix,
    unit_vectors,
)
from homeward.drives.cameras.lens import Lens
from homeward.vision.cameras.panoramic import Equirectangular

FISHEYE = Lens(
    fx=287, fy=287, cx=421, cy=397, model="equidistant", distortion=(-0.007, 0.04, -0.036, 0.0055)
)
CAMERAS = {
    "pinhole": (Lens(fx=600, fy=600, cx=320, cy=240), (480, 640)),
    "fisheye": (FISHEYE, (800, 848)),
    "panorama": (Equirectangular(), (512, 1024)),
}


def rotation(rng):
    q, r = np.linalg.qr(rng.standard_normal((3, 3)))
    return q * np.sign(np.linalg.det(q * np.sign(np.diag(r)))) * np.sign(np.diag(r))


def tag_in_space(rng, away=2.0):
    """Corners (4, 3) and middle (3,) of a large tag that is tilted against the camera."""
    middle = away * unit_vectors(rng.uniform(-0.4, 0.4), rng.uniform(-0.3, 0.3))
    turn = rotation(rng)
    square = 0.15 * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    return middle + square @ turn.T, middle


@pytest.mark.parametrize("name", CAMERAS)
def test_the_middle_is_exact_however_a_tag_is_turned(name):
    camera, shape = CAMERAS[name]
    rng = np.random.default_rng(3)
    tags = [tag_in_space(rng) for _ in range(60)]
    corners = np.array([np.column_stack(camera.pixels(*angles(c), shape)) for c, _ in tags])
    bearing, _ = tag_bearings(corners, 0.1, camera, shape)
    middle = np.array([m for _, m in tags])
    assert bearing == pytest.approx(angles(middle)[0], abs=1e-9)
    # The mean of the corners is off by what turning the tag makes of it.
    mean = camera.directions(*corners.mean(axis=1).T, shape)[0]
    assert np.abs(mean - angles(middle)[0]).max() > np.radians(0.15)


@pytest.mark.parametrize("name", CAMERAS)
def test_deviations_are_those_of_noisy_corners_and_tilts(name):
    """NEES of 4,000 draws: pixels and tilt are drawn as they are said to be."""
    camera, shape = CAMERAS[name]
    camera = camera.model_copy(update={"tilt_sigma": 0.01})
    rng = np.random.default_rng(4)
    seen, middles = [], []
    for _ in range(4000):
        corners, middle = tag_in_space(rng)
        shaken = tilt_matrix(*(0.01 * rng.standard_normal(2)))
        pixels = np.column_stack(camera.pixels(*angles(corners @ shaken), shape))
        seen.append(pixels + 0.3 * rng.standard_normal((4, 2)))
        middles.append(middle)
    bearing, sigma = tag_bearings(np.array(seen), 0.3, camera, shape)
    errors = (bearing - angles(np.array(middles))[0]) / sigma
    # The variance of 4,000 has a deviation of 2.2 %.
    assert np.var(errors) == pytest.approx(1.0, abs=0.09)


def test_tilt_costs_more_towards_the_top():
    camera, shape = CAMERAS["pinhole"]
    square = np.array([[-10, -10], [10, -10], [10, 10], [-10, 10]])
    corners = np.array([[320, 240], [320, 20]])[:, None] + square
    _, (middle, top) = tag_bearings(corners, 1e-6, camera, shape)
    assert middle < 1e-5
    assert top == pytest.approx(0.02 * 220 / 600, rel=0.01)


def test_corners_that_make_no_tag():
    camera, shape = CAMERAS["pinhole"]
    line = np.array([[0, 0], [1, 1], [2, 2], [3, 3]], float)
    bad = np.array([line, np.full((4, 2), 5.0), np.full((4, 2), np.nan)])
    assert np.isnan(tag_bearings(bad, 0.5, camera, shape)[0]).all()


@pytest.mark.parametrize("name", CAMERAS)
def test_ranges_of_upright_tags_are_right_however_they_face(name):
    camera, shape = CAMERAS[name]
    rng = np.random.default_rng(5)
    at, turn, first = (
        rng.uniform(-0.4, 0.4, 40),
        rng.uniform(-1.1, 1.1, 40),
        rng.integers(4, size=40),
    )
    far, up = rng.uniform(1.0, 4.0, 40), rng.uniform(-0.3, 0.3, 40)
    corners = []
    for a, b, k, r, z in zip(at, at + np.pi / 2 + turn, first, far, up, strict=True):
        side = 0.08 * np.array([np.cos(b), np.sin(b), 0.0])
        square = [p * side + [0, 0, q * 0.08] for p, q in [(1, 1), (-1, 1), (-1, -1), (1, -1)]]
        seen = np.array([r * np.cos(a), r * np.sin(a), z]) + np.roll(square, k, axis=0)
        corners.append(np.column_stack(camera.pixels(*angles(seen), shape)))
    found = tag_ranges(np.array(corners), np.full(40, 0.16), camera, shape)
    assert found == pytest.approx(far, rel=0.005)  # mean of the ends of a tag of 0.16 m
    unknown = tag_ranges(np.array(corners[:2]), sizes_of(["7", "8"], {"8": 0.16}), camera, shape)
    assert np.isnan(unknown[0])
    assert unknown[1] == pytest.approx(far[1], rel=0.005)
