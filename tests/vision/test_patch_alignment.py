"""Laying a feature's patch onto the other panorama: known shifts and shapes come back."""

import numpy as np
import pytest

pytest.importorskip("cv2")

import cv2
from vision_scene import align_features

from homeward.vision.features.patch_alignment import Pyramid

WIDTH, HEIGHT = 256, 96


def scene(column, row, seed=0):
    """Grey values anywhere of a smooth pattern that closes round the seam."""
    rng = np.random.default_rng(seed)
    grey = np.full(np.broadcast(column, row).shape, 128.0)
    for _ in range(60):
        turns, along = rng.integers(-24, 25), rng.uniform(-0.6, 0.6)
        phase = 2 * np.pi * turns * (column + 0.5) / WIDTH + along * row
        grey += 12 * np.cos(phase + rng.uniform(0, 2 * np.pi))
    return np.clip(grey, 0, 255)


def drawn(carry=lambda column, row: (column, row), noise=0.0):
    """Return the picture whose pixels show the scene at the position from `carry`."""
    column, row = np.meshgrid(np.arange(WIDTH, dtype=float), np.arange(HEIGHT, dtype=float))
    grey = scene(*carry(column, row))
    grey = grey + np.random.default_rng(1).normal(0, noise, grey.shape)
    return Pyramid.of(np.clip(np.rint(grey), 0, 255).astype(np.uint8))


def laid(home, now, at_home, at_now, size=4.0, growth=1.0, turn=0.0):
    at_home, at_now = (np.array(a, float).reshape(-1, 2) for a in (at_home, at_now))
    many = np.ones(len(at_home))
    return align_features(home, now, at_home, at_now, size * many, growth * many, turn * many)


def sigmas(found):
    """Return standard deviations of columns and rows, (n, 2)."""
    return np.sqrt(np.diagonal(found.covariance, axis1=1, axis2=2))


PLACES = np.array([[40.3, 30.2], [90.0, 50.7], [150.8, 40.1], [200.5, 60.0], [120.2, 25.6]])


@pytest.mark.parametrize("shift", [(0.0, 0.0), (0.4, -0.3), (1.5, 1.2), (-1.9, 0.6)])
def test_a_shift_comes_back(shift):
    now = drawn(lambda c, r: (c - shift[0], r - shift[1]))
    found = laid(drawn(), now, PLACES, PLACES)
    assert found.found.all()
    assert np.abs(found.column - PLACES[:, 0] - shift[0]).max() < 0.05
    assert np.abs(found.row - PLACES[:, 1] - shift[1]).max() < 0.05


def test_light_does_not_matter_and_noise_is_measured():
    dim = drawn(lambda c, r: (c - 0.7, r))
    noisy = drawn(lambda c, r: (c - 0.7, r), noise=8.0)
    darker = Pyramid(tuple(0.5 * a + 30 for a in dim.levels), dim.times, dim.width, dim.margin)
    found, rough = (laid(drawn(), now, PLACES, PLACES) for now in (darker, noisy))
    assert np.abs(found.column - PLACES[:, 0] - 0.7).max() < 0.05
    assert np.all(sigmas(rough) > sigmas(found))
    assert np.all(np.abs(rough.column - PLACES[:, 0] - 0.7) < 4 * sigmas(rough)[:, 0])


STRETCHED = np.array([[1.2, 0.1], [-0.05, 0.95]])
"""By a fifth one way, and sheared."""
GROWN = 1.6 * np.array([[np.cos(0.5), -np.sin(0.5)], [np.sin(0.5), np.cos(0.5)]])


@pytest.mark.parametrize(
    ("shape", "known", "within"),
    [
        (STRETCHED, {"size": 2.0}, 0.3),
        (STRETCHED, {"size": 6.0}, 0.1),
        (STRETCHED, {"size": 30.0}, 0.1),
        (GROWN, {"growth": 1.6, "turn": 0.5}, 0.1),  # those of the features
    ],
)
def test_a_change_of_shape_comes_back(shape, known, within):
    """About one point, whose place is asked for."""
    back, at, step = np.linalg.inv(shape), np.array([120.4, 45.3]), np.array([0.8, -0.5])

    def carry(column, row):
        c, r = column - at[0] - step[0], row - at[1] - step[1]
        return at[0] + back[0, 0] * c + back[0, 1] * r, at[1] + back[1, 0] * c + back[1, 1] * r

    found = laid(drawn(), drawn(carry), at, at, **known)
    assert found.found.all()
    assert abs(found.column[0] - at[0] - step[0]) < within
    assert abs(found.row[0] - at[1] - step[1]) < within


@pytest.mark.parametrize("home_at", [0.2, 254.9])
@pytest.mark.parametrize("turned", [100, 255, 3])
def test_the_seam_is_not_felt(home_at, turned):
    at = [home_at, 40.0]
    now = drawn(lambda c, r: (c - turned, r))
    there = (home_at + turned + 0.5) % WIDTH - 0.5
    found = laid(drawn(), now, at, [there + 0.6, 40.3])
    assert found.found.all()
    assert abs((found.column[0] - there + WIDTH / 2) % WIDTH - WIDTH / 2) < 0.05
    assert abs(found.row[0] - 40.0) < 0.05


def test_what_looks_different_is_not_found():
    other = drawn(lambda c, r: (c + 77.0, r + 13.0))
    assert not laid(drawn(), other, PLACES, PLACES).found.any()


def test_an_edge_is_sure_across_and_unsure_along():
    column = np.arange(WIDTH)
    image = np.tile(np.where(np.abs(column - 100) < 20, 200, 60), (HEIGHT, 1))
    noise = np.random.default_rng(0).normal(0, 2, (2, HEIGHT, WIDTH))
    home, now = (Pyramid.of(np.rint(image + n).astype(np.uint8)) for n in noise)
    edge = sigmas(laid(home, now, [80.0, 48.0], [80.0, 48.0]))[0]
    textured = sigmas(laid(drawn(), drawn(noise=2.0), PLACES, PLACES))
    assert edge[1] > 2 * textured.max()
    assert edge[0] < edge[1] / 5


def test_blank_patches_give_no_warning_and_are_not_found():
    blank = Pyramid.of(np.full((HEIGHT, WIDTH), 90, np.uint8))
    found = laid(blank, blank, PLACES, PLACES)
    assert not found.found.any()
    assert np.isfinite(found.column).all()


@pytest.mark.parametrize("shape", [(1, 4), (3, 5), (25, 120), (2, 2000)])
def test_pictures_of_any_size_can_be_looked_up_anywhere(shape):
    rng = np.random.default_rng(0)
    picture = Pyramid.of(rng.integers(0, 256, shape, dtype=np.uint8), times=3)
    points = rng.uniform(-1, 1, (7, 2, 9)) * 3 * max(shape)
    assert np.isfinite(picture.sample(points, rng.uniform(0.1, 9, 7))).all()


def test_no_matches_at_all():
    empty = np.zeros((0, 2))
    assert laid(drawn(), drawn(), empty, empty).column.shape == (0,)


def test_a_whole_pixel_is_that_pixel():
    image = np.random.default_rng(0).integers(0, 256, (20, 40), dtype=np.uint8)
    rows, columns = np.meshgrid(np.arange(20), np.arange(-40, 80), indexing="ij")
    points = np.stack([columns.ravel(), rows.ravel()])[:, None, :].transpose(2, 0, 1)
    picture = Pyramid.of(image)
    seen = picture.sample(points.astype(float), np.ones(len(points)))[:, 0].reshape(20, 120)
    smooth = cv2.GaussianBlur(np.tile(image, 3).astype(np.float32), (0, 0), 0.5)
    assert np.abs(seen - smooth)[:, 5:-5].max() < 0.5
