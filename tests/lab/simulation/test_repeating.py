"""Teach and repeat in a small room: near the route, back on it, and honest where that fails."""

import math

import numpy as np
import pytest

from homeward.drives.drive import HomeBearing
from homeward.errors import InputError
from homeward.estimator import Counts, Estimate, Status
from homeward.lab.simulation.course import Ending
from homeward.lab.simulation.scenario import (
    Listed,
    Noise,
    OdometryErrors,
    Rates,
    Repeat,
    Scenario,
    StartPose,
    Teach,
)
from homeward.lab.simulation.simulate import (
    changed_scenario,
    load_scenario,
    prepare,
    scenario_yaml,
    simulate,
)
from homeward.lab.simulation.trajectories import SEARCH_RADIUS, settled
from homeward.places.files import save_place
from homeward.places.joint_map import JointMap
from homeward.places.persistence import LandmarkPersistence
from homeward.places.place import Place, StoredHome, Visit
from homeward.places.route import Node, Route, stops
from homeward.registry import make_estimator

CORNERS = np.array([[0.0, 0.0], [2.5, 0.0], [2.5, 2.0]])
LANDMARKS = 16


def landmarks(moved=0):
    """Where landmarks of the room stand; some of them elsewhere than when the place was made."""
    rng = np.random.default_rng(4)
    at = {f"L{i}": rng.uniform((-2.5, -2.5), (5.0, 4.5)) for i in range(LANDMARKS)}
    for i in range(moved):
        at[f"L{i}"] = at[f"L{i}"] + rng.uniform(0.4, 1.5) * rng.choice([-1, 1], 2)
    return {name: (float(x), float(y)) for name, (x, y) in at.items()}


@pytest.fixture(scope="module")
def hall(tmp_path_factory):
    """The folder of a place that knows the room to a centimetre, and a route in it."""
    at, rng = landmarks(), np.random.default_rng(5)
    mean = np.array(list(at.values())).ravel() + rng.normal(0.0, 0.01, 2 * LANDMARKS)
    known = JointMap(tuple(at), (), mean, 1e-4 * np.eye(mean.size))
    known = known.with_home("home", {}, None, np.zeros(3), 1e-6 * np.eye(3)).at_home("home")
    nodes = [Node(0.0, 0.0, 0.0, 0.01), Node(2.5, 0.0, 0.0, 0.01, "shelf", 2.5)]
    nodes.append(Node(2.5, 2.0, math.pi / 2, 0.01, "dock"))
    visit = Visit(1, 20000.0, "first", "f", "first")
    place = Place(
        "hall",
        known,
        {n: LandmarkPersistence(20000.0, 20000.0) for n in at},
        {"home": StoredHome(20000.0, {n: HomeBearing(0.0) for n in at})},
        (visit,),
        routes={"round": Route(20000.0, tuple(nodes))},
    )
    folder = tmp_path_factory.mktemp("places") / "hall"
    save_place(place, folder)
    return str(folder)


def scenario(hall, moved=0, **told):
    start = told.pop("start", StartPose(x=-0.1, y=0.1, heading=0.2, prior=False))
    return Scenario(
        seed=3,
        landmarks=Listed(at=landmarks(moved)),
        noise=Noise(bearing_sigma=0.01, home_sigma=0.01),
        rates=Rates(odometry=10.0, bearings=2.5, truth=10.0),
        odometry=OdometryErrors(speed_sigma=0.005, turn_sigma=0.005, turn_scale=0.02),
        start=start,
        trajectory=Repeat(place=hall, route="round", speed=0.4, duration=90.0, **told),
        estimator="robust",
    )


def repeated(scenario):
    """Repeat; return the simulation, and time and true pose."""
    made = simulate(scenario, make_estimator(scenario.estimator, prepare(scenario)))
    truth = made.drive.truth
    return made, np.column_stack([truth.t, truth.x, truth.y, truth.heading])


def off(way):
    """How far points are from the route [m]."""
    x, y = way[:, 1:3].T
    first = np.hypot(x - np.clip(x, 0, 2.5), y)
    return np.minimum(first, np.hypot(x - 2.5, y - np.clip(y, 0, 2.0)))


@pytest.mark.parametrize(("moved", "most"), [(0, 0.08), (LANDMARKS // 2, 0.15)])
def test_a_repeat_is_bounded_however_much_was_moved(hall, moved, most):
    made, way = repeated(scenario(hall, moved))
    assert made.ending is Ending.DONE
    entered = np.argmax(off(way) < 0.05)
    assert off(way[entered:]).max() < most
    (row, dwell), *_ = stops(way[:, 0], way[:, 1:])
    assert math.dist(way[row, 1:3], (2.5, 0.0)) < most
    assert 2.0 < dwell < 4.0
    assert math.dist(way[-1, 1:3], (2.5, 2.0)) < most


def test_one_that_is_pushed_off_comes_back(hall):
    made, way = repeated(scenario(hall, push={"at": 6.0, "x": -0.5, "y": 1.0, "turn": 0.5}))
    assert made.ending is Ending.DONE
    jump = np.argmax(np.hypot(*np.diff(way[:, 1:3], axis=0).T))
    assert off(way)[jump + 1] > 0.7
    assert off(way)[-50:].max() < 0.15
    assert math.dist(way[-1, 1:3], (2.5, 2.0)) < 0.15


def test_blocked_it_waits_and_for_too_long_it_gives_up_and_says_so(hall):
    by_truth = {"estimator": "truth"}
    waits = changed_scenario(scenario(hall, blocked=(2.0, 12.0)), by_truth)
    made = simulate(waits)
    assert made.ending is Ending.DONE
    now = (made.drive.truth.t > 2.2) & (made.drive.truth.t < 12.0)
    assert np.ptp(made.drive.truth.x[now]) < 1e-3
    never = simulate(changed_scenario(waits, {"trajectory.blocked": [2.0, 80.0]}))
    assert never.ending is Ending.GAVE_UP
    assert "blocked; no progress for 30 s" in never.reason
    assert never.drive.odometry.t[-1] == pytest.approx(32.0, abs=1.0)


class Lost:
    """An estimator that never knows."""

    name, notes, counts = "lost", (), Counts()

    def odometry(self, t, v, omega):
        pass

    def estimate(self, t):
        return Estimate(t, Status.MAPPING, "lost")

    def bearings(self, t, sightings, sigmas=None):
        return self.estimate(t)

    def landmarks(self):
        return []


def test_one_that_never_knows_where_it_is_looks_round_and_gives_up(hall):
    made = simulate(scenario(hall), Lost())
    assert made.ending is Ending.GAVE_UP
    assert "lost, no pose" in made.reason
    truth = made.drive.truth
    # Within the second, wider circle of the search, seen from the start.
    assert np.hypot(truth.x, truth.y).max() < 4 * SEARCH_RADIUS + math.hypot(0.1, 0.1)
    assert np.ptp(truth.x) > 0.9  # on circles, for the parallax


def test_a_repeat_repeats_to_the_last_bit_though_the_place_has_changed(hall, tmp_path):
    short = changed_scenario(scenario(hall), {"trajectory.duration": 6.0})
    told = settled(short)
    assert (told.trajectory.version, told.trajectory.when) == (1, 20001.0)
    file = tmp_path / "scenario.yaml"
    file.write_text(scenario_yaml(told), encoding="utf-8")
    again = load_scenario(str(file))
    one, other = (repeated(s)[0].drive for s in (told, again))
    assert np.array_equal(one.odometry.omega, other.odometry.omega)
    assert one.home == other.home
    assert one.home  # what it logs is what any robot logs
    assert prepare(told).home == {}  # but it knows the place instead


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"trajectory.route": "square"}, "no route 'square'; there are round"),
        ({"trajectory.place": "nowhere"}, "no such folder"),
        ({"trajectory.version": 7}, "has no version 7"),
    ],
)
def test_what_is_not_there_is_refused_in_one_line(hall, changes, words):
    with pytest.raises(InputError, match=words):
        settled(changed_scenario(scenario(hall), changes))


def test_a_hand_teaches_from_point_to_point_and_waits_there(hall):
    by_hand = Teach(speed=0.4, points=((2.5, 0.0), (2.5, 2.0)), dwell=4.0)
    taught = replace_trajectory(scenario(hall), by_hand)
    truth = simulate(taught).drive.truth
    poses = np.column_stack([truth.x, truth.y, truth.heading])
    ((row, dwell),) = stops(truth.t, poses)
    assert dwell == pytest.approx(4.0, abs=1.2)  # it starts and stops slowly
    assert poses[row, :2] == pytest.approx((2.5, 0.0), abs=0.04)
    assert poses[-1, :2] == pytest.approx((2.5, 2.0), abs=0.04)


def replace_trajectory(scenario, trajectory):
    return scenario.model_copy(update={"trajectory": trajectory, "estimator": "truth"})


def test_a_preset_with_way_points_can_be_taught():
    taught = load_scenario("warehouse", {"trajectory.kind": "teach"})
    assert taught.trajectory.points == load_scenario("warehouse").trajectory.points
    assert taught.trajectory.end_at_home
