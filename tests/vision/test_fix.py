"""Fused fixes of successive pictures are consistent for any correlation."""

import numpy as np
import pytest

from homeward.geometry.frames import Pose
from homeward.vision.homing.fix import Fix, fused


def fix(pose, sigmas, sure=True, t=0.0):
    return Fix(t, Pose(*pose), np.diag(sigmas) ** 2, sure, sure, False, "")


def test_the_same_fix_twice_has_the_same_covariance():
    once = fix((0.3, 0.1, 3.0), (0.02, 0.03, 0.01))
    again = fused(once, once)
    np.testing.assert_allclose(again.covariance, once.covariance)
    np.testing.assert_allclose(again.pose, once.pose)


def test_the_more_accurate_counts_with_the_newer_stamp():
    sure, unsure = fix((0.3, 0.1, 1.0), (0.01, 0.01, 0.01)), fix((0.34, 0.1, 1.0), 3 * [0.1], t=0.4)
    for one, other in ((sure, unsure), (unsure, sure)):
        both = fused(one, other)
        np.testing.assert_allclose(both.pose, sure.pose, atol=1e-9)
        assert both.t == other.t


def test_accuracy_along_and_across_is_combined():
    along, across = fix((0.0, 0.0, 0.0), (0.01, 0.2, 0.01)), fix((0.1, 0.1, 0.0), (0.2, 0.01, 0.01))
    x, y, _ = np.sqrt(np.diag(fused(along, across).covariance))
    assert max(x, y) < 0.02
    assert fused(along, across).pose[:2] == pytest.approx((0.0, 0.1), abs=0.01)


def test_headings_are_joined_across_the_seam():
    either = fused(fix((0, 0, 3.13), (1, 1, 0.1)), fix((0, 0, -3.13), (0.9, 0.9, 0.1)))
    assert abs(either.pose.heading) > 3.1


@pytest.mark.parametrize("consistent", [0.0, 0.5, 0.95])
def test_fused_fixes_are_consistent_for_any_correlation(consistent):
    """Of each, the error is partly that of the one before."""
    rng, squared = np.random.default_rng(8), []
    for _ in range(400):
        common, own, other = rng.standard_normal((3, 3))
        sigmas = rng.uniform(0.01, 0.1, (2, 3))
        errors = [np.sqrt(consistent) * common + np.sqrt(1 - consistent) * e for e in (own, other)]
        both = fused(*(fix(e * s, s) for e, s in zip(errors, sigmas, strict=True)))
        squared.append(both.pose @ np.linalg.solve(both.covariance, both.pose))
    assert np.mean(squared) < 3.4  # 3, and three times what chance makes of 400


def test_what_contradicts_or_is_not_sure_is_not_joined():
    first = fix((0.0, 0.0, 0.0), (0.01, 0.01, 0.01))
    far = fix((0.5, 0.0, 0.0), (0.02, 0.02, 0.02))
    unsure = fix((0.01, 0.0, 0.0), (0.02, 0.02, 0.02), sure=False)
    for new in (far, unsure):
        assert fused(first, new) is new
        assert fused(None, new) is new
    assert fused(unsure, first) is first
