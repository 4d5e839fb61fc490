"""What README and docs show must run as it stands there."""

import os
import re
import subprocess
import sys
from pathlib import Path

import nbformat
import numpy as np
import pytest
from cli.commands import first_seconds

from docs.notebooks import notebook

ROOT = Path(__file__).resolve().parents[1]
LESSONS = sorted((ROOT / "docs" / "learn").glob("*.md"))
README = (ROOT / "README.md").read_text(encoding="utf-8")


def blocks(text, language):
    return re.findall(rf"```{language}\n(.*?)```", text, re.DOTALL)


def block(language):
    (found,) = blocks(README, language)
    return found


def doc(name):
    return (ROOT / "docs" / name).read_text(encoding="utf-8")


@pytest.fixture
def short_sample(tmp_path, monkeypatch):
    """Let `sample` be a folder with the first 40 s of that drive."""
    first_seconds(tmp_path / "sample", 40.0)
    monkeypatch.chdir(tmp_path)


@pytest.mark.usefixtures("short_sample")
def test_python_example_runs(capsys):
    exec(compile(block("python"), "README.md", "exec"), {})
    assert capsys.readouterr().out.startswith("mapping ")


def test_python_of_the_camera_front_end_runs_in_order():
    pytest.importorskip("cv2")
    home = np.random.default_rng(0).integers(0, 256, (128, 512), np.uint8)
    names = {"home_image": home, "image": np.roll(home, 40, axis=1), "t": 0.0}
    names["mask_image"] = np.full_like(home, 255)
    for text in blocks(doc("do/panoramas.md"), "python"):
        exec(compile(text, "do/panoramas.md", "exec"), names)
    assert names["seen"].home.accepted
    assert names["estimate"].reason


def test_python_of_a_batch_runs(capsys):
    (text,) = blocks(doc("do/speed.md"), "python")
    exec(compile(text.replace("10_000", "8"), "do/speed.md", "exec"), {})
    assert capsys.readouterr().out


def test_python_of_what_bearings_tell_runs():
    names = {}
    (text,) = blocks(doc("understand/bearings.md"), "python")
    exec(compile(text, "understand/bearings.md", "exec"), names)
    assert names["view"].windows[0].weakest


def test_python_of_a_floor_runs(tmp_path):
    coarse = tmp_path / "coarse.yaml"
    plan = (ROOT / "src/homeward/data/plans/warehouse.yaml").read_text(encoding="utf-8")
    coarse.write_text(plan.replace("grid: 0.1", "grid: 1.0"), encoding="utf-8")
    (text,) = blocks(doc("do/plan.md"), "python")
    names = {}
    exec(compile(text.replace("warehouse", str(coarse)), "do/plan.md", "exec"), names)
    assert names["view"].position.shape == names["view"].begins.shape


@pytest.mark.parametrize("page", LESSONS, ids=lambda page: page.stem)
def test_python_of_a_lesson_runs_as_its_notebook(page, capsys):
    text, names = page.read_text(encoding="utf-8"), {}
    made = nbformat.reads(notebook(text), as_version=4)
    nbformat.validate(made)
    code = [cell.source for cell in made.cells if cell.cell_type == "code"]
    assert code == [block.rstrip() for block in blocks(text, "python")]
    for source in code:
        exec(compile(source, page.name, "exec"), names)
    words = [cell.source for cell in made.cells if cell.cell_type == "markdown"]
    assert words[0].startswith("# ")
    assert not re.search(r"<(div|script)|\]\(", "".join(words))


@pytest.mark.usefixtures("short_sample")
def test_python_of_places_runs(capsys):
    (text,) = blocks(doc("do/places.md"), "python")
    exec(compile(text, "places.md", "exec"), {})
    assert "verdict='first', stayed=0" in capsys.readouterr().out


@pytest.mark.usefixtures("short_sample")
def test_python_of_routes_runs(capsys):
    (text,) = blocks(doc("do/routes.md"), "python")
    exec(compile(text, "routes.md", "exec"), {})
    assert "State.DRIVING" in capsys.readouterr().out


def test_python_of_a_lost_robot_runs(capsys):
    (text,) = blocks(doc("do/lost.md"), "python")
    exec(compile(text, "lost.md", "exec"), {})
    assert capsys.readouterr().out.startswith("False mapping")


def test_python_on_a_robot_runs(capsys):
    names = {}
    for text in blocks(doc("do/online.md"), "python"):
        exec(compile(text, "online.md", "exec"), names)
    assert capsys.readouterr().out.startswith("mapping ")


def recipe(*words):
    """Return the commands that make would run for these targets in a fresh clone."""
    # Without what a make that runs these tests hands on.
    given = {k: v for k, v in os.environ.items() if k not in ("PYTHON", "MAKEFLAGS", "MFLAGS")}
    options = {"cwd": ROOT, "env": given, "capture_output": True, "text": True, "check": True}
    return subprocess.run(["make", "--dry-run", "--always-make", *words], **options).stdout


def test_each_python_has_an_environment_of_its_own():
    version = f"{sys.version_info[0]}.{sys.version_info[1]}"
    assert ".venv/bin/homeward plan" in recipe("plan")
    assert f".venv-{version}/bin/homeward plan" in recipe("plan", f"PYTHON={sys.executable}")
    assert f".venv-demo-{version}/bin/homeward run" in recipe("demo", f"PYTHON={sys.executable}")


def test_the_demo_installs_only_what_it_needs():
    commands = recipe("demo")
    assert re.findall(r"'\.\[(.*)\]'", commands) == ["report"]
    assert ".venv/" not in commands
    assert "dev" not in re.findall(r"-e '\.\[(.*)\]'", recipe("install"))[0].split(",")
    assert "dev" in re.findall(r"-e '\.\[(.*)\]'", recipe("lint"))[0].split(",")


def test_the_picture_of_the_report_is_of_the_result_that_the_readme_quotes():
    """`docs/make_pictures.py sample-report.png` writes the summary into the picture."""
    picture = (ROOT / "docs/images/sample-report.png").read_bytes()
    quoted = re.search(r"^> (Localised (?:.|\n> )*?)\n> Report", README, re.M)
    assert " ".join(quoted[1].split("\n> ")).strip().encode() in picture
