"""What lies beside a feature that was found is found where its map takes it, and nothing else."""

import numpy as np
import pytest

pytest.importorskip("cv2")

import cv2

from homeward.vision import Equirectangular, look
from homeward.vision.alignment import align
from homeward.vision.neighbours import neighbours

WIDTH, HEIGHT = 512, 128
MIDDLE = (255.5, 63.5)


def blots(seed):
    """A smooth panorama, closed round the seam."""
    noise = np.random.default_rng(seed).normal(0, 300, (HEIGHT, 3 * WIDTH)).astype(np.float32)
    noise[:, :WIDTH] = noise[:, 2 * WIDTH :] = noise[:, WIDTH : 2 * WIDTH]
    smooth = cv2.GaussianBlur(noise, (0, 0), 3.0, borderType=cv2.BORDER_REFLECT)
    return np.clip(128 + smooth[:, WIDTH : 2 * WIDTH], 0, 255).astype(np.uint8)


def seen(image):
    return look(image, Equirectangular())


def turned(image, columns):
    """The panorama turned about the vertical: its features lie so many columns to the right."""
    return np.roll(image, columns, axis=1)


def place(view, rows):
    return np.column_stack([view.column[rows], view.row[rows]])


def laid(home, now, rows, at_now, growth=1.0):
    """Lay some of home's features, at places that are known."""
    many = np.ones(len(rows))
    told = place(home, rows), at_now, home.size[rows], growth * many, 0 * many
    return align(home.picture, now.picture, *told)


@pytest.mark.parametrize("columns", [0, 37, 300])
def test_features_beside_a_few_are_found_where_they_lie_across_the_seam(columns):
    home = seen(blots(0))
    now = seen(turned(blots(0), columns))
    known = np.flatnonzero((home.column < 20) | (home.column > WIDTH - 20))[::6]
    there = place(home, known) + np.array([columns, 0])
    rows, found = neighbours(home, now, known, laid(home, now, known, there))
    assert len(rows) > 2 * len(known)
    assert len(found) == len(np.unique(rows)) == len(rows)
    assert not np.isin(rows, known).any()
    across = (found.column - home.column[rows] - columns + WIDTH / 2) % WIDTH - WIDTH / 2
    assert np.abs(across).max() < 0.1
    assert np.abs(found.row - home.row[rows]).max() < 0.1
    beyond = [home.column[rows] < WIDTH / 2, home.column[rows] > WIDTH / 2]
    assert all(side.any() for side in beyond)


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
    rows, found = neighbours(home, now, known[good], begun[good])
    assert len(rows) >= 5
    there = place(home, rows) @ shape.T + carry[:, 2]
    assert np.median(np.hypot(*(found.place - there).T)) < 0.2
    assert np.median(np.abs(found.shape - shape).max(axis=(1, 2))) < 0.15


def test_what_looks_different_is_not_found():
    home, other = seen(blots(2)), seen(blots(3))
    known = np.arange(0, len(home), 5)
    same = laid(home, home, known, place(home, known))
    assert same.found.all()
    rows, _ = neighbours(home, other, known, same)
    assert len(rows) < 0.05 * len(home)


def test_one_of_each_place_and_none_where_something_is_known():
    home = seen(blots(4))
    known = np.arange(0, len(home), 3)
    rows, _ = neighbours(home, home, known, laid(home, home, known, place(home, known)))
    spots = place(home, np.concatenate([known, rows])).round()
    fresh = spots[len(known) :]
    assert len(rows)
    assert len(np.unique(fresh, axis=0)) == len(rows)
    assert not (fresh[:, None] == spots[: len(known)]).all(axis=2).any()


def test_nothing_known_and_nothing_else_there():
    home = seen(blots(5))
    for known in (np.zeros(0, int), np.arange(len(home))):
        told = laid(home, home, known, place(home, known))
        rows, found = neighbours(home, home, known, told)
        assert len(rows) == len(found) == 0
        assert found.shape.shape == (0, 2, 2)


@pytest.mark.parametrize("times", [1e-4, 1e4, 0.0])
def test_maps_that_carry_nothing_are_left_alone(times):
    home = seen(blots(6))
    known = np.arange(0, len(home), 4)
    told = laid(home, home, known, place(home, known))
    told.shape[:] *= times
    rows, _ = neighbours(home, home, known, told)
    assert len(rows) == 0


def test_of_too_many_only_some_are_tried(monkeypatch):
    home = seen(blots(7))
    known = np.arange(0, len(home), 10)
    told = laid(home, home, known, place(home, known))
    every, _ = neighbours(home, home, known, told)
    monkeypatch.setattr("homeward.vision.neighbours.MOST_FEATURES", 12)
    monkeypatch.setattr("homeward.vision.neighbours.MOST_GUIDES", 5)
    some, found = neighbours(home, home, known, told)
    assert len(every) > 12
    assert 0 < len(some) <= 12
    assert np.abs(found.place - place(home, some)).max() < 0.1
