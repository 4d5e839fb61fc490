"""What runs on a robot that has the core alone, and what is said of the rest."""

import json
import subprocess
import sys

CORE = """
import sys


class Absent:
    NAMES = "PIL apsw backports bokeh casadi cv2 dask jinja2 lz4 markupsafe matplotlib paho pandas"
    NAMES = [*NAMES.split(), "rosbags", "ruamel", "shapely", "websockets", "xarray"]

    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in self.NAMES:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)


sys.meta_path.insert(0, Absent())
"""
LIBRARY = """
from homeward import Localizer, open_drive, run, save_drive
from homeward.drives.drive import Sightings
from homeward.errors import InputError
from homeward.live.messages import BearingsIn, OdometryIn
from homeward.live.session import Session

drive = open_drive("sample")
session = Session(homes={"home": drive.home}, robot=drive.settings)
for t, *twist in zip(*(x[:400].tolist() for x in vars(drive.odometry).values()), strict=True):
    session.receive(OdometryIn(t=t, v=twist[0], omega=twist[1], vy=twist[2]), t)
    list(session.process())
for t, seen, _ in list(drive.sightings.stamps())[:80]:
    session.receive(BearingsIn(t=t, bearings=seen), t)
list(session.process())
print(session.localisation.fix.estimate.status.value, "scipy.stats" in sys.modules)
try:
    from homeward import ekf
except InputError as error:
    print(error)
"""
SEVERAL = """
import json
import os

from typer.testing import CliRunner

from homeward.cli.main import app

results = []
for k, words in enumerate(json.loads(sys.argv[1])):
    os.mkdir(str(k))
    os.chdir(str(k))
    done = CliRunner().invoke(app, words)
    results.append((done.exit_code, done.output, os.listdir()))
    os.chdir("..")
print(json.dumps(results))
"""
NEEDS = {
    ("run", "sample", "--estimator", "robust,ekf"): "report",
    ("convert", "sample", "sample.mcap"): "bags",
    ("simulate", "living-room", "--images", "--out", "out"): "vision",
    ("settings", "rooms"): "vision",
    ("plan", "--landmarks", "3"): "filters",
    ("export", "ekf", "--landmarks", "3", "--out", "out"): "filters",
    ("live", "--websocket", "0"): "live",
}
"""Commands, and the extra that each needs."""
NEEDS_NONE = (
    ("info", "sample"),
    ("convert", "sample", "drive"),
    ("settings",),
    ("settings", "robust"),
)


def alone(code, *words, core=CORE, cwd=None):
    """Run Python as where nothing but the core is installed."""
    done = [sys.executable, "-c", core + code, *words]
    return subprocess.run(done, capture_output=True, text=True, cwd=cwd, check=False)


def commands_alone(folder, *commands):
    """Exit status, output and files written of commands where nothing but the core is installed."""
    done = alone(SEVERAL, json.dumps(commands), cwd=folder)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_the_localiser_and_live_sessions_need_the_core_alone():
    done = alone(LIBRARY)
    assert done.returncode == 0, done.stderr
    status, told = done.stdout.splitlines()
    assert status in ("mapping False", "localised False", "unverified False")  # it takes a second
    assert "the extra filters" in told


def test_a_robot_needs_numpy_scipy_and_yaml_alone():
    others = "PIL click pydantic rich threadpoolctl typer typing_extensions"
    done = alone(LIBRARY, core=CORE.replace("PIL", others))
    assert done.returncode == 0, done.stderr


def test_without_the_packages_of_commands_one_line_says_what_to_install():
    program = "sys.argv = ['homeward', 'run', 'sample']\nimport homeward.__main__ as m\nm.main()"
    done = alone(program, core=CORE.replace("PIL", "PIL typer"))
    assert done.returncode == 2
    said = "homeward: typer is not installed; the commands need: pip install typer rich"
    assert done.stderr.startswith(said)
    assert len(done.stderr.splitlines()) == 1


def test_a_command_says_in_one_line_which_extra_it_needs(tmp_path):
    results = commands_alone(tmp_path, *NEEDS, *NEEDS_NONE)
    for (words, extra), (status, said, written) in zip(NEEDS.items(), results, strict=False):
        assert status == 2, words
        (line,) = said.splitlines()
        assert f"need the extra {extra}" in line
        assert written == []
    # Folders of tables and settings need the core alone.
    for words, (status, said, _) in zip(NEEDS_NONE, results[len(NEEDS) :], strict=True):
        assert status == 0, (words, said)


def test_a_run_needs_the_core_alone_and_leaves_no_page_of_another(tmp_path):
    drive, out = str(tmp_path / "drive"), tmp_path / "out"
    words = ("run", drive, "--out", str(out))
    out.mkdir()
    for name in ("run.yaml", "report.html", "run.mcap"):
        (out / name).touch()
    simulated = ("simulate", "circle", "--set", "trajectory.duration=20", "--out", drive)
    results = commands_alone(tmp_path, simulated, words, (*words, "--json"))
    assert [status for status, *_ in results] == [0, 0, 0], results
    _, (_, said, _), (_, facts, _) = results
    assert f"Files: {out}" in " ".join(said.split())
    reason = "no report.html and no run.mcap: pages and pictures need the extra report"
    assert reason in " ".join(said.split())
    written = {file.name for file in out.iterdir()}
    assert written == {
        *("estimate.csv", "landmarks.csv", "metrics.json", "run.yaml", "trajectory.tum")
    }
    assert json.loads(facts)["report"] is None
