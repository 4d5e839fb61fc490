"""The compiled loops say what NumPy says, and without a compiler NumPy says it."""

from dataclasses import replace

import numpy as np
import pytest

from homeward.localizer.compiled import compiled
from homeward.localizer.home import gauss_newton
from homeward.localizer.home.gauss_newton import fit, solved
from homeward.localizer.home.linearisation import linearised
from homeward.localizer.home.problem import HomeProblem
from homeward.localizer.localizer import Localizer
from homeward.localizer.output.pose import in_home_frame

pytestmark = pytest.mark.skipif(compiled() is None, reason="no C compiler, nothing to compare")


def a_home(rng, q=6, prior=None):
    """Landmarks round a home, as known, with a home bearing each."""
    at = rng.uniform(0.0, 2.0 * np.pi, q)
    landmarks = rng.uniform(1.0, 3.0, q)[:, None] * np.stack([np.cos(at), np.sin(at)], axis=1)
    root = 0.05 * rng.normal(size=(4 + 2 * q, 4 + 2 * q))
    return HomeProblem(
        mean=np.concatenate([[0.5, 0.2, 0.3, 0.0], landmarks.ravel()]),
        covariance=root @ root.T,
        bearings=at + 0.02 * rng.normal(size=q),
        sigmas=rng.uniform(0.005, 0.03, q),
        mount=np.array([0.1, 0.0, 0.2]),
        same_camera=True,
        moved_prior=0.1,
        prior=prior,
        prior_information=None if prior is None else np.diag([4.0, 3.0, 2.0]),
    )


@pytest.mark.parametrize("prior", [None, np.array([0.1, -0.1, 0.2])])
def test_home_is_solved_for(both, prior):
    problem = a_home(np.random.default_rng(4), prior=prior)
    around = both(linearised, problem, np.array([0.1, 0.1, -0.2]), problem.mean)
    assert np.allclose(around[0].correlated, around[1].correlated)
    assert np.allclose(around[0].residual_covariance, around[1].residual_covariance)
    for inliers in (np.ones(6, bool), np.array([1, 0, 1, 1, 0, 1], bool)):
        native, plain = both(solved, around[0], inliers)
        for field in ("step", "precision", "information", "log_volume", "home", "joint_covariance"):
            assert np.allclose(getattr(native, field), getattr(plain, field)), field
        for field in ("innovation", "variance", "odds", "log_evidence"):
            ours, theirs = (getattr(v, field) for v in both(lambda f: replace(f).evidence, native))
            assert np.allclose(ours, theirs), field
        assert np.allclose(*both(lambda f: replace(f).inflation, native), rtol=1e-8)
        ours, theirs = both(in_home_frame, native)
        assert np.allclose(ours.pose, theirs.pose)
        assert np.allclose(ours.covariance, theirs.covariance)
        inside = native.precision[inliers][:, inliers]
        assert np.allclose(
            inside @ around[0].residual_covariance[inliers][:, inliers], np.eye(inliers.sum())
        )
        assert not native.precision[~inliers].any()


@pytest.mark.parametrize("steps", [1, 3, 20])
@pytest.mark.parametrize("prior", [None, np.array([0.1, -0.1, 0.2])])
def test_home_is_iterated_to(both, prior, steps):
    problem = a_home(np.random.default_rng(6), prior=prior)
    inliers = np.array([1, 1, 1, 0, 1, 1], bool)
    native, plain = both(fit, problem, np.array([0.4, -0.3, 0.3]), inliers, steps)
    for field in ("home", "step", "known", "information", "log_evidence", "joint_covariance"):
        assert np.allclose(getattr(native, field), getattr(plain, field)), field
    if steps == 20:
        assert problem.length(native.step) < gauss_newton.SETTLED
    assert both(fit, problem, np.zeros(3), np.zeros(6, bool))[0] is None or prior is not None


def test_bearings_without_spread_fix_no_home(both):
    problem = a_home(np.random.default_rng(5))
    around = linearised(problem, np.zeros(3), problem.mean)
    around.residual_covariance[:] = -1.0
    assert both(solved, around, np.ones(6, bool)) == (None, None)


def test_without_a_compiler_the_user_is_told(monkeypatch):
    monkeypatch.delitem(vars(compiled), "_loaded")
    monkeypatch.setenv("CC", "no-such-compiler")
    assert compiled() is None
    assert any("no-such-compiler" in note for note in Localizer({}).notes)
