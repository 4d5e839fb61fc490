"""Recorded drives in a study: as they are, and made harder."""

import csv
import json

import numpy as np
import pytest
import yaml
from cli.commands import call, done, first_seconds, refused
from lab.studies.chores import draw_no_figures, in_this_process

from homeward.drives.opening import open_drive
from homeward.lab.studies.study.plan import load_study
from homeward.lab.studies.study.trial import (
    Recording,
    falsified,
    recorded_trial,
    with_dropped,
)
from homeward.registry import make_estimator
from homeward.runs.scoring import score
from homeward.track import run


@pytest.fixture
def short(tmp_path):
    return first_seconds(tmp_path / "short", 6.0)


def study(folder, **changes):
    tree = {"runs": 2, "block": 1, "loop": "open", "estimators": ["ekf", "robust"], **changes}
    path = folder / "my.yaml"
    path.write_text(yaml.safe_dump(tree))
    return path


def test_falsified_bearings_are_off_by_the_fault_and_the_others_are_not():
    drive = open_drive("sample")
    made = falsified(drive, 4, np.random.default_rng(0), (0.2, 0.6))
    off = [made.home[i].bearing - drive.home[i].bearing for i in drive.home]
    size = np.abs(np.angle(np.exp(1j * np.array(off))))
    assert np.sum(size > 0) == 4
    assert np.all((size[size > 0] > 0.2) & (size[size > 0] < 0.6))
    assert all(made.home[i].sigma == drive.home[i].sigma for i in drive.home)


def test_dropped_sightings_are_a_share_of_all_in_their_order():
    drive = open_drive("sample")
    left = with_dropped(drive, 0.25, np.random.default_rng(0)).sightings
    assert left.t.size == pytest.approx(0.75 * drive.sightings.t.size, rel=0.05)
    before = set(zip(drive.sightings.t, drive.sightings.landmark, strict=True))
    assert set(zip(left.t, left.landmark, strict=True)) <= before
    assert np.all(np.diff(left.t) >= 0)
    none = with_dropped(drive, 0.0, np.random.default_rng(0))
    assert none.sightings.t.size == drive.sightings.t.size


def test_runs_that_differ_in_one_trouble_are_alike_in_the_others():
    both = recorded_trial(Recording(drive="sample", falsified=3, dropped=0.5), 7).drive
    home = recorded_trial(Recording(drive="sample", falsified=3), 7).drive
    seen = recorded_trial(Recording(drive="sample", dropped=0.5), 7).drive
    assert both.home == home.home
    np.testing.assert_array_equal(both.sightings.t, seen.sightings.t)
    assert recorded_trial(Recording(drive="sample", falsified=3), 8).drive.home != home.home


def test_a_trial_knows_what_was_falsified_and_only_that():
    trial = recorded_trial(Recording(drive="sample", falsified=2), 1)
    assert len(trial.moved) == 2
    assert not trial.none_else
    assert trial.true_home == open_drive("sample").home_bearings()


def test_a_study_of_drives_and_scenarios_stands_in_one_table(short, tmp_path, monkeypatch):
    monkeypatch.setattr("homeward.lab.studies.blocks.finish.on_processes", in_this_process)
    draw_no_figures(monkeypatch)
    entry = {"drive": "short", "label": "real", "grid": {"dropped": [0.0, 0.3]}}
    changes = {"scenario": "circle", "set": {"trajectory.duration": 3}}
    path = study(tmp_path, drives=[entry], **changes)
    done(call("study", path, "--out", tmp_path / "out"))
    with (tmp_path / "out" / "table.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert [(r["scenario"], r["estimator"], r["runs"]) for r in rows] == [
        *[("circle", e, "2") for e in ("ekf", "robust")],
        # Nothing differs from run to run where nothing is random.
        *[("real, dropped 0", e, "1") for e in ("ekf", "robust")],
        *[("real, dropped 0.3", e, "2") for e in ("ekf", "robust")],
    ]
    drive = open_drive(short)
    metrics = score(run(drive, make_estimator("ekf", drive)), drive.truth)
    assert float(rows[2]["rmse_m"]) == pytest.approx(metrics.accuracy.position.rmse)
    # It repeats from what it wrote, wherever that lies.
    again = load_study(str(tmp_path / "out" / "study.yaml"))
    assert again.drives[0].drive == str(short)
    again = call("study", tmp_path / "out" / "study.yaml", "--out", tmp_path / "out", "--json")
    assert again.exit_code == 0
    told = json.loads(again.stdout)
    assert {line["estimator"] for line in told["lines"]}
    assert not told["failures"]
    assert "RMSE ratio to ekf" in (tmp_path / "out" / "table.md").read_text()


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"drives": ["nowhere"]}, "nowhere"),
        ({"drives": ["short"], "loop": "closed"}, "a recorded drive cannot be steered"),
        ({"drives": ["short"], "grid": {"seed": [1]}}, "need a scenario"),
        ({"drives": ["short", "short"]}, "two have the name"),
        ({"drives": [{"drive": "short", "dropped": 1}]}, "dropped"),
        ({"drives": [{"drive": "short", "falsified": 99}]}, "falsified must be at most"),
        ({"drives": [{"drive": "short", "home_noise_deg": 1}]}, "MRCLAM"),
        ({"drives": [{"drive": "short", "grid": {"dropt": [1]}}]}, "dropt"),
        ({"drives": ["blind"]}, "no ground truth"),
    ],
)
def test_drives_that_cannot_be_studied_are_one_line(short, tmp_path, changes, told):
    blind = first_seconds(tmp_path / "blind", 6.0)
    (blind / "truth.csv").unlink()
    line = refused(call("study", study(tmp_path, **changes), "--out", tmp_path / "out"))
    assert told in line
    assert not (tmp_path / "out").exists()


def test_real_drives_without_a_start_take_it_from_the_truth(data_dir, tmp_path):
    folder = data_dir / "MRCLAM_Dataset6"
    if not folder.is_dir():
        pytest.skip("no MRCLAM_Dataset6 in the data folder")
    told = {"robot": 1, "home": (2.0, 0.0, 0.3), "home_noise_deg": 0.5, "falsified": 3}
    trial = recorded_trial(Recording(drive=str(folder), **told), 0)
    assert trial.none_else
    assert len(trial.moved) == 3
    other = recorded_trial(Recording(drive=str(folder), **told), 1)
    assert other.true_home != trial.true_home
