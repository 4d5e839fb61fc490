"""Files of earlier versions, which are read for ever: never write `tests/data/old_files` again."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner
from visited import mapped, room

from homeward import Localizer
from homeward.cli.main import app
from homeward.drives.drive import HomeBearing
from homeward.drives.settings import DriveSettings
from homeward.errors import InputError
from homeward.io.settings import read_settings
from homeward.live.fleet.merging import LIVE, SharedPlace
from homeward.live.recording import read_drive
from homeward.places.files import load_place, save_place
from homeward.places.visit_data import VisitData
from homeward.places.visiting import merged

OLD = Path(__file__).parents[1] / "data" / "old_files"


def test_a_place_with_a_route_is_read_used_and_written(tmp_path):
    folder = shutil.copytree(OLD / "place", tmp_path / "hall")
    place = load_place(folder)
    there = dict(zip(place.map.names, place.map.positions, strict=True))
    assert {n: p.tolist() for n, p in there.items()} == {
        n: pytest.approx(p.tolist(), abs=0.2) for n, p in room(5).items()
    }
    assert place.together == (("L1", "L2"),)
    assert [(n.waypoint, n.dwell) for n in place.route("round").nodes][1] == ("dock", 2.0)
    assert place.homes["home"].seen["L0"].bearing == 0.1
    assert Localizer({}, known=place.known(when=20001.0)) is not None
    data = VisitData("new", "1f", 20001.0, mapped(room(5), np.random.default_rng(1)))
    assert merged(place, data).visits[-1].stayed == 5
    assert save_place(place, folder, 1) == 2
    assert np.array_equal(load_place(folder).map.covariance, place.map.covariance)
    assert CliRunner().invoke(app, ["place", "info", str(folder)]).exit_code == 0


def test_a_visit_that_a_merger_or_a_robot_kept_is_read(tmp_path):
    folder = shutil.copytree(OLD / "place", tmp_path / "hall")
    (folder / LIVE).mkdir()
    shutil.copy(OLD / "visit.json", folder / LIVE / "a.1f.json")
    shared = SharedPlace(folder)
    shared.load(0.0, 20001.0)
    assert shared.problems == []
    assert shared.visits["a", "1f"].message.doubted == ("L0",)
    ((*_, text),) = shared.settle(0.0)
    assert "5 stayed" in text
    place = load_place(folder)
    assert place.home_pose("dock") == pytest.approx((1.0, 2.0, 0.5), abs=0.1)
    assert place.homes["dock"].seen["L2"] == HomeBearing(1.0, 0.01, "rear")
    assert {*place.routes} == {"round"}  # that of the place: the visit's has the same name


def test_a_robot_file_is_read():
    robot = read_settings(OLD / "robot.yaml", DriveSettings)
    assert robot.sensor.pose == (0.12, -0.01, 0.02)
    assert robot.cameras["rear"].yaw == 3.1
    assert robot.odometry.speed_scale == 1.02
    assert robot.bearings_late == 0.08


def test_a_recording_of_a_live_session_is_read(tmp_path):
    drive = read_drive(OLD / "session.jsonl")
    assert drive.odometry.t[[0, -1]].tolist() == [1000.0, 1003.9]
    assert set(drive.odometry.v) == {0.3}
    assert drive.sightings.t.size == 40
    assert drive.home["a"] == HomeBearing(0.1, 0.01)
    newer = tmp_path / "session.jsonl"
    newer.write_text((OLD / "session.jsonl").read_text().replace("{", '{"version": 2, ', 1))
    with pytest.raises(InputError, match="version: must be 1"):
        read_drive(newer)
