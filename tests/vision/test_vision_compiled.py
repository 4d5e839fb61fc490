"""The loops of the compiled core agree with NumPy."""

import numpy as np
import pytest

pytest.importorskip("cv2")

from vision_scene import align_features

from homeward import core
from homeward.vision import Equirectangular, compare, extract
from homeward.vision.features.patch_alignment import Pyramid
from homeward.vision.geometry.epipolar import Pairs, residuals
from homeward.vision.geometry.refinement import irls

pytestmark = pytest.mark.skipif(core.compiled is None, reason=core.missing)


def blots(rng, shape):
    """A panorama of smooth blots."""
    import cv2

    noise = rng.normal(0, 600, shape).astype(np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), 4.0, borderType=cv2.BORDER_REFLECT)
    return np.clip(128 + smooth, 0, 255).astype(np.uint8)


@pytest.mark.parametrize("times", [1, 2])
@pytest.mark.parametrize("shape", [(96, 256), (3, 5), (1, 4), (25, 120), (40, 700)])
def test_patches_are_laid_alike(both, shape, times):
    rng, n = np.random.default_rng(0), 60
    home = blots(rng, shape)
    now = np.roll(home, 3, axis=1)
    at = rng.uniform(-0.5, 0.5, (n, 2)) * [shape[1], shape[0]] + np.array(shape[::-1]) / 2
    size, growth, turn = rng.uniform(0.5, 12, n), rng.uniform(0.7, 1.4, n), rng.normal(0, 0.2, n)
    there = at + rng.normal([3, 0], 0.5, (n, 2))
    given = (Pyramid.of(home, times), Pyramid.of(now, times), at, there, size, growth, turn)
    native, plain = both(align_features, *given)
    # Where the two do not look alike, small differences grow from step to step.
    assert np.mean(native.found == plain.found) > 0.98
    same = native.found & plain.found
    assert np.abs(native.column - plain.column)[same].max(initial=0) < 5e-3
    assert np.abs(native.row - plain.row)[same].max(initial=0) < 5e-3
    size = np.trace(plain.covariance, axis1=1, axis2=2)[:, None, None]
    # Of tiny pictures little is left but rounding.
    alike = np.abs((native.covariance - plain.covariance) / size)[same].max(initial=0) < 1e-2
    assert min(shape) < 25 or (alike and same.sum() > n / 2)


def test_a_feature_is_laid_after_several_maps_as_after_each_alone():
    rng, n = np.random.default_rng(3), 20
    image = blots(rng, (96, 256))
    pictures = Pyramid.of(image), Pyramid.of(np.roll(image, 3, axis=1))
    at = rng.uniform([0, 0], [256, 96], (n, 2))
    given = at, at + rng.normal([3, 0], 1.0, (n, 2)), np.full(n, 4.0), np.ones(n), np.zeros(n)
    other = at, at + rng.normal([3, 0], 1.0, (n, 2)), np.full(n, 4.0), np.full(n, 1.2), np.zeros(n)
    # Each feature twice, one after the other.
    pairs = (np.stack(pair, axis=1) for pair in zip(given, other, strict=True))
    together = align_features(*pictures, *(pair.reshape(2 * n, *pair.shape[2:]) for pair in pairs))
    for first, alone in enumerate(
        (align_features(*pictures, *given), align_features(*pictures, *other))
    ):
        assert np.array_equal(together.place[first::2], alone.place)
        assert np.array_equal(together.covariance[first::2], alone.covariance)


def test_patches_far_outside_and_out_of_shape_are_looked_up_safely(both):
    rng = np.random.default_rng(1)
    picture = Pyramid.of(blots(rng, (50, 120)))
    far = rng.choice([-1e9, -300.0, 0.0, 1e5, 1e12], (40, 2))
    growth = rng.choice([1e-3, 1.0, 30.0], 40)
    for laid in both(
        align_features, picture, picture, far, -far, np.full(40, 4.0), growth, far[:, 0]
    ):
        assert np.isfinite(laid.column).all()


def matches(rng, n):
    """Matches, most of them possible for a small motion."""
    home = np.column_stack([rng.uniform(-np.pi, np.pi, n), rng.normal(0, 0.3, n)])
    now = home + rng.normal(0, 0.05, (n, 2))
    root = rng.uniform(0.001, 0.01, (n, 2, 2))
    return Pairs.of(home, now, root @ root.swapaxes(1, 2), rng.normal(0, 0.3, n))


@pytest.mark.parametrize("looseness", [0.0, 0.02])
@pytest.mark.parametrize(("m", "n"), [(1, 1), (30, 60), (2, 0)])
def test_residuals_are_alike(both, m, n, looseness):
    rng = np.random.default_rng(n)
    motions = rng.normal(0, 1, (m, 5)) * [3, 0.5, 0.05, 0.05, 0.05]
    native, plain = both(residuals, motions, matches(rng, n), looseness)
    assert np.allclose(native.value, plain.value, rtol=1e-9, atol=1e-9)
    assert np.allclose(native.jacobian, plain.jacobian, rtol=1e-9, atol=1e-9)
    assert np.array_equal(native.possible, plain.possible)
    assert n < 60 or 0.1 < native.possible.mean() < 0.9


def test_motions_are_fitted_alike(both):
    rng, m, n = np.random.default_rng(0), 40, 50
    starts = rng.normal(0, 1, (m, 5)) * [3, 0.5, 0.05, 0.05, 0.05]
    kept = rng.random((m, n)) < 0.7
    pairs = matches(rng, n)
    for scale, counts in ((3.0, kept), (1.0, 1.0)):
        native, plain = both(irls, starts, pairs, 0.02, scale, counts)
        # Some steps are hardly determined, and there rounding grows.
        assert np.median(np.abs(native - plain).max(axis=1)) < 1e-12
        assert np.abs(native - plain).max() < 1e-3


def test_motions_without_matches_stay_where_they_are(both):
    starts = np.array([[1.0, 2.0, 0.0, 0.0, 0.0]])
    none = matches(np.random.default_rng(0), 0)
    for fitted in both(irls, starts, none, 0.02, 3.0):
        assert np.allclose(fitted, starts)
    some = matches(np.random.default_rng(0), 5)
    for fitted in both(irls, starts, some, 0.02, 3.0, np.zeros((1, 5))):
        assert np.allclose(fitted, starts)


def test_comparisons_are_alike(both):
    rng = np.random.default_rng(2)
    image = blots(rng, (128, 512))
    views = [extract(np.roll(image, shift, axis=1), Equirectangular()) for shift in (0, 40)]
    native, plain = both(compare, *views, Equirectangular())
    assert native.accepted
    assert plain.accepted
    assert np.array_equal(native.agrees, plain.agrees)
    assert native.heading == pytest.approx(plain.heading, abs=1e-4)
    sigma = np.sqrt(np.diag(plain.covariance))
    assert np.abs((native.covariance - plain.covariance) / np.outer(sigma, sigma)).max() < 0.02
