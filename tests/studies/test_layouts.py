"""The paper's cases over many layouts: the same runs, in blocks, and what is counted of them."""

import numpy as np
import pytest
from report.figure_faults import faults
from studies.chores import in_this_process
from typer.testing import CliRunner

from homeward.cli.main import app
from homeward.report.layout_figures import FIGURES
from homeward.report.layout_page import headline
from homeward.studies.blocks.finish import Where
from homeward.studies.paper.cases import FILTERS, run_filter
from homeward.studies.paper.layout_study import (
    CLAIMED,
    all_order_share,
    better_share,
    layout_settings,
    order_share,
    printed_shares,
    study_layouts,
)
from homeward.studies.paper.layouts import (
    BOUND,
    ROBUST,
    Block,
    Outcome,
    Question,
    open_store,
    run_block,
)
from homeward.studies.paper.many import run_many
from homeward.studies.paper.robust import bound_rmse, run_robust
from homeward.studies.paper.search import cost
from homeward.studies.paper.settings import Assumed, PaperSettings, Printed
from homeward.studies.paper.world import draw_world

SETTINGS = PaperSettings()


def call(*words):
    return CliRunner().invoke(app, [str(word) for word in words])


@pytest.fixture
def here(monkeypatch):
    """Compute blocks in this process: workers have tests of their own."""
    monkeypatch.setattr("homeward.studies.blocks.finish.on_processes", in_this_process)


@pytest.mark.parametrize("case", ["2", "4"])
@pytest.mark.parametrize("name", FILTERS)
def test_many_at_once_are_the_runs_one_by_one(case, name):
    short = PaperSettings(assumed=Assumed(longest=5, circle_time=5))
    worlds = [draw_world(case, short, k) for k in range(3)]
    rmse, distance = run_many(name, case, worlds, short, engine="interpreter")
    for k, world in enumerate(worlds):
        run = run_filter(name, case, world, short)
        np.testing.assert_allclose(rmse[k], run.rmse, rtol=1e-7)
        np.testing.assert_allclose(distance[k], run.final_distance, rtol=1e-7)


def test_a_layout_is_the_same_in_any_block():
    whole = run_block(Block(SETTINGS, "2", ("EKF", BOUND), 0, 3))
    part = run_block(Block(SETTINGS, "2", (BOUND, "EKF"), 2, 3))
    np.testing.assert_allclose(part["rmse"][:, 0], whole["rmse"][::-1, 2], rtol=1e-9)


def test_names_of_blocks_tell_their_settings():
    other = SETTINGS.model_copy(update={"seed": 1})
    names = [
        set(Question(s, case, filters, n).blocks())
        for s in (SETTINGS, other)
        for case in ("2", "4")
        for filters in (("EKF",), ("PI-EKF",))
        for n in (100,)
    ]
    assert len(set.union(*names)) == 8
    more = Question(SETTINGS, "2", ("EKF",), 600).blocks()
    assert len(more) == 3
    assert len(more.keys() & Question(SETTINGS, "2", ("EKF",), 500).blocks().keys()) == 2


def test_free_gains_contain_the_printed_ones():
    world = draw_world("2", SETTINGS, 1)
    free = PaperSettings(printed=Printed(Pi=(0.05, 0.05, 0.05, 0.05)))
    own = PaperSettings(printed=Printed(Pi=(0.05, 0.05, 0.05, 0.0), M="own"))
    ones = PaperSettings(printed=Printed(Pi=(0.05, 0.05, 0.05, 0.0)))
    as_printed = run_filter("PI-EKF", "2", world, SETTINGS).rmse
    np.testing.assert_array_equal(run_filter("PI-EKF", "2", world, free).rmse, as_printed)
    # "own" differs in the rows of the bearings alone, which no gain lets through here.
    np.testing.assert_array_equal(
        run_filter("PI-EKF", "2", world, own).rmse, run_filter("PI-EKF", "2", world, ones).rmse
    )


def test_without_gains_the_pi_ekf_is_the_ekf():
    none = PaperSettings(printed=Printed(Pi=0.0))
    world = draw_world("4", none, 0)
    np.testing.assert_allclose(
        run_filter("PI-EKF", "4", world, none).rmse, run_filter("EKF", "4", world, none).rmse
    )


def test_the_robust_localiser_comes_home_near_the_bound():
    errors, bounds = [], []
    for k in range(3):
        world = draw_world("2", SETTINGS, k)
        rmse, distance = run_robust("2", world, SETTINGS)
        assert distance < 0.1
        errors.append(rmse)
        bounds.append(bound_rmse("2", world, SETTINGS))
    rms = [np.sqrt(np.mean(np.square(v), axis=0)) for v in (errors, bounds)]
    assert np.all(rms[0] < 3 * rms[1])
    assert np.all(np.array(bounds) > 0)


def outcome(**rmse):
    names = {"EKF": "EKF", "PI": "PI-EKF", "all": "A-EKF (all)"}
    values = np.array([np.tile(np.array(v, float)[:, None], 3) for v in rmse.values()])
    return Outcome(tuple(names[k] for k in rmse), values, np.zeros(values.shape[:2]))


def test_orders_are_counted_right():
    made_up = outcome(EKF=[3, 3, 1, np.inf], all=[2, 4, 2, 2], PI=[1, 1, 3, 1])
    assert order_share(made_up, CLAIMED, 0) == 0.5
    assert all_order_share(made_up, CLAIMED) == 0.5
    assert better_share(made_up, "PI-EKF", "EKF", 1) == 0.75
    # Case 4 prints PI-EKF < EKF < A-EKF for R and alpha, EKF < PI-EKF < A-EKF for theta.
    assert printed_shares(made_up, "4") == [0.25, 0.0, 0.25]


def test_the_cost_is_a_ratio_of_errors():
    ekf = np.array([[1.0, 2.0, 4.0]] * 3)
    assert cost(ekf / 2, ekf) == pytest.approx(0.5)
    diverged = ekf.copy()
    diverged[:2] = np.inf
    assert cost(diverged, ekf) == np.inf


def test_settings_go_where_they_belong():
    settings = layout_settings({"varied": 5, "assumed": {"faults": 3}}, layouts=7, seed=4)
    assert (settings.varied, settings.layouts, settings.paper.seed) == (5, 7, 4)
    assert settings.paper.assumed.faults == 3


def test_the_study_writes_its_page_and_goes_on_from_its_blocks(tmp_path, here, monkeypatch):
    short = ("--set", "assumed.longest=1", "--set", "assumed.circle_time=1")
    words = ["reproduce", "--study", "--runs", "4", *short, "--out", tmp_path / "out"]
    sizes = ["--set", "varied=2", "--set", "searched=2", "--set", "robust=2"]
    answer = call(*words, *sizes)
    assert answer.exit_code == 0, answer.output
    page = (tmp_path / "out" / "layouts.html").read_text()
    for text in ("4 random layouts", "16.7 %", "free Pi, M own", "as its table prints"):
        assert text in page
    for name in FIGURES:
        assert (tmp_path / "out" / f"{name}.png").read_bytes().startswith(b"\x89PNG")
    table = np.genfromtxt(tmp_path / "out" / "layouts.csv", delimiter=",", dtype=str)
    assert len(table) == 1 + 2 * 4 * len(FILTERS) + 2 * 2 * len((ROBUST, BOUND))

    def compute(function, arguments):
        raise AssertionError(f"{len(arguments)} blocks computed again")

    monkeypatch.setattr("homeward.studies.blocks.finish.on_processes", compute)
    values = {"assumed": {"longest": 1, "circle_time": 1}, "varied": 2, "searched": 2, "robust": 2}
    study = study_layouts(layout_settings(values, 4), open_store(tmp_path / "out"), Where())
    assert headline(study) in answer.stdout
    for _, draw in FIGURES.values():
        assert faults(draw(study)) == [], draw.__name__


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["--workers", "2"], "need --study"),
        (["--study", "--set", "varied=0"], "varied"),
        (["--study", "--set", "assumed.speed=1"], "speed"),
        (["--study", "--runs", "0"], "layouts"),
    ],
)
def test_wrong_options_are_one_line(tmp_path, words, complaint):
    answer = call("reproduce", "--out", tmp_path / "x", *words)
    assert answer.exit_code == 2
    assert complaint in answer.stderr
    assert len(answer.stderr.strip().splitlines()) == 1
    assert not (tmp_path / "x").exists()
