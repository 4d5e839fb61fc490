"""The wheel where there is no compiler: the core alone, then the compiled core.

`make test-wheel` builds it and sets HOMEWARD_WHEEL.
"""

import json
import os
import subprocess
import sys
import sysconfig
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

ROOT = Path(__file__).parents[1]
LARGEST_MB = 211
"""Of the core's files, with the bytecode of what a run imports (pip adds that of all, 44): 204, of
which NumPy and SciPy are 178, and what the next versions add."""
STARTS_NOTHING = """
import sys

STARTS = {"subprocess.Popen", "os.exec", "os.posix_spawn", "os.system", "os.fork"}


def refuse(event, told):
    if event in STARTS and told[0] != "uname":  # with which Python finds out where it is
        raise SystemExit(f"{event} {told}")


sys.addaudithook(refuse)
"""
ONLINE = """
from homeward import Localizer

home = {"door": 0.31, "lamp": -1.20, "crate 7": 2.75}
localizer = Localizer(home, sensor={"x": 0.2, "bearing_sigma": 0.01})
localizer.odometry(0.00, 0.20, 0.05)
print(localizer.bearings(0.05, {"door": 0.30, "lamp": -1.21}).status.value)
"""
RUN = """
from homeward.__main__ import main

sys.argv[1:] = ["run", "sample", "--json"]
main()
"""
LOOK = """
import json

import numpy as np

from homeward import core
from homeward.lab.simulation.render.drive import Eye
from homeward.lab.simulation.render.room.settings import load_room
from homeward.geometry.frames import Polar, from_polar
from homeward.vision import Equirectangular, compare, extract

eye = Eye(load_room("living-room"))
start = eye.scenario.start
pose = from_polar(Polar(start.R, start.theta, start.alpha))
pictures = [np.asarray(p) for p in (eye.home_picture(), eye.look(0.0, pose, 1))]
greys = [np.rint(p.mean(axis=2)).astype(np.uint8) for p in pictures]
found = compare(*(extract(grey, Equirectangular()) for grey in greys), Equirectangular())
numbers = [found.heading, found.home_direction, np.asarray(found.covariance).tolist()]
print(json.dumps([core.description(), *numbers]))
"""


@pytest.fixture(scope="module")
def wheel():
    if "HOMEWARD_WHEEL" not in os.environ:
        pytest.skip("a wheel in an environment of its own: make test-wheel")
    (file,) = Path(os.environ["HOMEWARD_WHEEL"]).resolve().glob("*.whl")
    return file


class Environment(NamedTuple):
    """A Python and the folder of all its packages."""

    python: Path
    packages: Path

    def install(self, what):
        pip = [sys.executable, "-m", "pip", "--python", str(self.python), "install", "--quiet"]
        pip += ["--disable-pip-version-check", "--no-compile", "-c", "constraints.txt", what]
        done = subprocess.run(pip, cwd=ROOT, capture_output=True)
        if done.returncode:
            pytest.skip(f"cannot be installed here: {done.stderr.decode().splitlines()[-1]}")

    def call(self, code, *words, cwd, **env):
        """Run code that may start no program, and would find none."""
        bare = {"PATH": "", "HOME": str(cwd), "OPENBLAS_NUM_THREADS": "1"} | env
        command = [str(self.python), "-c", STARTS_NOTHING + code, *words]
        done = subprocess.run(command, cwd=cwd, env=bare, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        return done.stdout


@pytest.fixture(scope="module")
def core(wheel, tmp_path_factory):
    """An environment with the wheel's core alone."""
    place = tmp_path_factory.mktemp("environment")
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(place)], check=True)
    packages = Path(sysconfig.get_path("purelib", vars={"base": str(place)}))
    made = Environment(place / "bin" / "python", packages)
    made.install(str(wheel))
    return made


def test_the_core_is_small_and_runs_a_drive(core, tmp_path):
    assert core.call(ONLINE, cwd=tmp_path).strip() == "mapping"
    told = json.loads(core.call(RUN, cwd=tmp_path))
    assert told["report"] is None
    assert told["metrics"]["position_rmse_m"] < 0.1
    assert (tmp_path / "out" / "sample" / "estimate.csv").exists()
    sizes = {}
    for file in core.packages.glob("*/**/*"):
        if file.is_file():
            package = file.relative_to(core.packages).parts[0].partition(".")[0]
            sizes[package] = sizes.get(package, 0.0) + file.stat().st_size / 1e6
    told = ", ".join(f"{n} {s:.1f}" for n, s in sorted(sizes.items(), key=lambda e: -e[1])[:9])
    print(f"\nthe core takes {sum(sizes.values()):.0f} MB: {told}, ...")
    assert sum(sizes.values()) < LARGEST_MB


def test_the_compiled_core_answers_as_numpy(wheel, core, tmp_path):
    if wheel.name.endswith("-any.whl"):
        pytest.skip("no C++ compiler: the wheel is pure")
    core.install(f"{wheel}[vision]")
    compiled = json.loads(core.call(LOOK, cwd=tmp_path))
    plain = json.loads(core.call(LOOK, cwd=tmp_path, HOMEWARD_PURE="1"))
    assert (compiled[0], plain[0]) == ("compiled core", "NumPy only: HOMEWARD_PURE is set")
    np.testing.assert_allclose(compiled[1:3], plain[1:3], rtol=0, atol=1e-3)
    np.testing.assert_allclose(compiled[3], plain[3], rtol=0.05, atol=1e-6)


def test_without_a_compiler_the_wheel_is_pure(tmp_path):
    command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "-w", str(tmp_path)]
    none = os.environ | {"CC": "/bin/false", "CXX": "/bin/false"}
    done = subprocess.run([*command, str(ROOT)], env=none, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert [file.name for file in tmp_path.iterdir()] == ["homeward-0.2.0-py3-none-any.whl"]
