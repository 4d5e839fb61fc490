"""Patches next to a match are found where its map predicts them, and nothing else."""

import numpy as np
import pytest

pytest.importorskip("cv2")

import cv2
from vision_scene import align_features

from homeward.vision import Equirectangular, extract
from homeward.vision.features.matching import propagate_matches

WIDTH, HEIGHT = 512, 128
MIDDLE = (255.5, 63.5)


def blots(seed):
    """A smooth panorama, closed round the seam."""
    noise = np.random.default_rng(seed).normal(0, 300, (HEIGHT, 3 * WIDTH)).astype(np.float32)
    noise[:, :WIDTH] = noise[:, 2 * WIDTH :] = noise[:, WIDTH : 2 * WIDTH]
    smooth = cv2.GaussianBlur(noise, (0, 0), 3.0, borderType=cv2.BORDER_REFLECT)
    return np.clip(128 + smooth[:, WIDTH : 2 * WIDTH], 0, 255).astype(np.uint8)


def seen(image):
    return extract(image, Equirectangular())


def turned(image, columns):
    """The panorama turned about the vertical: its features are shifted by columns to the right."""
    return np.roll(image, columns, axis=1)


def place(view, rows):
    return np.column_stack([view.column[rows], view.row[rows]])


def laid(home, now, rows, at_now, growth=1.0):
    """Lay some of home's features, at places that are known."""
    many = np.ones(len(rows))
    given = place(home, rows), at_now, home.size[rows], growth * many, 0 * many
    return align_features(home.pyramid, now.pyramid, *given)


@pytest.mark.parametrize("columns", [0, 37, 300])
def test_features_next_to_a_few_are_found_across_the_seam(columns):
    home = seen(blots(0))
    now = seen(turned(blots(0), columns))
    known = np.flatnonzero((home.column < 20) | (home.column > WIDTH - 20))[::6]
    there = place(home, known) + np.array([columns, 0])
    (column, row), found = propagate_matches(home, now, known, laid(home, now, known, there))
    assert len(column) > 2 * len(known)
    assert len(found) == len(column)
    across = (found.column - column - columns + WIDTH / 2) % WIDTH - WIDTH / 2
    assert np.abs(across).max() < 0.1
    assert np.abs(found.row - row).max() < 0.1
    assert (column < WIDTH / 2).any()
    assert (column > WIDTH / 2).any()


def test_size_and_shear_are_handed_on():
    """Stretched and sheared about the middle, where the only feature lies that is known."""
    image, shape = blots(1), np.array([[1.3, 0.15], [-0.1, 1.2]])
    carry = np.column_stack([shape, MIDDLE - shape @ MIDDLE])
    now = cv2.warpAffine(image, carry, (WIDTH, HEIGHT), flags=cv2.INTER_CUBIC)
    home, now = seen(image), seen(now)
    apart = np.hypot(*(place(home, slice(None)) - MIDDLE).T)
    # Not every patch about a feature is laid well: the nearest one that is.
    known = np.argsort(apart)[:8]
    begun = laid(home, now, known, place(home, known) @ shape.T + carry[:, 2], 1.25)
    off = np.abs(begun.shape - shape).max(axis=(1, 2))
    good = np.flatnonzero(begun.found & (off < 0.1))[:1]
    places, found = propagate_matches(home, now, known[good], begun.rows(good))
    assert len(found) >= 5
    there = places.T @ shape.T + carry[:, 2]
    assert np.median(np.hypot(*(found.place - there).T)) < 0.2
    assert np.median(np.abs(found.shape - shape).max(axis=(1, 2))) < 0.15


@pytest.mark.parametrize("seed", [2, 4, 6])
def test_hardly_anything_is_found_where_all_looks_different(seed):
    home, other = seen(blots(seed)), seen(blots(seed + 1))
    known = np.arange(0, len(home), 5)
    same = laid(home, home, known, place(home, known))
    assert same.found.all()
    _, found = propagate_matches(home, other, known, same)
    assert len(found) < 0.1 * len(home.patches[0])


def test_one_of_each_place_and_none_where_something_is_known():
    home = seen(blots(4))
    known = np.arange(0, len(home), 3)
    places, _ = propagate_matches(home, home, known, laid(home, home, known, place(home, known)))
    fresh, taken = places.T.round(), place(home, known).round()
    assert len(fresh)
    assert len(np.unique(fresh, axis=0)) == len(fresh)
    assert not (fresh[:, None] == taken).all(axis=2).any()


def test_nothing_known_and_nothing_else_there(monkeypatch):
    monkeypatch.setattr("homeward.vision.features.detection.MIN_CORNER", 1.0)
    home = seen(blots(5))
    for known in (np.zeros(0, int), np.arange(len(home))):
        given = laid(home, home, known, place(home, known))
        places, found = propagate_matches(home, home, known, given)
        assert places.shape[1] == len(found) < 3  # the strongest corner of all
        assert found.shape.shape == (len(found), 2, 2)


@pytest.mark.parametrize("times", [1e-4, 1e4, 0.0])
def test_maps_that_carry_nothing_are_left_alone(times):
    home = seen(blots(6))
    known = np.arange(0, len(home), 4)
    given = laid(home, home, known, place(home, known))
    given.shape[:] *= times
    _, found = propagate_matches(home, home, known, given)
    assert len(found) == 0


def test_of_too_many_only_some_are_tried(monkeypatch):
    home = seen(blots(7))
    known = np.arange(0, len(home), 10)
    given = laid(home, home, known, place(home, known))
    _, every = propagate_matches(home, home, known, given)
    monkeypatch.setattr("homeward.vision.features.matching.MAX_PATCHES", 12)
    monkeypatch.setattr("homeward.vision.features.matching.MAX_GUIDES", 5)
    places, some = propagate_matches(home, home, known, given)
    assert len(every) > 36
    assert 0 < len(some) <= 36  # twelve in each of three rounds
    assert np.abs(some.place - places.T).max() < 0.1


def test_propagated_matches_have_larger_sigmas_than_matches():
    home = seen(blots(8))
    known = np.arange(0, len(home), 4)
    begun = laid(home, home, known, place(home, known))
    _, found = propagate_matches(home, home, known, begun)
    assert found.covariance[:, 0, 0].min() > 2 * begun.covariance[:, 0, 0].min()


def squares(times, columns=(100, 400)):
    """Bright squares on a dark panorama, of a side of 20 px times `times`."""
    image = np.full((HEIGHT * times, WIDTH * times), 60, np.uint8)
    for column in columns:
        image[50 * times : 70 * times, column * times : (column + 20) * times] = 200
    return image


@pytest.mark.parametrize(("times", "enlarged"), [(1, 1), (0.5, 2)])
def test_corners_are_among_what_can_be_laid(times, enlarged):
    image = cv2.resize(squares(1), None, fx=times, fy=times, interpolation=cv2.INTER_AREA)
    view = seen(image)
    assert view.pyramid.times == enlarged
    patches, of = view.patches
    assert np.array_equal(patches[of, :2].round(), place(view, slice(None)).round())
    corners = np.delete(patches, of, axis=0)
    true = times * np.array([[c, r] for c in (100, 120, 400, 420) for r in (50, 70)]) - 0.5
    apart = np.hypot(*(corners[:, None, :2] - true).transpose(2, 0, 1))
    assert apart.min(axis=0).max() < 3 * times
    assert apart.min(axis=1).max() < 6 * times
    assert np.allclose(corners[:, 2], 3.0 / enlarged)


def test_a_corner_at_the_seam_is_there_once():
    view = seen(np.roll(squares(1, columns=(100,)), 412, axis=1))  # its left side at the seam
    corners = view.patches[0]
    at_seam = np.abs((corners[:, 0] + 0.5 + WIDTH / 2) % WIDTH - WIDTH / 2) < 4
    assert np.ptp(corners[at_seam, 1]) > 10
    assert ((corners[:, 0] >= -0.5) & (corners[:, 0] < WIDTH - 0.5)).all()


def test_a_panorama_that_shows_nothing_has_nothing_to_lay():
    patches, of = seen(np.full((HEIGHT, WIDTH), 90, np.uint8)).patches
    assert patches.shape == (0, 3)
    assert of.shape == (0,)
