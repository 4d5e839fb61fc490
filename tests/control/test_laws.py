"""Homing laws: the paper's on every number type; costs, proofs and drives home of the others."""

import math

import casadi as ca
import numpy as np
import pytest

from homeward.control.laws import (
    LAWS,
    average_landmark_vector,
    home_vector,
    homing,
    squared_angles,
    steer,
)
from homeward.errors import InputError
from homeward.geometry.frames import Polar, Pose, advance
from homeward.lab.simulation.course import Ending
from homeward.lab.simulation.simulate import load_scenario, simulate

TERMS = {
    average_landmark_vector: lambda d: 1 - np.cos(d),
    squared_angles: lambda d: d**2 / 2,
}
LANDMARKS = np.array([[1.4, 0.3], [-0.2, 1.7], [-1.5, -0.4], [0.6, -1.2], [2.5, 2.5]])
HOME = np.arctan2(LANDMARKS[:, 1], LANDMARKS[:, 0])


def directions(x):
    off = LANDMARKS - x
    return np.arctan2(off[:, 1], off[:, 0])


def cost(slope, x):
    d = np.angle(np.exp(1j * (HOME - directions(x))))
    return np.sum(np.hypot(*(LANDMARKS - x).T) * TERMS[slope](d))


@pytest.mark.parametrize("slope", TERMS)
def test_each_is_minus_the_gradient_of_its_cost(slope):
    for x in np.random.default_rng(0).normal(size=(50, 2)) * 2:
        step = 1e-6 * np.eye(2)
        numeric = [(cost(slope, x + e) - cost(slope, x - e)) / 2e-6 for e in step]
        np.testing.assert_allclose(slope(directions(x), HOME), np.negative(numeric), atol=1e-6)


@pytest.mark.parametrize("slope", TERMS)
def test_the_cost_grows_on_every_ray_from_home(slope):
    for x in np.random.default_rng(1).normal(size=(2000, 2)) * 5:
        assert slope(directions(x), HOME) @ x < 0


@pytest.mark.parametrize("slope", TERMS)
@pytest.mark.parametrize("most", [0.15, 3.0])
def test_steering_never_raises_the_cost_and_ends_at_home_however_tight_its_bounds(slope, most):
    for start in [(1.0, 0.2, 0.0), (-0.9, 0.9, 2.0), (0.3, -0.5, -1.6), (4.0, -3.0, 0.7)]:
        pose, before = Pose(*start), math.inf
        for _ in range(3600):
            seen = dict(enumerate(directions(np.array(pose[:2])).tolist()))
            way = home_vector(slope, seen, dict(enumerate(HOME.tolist())), 1.5)
            twist = steer(*way, pose.heading, 0.1, most)
            assert 0 <= twist.v <= 0.1
            assert abs(twist.omega) <= most
            now = cost(slope, np.array(pose[:2]))
            assert now <= before + 1e-9
            before, pose = now, advance(pose, twist, 0.05)
        assert math.hypot(pose.x, pose.y) < 0.02


@pytest.mark.parametrize("heading", [0.4, 1.5, -2.5, math.pi])
def test_the_path_to_a_point_is_nearly_straight_and_the_distance_never_grows(heading):
    pose, before = Pose(-4.0, 0.0, heading), 4.0
    for _ in range(1500):
        pose = advance(pose, steer(-pose.x, -pose.y, pose.heading, 0.5, 1.0, 2.0), 0.02)
        now = math.hypot(pose.x, pose.y)
        assert abs(pose.y) < 0.2
        assert now <= before
        before = now
    assert before < 0.01


def test_the_way_home_is_about_as_long_as_it_is_near_home():
    ring = np.linspace(0, 2 * math.pi, 12, endpoint=False)
    marks = 1.5 * np.stack([np.cos(ring), np.sin(ring)], axis=1)
    x = np.array([0.05, -0.08])
    seen = np.arctan2(*(marks - x).T[::-1])
    for slope in TERMS:
        way = home_vector(slope, dict(enumerate(seen)), dict(enumerate(ring)), 1.5)
        np.testing.assert_allclose(way, -x, atol=0.01)


def test_without_two_landmarks_of_home_there_is_no_way():
    assert home_vector(average_landmark_vector, {"a": 1.0, "c": 2.0}, {"b": 1.0}, 1.5) is None


def test_the_way_is_about_right_where_few_landmarks_are_in_sight_on_one_side():
    marks = 1.5 * np.array([[np.cos(a), np.sin(a)] for a in (0.0, 0.3, 0.7)])
    x = np.array([0.06, 0.03])
    seen = np.arctan2(*(marks - x).T[::-1])
    way = home_vector(squared_angles, dict(enumerate(seen)), {0: 0.0, 1: 0.3, 2: 0.7}, 1.5)
    assert math.hypot(*way) == pytest.approx(math.hypot(*x), rel=0.15)


def test_a_law_of_another_package_drives_home(tmp_path, monkeypatch):
    (tmp_path / "law_of_mine.py").write_text(
        "from homeward.control.laws import squared_angles as mine\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    changes = {"trajectory.law": "law_of_mine:mine", "moved.count": 0, "noise.bearing_sigma": 0.002}
    assert simulate(load_scenario("paper-homing", changes)).final_distance < 0.2


@pytest.mark.parametrize(
    ("law", "words"),
    [
        ("nonsense", "no law 'nonsense': use one of paper, lyapunov, alv, tron"),
        ("no_such:law", "there is no module no_such"),
        ("math:pi", "cannot be called"),
        ("numpy:add.reduce", "raised|no x and y"),
    ],
)
def test_what_is_no_law_is_one_clear_error(law, words):
    with pytest.raises(InputError, match=words):
        simulate(load_scenario("paper-homing", {"trajectory.law": law}))


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("seed", range(3))
def test_each_law_drives_home_where_bearings_are_right(law, seed):
    changes = {
        "seed": seed,
        "trajectory.law": law,
        "trajectory.max_turn_rate": 0.5,
        "moved.count": 0,
    }
    changes |= {"noise.bearing_sigma": 0.002, "noise.home_sigma": 0.002, "sensor.yaw": 0.4}
    simulation = simulate(load_scenario("paper-homing", changes))
    assert simulation.ending is Ending.DONE
    assert simulation.final_distance < 0.1
    assert np.abs(simulation.drive.odometry.omega).max() < 0.5 + 5 * 0.01


def test_with_a_camera_that_sees_nothing_it_searches_until_time_is_up():
    changes = {"trajectory.law": "alv", "visibility.probability": 0, "trajectory.duration": 5}
    assert simulate(load_scenario("paper-homing", changes)).ending is Ending.TIME_UP


@pytest.mark.parametrize(
    ("theta", "alpha", "omega"),
    [
        (0.0, math.pi, 0.0),  # looks at home already
        (0.5, 0.5 - math.pi, 0.0),
        (-0.872, 0.349, math.pi - 1.221),  # the paper's start
        (0.0, math.pi - 0.2, 0.2),  # home to the left: turn left
        (0.0, math.pi + 0.2, -0.2),
        (0.0, 0.0, math.pi),  # looks away
        (3.0, -3.0, math.pi - (-6.0 + 2 * math.pi)),  # the shorter way round
    ],
)
def test_turns_by_the_error_of_its_heading(theta, alpha, omega):
    twist = homing(Polar(1.0, theta, alpha), 0.125)
    assert twist.v == 0.125
    assert twist.omega == pytest.approx(omega, abs=1e-12)


def test_is_the_same_on_arrays_and_symbols():
    rng = np.random.default_rng(0)
    theta, alpha = rng.uniform(-4, 4, (2, 50))
    each = [homing(Polar(1.0, a, b), 0.3).omega for a, b in zip(theta, alpha, strict=True)]
    on_array = homing(Polar(1.0, theta, alpha), 0.3).omega
    np.testing.assert_array_equal(on_array, each)
    polar = Polar(*(ca.SX.sym(name) for name in ("R", "theta", "alpha")))
    function = ca.Function("law", list(polar), [homing(polar, 0.3).omega])
    on_symbols = [float(function(1.0, a, b)) for a, b in zip(theta, alpha, strict=True)]
    np.testing.assert_allclose(on_symbols, each, atol=1e-14)
