"""Two versions run on the same drives, and no figure that is worse passes."""

import shutil
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from lab.studies.chores import in_this_process

from benchmarks import against
from benchmarks.consistency.scenarios import Family
from benchmarks.monte_carlo import Run
from benchmarks.paired import comparison, drives, variants
from benchmarks.paired.comparison import NO_WORSE, OPEN, SAME, WORSE, Row
from benchmarks.paired.drives import Case, Input
from homeward.drives.folder import write_folder
from homeward.drives.opening import open_drive

ROOT = Path(__file__).parents[1]
SHORT = ROOT / "tests" / "data" / "state_log" / "moved"
rng = np.random.default_rng(0)
NOISE = rng.normal(size=30)
NOISE -= NOISE.mean()


def decided(figure, worse_by, lost=0):
    """The decision on one figure, next to another that is the same on all drives."""
    same = Row("gate", "room", "pose", np.zeros(30), 0)
    found = [Row("gate", "room", figure, np.asarray(worse_by), lost), same]
    decision, other = comparison.decisions(found)
    assert other == SAME
    return decision


def test_a_figure_is_no_worse_worse_or_not_decidable():
    assert decided("rmse", np.zeros(30)) == SAME
    assert decided("rmse", 0.01 * NOISE) == NO_WORSE
    assert decided("rmse", 0.02 + 0.01 * NOISE) == NO_WORSE  # 2 % worse, certainly below 3 %
    assert decided("rmse", 0.04 + 0.01 * NOISE) == WORSE
    assert decided("rmse", 0.3 * NOISE) == OPEN
    assert decided("rmse", [0.1, 0.1]) == OPEN  # two drives
    assert decided("rmse", [0.1] * 5) == WORSE
    assert decided("rmse", 0.01 * NOISE, lost=1) == OPEN  # a drive without a pose is missing
    assert decided("beyond4", 0.01 + 0.001 * NOISE) == WORSE
    assert decided("pose", 0.01 + 0.001 * NOISE) == NO_WORSE


def test_many_rows_need_more_evidence_than_one():
    assert comparison.holm([0.01, 0.04, 0.03, 1.0]).tolist() == [0.04, 0.09, 0.09, 1.0]
    worse_by = 0.01 + 0.05 * NOISE
    assert decided("nees", worse_by) == NO_WORSE
    rows = [Row("gate", str(k), "nees", worse_by, 0) for k in range(100)]
    assert set(comparison.decisions(rows)) == {OPEN}


def test_differences_have_the_sign_of_their_figure():
    assert comparison.difference("rmse", 1.03, 1.0) == pytest.approx(np.log(1.03))
    assert comparison.difference("pose", 0.9, 1.0) == pytest.approx(0.1)
    assert comparison.difference("wrong", 0.02, 0.01) == pytest.approx(0.01)
    assert comparison.difference("nees", 6.0, 3.0) == pytest.approx(np.log(2.0))
    assert comparison.difference("nees", 3.0, 1.5) == pytest.approx(-np.log(2.0))
    row = Row("gate", "room", "pose", np.array([0.1, 0.1, 0.1]), 0)
    assert row.effect() == pytest.approx((-0.1, -0.1, -0.1))


def test_withheld_poses_count():
    pair = {"pose": 0.5}, {"pose": 0.9, "rmse": 0.1}
    found = comparison.rows({Case("gate", "room", k): pair for k in range(5)}, ["pose", "rmse"])
    assert [(row.figure, row.lost) for row in found] == [("pose", 0), ("rmse", 5)]
    assert comparison.decisions(found) == [WORSE, OPEN]
    assert "5 drives without a value" in comparison.table(found, [WORSE, OPEN])


@pytest.fixture
def short(tmp_path, monkeypatch):
    """A benchmark of one recorded drive."""
    drive = open_drive(SHORT)
    begin = {n: (c := getattr(drive, n)).rows(c.t < 15.0) for n in ("odometry", "sightings")}
    write_folder(replace(drive, **begin), tmp_path / "drive")
    given = Input(drive, frozenset(), folder=tmp_path / "drive")
    monkeypatch.setitem(drives.BENCHMARKS, "short", lambda: {"moved": Family("", lambda _: given)})
    monkeypatch.setattr("homeward.lab.studies.blocks.finish.on_processes", in_this_process)
    drives.families.cache_clear()
    yield
    drives.families.cache_clear()


def called(monkeypatch, capsys, *words):
    monkeypatch.setattr(sys, "argv", ["against", *map(str, words)])
    code = against.main()
    return code, capsys.readouterr().out


def test_both_packages_run_from_environments_of_their_own(short, tmp_path, monkeypatch, capsys):
    """Pip's installation is replaced by a copy, which needs no network."""
    real = variants._call

    def call(*command):
        if "pip" not in command:
            return real(*command)
        site, source = (Path(command[k]) for k in (-2, -1))
        return shutil.copytree(source / "src" / "homeward", site / "homeward")

    monkeypatch.setattr(variants, "_call", call)
    if not (ROOT / ".git").exists():
        pytest.skip("no repository")
    python = variants.environment(variants.commit_of("HEAD"), tmp_path)
    monkeypatch.setattr(against, "environment", lambda commit: python)
    old = variants.Variant(str(python))
    assert "error" in variants.measured(old, Input(None, folder=tmp_path))
    code, told = called(monkeypatch, capsys, "HEAD", "short", "--seeds", 1)
    assert code == 0
    assert "1 drives" in told
    assert "short moved" in told


def test_the_command_fails_if_worse(short, monkeypatch, capsys):
    monkeypatch.setattr(against, "environment", lambda commit: "")
    good = {"pose": 1.0, "rmse": 0.1}
    found = {"new": good | {"rmse": 0.2}, "old": good}
    monkeypatch.setattr(against, "compared", lambda _, todo, *how: dict.fromkeys(todo, found))
    code, told = called(monkeypatch, capsys, "HEAD", "short", "--seeds", 4)
    assert code == 1
    assert "worse: 1" in told
    code, told = called(monkeypatch, capsys, "no-such-tag", "short")
    assert code == 2
    assert "no-such-tag is no tag, branch or commit" in told


def test_a_drive_without_truth_gets_that_of_the_last_variant(short, monkeypatch):
    def measured(variant, given, needs_truth=False):
        asked.append((variant.without, needs_truth))
        return {"rmse": float(variant.without != "")}

    make = drives.families("short")["moved"].make
    family = Family("", lambda k: replace(make(k), needs_truth=True))
    monkeypatch.setitem(drives.BENCHMARKS, "short", lambda: {"moved": family})
    drives.families.cache_clear()
    monkeypatch.setattr(variants, "measured", measured)
    asked, both = [], {"new": variants.Variant(without="x"), "old": variants.Variant()}
    for number in (0, 1):
        asked.clear()
        found = variants.one(both, Run("short moved", "robust", number))
        assert found == {"new rmse": 1.0, "old rmse": 0.0}
        assert asked[0] == ("", True)
        assert asked[1:] == [("", False), ("x", False)][:: -1 if number else 1]


def test_an_error_of_the_present_version_alone_fails(capsys):
    error = {"error": "ValueError: no"}
    case = Case("gate", "room", 0)
    assert against.failed({case: (error, {"pose": 1.0})}) == 1
    assert against.failed({case: (error, error)}) == 0
    assert "ERROR: new: gate room 0: ValueError: no" in capsys.readouterr().out
