"""What a run writes, read back; nothing foreign is overwritten, nothing half-written."""

import csv
import dataclasses
import json
import math

import numpy as np
import pytest
import yaml
from made_up_run import FILES, SETTINGS, made_up

from homeward.errors import InputError
from homeward.estimator import LandmarkEstimate
from homeward.runs.report import run_page
from homeward.runs.report.folder import write_run


def rows_of(file):
    with file.open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    out = tmp_path_factory.mktemp("run") / "deep" / "out"
    write_run(out, *made_up(), SETTINGS)
    return out


@pytest.fixture
def unplotted(monkeypatch):
    """Spare a test the time that plots take."""
    monkeypatch.setattr(run_page, "_plots", lambda drive, track: {})


def test_estimate_reads_back(folder):
    _, track = made_up()
    rows = rows_of(folder / "estimate.csv")
    assert ",".join(rows[0]) == ("t,x,y,heading,R,theta,alpha,sigma_x,sigma_y,sigma_heading,status")
    assert [float(r["t"]) for r in rows] == track.t.tolist()
    assert all(rows[0][k] == "" for k in rows[0] if k not in ("t", "status"))
    assert rows[0]["status"] == "mapping"
    last = {k: float(v) for k, v in rows[-1].items() if k != "status"}
    assert last["x"] == pytest.approx(track.x[-1], rel=1e-8)
    assert last["R"] == pytest.approx(math.hypot(last["x"], last["y"]), rel=1e-8)
    assert last["theta"] == pytest.approx(math.atan2(last["y"], last["x"]), rel=1e-8)
    assert last["alpha"] == last["heading"]
    assert last["sigma_heading"] == pytest.approx(0.1)
    assert rows[-1]["status"] == "coasting"


def test_trajectory_reads_back(folder):
    _, track = made_up()
    rows = np.loadtxt(folder / "trajectory.tum")
    assert rows.shape == (int(track.has_pose.sum()), 8)
    assert rows[:, 0].tolist() == track.t[track.has_pose].tolist()
    np.testing.assert_allclose(np.linalg.norm(rows[:, 4:], axis=1), 1.0, atol=1e-8)
    turned = 2 * np.arctan2(rows[:, 6], rows[:, 7]) - track.heading[track.has_pose]
    np.testing.assert_allclose(np.cos(turned), 1.0)
    assert not rows[:, 3:6].any()


def test_landmarks_read_back(folder):
    rows = rows_of(folder / "landmarks.csv")
    assert ",".join(rows[0]) == (
        "landmark,x,y,distance,sigma_distance,home_bearing_stored,home_bearing_estimated,"
        "moved_probability,moved,sightings,moved_at,exchanged_with"
    )
    assert [r["moved"] for r in rows] == ["yes", "no", "no", "no"]
    assert rows[1]["x"] == "1.25"
    assert rows[0]["moved_at"] == ""
    assert rows[0]["sightings"] == "40"


def test_metrics_are_strict_json(folder):
    def refuse(word):
        raise AssertionError(word)

    text = (folder / "metrics.json").read_text(encoding="utf-8")
    metrics = json.loads(text, parse_constant=refuse)
    assert metrics["position_rmse_m"] == pytest.approx(0.05)
    assert metrics["pose_share"] == pytest.approx(0.9, abs=0.01)
    assert metrics["rejected"] == {"bearing is outside the gate": 3}


def test_run_yaml_holds_every_setting_and_the_versions(folder):
    run = yaml.safe_load((folder / "run.yaml").read_text(encoding="utf-8"))
    assert {"homeward", "numpy", "scipy"} <= run.pop("versions").keys()
    assert run == SETTINGS


@pytest.mark.usefixtures("unplotted")
def test_an_estimator_without_landmarks(tmp_path):
    drive, track = made_up()
    silent = dataclasses.replace(track, landmarks=[LandmarkEstimate(i) for i in "abcd"])
    assert "does not detect moved landmarks" in write_run(tmp_path, drive, silent, {})
    assert set(rows_of(tmp_path / "landmarks.csv")[0].values()) == {"a", "0", ""}


@pytest.mark.usefixtures("unplotted")
def test_an_earlier_run_is_replaced_and_the_users_own_files_stay(tmp_path):
    write_run(tmp_path, *made_up(), {"run": 1})
    (tmp_path / "my notes.txt").write_text("keep me")
    write_run(tmp_path, *made_up(), {"run": 2})
    assert yaml.safe_load((tmp_path / "run.yaml").read_text())["run"] == 2
    assert {p.name for p in tmp_path.iterdir()} == FILES | {"my notes.txt"}


def test_a_folder_that_is_no_run_is_refused_and_left_alone(tmp_path):
    (tmp_path / "estimate.csv").write_text("mine")
    with pytest.raises(InputError, match=r"no run\.yaml") as caught:
        write_run(tmp_path, *made_up(), {})
    assert "\n" not in str(caught.value)
    assert [p.name for p in tmp_path.iterdir()] == ["estimate.csv"]
    assert (tmp_path / "estimate.csv").read_text() == "mine"


def test_the_same_run_writes_the_same_bytes(tmp_path):
    for out in ("one", "two"):
        write_run(tmp_path / out, *made_up(), SETTINGS)
    for name in FILES:
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes()
