"""The harness of the benchmarks: options, runs, tables, and figures of a track."""

import math
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from lab.studies.chores import in_this_process

from benchmarks import measures, random_faults
from benchmarks.faults import samples_of
from benchmarks.monte_carlo import Column, Run, benchmark, print_table
from homeward.drives.opening import open_drive
from homeward.registry import make_estimator
from homeward.track import run as follow

COLUMNS = (Column("mean", "value", np.nanmean, 1), Column("worst", "value", np.nanmax, 0))


def made_up(run, plus):
    return {"value": None if run.seed == 3 else run.seed + plus + 10.0 * (run.scenario == "b")}


def test_a_benchmark_is_a_function_of_a_run_and_the_columns_of_a_table(monkeypatch, capsys):
    monkeypatch.setattr("homeward.lab.studies.blocks.finish.on_processes", in_this_process)
    words = ["--rooms", "a", "b", "--first", "1", "--plus", "0.5", "--jobs", "1"]
    monkeypatch.setattr(sys, "argv", ["made-up", *words])
    found = benchmark("", made_up, ["a", "b", "c"], COLUMNS, seeds=3, names="rooms", plus=0.0)
    assert [run.seed for run in found] == [1, 1, 2, 2, 3, 3]
    lines = capsys.readouterr().out.splitlines()
    assert [line.split() for line in lines] == [
        ["mean", "worst"], ["a", "2.0", "2"], ["b", "12.0", "12"], ["all", "7.0", "12"],
    ]  # fmt: skip
    assert len({line.rindex(line.split()[-1]) + len(line.split()[-1]) for line in lines}) == 1


def test_a_figure_that_no_run_has_is_a_dash(capsys):
    assert Column("rmse").cell([{}, {"rmse": None}]) == "-"
    print_table([["", "x"], ["a", "-"]])
    assert capsys.readouterr().out == "   x\na  -\n"


@pytest.fixture(scope="module")
def drive():
    whole = open_drive(Path(__file__).parent / "data" / "state_log" / "moved")
    parts = {n: getattr(whole, n) for n in ("odometry", "sightings")}
    return type(whole)(**{**vars(whole), **{n: c.rows(c.t < 25.0) for n, c in parts.items()}})


def test_figures_of_a_track_agree_with_each_other(drive):
    track = follow(drive, make_estimator("robust", drive))
    whole = measures.figures(track, drive.truth, frozenset())
    late = measures.figures(track, drive.truth, after_s=20.0)
    assert 0.0 <= whole["sure"] <= whole["pose"] <= 1.0
    assert whole["inside1"] <= whole["inside2"] <= whole["inside3"] <= 1.0
    assert whole["inside3"] == pytest.approx(1.0 - whole["beyond3"])
    assert whole["precision"] == whole["exact"]  # nothing moved
    assert whole["recall"] is None
    assert "exact" not in late
    assert late["rmse"] != whole["rmse"]
    never = measures.figures(track, drive.truth, after_s=100.0)
    assert "rmse" not in never


def test_the_scale_of_a_map_does_not_depend_on_its_frame(drive):
    track = follow(drive, make_estimator("robust", drive))
    kept = [m for m in track.landmarks if math.isfinite(m.x) and not m.moved]
    turned = {m.landmark: 0.5 * np.array([-m.y + 3.0, m.x - 1.0]) for m in kept}
    assert measures.scale_of(track, turned) == pytest.approx(2.0)
    assert math.isnan(measures.scale_of(track, {}))


def test_faults_in_random_rooms_are_compared_with_the_same_drive_without(monkeypatch):
    whole = random_faults.room(1)[0]
    o, seen = whole.drive.odometry, whole.drive.sightings
    until = whole.begin + 12.0
    short = replace(whole.drive, odometry=o.rows(o.t < until), sightings=seen.rows(seen.t < until))
    scene = whole._replace(drive=short, samples=samples_of(short), end=whole.begin + 6.0)
    monkeypatch.setattr(random_faults, "room", lambda seed: (scene, "short"))
    none, reversed_, again = (
        random_faults.measured(Run(kind, "robust", 1))
        for kind in ("none", "bearings are reversed", "none")
    )
    assert none == again
    assert none["has_pose"] == reversed_["has_pose"] == 1.0
    assert not none["wrong"]
    assert none["after"] == 1.0
    assert reversed_["localised"] < none["localised"]


def test_each_kind_of_fault_changes_a_drive():
    scene, _ = random_faults.room(1)
    for kind, fault in random_faults.KINDS.items():
        changed = fault(np.random.default_rng(0))(scene)
        assert (changed != scene.samples) == (kind != "none"), kind
