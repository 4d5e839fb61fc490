"""`--json`: output of commands for programs, and its page."""

import json
import re
from pathlib import Path

import pytest
import typer
from commands import call, first_seconds

from homeward.cli.main import app

PAGE = (Path(__file__).resolve().parents[2] / "docs/look-up/files.md").read_text("utf-8")


def documented(command, part=0):
    """Keys of the tables below a command's heading, of one level, without those of arrays."""
    text = re.search(rf"## homeward {command} --json\n(.*?)\n## ", PAGE, re.DOTALL)[1]
    tables = re.findall(r"\| key \|.*?(?=\n\n|$)", text, re.DOTALL)
    cells = re.findall(r"^\| (`.*?) \|", tables[part], re.MULTILINE)
    names = [name for cell in cells for name in re.findall(r"`(.*?)`", cell)]
    return {re.split(r"[.\[]", name)[0] for name in names} - {""}


def said(*words, status=0):
    done = call(*words, "--json")
    assert done.exit_code == status, done.output
    return json.loads(done.stdout)


WRITE = {"studio", "convert", "export", "live"}
"""What these make are files, pages or a talk."""
WRITE |= {f"place {name}" for name in ("view", "merge", "forget", "undo", "serve", "broker-config")}


def test_all_commands_that_answer_do_so_for_programs():
    command = typer.main.get_command(app)
    every = {
        " ".join(filter(None, (name, inner))): one
        for name, group in command.commands.items()
        for inner, one in getattr(group, "commands", {"": group}).items()
    }
    answers = {n for n, c in every.items() if any(p.name == "json" for p in c.params)}
    assert every.keys() - answers == WRITE
    assert answers == set(re.findall(r"^## homeward ([\w ]+) --json$", PAGE, re.MULTILINE))
    listed = PAGE.partition("Results for programs")[2].partition("have `--json`")[0]
    assert answers == set(re.findall(r"`([a-z ]+)`", listed))


def test_an_import_and_a_simulation(drive, tmp_path):
    files = [drive / f"{name}.csv" for name in ("odometry", "bearings", "home")]
    result = said("import", *files, "--picture", tmp_path / "i.png", "--out", tmp_path / "i")
    assert set(result) == documented("import")
    assert [c["as"] for c in result["columns"] if c["is"] == "odometry"] == ["t", "v", "omega"]
    assert Path(result["folder"]).is_dir()
    assert result["next"] == f"homeward run {tmp_path / 'i'}"
    result = said("import", *files, "--picture", tmp_path / "i.png")
    assert result["next"].endswith("home.csv --out out/drive")
    result = said("simulate", "circle", "--out", tmp_path / "s")
    assert set(result) == documented("simulate")
    assert result["moved"].keys() <= set(result["landmarks"])


@pytest.fixture
def drive(tmp_path):
    return first_seconds(tmp_path / "drive", 20.0)


def test_a_run(drive, tmp_path):
    result = said("run", drive, "--out", tmp_path / "run")
    assert set(result) == documented("run")
    assert result["metrics"] == json.loads((tmp_path / "run" / "metrics.json").read_text())
    assert {m["landmark"] for m in result["landmarks"] if m["moved"]} <= {"L01", "L02", "L08"}


def test_several_estimators(drive, tmp_path):
    result = said("run", drive, "--estimator", "ekf,ukf", "--out", tmp_path / "runs")
    assert set(result) == documented("run", 1)
    first, second = result["runs"]
    assert first["metrics"]["position_rmse_m"] < 1
    assert first["failure"] is None
    assert second["estimator"] == "ukf"


def test_what_bearings_determine(drive, tmp_path):
    result = said("plan", "--landmarks", "2", "--out", tmp_path / "model")
    assert set(result) == documented("plan", 2)
    assert (result["rank"], result["unknowns"]) == (4, 5)
    result = said("plan", "--drive", drive, "--window", "20", "--out", tmp_path / "observed")
    assert set(result) == documented("plan", 3)
    assert result["whole"]["position_sigma_m"] > 0


def test_a_plan(tmp_path):
    plans = Path(__file__).resolve().parents[2] / "src/homeward/data/plans"
    coarse = tmp_path / "coarse.yaml"
    coarse.write_text((plans / "warehouse.yaml").read_text().replace("grid: 0.1", "grid: 2.0"))
    result = said("plan", coarse, "--out", tmp_path / "plan")
    assert set(result) == documented("plan")
    assert 0 <= result["safe_share"] <= result["share"] <= 1
    assert all(m["share_without"] <= result["share"] for m in result["landmarks"])
    result = said("plan", coarse, "--from", "5,3")
    assert set(result) == documented("plan", 1)
    assert result["begins"]


def test_settings():
    result = said("settings", "ekf")
    assert set(result) == documented("settings")
    plain = call("settings", "ekf").output
    assert all(f"{key['name']}={key['default']}" in plain for key in result["keys"])
    assert {"robust", "ekf", "plan"} <= set(said("settings")["settings"])
