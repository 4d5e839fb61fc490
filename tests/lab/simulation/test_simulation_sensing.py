"""What odometry and the camera make of the truth."""

import math

import numpy as np
import pytest

from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose, Twist, bearing, compose
from homeward.lab.simulation.course import Camera, Wheels
from homeward.lab.simulation.simulate import load_scenario
from homeward.lab.simulation.world import build_world

N = 4000
HERE = Pose(0.3, -0.2, 0.4)


def camera_of(scenario):
    world = build_world(scenario)
    return Camera(scenario, world), world


def looks(changes, times=N):
    camera, world = camera_of(load_scenario("paper-homing", changes))
    return [camera.look(HERE) for _ in range(times)], world


def test_exact_bearings_are_those_of_the_camera_where_it_sits():
    mount = {"sensor.x": 0.3, "sensor.y": -0.1, "sensor.yaw": 0.7}
    changes = {"noise.bearing_sigma": 0, "visibility.probability": 1, "home.heading": 1.1}
    seen, world = looks(mount | changes | {"home.x": 4.0}, times=1)
    x, y = world.in_home_frame.T
    expected = bearing(compose(HERE, Pose(0.3, -0.1, 0.7)), x, y)
    assert seen[0] == pytest.approx(dict(zip(world.ids, expected.tolist(), strict=True)), abs=6e-6)
    centre = bearing(HERE, x, y) - 0.7
    assert np.abs(wrap(expected - centre)).max() > 0.05  # so that the offset matters


def test_bearing_noise_is_as_large_as_it_says():
    seen, world = looks({"visibility.probability": 1})
    x, y = world.in_home_frame.T
    true = bearing(HERE, x, y)
    errors = wrap(np.array([list(s.values()) for s in seen]) - true)
    assert errors.shape == (N, 7)
    assert abs(errors.mean()) < 4 * 0.05 / math.sqrt(errors.size)
    assert abs(errors.std() / 0.05 - 1) < 4 / math.sqrt(2 * errors.size)
    # Landmarks and looks are independent of each other.
    between = np.corrcoef(errors.T)[np.triu_indices(7, 1)]
    along = np.mean(errors[1:] * errors[:-1]) / 0.05**2
    assert np.abs(between).max() < 5 / math.sqrt(N)
    assert abs(along) < 4 / math.sqrt(errors.size)


def test_each_sighting_has_its_probability():
    seen, world = looks({"visibility.probability": 0.7})
    for landmark in world.ids:
        share = np.mean([landmark in s for s in seen])
        assert abs(share - 0.7) < 4.5 * math.sqrt(0.7 * 0.3 / N)


def test_at_least_so_many_are_seen_if_in_view():
    seen, world = looks({"visibility.probability": 0.1, "visibility.at_least": 3})
    counts = np.array([len(s) for s in seen])
    assert counts.min() == 3
    assert counts.max() > 3
    # The three are a fair draw: by symmetry each landmark is seen mean(count) / 7 of the time.
    share = np.array([np.mean([i in s for s in seen]) for i in world.ids])
    mean = counts.mean() / 7
    assert np.abs(share - mean).max() < 4.5 * math.sqrt(mean * (1 - mean) / N)


def test_at_least_cannot_exceed_what_is_in_view():
    narrow = {"visibility.field_of_view": 1.8, "visibility.at_least": 5, "moved.count": 0}
    seen, world = looks(narrow | {"visibility.probability": 0.0}, times=50)
    x, y = world.in_home_frame.T
    in_view = np.abs(bearing(HERE, x, y)) <= 0.9
    assert 1 <= in_view.sum() < 5
    for s in seen:
        assert set(s) == {i for i, v in zip(world.ids, in_view, strict=True) if v}


def test_zero_probability_sees_nothing():
    assert looks({"visibility.probability": 0.0}, times=20)[0] == [{}] * 20


def test_wrong_ids_are_as_many_as_asked_and_are_of_others():
    changes = {"visibility.probability": 1, "noise.bearing_sigma": 0, "noise.wrong_ids": 0.2}
    seen, world = looks(changes, times=2000)
    x, y = world.in_home_frame.T
    true = bearing(HERE, x, y)
    shown = {i: [] for i in world.ids}
    for s in seen:
        for landmark, value in s.items():
            owner = world.ids[int(np.abs(wrap(true - value)).argmin())]
            shown[landmark].append(owner)
    # Of equal ids the last counts, so a right sighting can be covered by a later wrong one, or
    # cover it: compare with the same draw made independently.
    rng, wrong, total = np.random.default_rng(0), 0, 0
    for _ in range(20000):
        ids = np.arange(7)
        swap = rng.random(7) < 0.2
        ids = np.where(swap, (ids + rng.integers(1, 7, 7)) % 7, ids)
        owners = dict(zip(ids.tolist(), range(7), strict=True))
        wrong += sum(a != b for a, b in owners.items())
        total += len(owners)
    observed = np.mean([o != i for i, owners in shown.items() for o in owners])
    assert abs(observed - wrong / total) < 4.5 * math.sqrt(0.2 * 0.8 / 12000)
    assert all(len(set(owners)) == 7 for owners in shown.values())


def test_odometry_noise_per_sample_is_the_papers():
    scenario = load_scenario("paper-homing")
    wheels = Wheels(scenario)
    twists = np.array([wheels.measure(Twist(0.125, 0.3)) for _ in range(N)])
    for column, mean, sigma in ((0, 0.125, 0.005), (1, 0.3, 0.01)):
        assert abs(twists[:, column].mean() - mean) < 4 * sigma / math.sqrt(N)
        assert abs(twists[:, column].std() / sigma - 1) < 4 / math.sqrt(2 * N)


def test_white_noise_is_the_same_over_a_second_at_any_rate():
    sums = []
    for rate in (10.0, 40.0):
        wheels = Wheels(load_scenario("paper-homing", {"rates.odometry": rate}))
        n = int(rate)
        speed = np.array([wheels.measure(Twist(0.0, 0.0)).v for _ in range(400 * n)])
        sums.append((speed.reshape(400, n) / rate).sum(axis=1).std())
    # 0.005 m/s a sample at 20 Hz comes to 0.005 / sqrt(20) m in a second.
    for total in sums:
        assert abs(total / (0.005 / math.sqrt(20)) - 1) < 4 / math.sqrt(2 * 400)


def test_given_constant_errors_are_those_given():
    silent = {"odometry.speed_sigma": 0, "odometry.turn_sigma": 0}
    errors = {"odometry.speed_scale": 0.1, "odometry.turn_scale": -0.05, "odometry.turn_bias": 0.02}
    wheels = Wheels(load_scenario("paper-homing", silent | errors))
    assert wheels.measure(Twist(1.0, 2.0)) == Twist(1.1, 1.92)


def test_drawn_constant_errors_hold_for_a_drive_and_differ_between_drives():
    silent = {"odometry.speed_sigma": 0, "odometry.turn_sigma": 0}
    drawn = []
    for seed in range(200):
        changes = silent | {"seed": seed, "odometry.speed_scale_sigma": 0.05}
        wheels = Wheels(load_scenario("paper-homing", changes))
        first, second = (wheels.measure(Twist(1.0, 0.0)) for _ in range(2))
        assert first == second
        drawn.append(first.v - 1.0)
    assert abs(np.mean(drawn)) < 4 * 0.05 / math.sqrt(200)
    assert abs(np.std(drawn) / 0.05 - 1) < 4 / math.sqrt(2 * 200)
