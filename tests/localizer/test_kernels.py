"""The compiled core gives the numbers of the reference, and refuses what would be read wrongly."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from homeward import core
from homeward.localizer import kernels
from homeward.localizer.motions import DELAY, NC, SPEED_SCALE, TIME_CONSTANT, TURN_SLIP
from homeward.localizer.reference import motion, window
from homeward.localizer.reference.window import STEP, NormalEquations, SightedFrom
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
        row[window.INFORMATION] = (root @ root.T + 10.0 * np.eye(3)).ravel()
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


def built(module, poses, shared, steps, seen):
    """Normal equations as one of the two builds them, with a prior that makes them definite."""
    e = NormalEquations.zeros(len(poses), shared.size)
    e.own[0] += np.eye(3)
    e.common[:] += np.eye(shared.size)
    module.add_odometry(e, poses, shared[:NC], steps)
    module.add_bearings(e, seen, poses, shared)
    module.add_sightings(e, window.weighed(seen, poses, shared))
    return e


@pytest.mark.parametrize("seed", range(20))
def test_the_window_is_built_and_solved_as_by_the_reference(seed):
    rng = np.random.default_rng(seed)
    w, n = int(rng.integers(1, 12)), int(rng.integers(1, 9))
    inputs = random_window(rng, w, n, int(rng.integers(1, 20)))
    here, there = built(kernels, *inputs), built(window, *inputs)
    size = np.abs(there.common).max()
    for name in ("own", "next", "shared", "common", "slope", "common_slope"):
        found, expected = getattr(here, name), getattr(there, name)
        assert found == pytest.approx(expected, rel=1e-9, abs=1e-12 * size), name
    for found, expected in zip(kernels.solve(there), window.eliminate(there).solve(), strict=True):
        assert found == pytest.approx(expected, rel=1e-9, abs=1e-9 * np.abs(expected).max())


def test_a_singular_window_is_the_error_of_the_reference():
    e = NormalEquations.zeros(3, NC)
    for solve in (kernels.solve, lambda e: window.eliminate(e).solve()):
        with pytest.raises(np.linalg.LinAlgError):
            solve(e)


def test_arrays_of_another_layout_or_shape_are_refused():
    e = NormalEquations.zeros(2, NC)
    arrays = e.own, e.next, e.shared, e.common, e.slope, e.common_slope
    core.compiled.add_odometry(np.zeros((2, 3)), np.zeros(NC), np.zeros((1, STEP)), *arrays)
    with pytest.raises(TypeError):
        core.compiled.add_odometry(np.zeros((3, 2)).T, np.zeros(NC), np.zeros((1, STEP)), *arrays)
    with pytest.raises(ValueError, match="poses has another shape"):
        core.compiled.add_odometry(np.zeros((3, 3)), np.zeros(NC), np.zeros((1, STEP)), *arrays)
    seen = random_window(np.random.default_rng(0), 2, 2, 3)[3]
    wrong = seen._replace(landmark=seen.landmark + 7)
    e = NormalEquations.zeros(2, NC + 4)
    with pytest.raises(IndexError, match="a sighting of another window"):
        kernels.add_bearings(e, wrong, np.zeros((2, 3)), np.zeros(NC + 4))
