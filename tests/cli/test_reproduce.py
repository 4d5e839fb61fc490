"""`homeward reproduce` as a user would call it; the studies behind it."""

import csv
from dataclasses import replace

import numpy as np
import pytest
import yaml
from typer.testing import CliRunner

from homeward.cli.main import app
from homeward.report.paper_figures import FIGURES
from homeward.studies.paper.cases import FILTERS, reproduce, run_filter
from homeward.studies.paper.settings import Assumed, PaperSettings
from homeward.studies.paper.tables import PRINTED, ordering_share, printed_order, rows
from homeward.studies.paper.world import CASES, draw_world


def call(*words):
    return CliRunner().invoke(app, [str(word) for word in words])


@pytest.fixture(scope="module")
def result():
    return reproduce(PaperSettings(runs=4))


def test_page_and_figures_are_written(tmp_path):
    out = tmp_path / "paper"
    answer = call("reproduce", "--out", out, "--runs", "2", "--seed", "5")
    assert answer.exit_code == 0, answer.output
    page = (out / "paper.html").read_text()
    for words in ("leaves open", "wrong in it", "0.3778", "1.9091", "0.0174"):
        assert words in page
    for name in FIGURES:
        assert (out / f"{name}.png").read_bytes().startswith(b"\x89PNG")
    with (out / "rmse.csv").open() as stream:
        assert len(list(csv.DictReader(stream))) == len(CASES) * len(FILTERS) * 2
    settings = yaml.safe_load((out / "reproduce.yaml").read_text())
    assert (settings["runs"], settings["seed"]) == (2, 5)


@pytest.mark.parametrize(
    ("option", "word"),
    [
        ("assumed.speed=1", "speed"),
        ("assumed.fault=x", "fault"),
        ("assumed.fault=[0.5,0.2]", "least"),
        ("assumed.layout_distance=[2,1]", "least"),
        ("assumed.longest=0.01", "sample_time"),
        ("assumed.meaning_of_Q=z", "Q"),
    ],
)
def test_wrong_options_are_one_line(tmp_path, option, word):
    answer = call("reproduce", "--out", tmp_path / "x", "--set", option)
    assert answer.exit_code == 2
    assert word in answer.stderr
    assert len(answer.stderr.strip().splitlines()) == 1
    assert not (tmp_path / "x").exists()


def test_every_case_and_filter_has_a_row(result):
    table = rows(result)
    assert [(r.case, r.filter) for r in table] == [(c, f) for c in CASES for f in FILTERS]
    assert sum(r.printed is not None for r in table) == len(PRINTED) * len(FILTERS)
    for row in table:
        assert np.all(row.low <= row.median)
        assert np.all(row.median <= row.high)


def test_the_order_is_the_one_that_the_paper_prints(result):
    assert printed_order("2", 0) == ("PI-EKF", "A-EKF", "EKF")
    assert printed_order("2", 2) == ("PI-EKF", "EKF", "A-EKF")
    assert printed_order("4", 0) == ("PI-EKF", "EKF", "A-EKF")
    assert printed_order("4", 1) == ("EKF", "PI-EKF", "A-EKF")
    rmse = {name: np.full((4, 3), value) for name, value in (("EKF", 1.0), ("PI-EKF", 2.0))}
    rmse["A-EKF (all)"] = np.array([[3.0, 3.0, 3.0]] * 3 + [[1.5, 1.5, 1.5]])
    made_up = replace(result, rmse={"4": rmse})
    assert [ordering_share(made_up, "4", k) for k in range(3)] == [0.0, 0.75, 0.0]


def test_runs_are_the_same_whatever_else_is_run(result):
    alone = reproduce(PaperSettings(runs=2))
    for case in CASES:
        for name in FILTERS:
            np.testing.assert_array_equal(alone.rmse[case][name], result.rmse[case][name][:2])


def test_without_any_error_the_ekf_is_exact_and_comes_home():
    nothing = Assumed(bearing_sigma=0.0, initial_error=(0.0, 0.0, 0.0), guard=1e-4)
    settings = PaperSettings(assumed=nothing)
    for k in range(3):
        run = run_filter("EKF", "1", draw_world("1", settings, k), settings)
        assert run.arrived
        assert run.final_distance < 0.055
        assert np.all(run.rmse < [2e-3, 2e-2, 2e-3])


def test_faults_are_those_of_the_case():
    settings = PaperSettings()
    count = {"1": 0, "2": 2, "3 (one fault)": 1, "3 (several)": 3, "4": 0}
    for case in CASES:
        faults = draw_world(case, settings, 3).faults
        assert np.count_nonzero(faults) == count[case]
    drawn = np.abs([f for k in range(50) for f in draw_world("2", settings, k).faults if f])
    assert drawn.min() >= 0.2
    assert drawn.max() <= 0.5


def test_meanings_of_Q_and_R_matter():
    rmse = {}
    for q in ("input", "state"):
        for r in ("variance", "deviation"):
            settings = PaperSettings(assumed=Assumed(meaning_of_Q=q, meaning_of_R=r))
            world = draw_world("2", settings, 1)
            rmse[q, r] = tuple(run_filter("EKF", "2", world, settings).rmse)
    assert len(set(rmse.values())) == 4
    assert np.all(np.isfinite(list(rmse.values())))


def test_one_parameter_finds_the_single_fault():
    """Case 3: the estimated home bearing comes nearer to the truth than what home stored."""
    settings = PaperSettings()
    better = 0
    for k in range(10):
        world = draw_world("3 (one fault)", settings, k)
        run = run_filter("A-EKF (one)", "3 (one fault)", world, settings)
        found = run.state[-1, -1] - world.true_home_bearings[0]
        better += abs(np.angle(np.exp(1j * found))) < abs(world.faults[0]) / 2
    assert better >= 7


def test_a_reproduction_without_faults_has_all_its_figures(tmp_path):
    changes = ("faults=0", "single_fault=0", "several_faults=[]", "stop_radius=0.1", "longest=1")
    words = [word for change in changes for word in ("--set", f"assumed.{change}")]
    answer = call("reproduce", "--out", tmp_path / "paper", "--runs", "1", *words)
    assert answer.exit_code == 0, answer.output
    page = (tmp_path / "paper" / "paper.html").read_text()
    assert "home within 20 cm" in page
    assert "0.99 % at the stop radius" in page
