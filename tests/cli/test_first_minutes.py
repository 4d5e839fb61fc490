"""What a new user types first: help, versions, defaults, exit statuses, and mistakes."""

import dataclasses
import os
import pty
import re
import shutil
import signal
import subprocess
import sys
import time
import tomllib
from pathlib import Path

import numpy as np
import pytest
import typer
import yaml
from commands import call, done, first_seconds, refused
from lab.studies.chores import draw_no_figures, in_this_process
from typer.testing import CliRunner

import homeward
from homeward import core
from homeward.cli import options as terminal
from homeward.cli.main import app
from homeward.cli.settings import OTHERS, other_model
from homeward.drives.drive import Sightings
from homeward.errors import InputError, missing_extra_error, needs_extra
from homeward.io.models import ANY, keys
from homeward.io.settings import nested, validated
from homeward.registry import ESTIMATORS, settings_model
from homeward.runs import single_run

ROOT = Path(__file__).resolve().parents[2]
NAMES = [name for name in typer.main.get_command(app).commands if name != "place"]


def program(*words, **options):
    return subprocess.Popen([sys.executable, "-m", "homeward", *map(str, words)], **options)


def on_terminal(width, *words):
    """What a command shows on a terminal so wide."""
    ours, theirs = pty.openpty()
    given = {**os.environ, "COLUMNS": str(width), "TERM": "xterm"}
    with program(*words, stdout=theirs, stderr=subprocess.DEVNULL, env=given) as running:
        os.close(theirs)
        shown = b""
        try:
            while piece := os.read(ours, 65536):
                shown += piece
        except OSError:  # the other end is closed
            pass
        running.wait(60)
    os.close(ours)
    return shown.decode()


@pytest.fixture
def short(tmp_path):
    """The first five seconds of the sample drive, and the folder in which commands run."""
    return first_seconds(tmp_path / "short", 5.0)


def test_the_version_is_said_in_every_way():
    (said,) = re.findall(r'^version = "(.*)"', (ROOT / "pyproject.toml").read_text(), re.MULTILINE)
    assert homeward.__version__ == said
    assert call("--version").stdout == f"homeward {said} ({core.description()})\n"
    reported = subprocess.run(
        [sys.executable, "-m", "homeward", "--version"], capture_output=True, text=True, check=True
    )
    assert reported.stdout == f"homeward {said} ({core.description()})\n"
    assert f"version: {said}\n" in (ROOT / "CITATION.cff").read_text()


def test_what_can_be_imported_is_listed_and_there():
    assert {"open_drive", "run", "make_estimator", "score", "__version__"} <= set(dir(homeward))
    assert {"Localizer", "HomeBearing", "ekf", "smooth", "Estimate"} <= set(homeward.__all__)
    assert all(getattr(homeward, name) is not None for name in dir(homeward))


def test_what_is_not_asked_for_is_not_imported():
    names = (
        "import sys, homeward; print(sorted(m for m in sys.modules if m.startswith('homeward')))"
    )
    reported = subprocess.run(
        [sys.executable, "-c", names], capture_output=True, text=True, check=True
    )
    assert reported.stdout == "['homeward']\n"


def test_the_sample_is_opened_from_python_by_its_name(tmp_path, monkeypatch):
    assert homeward.open_drive("sample").sightings.t.size > 1000
    monkeypatch.chdir(tmp_path)
    Path("sample").mkdir()
    with pytest.raises(InputError, match="neither"):
        homeward.open_drive("sample")


@pytest.mark.parametrize("name", NAMES)
def test_every_command_has_help_with_the_exit_statuses(name):
    shown = call(name, "-h").stdout
    assert shown == call(name, "--help").stdout
    assert "1 no result" in " ".join(shown.split())


@pytest.mark.parametrize("width", [50, 80])
def test_help_is_wrapped_at_words_and_never_cut(width):
    assert "130 interrupted" in " ".join(call("-h").stdout.split())
    for words in ([], *([name] for name in NAMES)):
        shown = call(*words, "--help", terminal_width=width).stdout
        assert shown.startswith("Usage: homeward"), words
        assert all(len(line.rstrip()) <= width for line in shown.splitlines()), words
        for several in (
            "[ARGS]...",
            "{files}...",
            "files... ",
            "{drives}...",
            "drives... ",
            "--set ...",
        ):
            shown = shown.replace(several, "")
        assert "..." not in shown


def test_output_is_wrapped_at_words_and_notes_are_highlighted(short, tmp_path):
    width = 32
    (short / "drive.yaml").write_text("sensor: {x: 0.2}\n")
    shown = on_terminal(width, "run", short, "--estimator", "ekf", "--out", tmp_path / "o")
    assert "\x1b[33m\x1b[1mNote: " in shown
    plain = re.sub(r"\x1b\[\d*m", "", shown)
    assert "which biases every bearing." in " ".join(plain.split())
    assert all(len(line) <= width or " " not in line.strip() for line in plain.splitlines())


def test_a_table_too_wide_for_the_terminal_becomes_a_list(short):
    assert re.search(r"odometry.csv +t,v,omega +101", on_terminal(90, "info", short))
    shown = on_terminal(40, "info", short)
    assert "odometry.csv: columns t,v,omega, stamps" in shown
    assert all(len(line) <= 40 or " " not in line.strip() for line in shown.splitlines())


def test_rows_of_a_list_are_indented_and_begin_with_their_first_cell(monkeypatch, capsys):
    monkeypatch.setattr(terminal, "_width", lambda stream: 30)
    head = ["scenario", "estimator", "RMSE [m]", "heading [deg]"]
    terminal.table([head, ["wide hall", "ekf", "0.1", "2"], ["", "robust", "", "1"]])
    assert capsys.readouterr().out.splitlines() == [
        "wide hall: estimator ekf, RMSE",
        "  [m] 0.1, heading [deg] 2",
        "estimator robust, heading",
        "  [deg] 1",
    ]


def test_shell_completion_can_be_shown(monkeypatch):
    # It is the shell among its parents that a command would ask; tests may have none.
    monkeypatch.setattr("shellingham.detect_shell", lambda: ("bash", "/bin/bash"))
    reported = CliRunner().invoke(app, ["--show-completion"], env={"SHELL": "/bin/bash"})
    assert "complete" in reported.output


def test_without_out_a_run_goes_where_its_drive_is_named(short, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("out", "demo").mkdir(parents=True)  # as after make demo
    assert "Report: out/short/report.html" in call("run", short).stdout
    assert "Report: out/short/report.html" in call("run", "short").stdout
    shutil.copytree(short, Path("out", "drive"))
    assert "Report: out/drive-run/report.html" in call("run", "out/drive").stdout
    assert not Path("out", "drive", "run.yaml").exists()


def test_a_drive_of_the_same_name_gets_a_folder_of_its_own(short, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    other = shutil.copytree(short, tmp_path / "other" / "short")
    for _ in range(2):  # the second time each finds its own
        assert "Report: out/short/report.html" in call("run", short).stdout
        assert "Report: out/short-run/report.html" in call("run", other).stdout
    third = shutil.copytree(short, tmp_path / "third" / "short")
    assert "Report: out/short-2/report.html" in call("run", third).stdout
    Path("out").rename("elsewhere")
    Path("out").touch()
    assert "not a folder" in call("run", short).stderr


BAD_INPUTS = [
    (["run", "bad"], "bearings.csv, row 3"),
    (["plan", "--drive", "bad"], "bearings.csv, row 3"),
    (["plan", "off.yaml"], "outside the outline"),
    (["compare", "a.png", "b.png"], "a.png"),
    (["see", "short"], "images.csv"),
    (["convert", "bad", "--"], "bearings.csv, row 3"),
]


@pytest.mark.parametrize(("words", "fragment"), BAD_INPUTS, ids=lambda v: " ".join(v))
def test_inputs_are_checked_before_outputs(short, tmp_path, monkeypatch, words, fragment):
    monkeypatch.chdir(tmp_path)
    shutil.copytree(short, "bad")
    rows = Path("bad", "bearings.csv").read_text().splitlines()
    rows[2] = "0.1,L01,north"
    Path("bad", "bearings.csv").write_text("\n".join(rows))
    plan = {"outline": [[0, 0], [4, 0], [4, 4], [0, 4]], "landmarks": {"a": [9, 9]}}
    Path("off.yaml").write_text(yaml.safe_dump({**plan, "home": {"x": 1, "y": 1}}))
    Path("full").mkdir()
    Path("full", "thesis.tex").write_text("irreplaceable")
    out = ["full"] if words[0] == "convert" else ["--out", "full"]
    assert fragment in refused(call(*words, *out))
    assert [file.name for file in Path("full").iterdir()] == ["thesis.tex"]


def test_where_nothing_can_be_written_a_run_does_not_begin(short, tmp_path, monkeypatch):
    monkeypatch.setattr(single_run, "follow", None)  # would fail
    (tmp_path / "notes").touch()
    assert "is not a folder" in refused(call("run", short, "--out", tmp_path / "notes" / "out"))
    assert "is not a folder" in refused(call("run", short, "--out", tmp_path / "notes"))
    monkeypatch.setattr(os, "access", lambda path, how: path != tmp_path)  # root may write anywhere
    assert "is not writable" in refused(call("run", short, "--out", tmp_path / "a" / "b"))
    assert sorted(p.name for p in tmp_path.iterdir()) == ["notes", "short"]


def test_no_pose_is_no_answer(short, tmp_path):
    (short / "home.csv").write_text("landmark,bearing\nelsewhere,0.3\n")
    (short / "drive.yaml").unlink()
    result = call("run", short, "--out", tmp_path / "out")
    assert "No pose found" in result.stdout
    assert result.exit_code == 1
    (short / "truth.csv").unlink()
    result = call("plan", "--drive", short, "--out", tmp_path / "o")
    assert "found no pose" in result.stderr
    assert result.exit_code == 1


def test_pictures_in_which_nothing_is_found_are_no_answer(short, tmp_path, monkeypatch):
    blind = dataclasses.replace(homeward.open_drive(short), sightings=Sightings(*[np.empty(0)] * 4))
    monkeypatch.setattr(single_run, "open_drive", lambda *place, **choices: blind)
    (tmp_path / "images.csv").touch()
    result = call("run", tmp_path, "--out", tmp_path / "out")
    assert "no landmark was found in its images" in result.stderr
    assert result.exit_code == 1
    assert "no sightings of landmarks in it" in refused(call("run", short))


def test_a_study_whose_every_run_fails_is_no_answer(tmp_path, monkeypatch):
    monkeypatch.setattr("homeward.lab.studies.blocks.finish.on_processes", in_this_process)
    draw_no_figures(monkeypatch)
    study = {"runs": 1, "scenario": "warehouse", "loop": "open", "estimators": ["ekf"]}
    study["set"] = {"start.prior": False, "trajectory.duration": 2.0}
    (tmp_path / "failing.yaml").write_text(yaml.safe_dump(study))
    result = call("study", tmp_path / "failing.yaml", "--out", tmp_path / "out")
    assert "1 failed" in result.stdout, result.output
    assert result.exit_code == 1


@pytest.mark.parametrize("when", [0.05, 1.5])
def test_ctrl_c_ends_with_one_line_and_130(when, tmp_path):
    words = ["simulate", "circle", "--set", "trajectory.duration=100000", "--out", tmp_path / "x"]
    # Background jobs ignore SIGINT, and so do their children.
    heard = {"preexec_fn": lambda: signal.signal(signal.SIGINT, signal.SIG_DFL)}
    with program(*words, stderr=subprocess.PIPE, text=True, **heard) as running:
        time.sleep(when)
        # While Python itself starts, before a line of ours runs, its own word is a traceback.
        while not Path(f"/proc/{running.pid}/maps").read_text().count("numpy"):
            time.sleep(0.01)
        running.send_signal(signal.SIGINT)
        try:
            said = running.communicate(timeout=30.0)[1]
        except subprocess.TimeoutExpired:
            # CPython prints and drops what is raised in the callback of a weak reference, as a
            # module is imported: then one presses again.
            running.send_signal(signal.SIGINT)
            said = running.communicate(timeout=30.0)[1]
            assert "Exception ignored in" in said
            said = said.splitlines(keepends=True)[-1]
        # 130 in a shell either way: where it comes within code that is run from a string, as a
        # dataclass is made, CPython ends by the signal itself, though it was caught.
        assert running.wait(60) in (130, -signal.SIGINT), said
    assert said in ("homeward: stopped\n", "")  # typer prints nothing while it parses


def test_what_an_extra_needs_is_said_with_a_way_that_works():
    pyproject = tomllib.loads((ROOT / "pyproject.toml").read_text())
    extras = pyproject["project"]["optional-dependencies"]
    sources = "\n".join(file.read_text() for file in (ROOT / "src").rglob("*.py"))
    named = set(re.findall(r'needs_extra\("[^"]+", "(\w+)"\)', sources))
    for package in ("bokeh.plotting", "casadi", "dask", "rosbags.typesys", "paho", "websockets"):
        reported = missing_extra_error(ModuleNotFoundError(name=package))
        named |= set(re.findall(r"the extra (\w+)", str(reported)))
    assert missing_extra_error(ModuleNotFoundError(name="nobody")) is None
    reported = {"bags", "filters", "fleet", "live", "report", "scale", "vision"}
    assert named == reported == set(extras) - {"bench", "demo-physics", "dev", "docs"}
    line = str(needs_extra("images", "vision"))
    assert "pip install -c constraints.txt -e '.[vision]'" in line
    assert (ROOT / "constraints.txt").is_file()
    everything = sources + "\n".join(file.read_text() for file in ROOT.glob("*.md"))
    everything += "\n".join(file.read_text() for file in (ROOT / "docs").rglob("*.md"))
    assert "pip install 'homeward[" not in everything  # nothing is published under that name


def test_settings_are_listed_for_all_that_has_any():
    listed = call("settings").stdout
    assert all(f"homeward settings {name}" in listed for name in OTHERS)
    every = {name: {k.name for k in keys(other_model(name))} for name in OTHERS}
    pattern = re.compile(r"^(\S*)\*  # as (?:`(\w+)` of )?`homeward settings (\w+)`$", re.M)
    for name in OTHERS:
        reported = call("settings", name).stdout
        elsewhere = {
            head + key.removeprefix(f"{part}." if part else "")
            for head, part, other in pattern.findall(reported)
            for key in every[other]
            if key.startswith(part)
        }
        for key in every[name]:
            assert f"{key}=" in reported or key in elsewhere, (name, key)
    assert "window=40  # Keyframes" in call("settings", "robust").stdout
    assert "choose one of: robust" in refused(call("settings", "kalman"))


@pytest.mark.parametrize("name", ESTIMATORS)
def test_every_default_that_is_listed_can_be_set(name):
    model = settings_model(name)
    listed = {key.name: yaml.safe_load(key.default) for key in keys(model) if ANY not in key.name}
    assert validated(model, nested(listed)) == model()


def test_listed_defaults_are_those_of_the_model_that_holds_them():
    reported = {key.name: key.default for key in keys(other_model("rooms"))}
    assert reported["rates.truth"] == "20.0"  # a room's, not those of any drive
    assert reported["boxes.*.at"] == "needed"


def test_the_help_is_one_screen_in_groups():
    shown = call("--help", terminal_width=80).stdout
    assert len(shown.splitlines()) < 42
    titles = [line for line in shown.splitlines() if line.endswith(":") and line[0] != " "]
    assert titles == ["Options:", "Your robot:", "Design and research:", "Files:"]
    assert all(f"  {name} " in shown for name in NAMES)


def test_a_run_ends_with_the_next_command(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    short = first_seconds(tmp_path / "short", 40.0)
    said = call("run", short).stdout.splitlines()
    assert said[-1] == "Next: homeward tune short"
    (tmp_path / "robot.yaml").write_text("sensor: {bearing_sigma: 0.01}\n")
    said = call("run", short, "--robot-file", "robot.yaml").stdout.splitlines()
    assert said[-1] == "Next: homeward live --tcp 7707 --robot-file robot.yaml"


def test_the_note_on_scale_comes_once_for_a_robot(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    short = first_seconds(tmp_path / "short", 20.0)
    (short / "drive.yaml").write_text("sensor: {x: 0.2}\n")
    assert "One measured distance removes it" in call("run", short).stdout
    (tmp_path / "robot.yaml").write_text("sensor: {bearing_sigma: 0.01}\n")
    later = done(call("run", short, "--robot-file", "robot.yaml")).stdout
    assert "One measured distance" not in later
