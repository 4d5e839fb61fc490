"""The compiled core gives the numbers of the reference, and refuses what would be read wrongly."""

import copy

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from homeward import core
from homeward.localizer import kernels
from homeward.localizer.motions import (
    CAMERA_YAW,
    DELAY,
    HEAD,
    NC,
    SPEED_SCALE,
    TIME_CONSTANT,
    TURN_SLIP,
    Motion,
)
from homeward.localizer.reference import extension, factors, frame, motion, window
from homeward.localizer.reference.extension import Unknown
from homeward.localizer.reference.factors import STEP, NormalEquations, SightedFrom
from homeward.localizer.reference.frame import GateInput
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


LONG = 48
"""Windows with more poses are eliminated in segments by the compiled core."""


def random_size(rng):
    """A number of poses, landmarks and frames: of a short window, or of a long one."""
    if rng.random() < 0.3:
        w = int(rng.integers(LONG - 2, 3 * LONG))
        return w, int(rng.integers(1, w // 4)), int(rng.integers(w // 2, 2 * w))
    return int(rng.integers(2, 12)), int(rng.integers(1, 9)), int(rng.integers(1, 20))


def random_window(rng, w, n, f):
    """Poses, shared unknowns, motions, and bearings from f frames in a window.

    In a long one, the robot drives past the landmarks, which are in view one after the other.
    """
    poses = np.cumsum(rng.normal(0.0, 0.3, (w, 3)), axis=0)
    shared = np.concatenate([rng.normal(0.0, 0.02, NC), rng.normal(0.0, 4.0, 2 * n)])
    steps = rng.normal(0.0, 0.1, (w - 1, STEP))
    for row in steps:
        root = rng.normal(size=(3, 3))
        row[factors.INFORMATION] = (root @ root.T + 10.0 * np.eye(3)).ravel()
    pose = np.sort(rng.integers(0, w, f))
    m = 3 * f
    frame = np.sort(rng.integers(0, f, m))
    jacobians = rng.normal(0.0, 0.5, (f, 3, NC))
    jacobians[rng.random(f) < 0.5, :, :CAMERA_YAW] = 0.0  # at the keyframe itself
    landmark = rng.integers(0, n, m)
    if w > LONG:
        landmark = (pose[frame] * n // w + landmark % 3) % n
    sigmas = rng.uniform(0.002, 0.02, m)
    seen = SightedFrom(
        rng.uniform(-3.0, 3.0, m),
        sigmas,
        sigmas * rng.uniform(1.0, 3.0, m),
        frame,
        landmark,
        pose,
        rng.normal(0.0, 0.2, (f, 3)),
        jacobians,
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
    size = [(1, 0, 0), (1, 5, 2), (7, 0, 0)][seed] if seed < 3 else random_size(rng)
    given, add_more = random_problem(rng, *size)
    more = add_more if seed % 2 else None
    both = kernels.linearised(given, more), window.linearised(given, more)
    for part in ("seen", "motions"):
        for found, expected in zip(*(getattr(one, part) for one in both), strict=True):
            assert found == pytest.approx(expected, rel=1e-9, abs=1e-12), part
    here, there = (one.equations for one in both)
    size = np.abs(there.common).max()
    for module, e in ((kernels, here), (factors, there)):
        module.add_sightings(e, both[1].seen)
    for name in ("own", "next", "shared", "common", "slope", "common_slope"):
        found, expected = getattr(here, name), getattr(there, name)
        assert found == pytest.approx(expected, rel=1e-9, abs=1e-12 * size), name
    of_both = kernels.solve_equations(there), window.eliminate(there).solve()
    for found, expected in zip(*of_both, strict=True):
        assert found == pytest.approx(expected, rel=1e-9, abs=1e-9 * np.abs(expected).max())
    for found, expected in zip(kernels.solve(given, more), window.solve(given, more), strict=True):
        scale = np.abs(expected).max()
        assert found == pytest.approx(expected, rel=1e-7, abs=1e-7 * scale)  # up to five steps


def random_frame(rng, case):
    """A frame whose bearings are near their prediction, and the state that predicts them."""
    n = {"none mapped": 0, "one": 1, "two": 2}.get(case, int(rng.integers(3, 25)))
    places = 4.0 * rng.normal(size=2 * n)
    mean = np.concatenate([rng.normal(size=3), rng.normal(0.0, 0.01, NC), places])
    root = rng.normal(size=(mean.size, mean.size)) / 100.0
    motion = Motion(
        rng.normal(0.0, 0.3, 3),
        np.diag(rng.uniform(1e-5, 0.01, 3)),
        rng.normal(0.0, 0.2, (3, NC)),
        calibration=rng.normal(0.0, 0.01, NC),
    )
    m = n + int(rng.integers(0, 4))
    landmark = np.concatenate([np.arange(n), np.full(m - n, -1)])
    rng.shuffle(landmark)
    exact = GateInput(
        mean=mean,
        covariance=root @ root.T,
        p_static=np.where(rng.random(n) < 0.1, 0.0, 1.0),
        scale=float(rng.uniform(1.0, 5.0)) if n else np.inf,
        motion=motion,
        is_keyframe=bool(rng.random() < 0.3),
        mount=rng.normal(0.0, 0.2, 3),
        offset=rng.normal(size=3) if rng.random() < 0.3 else None,
        bearings=np.zeros(m),
        sigmas=rng.uniform(0.002, 0.02, m),
        landmark=landmark,
        gate=4.0,
        stamps=(int(rng.integers(1, 5)), 6),
    )
    if case == "singular":  # all bearings are exact but for a common turn
        one, still = np.zeros_like(exact.covariance), np.zeros((3, 3))
        one[2, 2] = 0.01
        exact = exact._replace(covariance=one, sigmas=np.zeros(m), is_keyframe=True)
        exact = exact._replace(motion=Motion(motion.delta, still, motion.jacobian))
    if case == "on a landmark":
        near = frame.gate_frame(exact).eye[:2] + 1e-4 * rng.normal(size=2)
        exact = exact._replace(mean=np.concatenate([mean[:HEAD], near, places[2:]]))
    expected = frame.gate_frame(exact)
    drawn = 0.5 if case == "singular" else rng.uniform(0.1, 1.0) * rng.normal(size=n)
    bearings = np.zeros(m)
    bearings[landmark >= 0] = drawn * expected.deviation - expected.residual
    outliers = rng.random(m) < (0.4 if case == "many outliers" else 0.05)
    return exact._replace(bearings=bearings + outliers * rng.uniform(-1.0, 1.0, m))


CASES = ("none mapped", "one", "two", "any", "many outliers", "singular", "on a landmark")


@pytest.mark.parametrize("case", CASES)
def test_a_frame_is_gated_as_by_the_reference(case):
    rejected = tested = 0
    for seed in range(60):
        given = random_frame(np.random.default_rng(seed), case)
        here, there = kernels.gate_frame(given), frame.gate_frame(given)
        for name, found, expected in zip(there._fields, here, there, strict=True):
            scale = np.abs(expected).max(initial=0.0)
            assert found == pytest.approx(expected, rel=1e-9, abs=1e-9 * scale), (seed, name)
        assert here.accepted.tolist() == there.accepted.tolist()
        rejected += np.count_nonzero(~there.accepted)
        tested += there.square > 0.0
    assert (rejected > 0) == (case != "none mapped")
    assert (tested > 0) == (case not in ("none mapped", "one", "singular"))


def test_a_state_is_propagated_as_by_the_reference():
    given = random_frame(np.random.default_rng(0), "any")
    state = given.mean, given.covariance, given.motion
    for found, expected in zip(kernels.propagate(*state), frame.propagate(*state), strict=True):
        assert found == pytest.approx(expected, rel=1e-9, abs=1e-12)


def unknown(rng, given, j, blocks, in_motions):
    """Unknowns that change some bearings and, if so, some motions."""
    m, w = len(given.seen.bearings), len(given.poses)
    by_bearing = rng.normal(size=(m, j)) * (rng.random((m, j)) < 0.7)
    by_motion = rng.normal(size=(w - 1, 3, j * blocks)) if in_motions else None
    if by_motion is not None:
        by_motion[::2] = 0.0
    prior = rng.uniform(0.0, 3.0, j * blocks)
    return Unknown(by_bearing, rng.integers(-1, blocks, m), prior, by_motion)


@pytest.mark.parametrize("seed", range(20))
def test_a_window_is_extended_as_by_the_reference(seed):
    rng = np.random.default_rng(seed)
    given, _ = random_problem(rng, *(random_size(rng) if seed else (1, 4, 9)))
    more = unknown(rng, given, *rng.integers(1, 5, 2).tolist(), seed % 2)
    for module in (kernels, extension):
        assert module.extend(window.linearised(given), more).absorbed == ()
    here, there = (m.extend(window.linearised(given), more, True) for m in (kernels, extension))
    for found, expected in zip((*here[:3], *here[3]), (*there[:3], *there[3]), strict=True):
        scale = np.abs(expected).max(initial=0.0)
        assert found == pytest.approx(expected, rel=1e-9, abs=1e-9 * scale)


@pytest.mark.parametrize("module", [kernels, extension])
def test_an_extension_is_the_window_with_more_unknowns(module):
    """Information, slope and steps by the full matrices of all unknowns together."""
    rng = np.random.default_rng(4)
    given, _ = random_problem(rng, 4, 3, 9)
    at, more = window.linearised(given), unknown(rng, given, 2, 2, True)
    e, seen, motions = at
    w, a, m, k = 4, len(given.shared), len(seen.pose), more.prior.size
    old, new = np.zeros((m, 3 * w + a)), np.zeros((m, k))
    for i, (pose, landmark, block) in enumerate(
        zip(seen.pose, seen.landmark, more.block, strict=True)
    ):
        old[i, 3 * pose : 3 * pose + 3] = seen.jacobian[i, :3]
        old[i, 3 * w : 3 * w + NC] = seen.jacobian[i, 3:HEAD]
        old[i, 3 * w + NC + 2 * landmark :][:2] = seen.jacobian[i, HEAD:]
        if block >= 0:
            new[i, 2 * block : 2 * block + 2] = more.by_bearing[i]
    moved = np.zeros((w - 1, 3, 3 * w + a))
    for i in range(w - 1):
        moved[i, :, 3 * i : 3 * i + 6] = motions.jacobian[i, :, :6]
        moved[i, :, 3 * w : 3 * w + NC] = motions.jacobian[i, :, 6:]
    weights = motions.weight[:, None, None] * motions.information
    coupled = old.T @ new + np.einsum("iab,iac,icd->bd", moved, weights, more.by_motion)
    own = new.T @ new + np.einsum("iab,iac,icd->bd", more.by_motion, weights, more.by_motion)
    slope = new.T @ seen.residual + np.einsum(
        "iab,iac,ic->b", more.by_motion, weights, motions.error
    )
    hessian = np.zeros((3 * w + a, 3 * w + a))
    for i in range(w):
        hessian[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] = e.own[i]
        hessian[3 * i : 3 * i + 3, 3 * w :] = e.shared[i]
        if i < w - 1:
            hessian[3 * i : 3 * i + 3, 3 * i + 3 : 3 * i + 6] = e.next[i]
    hessian[3 * w :, 3 * w :] = e.common
    hessian = np.triu(hessian) + np.triu(hessian, 1).T
    steps = np.linalg.solve(hessian, coupled)
    found = module.extend(at, more, True)
    gradient = np.concatenate([e.slope.ravel(), e.common_slope])
    expected = (
        np.diag(more.prior) + own - coupled.T @ steps,
        slope - steps.T @ gradient,
        steps[3 * w :],
        old @ steps,
        moved @ steps,
    )
    for one, other in zip((*found[:3], *found[3]), expected, strict=True):
        assert one == pytest.approx(other, rel=1e-8, abs=1e-8 * np.abs(other).max())


def test_an_unknown_of_another_window_is_refused():
    given, _ = random_problem(np.random.default_rng(0), 3, 2, 4)
    at, more = window.linearised(given), unknown(np.random.default_rng(1), given, 2, 2, True)
    with pytest.raises(IndexError, match="a sighting of another window"):
        kernels.extend(at, more._replace(block=more.block + 2))
    with pytest.raises(IndexError, match="a sighting of another window"):
        kernels.extend(at._replace(seen=at.seen._replace(pose=at.seen.pose + 3)), more)
    with pytest.raises(ValueError, match="by_motion has another shape"):
        kernels.extend(at, more._replace(by_motion=more.by_motion[:, :, :1].copy()))
    no_number = window.linearised(given).equations
    no_number.own[0] = np.nan
    for module in (kernels, extension):
        for singular in (NormalEquations.zeros(3, len(given.shared)), no_number):
            with pytest.raises(np.linalg.LinAlgError):
                module.extend(at._replace(equations=singular), more)


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
    another = random_frame(np.random.default_rng(0), "any")._replace(landmark=np.array([99]))
    with pytest.raises(ValueError, match="landmark has another shape"):
        kernels.gate_frame(another)
    one = another._replace(bearings=np.zeros(1), sigmas=np.ones(1))
    with pytest.raises(IndexError, match="a landmark of another map"):
        kernels.gate_frame(one)
