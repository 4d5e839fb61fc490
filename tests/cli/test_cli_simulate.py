"""`homeward simulate` as a user runs it, and the sample drive that it made."""

import shlex
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
from commands import call, done

from homeward.drives.folder import read_folder

SAMPLE = Path(str(files("homeward").joinpath("data", "sample")))


def simulate(*arguments):
    return call("simulate", *arguments)


@pytest.mark.parametrize("preset", ["paper-homing", "circle"])
def test_a_preset_becomes_a_drive_folder(preset, tmp_path):
    result = done(simulate(preset, "--out", tmp_path / "d", "--seed", 3))
    assert result.stdout.count("\n") == 2
    assert preset in result.stdout
    drive = read_folder(tmp_path / "d")
    assert drive.truth is not None
    assert len(drive.home) == 7
    assert drive.settings.start is not None


def test_options_change_the_scenario_and_its_file_repeats_it(tmp_path):
    options = ["--trajectory", "homing", "--estimator", "ekf", "--seed", 5]
    sets = ["--set", "noise.bearing_sigma=0.01", "--set", "moved.faults={L08: 0.4}"]
    sets += ["--set", "moved.count=0"]
    done(simulate("warehouse", "--out", tmp_path / "a", *options, *sets))
    scenario = (tmp_path / "a" / "scenario.yaml").read_text()
    assert "kind: homing" in scenario
    assert "estimator: ekf" in scenario
    assert "L08: 0.4" in scenario
    done(simulate(tmp_path / "a" / "scenario.yaml", "--out", tmp_path / "b"))
    for path in (tmp_path / "a").iterdir():
        assert path.read_bytes() == (tmp_path / "b" / path.name).read_bytes()


def test_the_sample_drive_is_what_its_command_makes(tmp_path):
    program, *arguments = shlex.split((SAMPLE / "COMMAND.txt").read_text())
    assert program == "homeward"
    arguments[arguments.index("--out") + 1] = str(tmp_path / "d")
    done(call(*arguments))
    made = {path.name: path.read_bytes() for path in (tmp_path / "d").iterdir()}
    shipped = {path.name: path.read_bytes() for path in SAMPLE.iterdir()}
    del shipped["COMMAND.txt"]
    assert made == shipped


def test_the_sample_drive_is_a_fair_sample():
    assert sum(path.stat().st_size for path in SAMPLE.iterdir()) < 500_000
    drive = read_folder(SAMPLE)
    assert 150 < drive.span[1] - drive.span[0] < 210
    counts = np.array([len(seen) for _, seen, _ in drive.sightings.stamps()])
    assert ((counts >= 3) & (counts <= 8)).mean() > 0.9
    assert len(set(drive.sightings.landmark)) == 15
    world = [line.split(",") for line in (SAMPLE / "world.csv").read_text().splitlines()[1:]]
    moved = {row[0] for row in world if row[3] == "1"}
    assert len(moved) == 3
    assert moved <= set(drive.home)
    assert drive.settings.sensor.x == 0.2
    assert drive.settings.sensor.field_of_view == pytest.approx(np.radians(240))
