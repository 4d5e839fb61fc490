"""Estimators of other packages: found, held to the protocol, and their faults told in one line."""

import importlib
import re
import shutil
import subprocess
import sys
import tomllib
from dataclasses import replace
from pathlib import Path

import pytest
from cli.commands import call, done, first_seconds, refused

from homeward.drives.opening import open_drive
from homeward.errors import InputError
from homeward.registry import estimator_names, make_estimator, needs_start
from homeward.track import run

TEMPLATE = Path(__file__).parents[1] / "docs" / "do" / "estimator"
GOOD = """
from homeward.io.models import Strict
from homeward.estimator import Counts, Estimate, Status
from homeward.geometry.frames import Pose

class Settings(Strict):
    x: float = 1.0

class Mine:
    name, notes = "mine", ()
    def __init__(self, drive, x=1.0):
        self.counts, self.x = Counts(), x
    def odometry(self, t, v, omega): pass
    def bearings(self, t, sightings, sigmas=None): return self.estimate(t)
    def estimate(self, t):
        sure = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]
        return Estimate(t, Status.LOCALISED, "said so", (self.x, 0, 0), sure)
    def landmarks(self): return []

def make(drive, settings: Settings): return Mine(drive, settings.x)
class Late(Mine):
    def bearings(self, t, sightings, sigmas=None): return 1 / 0
class Wordless(Mine):
    def estimate(self, t): return (0, 0, 0)
class Infinite(Mine):
    def estimate(self, t):
        return Estimate(t, Status.LOCALISED, "", Pose(float("nan"), 0, 0), [[1] * 3] * 3)
class Half(Mine):
    def estimate(self, t): return Estimate(t, Status.LOCALISED, "", Pose(0, 0, 0))
class Unborn(Mine):
    def __init__(self, drive): raise KeyError("nothing\\nhere")
class Quits(Mine):
    def __init__(self, drive): raise SystemExit(3)
class Strings(Mine):
    def __init__(self, drive):
        super().__init__(drive)
        self.counts.rejected["because"] = 1
class NoLandmarks(Mine):
    landmarks = property()
def nothing(drive): return None
def unreadable(drive, settings: "Nowhere"): return None
NUMBER = 3
"""


@pytest.fixture
def mine(tmp_path, monkeypatch):
    """A module in a folder that is looked into."""
    (tmp_path / "mine.py").write_text(GOOD)
    (tmp_path / "broken.py").write_text("import no_such_thing\n")
    (tmp_path / "odd.py").write_text("x = 1\nx.y\n")
    monkeypatch.syspath_prepend(tmp_path)
    yield
    for name in ("mine", "broken", "odd"):
        sys.modules.pop(name, None)


@pytest.fixture(scope="module")
def short(tmp_path_factory):
    return first_seconds(tmp_path_factory.mktemp("drives") / "short", 3.0)


@pytest.fixture
def installed(tmp_path, monkeypatch):
    """The template, as `pip install --target` leaves it."""
    project = tomllib.loads((TEMPLATE / "pyproject.toml").read_text())
    points = project["project"]["entry-points"]["homeward.estimators"]
    (name,) = project["tool"]["setuptools"]["py-modules"]
    shutil.copy(TEMPLATE / f"{name}.py", tmp_path)
    info = tmp_path / "dead_reckoning-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: dead-reckoning\nVersion: 1.0\n")
    lines = [f"{key} = {value}" for key, value in points.items()]
    (info / "entry_points.txt").write_text("\n".join(["[homeward.estimators]", *lines]))
    monkeypatch.syspath_prepend(tmp_path)
    importlib.invalidate_caches()
    yield tmp_path
    sys.modules.pop(name, None)


def test_the_template_runs_in_a_process_of_its_own_once_installed(installed, short, tmp_path):
    out = tmp_path / "out"
    words = ["run", str(short), "--estimator", "dead-reckoning", "--out", str(out)]
    done = subprocess.run(
        [sys.executable, "-m", "homeward", *words],
        env={"PYTHONPATH": str(installed), "PATH": "/usr/bin:/bin"},
        cwd="/",
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert "Position error" in done.stdout
    assert (out / "run.yaml").is_file()


def test_an_installed_estimator_is_one_of_all(installed):
    assert "dead-reckoning" in estimator_names()
    assert needs_start("dead-reckoning")
    drive = open_drive("sample")
    track = run(drive, make_estimator("dead-reckoning", drive))
    assert track.has_pose.all()
    assert "dead-reckoning" in refused(call("run", "sample", "--estimator", "dead"))
    listed = call("settings")
    assert "--estimator dead-reckoning" in listed.stdout


def test_an_estimator_of_any_module_takes_its_own_settings(mine, short, tmp_path):
    out = tmp_path / "out"
    done(call("run", short, "--estimator", "mine:make", "--set", "x=2.5", "--out", out))
    assert ",2.5,0,0," in (out / "estimate.csv").read_text().splitlines()[1]
    done(call("run", out / "run.yaml", "--estimator", "mine:make", "--out", tmp_path / "again"))
    assert "x=1.0" in call("settings", "mine:make").stdout
    assert "y" in refused(call("run", short, "--estimator", "mine:make", "--set", "y=1"))


def test_an_estimator_without_settings_refuses_any(mine, short):
    words = refused(call("run", short, "--estimator", "mine:Mine", "--set", "y=1"))
    assert "y: unknown key" in words


@pytest.mark.parametrize(
    ("word", "told"),
    [
        ("nowhere:make", "nowhere:make: there is no module nowhere"),
        ("mine.deeper:make", "there is no module mine.deeper"),
        ("broken:make", "no module no_such_thing, which broken imports"),
        ("odd:make", "importing odd raised AttributeError"),
        ("odd:make", "(odd.py, line 2)"),
        ("mine:other", "mine has no other"),
        ("mine:", "no estimator 'mine:': use one of robust"),
        (":make", "no estimator"),
        ("mine:NUMBER", "mine:NUMBER is a int, which cannot be called"),
        ("mine:nothing", "returned a NoneType without name, counts"),
        ("mine:NoLandmarks", "without landmarks"),
        ("mine:Unborn", "making it raised KeyError: 'nothing\\nhere' (mine.py, line"),
        ("mine:Quits", "making it raised SystemExit: 3"),
        ("mine:unreadable", "NameError: name 'Nowhere' is not defined"),
        ("mine:Late", "bearings at 0 s raised ZeroDivisionError: division by zero (mine.py, line"),
        ("mine:Wordless", "returned a tuple, not an Estimate"),
        ("mine:Infinite", "must return a finite pose"),
        ("mine:Half", "must return a finite pose"),
        ("mine:Strings", "counts is not a Counts"),
    ],
)
def test_what_is_wrong_with_an_estimator_is_one_line(mine, short, tmp_path, word, told):
    out = tmp_path / "out"
    assert told in refused(call("run", short, "--estimator", word, "--out", out))
    assert not out.exists()


def test_the_settings_of_the_manual_are_read(installed, short, tmp_path):
    text = (TEMPLATE.parent / "estimators.md").read_text(encoding="utf-8")
    (code,) = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    (installed / "of_the_manual.py").write_text(code)
    words = ["run", short, "--estimator", "of_the_manual:make", "--start", "1,0,0"]
    done(call(*words, "--set", "noise=0.1", "--out", tmp_path / "out"))
    assert "noise: 0.1" in (tmp_path / "out" / "run.yaml").read_text()
    drive = open_drive(short)
    nowhere = replace(drive, settings=drive.settings.model_copy(update={"start": None}))
    with pytest.raises(InputError, match="of_the_manual:make needs a start prior"):
        make_estimator("of_the_manual:make", nowhere)


def test_an_estimator_of_somebody_else_steers(mine, tmp_path):
    words = ["simulate", "paper-homing", "--set", "trajectory.duration=2", "--estimator"]
    done(call(*words, "mine:Mine", "--out", tmp_path / "a"))
    assert "division by zero" in refused(call(*words, "mine:Late", "--out", tmp_path / "b"))
    assert not (tmp_path / "b").exists()
