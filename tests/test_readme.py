"""What README and docs show must run as it stands there."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml

from homeward.drives.drive import DriveSettings
from homeward.studies.single_run import sample_drive

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def blocks(text, language):
    return re.findall(rf"```{language}\n(.*?)```", text, re.DOTALL)


def block(language):
    (found,) = blocks(README, language)
    return found


def doc(name):
    return (ROOT / "docs" / name).read_text(encoding="utf-8")


def test_python_example_runs(tmp_path, monkeypatch, capsys):
    shutil.copytree(sample_drive(), tmp_path / "out" / "drive")
    monkeypatch.chdir(tmp_path)
    exec(compile(block("python"), "README.md", "exec"), {})
    assert "Status." in capsys.readouterr().out


def test_python_of_the_camera_front_end_runs_in_order():
    pytest.importorskip("cv2")
    home = np.random.default_rng(0).integers(0, 256, (128, 512), np.uint8)
    names = {"home_image": home, "image": np.roll(home, 40, axis=1), "t": 0.0}
    names["mask_image"] = np.full_like(home, 255)
    for text in blocks(doc("vision.md"), "python"):
        exec(compile(text, "vision.md", "exec"), names)
    assert names["seen"].home.accepted
    assert names["estimate"].reason


def test_python_of_a_batch_runs(capsys):
    first, *_ = blocks(doc("engine.md"), "python")
    exec(compile(first.replace("10_000", "8"), "engine.md", "exec"), {})
    assert capsys.readouterr().out


def test_python_of_what_bearings_tell_runs():
    names = {}
    (text,) = blocks(doc("observability.md"), "python")
    exec(compile(text, "observability.md", "exec"), names)
    assert names["view"].windows[0].weakest


def test_python_of_a_floor_runs(tmp_path):
    coarse = tmp_path / "coarse.yaml"
    plan = (ROOT / "src/homeward/data/plans/warehouse.yaml").read_text(encoding="utf-8")
    coarse.write_text(plan.replace("grid: 0.1", "grid: 1.0"), encoding="utf-8")
    (text,) = blocks(doc("planning.md"), "python")
    names = {}
    exec(compile(text.replace("warehouse", str(coarse)), "planning.md", "exec"), names)
    assert names["view"].position.shape == names["view"].begins.shape


def test_drive_yaml_example_is_valid():
    settings = DriveSettings.model_validate(yaml.safe_load(block("yaml")))
    assert settings.start is not None


def test_links_and_pictures_exist():
    for target in re.findall(r"\]\(([^)#]+)\)", README):
        assert (ROOT / target).exists(), target


@pytest.mark.parametrize("target", ["demo", "test"])
def test_make_targets_exist(target):
    assert f"make {target}" in README
    assert re.search(rf"^{target}:", (ROOT / "Makefile").read_text(), re.MULTILINE)


def test_each_python_has_an_environment_of_its_own():
    # Without what a make that runs these tests hands on.
    given = {k: v for k, v in os.environ.items() if k not in ("PYTHON", "MAKEFLAGS", "MFLAGS")}
    options = {"cwd": ROOT, "env": given, "capture_output": True, "text": True, "check": True}
    said = [
        subprocess.run(["make", "-n", "plan", *chosen], **options).stdout
        for chosen in ([], [f"PYTHON={sys.executable}"])
    ]
    assert ".venv/bin/homeward plan" in said[0]
    assert f".venv-{sys.version_info[0]}.{sys.version_info[1]}/bin/homeward plan" in said[1]
