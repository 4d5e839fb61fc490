"""Scenarios from presets and files, with changes, and hostile ones."""

import math

import pytest

from homeward.errors import InputError
from homeward.lab.simulation.simulate import (
    PRESETS,
    load_scenario,
    scenario_yaml,
    simulate,
    write_simulation,
)


@pytest.mark.parametrize("preset", list(PRESETS))
def test_a_scenario_comes_back_from_its_file(preset, tmp_path):
    path = tmp_path / "scenario.yaml"
    path.write_text(scenario_yaml(PRESETS[preset]))
    assert load_scenario(str(path)) == PRESETS[preset]


def test_a_written_drive_repeats_from_its_scenario(tmp_path):
    changes = {"trajectory.duration": 5.0, "moved.count": 0, "moved.faults": {"L04": 0.3}}
    scenario = load_scenario("warehouse", changes)
    write_simulation(simulate(scenario), tmp_path / "a")
    again = load_scenario(str(tmp_path / "a" / "scenario.yaml"))
    write_simulation(simulate(again), tmp_path / "b")
    names = sorted(p.name for p in (tmp_path / "a").iterdir())
    assert names == [
        "bearings.csv",
        "drive.yaml",
        "home.csv",
        "odometry.csv",
        "scenario.yaml",
        "truth.csv",
        "world.csv",
    ]
    for name in names:
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


def test_world_csv_is_in_the_home_frame(tmp_path):
    at = {"a": [1.0, 3.0], "b": [4.0, 2.0]}
    changes = {"landmarks": {"layout": "listed", "at": at}, "moved.faults": {"b": -0.25}}
    home = {"home.x": 1.0, "home.y": 2.0, "home.heading": math.pi / 2, "moved.count": 0}
    simulation = simulate(load_scenario("paper-homing", changes | home | {"rates.truth": 1}))
    write_simulation(simulation, tmp_path / "d")
    assert (tmp_path / "d" / "world.csv").read_text() == (
        "landmark,x,y,moved,fault\na,1.0,0.0,0,0.0\nb,0.0,-3.0,1,-0.25\n"
    )


def test_changes_reach_into_the_scenario():
    changes = {"noise.bearing_sigma": 0.1, "visibility.range": [1, 4], "seed": 7}
    scenario = load_scenario("warehouse", changes)
    assert scenario.noise.bearing_sigma == 0.1
    assert scenario.visibility.range == (1.0, 4.0)
    assert scenario.seed == 7
    assert scenario.noise.home_sigma == PRESETS["warehouse"].noise.home_sigma


def test_another_trajectory_keeps_speed_and_duration():
    trajectory = load_scenario("warehouse", {"trajectory.kind": "circle"}).trajectory
    assert (trajectory.kind, trajectory.speed, trajectory.duration) == ("circle", 0.21, 240.0)
    same = load_scenario("circle", {"trajectory.kind": "circle"}).trajectory
    assert same == PRESETS["circle"].trajectory


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"noise.bearing_sigma": -1}, "noise.bearing_sigma"),
        ({"noise.bearing_sigma": math.nan}, "noise.bearing_sigma"),
        ({"noise.sgma": 1}, "noise.sgma"),
        ({"weather": "fine"}, "weather"),
        ({"noise": 3}, "noise"),
        ({"noise.bearing_sigma.deep": 3}, "noise.bearing_sigma.deep"),
        ({"seed": -3}, "seed"),
        ({"landmarks.count": 0}, "^landmarks.count: "),
        ({"landmarks": {"layout": "listed", "at": {}}}, "^landmarks.at: "),
        ({"landmarks.layout": "hexagon"}, "landmarks"),
        ({"moved.count": 16}, "moved.count: larger than landmarks.count"),
        ({"moved.faults": {"L09": 0.3}}, "either count or faults"),
        ({"moved.fault": [0.5, 0.2]}, r"moved.fault.*\[minimum, maximum\]"),
        ({"room": None}, "landmarks.layout: room needs a room"),
        ({"room.bounds": [3, 1, 2, 2]}, "room.bounds"),
        ({"room.shelves": [[3, 1, 2, 2]]}, "room.shelves.0"),
        ({"home.x": 3.0, "home.y": 1.7}, "home: outside the room or in a shelf"),
        ({"home.x": -1.0}, "home: outside the room or in a shelf"),
        ({"trajectory.points": [[1, 1], [3, 1.7]]}, "trajectory.points.1: outside"),
        ({"trajectory.kind": "teach", "trajectory.points": [[3, 1.7]]}, "points.0: outside"),
        ({"trajectory.kind": "teach", "trajectory.dwell": -1}, "^trajectory.dwell: "),
        ({"trajectory.kind": "repeat", "trajectory.place": "p"}, "^trajectory.route: "),
        ({"trajectory.points": []}, "^trajectory.points: "),
        ({"trajectory.spead": 1}, "^trajectory.spead: "),
        ({"trajectory.speed": 0}, "^trajectory.speed: "),
        ({"trajectory.kind": "spiral"}, "trajectory"),
        ({"start.R": 1.0}, "give R, theta and alpha, or x, y and heading"),
        ({"start": {"x": 1.0}}, "give R, theta and alpha, or x, y and heading"),
        ({"rates.jitter": 0.03}, "jitter must be at most 0.4 of the shortest period"),
        ({"rates.odometry": 0}, "rates.odometry"),
        ({"visibility.field_of_view": 7.0}, "visibility.field_of_view"),
        ({"visibility.probability": 1.1}, "visibility.probability"),
    ],
)
def test_hostile_changes_are_refused_in_one_line_that_names_the_key(changes, words):
    with pytest.raises(InputError, match=words) as caught:
        load_scenario("warehouse", changes)
    assert "\n" not in str(caught.value)
    assert "Value error" not in str(caught.value)


def test_hostile_files_are_refused_in_one_line(tmp_path):
    path = tmp_path / "s.yaml"
    for text, words in [
        ("", "start"),
        ("[1, 2]", "not a mapping"),
        ("a: [", "not YAML"),
        ("landmarks: {layout: ring}\nstart: {R: 1, theta: 0, alpha: 0}\n", "trajectory"),
    ]:
        path.write_text(text)
        with pytest.raises(InputError, match=words) as caught:
            load_scenario(str(path))
        assert "s.yaml" in str(caught.value)
        assert "\n" not in str(caught.value)


def test_a_name_that_is_no_preset_says_which_there_are():
    with pytest.raises(InputError, match="warehouse, paper-homing, circle"):
        load_scenario("warehuose")


def test_a_short_file_is_enough(tmp_path):
    path = tmp_path / "s.yaml"
    path.write_text(
        "landmarks: {layout: ring}\n"
        "start: {R: 1, theta: 0, alpha: 0, prior: false}\n"
        "trajectory: {kind: homing}\n"
    )
    simulation = simulate(load_scenario(str(path)))
    assert simulation.final_distance < 0.05
    assert simulation.drive.settings.start is None
