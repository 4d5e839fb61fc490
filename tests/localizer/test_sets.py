"""The compiled core fits and weighs sets of home bearings as the reference does."""

import math
from dataclasses import replace

import numpy as np
import pytest
from rig import Rig, ring

from homeward import core
from homeward.localizer import kernels
from homeward.localizer.home.problem import HomeProblem
from homeward.localizer.map.bodies import Bodies
from homeward.localizer.reference import labels, sets

pytestmark = pytest.mark.skipif(core.compiled is None, reason=f"NumPy only: {core.missing}")

NAMES = ("at", "by_place", "by_yaw", "cross_covariance", "columns")


def random_home(rng, q):
    """Landmarks round a home, of which some are on bodies, seen by one or two cameras."""
    way = rng.uniform(-math.pi, math.pi, q)
    places = rng.uniform(0.5, 6.0, q)[:, None] * np.stack([np.cos(way), np.sin(way)], axis=1)
    root = rng.choice([1e-3, 0.05, 1.0]) * rng.normal(size=(4 + 2 * q, 4 + 2 * q))
    walks = rng.normal(size=(q, 2, 2))
    body = rng.integers(0, max(q, 2) // 2, q)
    members = body == np.arange(max(q, 2) // 2)[:, None]
    members = members[members.sum(axis=1) > 1]
    known, several = rng.random() < 0.4, rng.random() < 0.5
    return HomeProblem(
        mean=np.concatenate([rng.normal(0.0, 0.3, 4), places.ravel()]),
        covariance=root @ root.T,
        bearings=way + rng.choice([0.02, 0.4]) * rng.normal(size=q),
        sigmas=rng.uniform(0.002, 0.05, q),
        mount=rng.normal(0.0, 0.2, 3),
        same_camera=bool(rng.random() < 0.5),
        moved_prior=rng.choice([0.02, 0.1, 0.4]),
        offsets=rng.normal(0.0, 0.1, (q, 3)) if several else None,
        prior=rng.normal(0.0, 0.2, 3) if known else None,
        prior_information=np.diag([400.0, 300.0, 200.0]) if known else None,
        walk_excess=1e-3 * walks @ walks.transpose(0, 2, 1),
        bodies=Bodies(members, rng.uniform(0.05, 0.95, len(members))),
    )


def assert_same(found, expected, names):
    """Assert that tuples of arrays are the same, by their largest entry."""
    for name, here, there in zip(names, found, expected, strict=True):
        size = np.abs(there).max(initial=1e-9)
        assert here == pytest.approx(there, rel=1e-9, abs=1e-9 * size), name


def compare(given, home, inliers):
    """Compare all functions on one set; return whether it determines home."""
    for steps in (1, 6):
        both = [fit(given, home, inliers, steps) for fit in (kernels.fit_home, sets.fit)]
        assert (both[0] is None) == (both[1] is None)
        if both[1] is None:
            return False
        if steps == 1:
            (linear, found), (expected, solution) = both
            assert_same(linear, expected, NAMES)
            assert_same(found, solution, solution._fields)
    moved = given.mean + 1e-3 * np.sin(np.arange(given.mean.size))
    after = given._replace(mean=moved, covariance=1.01 * given.covariance)
    before = expected, given.mean, inliers
    both = [f(after, *before) for f in (kernels.propagate_home, sets.propagated)]
    (linear, found), (propagated, solution) = both
    assert_same(linear, propagated, NAMES)
    assert_same(found, solution, solution._fields)
    assert_same(kernels.solve_set(after, propagated, inliers), solution, solution._fields)
    both = [f(after, propagated, inliers, solution) for f in (kernels.weigh_set, sets.weighed)]
    # Where the others hardly predict a bearing, its variance is a reciprocal of rounding.
    shares = [solution.alone[:, 4] / e.variance for e in both]
    here, there = (
        [share, e.innovation * share, *e[2:]] for share, e in zip(shares, both, strict=True)
    )
    for name, now, before in zip(sets.Evidence._fields, here, there, strict=True):
        assert now == pytest.approx(before, rel=1e-9, abs=1e-9), name
    return True


@pytest.mark.parametrize("seed", range(60))
def test_random_sets_are_fitted_and_weighed_as_by_the_reference(seed):
    rng = np.random.default_rng(seed)
    given = random_home(rng, int(rng.integers(1, 15))).arrays
    q = given.bearings.size
    for inliers in (np.ones(q, bool), np.zeros(q, bool), rng.random(q) < 0.7):
        compare(given, rng.normal(0.0, 0.3, 3), inliers)


def test_a_set_that_determines_no_home_is_none_of_both():
    given = random_home(np.random.default_rng(1), 5)
    for few in ([], [0], [0, 1]):
        alone = replace(given, prior=None, prior_information=None).arrays
        inliers = np.isin(np.arange(5), few)
        for broken in (alone._replace(information=np.zeros((3, 3))), alone):
            compare(broken, np.zeros(3), inliers)
    nothing = alone._replace(covariance=np.full_like(alone.covariance, math.nan))
    assert not compare(nothing, np.zeros(3), np.ones(5, bool))


def test_the_sets_of_a_drive_are_fitted_and_weighed_as_by_the_reference():
    rig = Rig(ring(9), seed=2, faults={"L2": 0.3})
    compared = 0
    for _ in range(12):
        rig.drive(5)
        hypotheses = rig.localizer.chart.home.hypotheses
        for f in hypotheses.fits if hypotheses is not None else ():
            compared += compare(f.problem.arrays, f.home, f.inliers)
    assert compared > 20


@pytest.mark.parametrize("seed", range(10))
def test_the_prior_of_labels_is_that_of_the_reference(seed):
    rng = np.random.default_rng(seed)
    k, f = int(rng.integers(1, 12)), int(rng.integers(1, 30))
    members = np.zeros((2 if k > 4 else 0, k), bool)
    members[:1, :2] = members[1:, 2:5] = True
    b = len(members)
    wrong = rng.uniform(0.01, 0.6, k) if seed % 2 else 0.1
    right = rng.random((f, k)) < rng.choice([0.0, 0.5, 0.9, 1.0])
    given = members, rng.uniform(0.05, 0.95, b), right, wrong, rng.normal(0.0, 3.0, b)
    assert kernels.log_labels(*given) == pytest.approx(labels.log_labels(*given), rel=1e-12)


def test_arrays_of_another_layout_or_shape_are_refused():
    given = random_home(np.random.default_rng(0), 4).arrays
    tunables = kernels._set_tunables(core.compiled.SetTunables)
    home = core.compiled.Home(*given, tunables)
    with pytest.raises(ValueError, match="sigmas has another shape"):
        core.compiled.Home(*given._replace(sigmas=given.sigmas[1:].copy()), tunables)
    with pytest.raises(TypeError):
        core.compiled.Home(*given._replace(sigmas=given.sigmas[::-1]), tunables)
    with pytest.raises(ValueError, match="inliers has another shape"):
        home.fit(np.zeros(3), np.ones(5, bool), 1)
