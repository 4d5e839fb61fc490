"""The wheel where there is no compiler: the core alone, then with the C that came with it.

`make test-wheel` builds it and sets HOMEWARD_WHEEL; for another machine, also HOMEWARD_PYTHON, the
command that runs its Python.
"""

import json
import os
import shlex
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
from dataclasses import astuple

import numpy as np

from homeward.geometry.frames import Polar, from_polar
from homeward.lab.simulation.render.drive import Eye
from homeward.lab.simulation.render.rays.raycast import compiled as rays
from homeward.lab.simulation.render.room.presets import room
from homeward.vision import Equirectangular, compare, extract
from homeward.vision.compiled import compiled as vision

eye = Eye(room("office", 1))
start = eye.scenario.start
pose = from_polar(Polar(start.R, start.theta, start.alpha))
pictures = [np.asarray(p) for p in (eye.home_picture(), eye.look(0.0, pose, 1))]
greys = [np.rint(p.mean(axis=2)).astype(np.uint8) for p in pictures]
found = compare(*(extract(grey, Equirectangular()) for grey in greys), Equirectangular())
files = [program()._name for program in (rays, vision)]
numbers = {"heading": found.heading, "home_direction": found.home_direction}
numbers["covariance"] = found.covariance
np.savez(sys.argv[1], *pictures, files=files, **numbers)
"""


@pytest.fixture(scope="module")
def wheel():
    if "HOMEWARD_WHEEL" not in os.environ:
        pytest.skip("a wheel in an environment of its own: make test-wheel")
    (file,) = Path(os.environ["HOMEWARD_WHEEL"]).resolve().glob("*.whl")
    return file


class Environment(NamedTuple):
    """A Python, the folder of all its packages, and pip's words for it."""

    python: list[str]
    packages: Path
    pip: list[str]

    def install(self, what):
        pip = [sys.executable, "-m", "pip", *self.pip, "--quiet", "--disable-pip-version-check"]
        pip += ["--no-compile", "-c", "constraints.txt", what]
        done = subprocess.run(pip, cwd=ROOT, capture_output=True)
        if done.returncode:
            pytest.skip(f"cannot be installed here: {done.stderr.decode().splitlines()[-1]}")

    def call(self, code, *words, cwd):
        """Run code that may start no program, and would find none."""
        env = {"PATH": "", "PYTHONPATH": str(self.packages)}
        return called(self.python, STARTS_NOTHING + code, *words, cwd=cwd, **env)


@pytest.fixture(scope="module")
def core(wheel, tmp_path_factory):
    """An environment with the wheel's core alone."""
    place = tmp_path_factory.mktemp("environment")
    if "HOMEWARD_PYTHON" in os.environ:
        python, machine = shlex.split(os.environ["HOMEWARD_PYTHON"]), wheel.stem.rpartition("_")[2]
        asked = [*python, "-c", "import sys; print('%d.%d' % sys.version_info[:2])"]
        version = subprocess.run(asked, check=True, capture_output=True, text=True).stdout.strip()
        packages = place / "packages"
        pip = ["install", "--only-binary=:all:", "--python-version", version]
        pip += [f"--platform=manylinux_2_{minor}_{machine}" for minor in range(17, 37)]
        pip += ["--upgrade", "--target", str(packages)]
    else:
        subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(place)], check=True)
        python = [str(place / "bin" / "python")]
        packages = Path(sysconfig.get_path("purelib", vars={"base": str(place)}))
        pip = ["--python", *python, "install"]
    made = Environment(python, packages, pip)
    made.install(str(wheel))
    return made


def called(python, code, *words, cwd, **env):
    """Run code in a Python and a folder."""
    bare = {"HOME": str(cwd), "OPENBLAS_NUM_THREADS": "1"} | env
    command = [*python, "-c", code, *words]
    done = subprocess.run(command, cwd=cwd, env=bare, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


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


def test_what_came_compiled_answers_as_what_is_compiled_here(wheel, core, tmp_path):
    if wheel.name.endswith("-any.whl"):
        pytest.skip("no C compiler: the wheel is pure")
    core.install(f"{wheel}[vision]")
    core.call(LOOK, "wheel.npz", cwd=tmp_path)
    assert not (tmp_path / ".cache").exists()  # nothing was compiled
    here = [sys.executable], "import sys" + LOOK, "here.npz"
    called(*here, cwd=tmp_path, PATH=os.environ["PATH"])
    came, made = np.load(tmp_path / "wheel.npz"), np.load(tmp_path / "here.npz")
    assert all(str(file).endswith("native/prebuilt.so") for file in came["files"])
    assert all(".cache" in str(file) for file in made["files"])
    equal = all(np.array_equal(came[key], made[key]) for key in made if key != "files")
    print(f"\n{wheel.name}: answers are equal", "bit for bit" if equal else "but for rounding")
    for key in ("arr_0", "arr_1"):  # of other vectors another last digit may come
        assert np.mean(came[key] != made[key]) < 1e-3
    for key in ("heading", "home_direction", "covariance"):
        np.testing.assert_allclose(came[key], made[key], rtol=1e-5)


def test_without_a_compiler_the_wheel_is_pure(wheel, tmp_path):
    command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "-w", str(tmp_path)]
    bare = os.environ | {"PATH": "", "CC": ""}
    done = subprocess.run([*command, str(ROOT)], env=bare, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert [file.name for file in tmp_path.iterdir()] == ["homeward-0.1.0-py3-none-any.whl"]
