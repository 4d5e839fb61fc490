"""Where landmarks stand, where they stood, and what home stored."""

import math

import numpy as np
import pytest

from homeward.errors import InputError
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose, bearing, compose
from homeward.lab.simulation.scenario import Mount
from homeward.lab.simulation.simulate import load_scenario, prepare
from homeward.lab.simulation.world import build_world

EXACT = {"noise.home_sigma": 0}


def warehouse(**changes):
    return load_scenario("warehouse", {k.replace("__", "."): v for k, v in changes.items()})


def test_the_ring_is_the_papers():
    for seed in range(20):
        scenario = load_scenario("paper-homing", {"seed": seed, "home.x": 3.0, "home.heading": 1.0})
        x, y = build_world(scenario).in_home_frame.T
        distance, angle = np.hypot(x, y), np.arctan2(y, x)
        assert ((distance >= 1) & (distance <= 2)).all()
        assert (np.abs(wrap(angle - 2 * math.pi * np.arange(7) / 7)) <= 0.3).all()


def test_ring_draws_fill_their_ranges():
    scenario = load_scenario("paper-homing", {"landmarks.count": 4000, "moved.count": 0})
    x, y = build_world(scenario).in_home_frame.T
    offset = wrap(np.arctan2(y, x) - 2 * math.pi * np.arange(4000) / 4000)
    # Four standard errors of the mean of a uniform variable.
    assert abs(np.hypot(x, y).mean() - 1.5) < 4 * 1 / math.sqrt(12 * 4000)
    assert abs(offset.mean()) < 4 * 0.6 / math.sqrt(12 * 4000)
    assert np.ptp(offset) > 0.59


def test_room_landmarks_hang_on_free_surfaces_far_enough_apart():
    for seed in range(10):
        scenario = warehouse(seed=seed, moved__count=0)
        places, room = build_world(scenario).places, scenario.room
        apart = np.hypot(*(places[:, None] - places[None]).transpose(2, 0, 1))
        assert apart[~np.eye(len(places), dtype=bool)].min() >= 1.0
        for x, y in places:
            gaps = [
                min(abs(x - x0), abs(x - x1), abs(y - y0), abs(y - y1))
                for x0, y0, x1, y1 in (room.bounds, *room.shelves)
                if x0 - 1e-9 <= x <= x1 + 1e-9 and y0 - 1e-9 <= y <= y1 + 1e-9
            ]
            assert min(gaps) < 1e-9


def test_no_landmark_between_a_shelf_and_the_wall_it_stands_at():
    scenario = warehouse(
        room__shelves=[[2.0, 5.0, 8.0, 6.0]], moved__count=0, landmarks__spacing=0.0
    )
    changes = scenario.model_copy(
        update={"landmarks": scenario.landmarks.model_copy(update={"count": 300})}
    )
    x, y = build_world(changes).places.T
    assert not ((x > 2.01) & (x < 7.99) & (y > 5.99)).any()
    assert ((x > 2.01) & (x < 7.99) & (y == 5.0)).any()


def test_listed_landmarks_are_where_they_were_put():
    at = {"door": [2.0, 5.0], "7": [4.0, 1.0]}
    scenario = load_scenario(
        "paper-homing",
        {"landmarks": {"layout": "listed", "at": at}, "moved.count": 0}
        | {"home.x": 2.0, "home.y": 1.0, "home.heading": math.pi / 2},
    )
    world = build_world(scenario)
    assert world.ids == ("door", "7")
    np.testing.assert_allclose(world.in_home_frame, [[4.0, 0.0], [0.0, -2.0]], atol=1e-12)


def stored_and_true(scenario):
    """Return stored and true bearing of each landmark at the home camera."""
    world, home = build_world(scenario), prepare(scenario).home
    camera = compose(scenario.home.pose, scenario.home_mount.pose)
    true = bearing(camera, world.places[:, 0], world.places[:, 1])
    return world, {
        i: (home[i].bearing, float(t)) for i, t in zip(world.ids, true, strict=True) if i in home
    }


@pytest.mark.parametrize("preset", ["warehouse", "paper-homing"])
@pytest.mark.parametrize("seed", range(8))
def test_moved_landmarks_give_exactly_the_drawn_faults_at_home(preset, seed):
    scenario = load_scenario(preset, EXACT | {"seed": seed})
    world, bearings = stored_and_true(scenario)
    low, high = scenario.moved.fault
    assert len(world.moved) == scenario.moved.count
    assert set(world.moved) <= set(bearings)
    for landmark, (stored, true) in bearings.items():
        fault = world.moved.get(landmark, 0.0)
        assert abs(wrap(stored - true - fault)) < 1e-5  # as stored: five decimals
        assert landmark not in world.moved or low <= abs(fault) <= high


def test_a_fault_is_where_home_saw_the_landmark_stand():
    scenario = warehouse(noise__home_sigma=0, home_sensor=Mount(x=0.1, y=-0.2, yaw=0.3))
    world, camera = build_world(scenario), compose(scenario.home.pose, Pose(0.1, -0.2, 0.3))
    old = bearing(camera, world.places_at_home[:, 0], world.places_at_home[:, 1])
    now = bearing(camera, world.places[:, 0], world.places[:, 1])
    np.testing.assert_allclose(wrap(old - now), world.fault, atol=1e-12)
    assert np.count_nonzero(world.fault) == 3


def test_faults_have_either_sign():
    faults = [
        fault
        for seed in range(40)
        for fault in build_world(load_scenario("paper-homing", {"seed": seed})).moved.values()
    ]
    positive = sum(fault > 0 for fault in faults)
    assert len(faults) == 80
    assert abs(positive - 40) < 4 * math.sqrt(80) / 2


def test_named_faults_are_those_named():
    scenario = load_scenario(
        "paper-homing", EXACT | {"moved.count": 0, "moved.faults": {"L2": -0.4, "L5": 0.3}}
    )
    world, bearings = stored_and_true(scenario)
    assert world.moved == {"L2": -0.4, "L5": 0.3}
    stored, true = bearings["L2"]
    assert wrap(stored - true) == pytest.approx(-0.4, abs=1e-5)


def test_home_stores_only_what_it_had_in_view():
    scenario = warehouse(moved__count=0, visibility__range=(0.3, 4.0))
    world, home = build_world(scenario), prepare(scenario).home
    camera = compose(scenario.home.pose, scenario.sensor.pose)
    far = np.hypot(world.places[:, 0] - camera.x, world.places[:, 1] - camera.y) > 4.0
    assert 0 < len(home) < 15
    assert not set(home) & {i for i, f in zip(world.ids, far, strict=True) if f}


def test_home_noise_is_as_large_as_it_says():
    scenario = load_scenario(
        "paper-homing",
        {"landmarks.count": 2000, "moved.count": 0, "noise.home_sigma": 0.03},
    )
    _, bearings = stored_and_true(scenario)
    errors = np.array([wrap(stored - true) for stored, true in bearings.values()])
    # Four standard errors of a mean and of a standard deviation.
    assert abs(errors.mean()) < 4 * 0.03 / math.sqrt(2000)
    assert abs(errors.std() / 0.03 - 1) < 4 / math.sqrt(2 * 2000)
    assert prepare(scenario).home["L0001"].sigma == 0.03


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"landmarks.count": 200}, "landmarks.count: the room has no space for 200"),
        ({"visibility.range": [0.0, 0.1]}, "moved.count: home can have seen only"),
        ({"visibility.range": [0.0, 0.1], "moved.count": 0}, "home has no landmark in view"),
        ({"moved.count": 0, "moved.faults": {"L99": 0.3}}, "moved.faults.L99: no such landmark"),
        ({"moved.count": 0, "moved.faults": {"L09": 3.0}}, "moved.faults.L09: home would not"),
    ],
)
def test_worlds_that_cannot_be_built_are_refused(changes, words):
    with pytest.raises(InputError, match=words) as caught:
        prepare(load_scenario("warehouse", changes))
    assert "\n" not in str(caught.value)
