"""`homeward run` as a user would call it."""

import csv
import json
import math
import shutil
from pathlib import Path

import pytest
import yaml
from commands import call, done, first_seconds, refused
from runs.made_up_run import FILES

from homeward.runs.single_run import sample_drive


@pytest.fixture
def short(tmp_path):
    """The first ten seconds of the sample drive."""
    return first_seconds(tmp_path / "short", 10.0)


def test_by_default_home_is_found_without_a_start_and_what_moved_is_named(tmp_path):
    folder = tmp_path / "drive"
    shutil.copytree(sample_drive(), folder)
    (folder / "drive.yaml").write_text("sensor: {x: 0.2, field_of_view: 4.19}\n")
    out = tmp_path / "out"
    result = done(call("run", folder, "--out", out))
    assert "L01, L02 and L08" in result.stdout
    metrics = json.loads((out / "metrics.json").read_text())
    assert metrics["position_rmse_m"] < 0.25
    with (out / "landmarks.csv").open() as stream:
        moved = {row["landmark"] for row in csv.DictReader(stream) if row["moved"] == "yes"}
    with (sample_drive() / "world.csv").open() as stream:
        assert moved == {r["landmark"] for r in csv.DictReader(stream) if r["moved"] == "1"}


@pytest.mark.parametrize("command", ["run", "info", "convert"])
def test_what_looks_wrong_with_the_input_is_said_on_the_terminal(short, tmp_path, command):
    file = short / "bearings.csv"
    head, *rows = file.read_text().splitlines()
    cells = [row.split(",") for row in rows]
    degrees = [(t, i, str(math.degrees(float(b))), *rest) for t, i, b, *rest in cells]
    file.write_text("\n".join([head, *map(",".join, degrees)]) + "\n")
    where = {"run": ["--out", tmp_path / "out"], "info": [], "convert": [tmp_path / "x.mcap"]}
    result = done(call(command, short, *where[command]))
    (line,) = [row for row in result.stdout.splitlines() if "if they are in degrees" in row]
    beyond = sum(abs(float(cells[2])) > math.tau for cells in degrees)
    assert line.startswith(f"Note: {beyond} bearings beyond a full turn")


def test_smoothing_is_said_and_repeats(short, tmp_path):
    first, second = tmp_path / "first", tmp_path / "second"
    result = done(call("run", short, "--smooth", "--out", first))
    assert "smoothed" in result.stdout
    done(call("run", first / "run.yaml", "--out", second))
    assert (first / "estimate.csv").read_bytes() == (second / "estimate.csv").read_bytes()


@pytest.mark.parametrize("name", ["ekf", "a-ekf", "pi-ekf"])
def test_run_writes_everything_and_all_of_it_is_finite(short, tmp_path, name):
    out = tmp_path / "out"
    result = done(call("run", short, "--estimator", name, "--out", out))
    assert "Position error" in result.stdout
    assert str(out / "report.html") in result.stdout
    assert {p.name for p in out.iterdir()} == FILES
    with (out / "estimate.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) >= 100
    for row in rows:
        assert all(math.isfinite(float(v)) for k, v in row.items() if k != "status")
    metrics = json.loads((out / "metrics.json").read_text())
    assert 0 < metrics["position_rmse_m"] < 5


def test_run_repeats_bit_for_bit_from_its_run_yaml(short, tmp_path):
    first, second = tmp_path / "first", tmp_path / "second"
    options = ["--estimator", "a-ekf", "--start", "1.2,-0.45,-1.0", "--set", "gate=null"]
    done(call("run", short, *options, "--out", first))
    done(call("run", first / "run.yaml", "--out", second))
    for name in ("estimate.csv", "trajectory.tum", "landmarks.csv", "run.yaml"):
        assert (first / name).read_bytes() == (second / name).read_bytes(), name
    assert yaml.safe_load((first / "run.yaml").read_text())["settings"]["gate"] is None


def test_a_start_from_ground_truth_is_noted(short, tmp_path):
    out = tmp_path / "out"
    ekf = ["--estimator", "ekf"]
    result = call("run", short, "--start", "truth", "--out", out, page=True)
    assert "comes from ground truth" in result.stdout
    assert "comes from ground truth" in (out / "report.html").read_text()
    # Without a prior in drive.yaml, the start comes from ground truth.
    settings = yaml.safe_load((short / "drive.yaml").read_text())
    del settings["start"]
    (short / "drive.yaml").write_text(yaml.safe_dump(settings))
    assert "comes from ground truth" in call("run", short, *ekf, "--out", out).stdout
    assert "comes from ground truth" not in call("run", short, "--out", out).stdout
    (short / "truth.csv").unlink()
    assert "start prior" in refused(call("run", short, *ekf, "--out", out))
    assert "no ground truth" in refused(call("run", short, "--out", out, "--start", "truth"))


def test_run_yaml_takes_no_changes_and_must_be_one(short, tmp_path):
    out = tmp_path / "out"
    done(call("run", short, "--out", out))
    assert "--smooth" in refused(call("run", out / "run.yaml", "--smooth", "--out", out))
    (tmp_path / "other.yaml").write_text("- 1\n")
    assert "other.yaml" in refused(call("run", tmp_path / "other.yaml", "--out", out))


def test_run_yaml_executes_code_only_where_the_option_names_it(short, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("mine_here.py").write_text(
        "from pathlib import Path\nfrom homeward import Localizer\n"
        "Path('executed').touch()\n"
        "def make(home, **robot):\n    return Localizer(home, **robot)\n"
    )
    out = tmp_path / "out"
    done(call("run", short, "--out", out))
    file = out / "run.yaml"
    settings = yaml.safe_load(file.read_text())
    settings |= {"estimator": "mine_here:make", "settings": {}}
    file.write_text(yaml.safe_dump(settings))
    line = refused(call("run", file, "--out", out))
    assert "Python code outside homeward" in line
    assert "--estimator mine_here:make" in line
    assert not Path("executed").exists()
    assert "--estimator" in refused(call("run", file, "--estimator", "ekf", "--out", out))
    call("run", file, "--estimator", "mine_here:make", "--out", out)
    assert Path("executed").exists()


def test_real_drive_runs_to_the_end(data_dir, tmp_path):
    out = tmp_path / "out"
    drive = data_dir / "MRCLAM_Dataset6"
    if not drive.is_dir():
        pytest.skip("no MRCLAM_Dataset6 in the data folder")
    home = ["--home", "2.0,0.0,0.3", "--home-noise-deg", "0.5"]
    robot = tmp_path / "robot"
    done(call("import", "mrclam", drive, "--robot", "2", *home, "--out", robot))
    done(call("run", robot, "--estimator", "ekf", "--out", out))
    with (out / "estimate.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert all(math.isfinite(float(v)) for r in rows for k, v in r.items() if k != "status")
    metrics = json.loads((out / "metrics.json").read_text())
    assert metrics["duration_s"] == pytest.approx(886, abs=1)
    # Dead reckoning from the true start is off by metres in the end.
    assert metrics["position_rmse_m"] < 2.0
    line = refused(call("run", drive, "--out", tmp_path / "b"))
    assert f"homeward import mrclam {drive.resolve()} --robot 1 --home" in line


def test_without_a_compiler_the_run_names_the_engine_that_ran(short, tmp_path, monkeypatch):
    monkeypatch.setenv("CC", str(tmp_path / "nothing"))
    out = tmp_path / "out"
    result = done(call("run", short, "--estimator", "ekf", "--set", "engine=native", "--out", out))
    said = [line for line in result.stdout.splitlines() if "interpreter" in line]
    assert len(said) == 1
    assert yaml.safe_load((out / "run.yaml").read_text())["settings"]["engine"] == "interpreter"
