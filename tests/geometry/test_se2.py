"""The Jacobians used for linearisation are those of `homeward.geometry.frames` by CasADi."""

import casadi as ca
import numpy as np
import pytest

from homeward.geometry import frames
from homeward.geometry.frames import Pose
from homeward.geometry.se2 import between, compose, lever, rotation, sight

A, B = ca.SX.sym("a", 3), ca.SX.sym("b", 3)
POSES = np.array([[0.4, -1.2, 2.9], [3.0, 0.5, -0.7], [0.0, 0.0, 0.0]])
OTHERS = np.array([[1.1, 0.3, -2.5], [-0.2, 4.0, 1.0], [1.0, 2.0, 0.5]])
PAIRS = list(zip(POSES, OTHERS, strict=True))


def _derivatives(expression: ca.SX) -> ca.Function:
    return ca.Function(
        "f", [A, B], [expression, ca.jacobian(expression, A), ca.jacobian(expression, B)]
    )


def _symbolic(function: object) -> ca.Function:
    pose = function(Pose(*ca.vertsplit(A)), Pose(*ca.vertsplit(B)))
    return _derivatives(ca.vertcat(*pose))


def _same_pose(pose: np.ndarray, other: np.ndarray) -> None:
    off = pose - other
    off[2] = frames.wrap(off[2])
    assert off == pytest.approx(np.zeros(3), abs=1e-12)


@pytest.mark.parametrize(("a", "b"), PAIRS)
def test_composition_and_its_jacobians_are_those_of_frames(a: np.ndarray, b: np.ndarray) -> None:
    value, by_a, by_b = (np.array(x) for x in _symbolic(frames.compose)(a, b))
    _same_pose(compose(a, b), value[:, 0])
    assert lever(compose(a, b) - a) == pytest.approx(by_a, abs=1e-12)
    assert rotation(a[2]) == pytest.approx(by_b, abs=1e-12)


@pytest.mark.parametrize(("a", "b"), PAIRS)
def test_relative_pose_and_its_jacobians_are_those_of_frames(a: np.ndarray, b: np.ndarray) -> None:
    value, by_a, by_b = (np.array(x) for x in _symbolic(frames.between)(a, b))
    _same_pose(between(a, b), value[:, 0])
    turned = rotation(a[2]).T
    assert turned == pytest.approx(by_b, abs=1e-12)
    assert -turned @ lever(b - a) == pytest.approx(by_a, abs=1e-12)


@pytest.mark.parametrize(("eye", "other"), PAIRS)
def test_bearing_and_its_derivatives_are_those_of_frames(
    eye: np.ndarray, other: np.ndarray
) -> None:
    bearing = frames.bearing(Pose(*ca.vertsplit(A)), B[0], B[1])
    value, by_eye, by_place = (np.array(x) for x in _derivatives(bearing)(eye, other))
    seen = sight(eye, other[:2])
    assert frames.wrap(float(seen.bearing) - value.item()) == pytest.approx(0.0, abs=1e-12)
    assert seen.by_place == pytest.approx(by_place[0, :2], abs=1e-12)
    assert [*-seen.by_place, -1.0] == pytest.approx(by_eye[0], abs=1e-12)


def test_many_poses_at_once_are_as_one_by_one() -> None:
    for function in (compose, between):
        each = [function(a, b) for a, b in zip(POSES, OTHERS, strict=True)]
        assert np.array_equal(function(POSES, OTHERS), each)
    assert np.array_equal(rotation(POSES[:, 2]), [rotation(p[2]) for p in POSES])
    assert np.array_equal(lever(OTHERS), [lever(o) for o in OTHERS])


def test_a_camera_that_stands_on_what_it_sees_has_finite_derivatives() -> None:
    assert np.isfinite(sight(np.zeros(3), np.zeros(2)).by_place).all()
