"""The compiled core gives the numbers of the reference, and refuses what would be read wrongly."""

import copy

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from homeward import core
from homeward.localizer import kernels
from homeward.localizer.motions import DELAY, NC, SPEED_SCALE, TIME_CONSTANT, TURN_SLIP
from homeward.localizer.reference import factors, motion, window
from homeward.localizer.reference.factors import STEP, NormalEquations, SightedFrom
from homeward.localizer.reference.window import Window
from homeward.odometry.history import TwistHistory

pytestmark = pytest.mark.skipif(core.compiled is None, reason=f"NumPy only: {core.missing}")

RATES = np.array([[1e-6, 4e-4, 1e-5], [1e-6, 1e-4, 1e-5], [1e-7, 1e-4, 4e-4]])
SPEEDS = st.sampled_from([0.0, 0.0, 0.3, -0.2, 1.0, np.nan])
TURNS = st.sampled_from([0.0, 0.0, 0.4, -0.7, 3.0])
STEPS = st.sampled_from([0.0, 1e-6, 0.02, 0.1, 0.9, 3.0])


@settings(max_examples=300, deadline=None)
@given(
    st.lists(st.tuples(STEPS, SPEEDS, TURNS, SPEEDS), max_size=14),
    st.floats(-0.5, 3.0),
    st.floats(0.0, 4.0),
    st.tuples(st.sampled_from([0.0, 0.05, -0.1, 1.2]), st.sampled_from([0.0, 0.07, 0.5])),
)
def test_preintegration_is_that_of_the_reference(twists, begin, duration, lags):
    history, t, calibration = TwistHistory(), 0.0, np.full(NC, 0.01)
    calibration[[DELAY, TIME_CONSTANT]] = lags
    calibration[[TURN_SLIP, SPEED_SCALE]] = 0.03, -0.02
    for step, v, omega, vy in twists:
        t += step
        history.add(t, v, omega, vy=vy)
    inputs = history.table, begin, begin + duration, calibration, RATES, (0.5, 0.7), 0.2
    here, bends, moving = kernels.preintegrate(*inputs)
    there, expected_bends, expected_moving = motion.preintegrate(*inputs)
    for name in ("delta", "covariance", "jacobian", "path", "turned"):
        found, expected = getattr(here, name), getattr(there, name)
        assert found == pytest.approx(expected, rel=1e-9, abs=1e-12), name
    assert bends == pytest.approx(expected_bends)
    assert moving == pytest.approx(expected_moving)


def random_window(rng, w, n, f):
    """Poses, shared unknowns, motions, and bearings from f frames in a window."""
    poses = np.cumsum(rng.normal(0.0, 0.3, (w, 3)), axis=0)
    shared = np.concatenate([rng.normal(0.0, 0.02, NC), rng.normal(0.0, 4.0, 2 * n)])
    steps = rng.normal(0.0, 0.1, (w - 1, STEP))
    for row in steps:
        root = rng.normal(size=(3, 3))
        row[factors.INFORMATION] = (root @ root.T + 10.0 * np.eye(3)).ravel()
    pose = np.sort(rng.integers(0, w, f))
    m = 3 * f
    frame = np.sort(rng.integers(0, f, m))
    sigmas = rng.uniform(0.002, 0.02, m)
    seen = SightedFrom(
        rng.uniform(-3.0, 3.0, m),
        sigmas,
        sigmas * rng.uniform(1.0, 3.0, m),
        frame,
        rng.integers(0, n, m),
        pose,
        rng.normal(0.0, 0.2, (f, 3)),
        rng.normal(0.0, 0.5, (f, 3, NC)),
    )
    return poses, shared, steps, seen


def random_problem(rng, w, n, f):
    """A window whose solution is well determined, and a factor that is added from outside."""
    poses, shared, steps, seen = random_window(rng, w, n, f)
    size = 3 + len(shared)
    root = rng.normal(size=(size, size))
    bounds = rng.random(NC) < 0.5, rng.random(NC) < 0.3
    prior = root @ root.T + 50.0 * np.eye(size), rng.normal(size=size), rng.normal(size=size)
    known = rng.uniform(1.0, 100.0, NC), rng.normal(0.0, 0.01, NC)
    given = Window(poses, shared, steps, seen, *prior, *known, *bounds)

    def add_more(e, poses, shared):
        e.common[0, 0] += 30.0
        e.common_slope[0] += 30.0 * (0.01 - shared[0])
        e.own[-1] += np.eye(3)
        e.slope[-1] -= poses[-1]

    return given, add_more


@pytest.mark.parametrize("seed", range(20))
def test_the_window_is_built_and_solved_as_by_the_reference(seed):
    rng = np.random.default_rng(seed)
    w, n = int(rng.integers(1, 12)) if seed else 1, int(rng.integers(0, 9))
    given, add_more = random_problem(rng, w, n, int(rng.integers(1, 20)) if n else 0)
    more = add_more if seed % 2 else None
    here, there = kernels.equations(given, more), window.equations(given, more)
    size = np.abs(there.common).max()
    weighed = factors.weighed(given.seen, given.poses, given.shared)
    for module, e in ((kernels, here), (factors, there)):
        module.add_sightings(e, weighed)
    for name in ("own", "next", "shared", "common", "slope", "common_slope"):
        found, expected = getattr(here, name), getattr(there, name)
        assert found == pytest.approx(expected, rel=1e-9, abs=1e-12 * size), name
    of_both = kernels.solve_equations(there), window.eliminate(there).solve()
    for found, expected in zip(*of_both, strict=True):
        assert found == pytest.approx(expected, rel=1e-9, abs=1e-9 * np.abs(expected).max())
    for found, expected in zip(kernels.solve(given, more), window.solve(given, more), strict=True):
        scale = np.abs(expected).max()
        assert found == pytest.approx(expected, rel=1e-7, abs=1e-7 * scale)  # up to five steps


def test_a_window_that_is_given_does_not_change():
    given, add_more = random_problem(np.random.default_rng(3), 6, 4, 9)
    before = copy.deepcopy(given)
    kernels.solve(given, add_more)
    for found, expected in zip(given, before, strict=True):
        np.testing.assert_equal(found, expected)


def test_a_singular_window_is_the_error_of_the_reference():
    e = NormalEquations.zeros(3, NC)
    for solve in (kernels.solve_equations, lambda e: window.eliminate(e).solve()):
        with pytest.raises(np.linalg.LinAlgError):
            solve(e)
    given, _ = random_problem(np.random.default_rng(0), 3, 2, 4)
    nothing = given._replace(
        information=np.zeros_like(given.information),
        steps=np.zeros_like(given.steps),
    )
    for solve in (kernels.solve, window.solve):
        with pytest.raises(np.linalg.LinAlgError):
            solve(nothing)


def test_arrays_of_another_layout_or_shape_are_refused():
    given, _ = random_problem(np.random.default_rng(0), 2, 2, 3)
    tunables = kernels._window_tunables(core.compiled.WindowTunables)
    poses, shared, steps, seen, *rest = given
    core.compiled.Window(poses, shared, steps, *seen, *rest, tunables)
    with pytest.raises(TypeError):
        core.compiled.Window(poses.T.copy().T, shared, steps, *seen, *rest, tunables)
    with pytest.raises(ValueError, match="steps has another shape"):
        core.compiled.Window(poses[:1], shared, steps, *seen, *rest, tunables)
    wrong = given._replace(seen=seen._replace(landmark=seen.landmark + 7))
    with pytest.raises(IndexError, match="a sighting of another window"):
        kernels.solve(wrong)
    wrong = given._replace(seen=seen._replace(pose=seen.pose + 7))
    with pytest.raises(IndexError, match="a frame of another window"):
        kernels.solve(wrong)
