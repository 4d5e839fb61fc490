"""The paper's cases over many layouts: the same runs, in blocks, and what is counted of them."""

import re
from dataclasses import fields

import numpy as np
import pytest
from cli.commands import call, done, refused
from lab.studies.chores import in_this_process
from runs.figure_faults import faults

from homeward.lab.report.paper.claims import claims, command, deciding_table
from homeward.lab.report.paper.layout_page import CLAIMED, FIGURES, grid_table, headline
from homeward.lab.studies.blocks.finish import StudyBlocks
from homeward.lab.studies.paper.cases import FAR, FILTERS, errors_over, run_filter, run_many
from homeward.lab.studies.paper.layouts import (
    BOUND,
    FAULTY,
    LONG,
    LONG_FAULTY,
    ROBUST,
    STUDIED,
    VARIANTS,
    LayoutSettings,
    Outcome,
    Question,
    grid_questions,
    open_store,
    run_block,
)
from homeward.lab.studies.paper.reproduction import (
    PRINTED,
    beats_printed,
    better_shares,
    layout_settings,
    order_share,
    printed_order_shares,
    study_layouts,
)
from homeward.lab.studies.paper.robust import bound_errors, run_robust
from homeward.lab.studies.paper.settings import Assumed, PaperSettings, Printed
from homeward.lab.studies.paper.world import draw_world, fault_count

SETTINGS = PaperSettings()
OFF = PaperSettings(assumed=Assumed(initial_error=(0.05, 0.1, 0.1)))
"""A start that is off."""


@pytest.fixture
def here(monkeypatch):
    """Compute blocks in this process: workers have tests of their own."""
    monkeypatch.setattr("homeward.lab.studies.blocks.finish.on_processes", in_this_process)


def test_faults_of_landmarks_that_there_are_not_do_not_count():
    few = PaperSettings(printed=Printed(landmarks=2), assumed=Assumed(several_faults=(0, 0.2, 0.3)))
    assert draw_world("3 (several)", few, 0).moved.sum() == 1
    assert fault_count("3 (several)", few) == 1


@pytest.mark.parametrize(
    ("name", "case", "landmarks"),
    [*((name, case, 7) for name in FILTERS for case in ("2", "4")), ("A-EKF (all)", "4", 1)],
)
def test_many_at_once_are_the_runs_one_by_one(name, case, landmarks):
    times = {"longest": 5, "circle_time": 5, "minimum_visible": min(2, landmarks)}
    assumed = Assumed(**times, initial_error=(0.05, 0.1, 0.1))
    short = PaperSettings(assumed=assumed, printed=Printed(landmarks=landmarks))
    worlds = [draw_world(case, short, k) for k in range(3)]
    many = run_many(name, case, worlds, short, engine="interpreter")
    for k, world in enumerate(worlds):
        run = run_filter(name, case, world, short)
        one = errors_over(run.errors, run.pose)
        for field in fields(one):
            together, alone = (getattr(e, field.name) for e in (many, one))
            np.testing.assert_allclose(together[k], alone[0], rtol=1e-6, err_msg=field.name)


def test_theta_is_also_told_where_home_is_far():
    error, pose = np.zeros((4, 3)), np.zeros((4, 3))
    pose[:, 0] = 2 * FAR, 1.5 * FAR, FAR / 2, FAR / 4
    error[:, 1] = 0.3, 0.4, 2.0, -3.0
    kept = errors_over(error, pose)
    assert kept.theta_far[0] == pytest.approx(np.sqrt((0.09 + 0.16) / 2))
    assert kept.rmse[0, 1] > 1
    assert kept.final[0].tolist() == [0, 3, 0]
    error[2] = np.nan
    lost = errors_over(error, pose)
    assert np.isinf(lost.rmse).all()
    assert np.isinf([lost.theta_far[0], lost.final[0, 0]]).all()


def test_a_layout_is_the_same_in_any_block():
    whole = run_block(Question(SETTINGS, "2", ("EKF", BOUND), 3))
    part = run_block(Question(SETTINGS, "2", (BOUND, "EKF"), 3, 2))
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
    errors = [run_filter("PI-EKF", "2", world, s).errors for s in (SETTINGS, free, own, ones)]
    np.testing.assert_array_equal(errors[0], errors[1])
    # "own" differs in the rows of the bearings alone, which no gain lets through here.
    np.testing.assert_array_equal(errors[2], errors[3])


def test_without_gains_the_pi_ekf_is_the_ekf():
    none = PaperSettings(printed=Printed(Pi=0.0))
    world = draw_world("4", none, 0)
    np.testing.assert_allclose(
        run_filter("PI-EKF", "4", world, none).errors, run_filter("EKF", "4", world, none).errors
    )


def test_the_robust_localiser_comes_home_near_the_bound():
    errors, bounds = [], []
    for k in range(3):
        world = draw_world("2", OFF, k)
        ran = run_robust("2", world, OFF)
        assert ran.final_distance[0] < 0.1
        errors.append(ran.rmse[0])
        bounds.append(bound_errors("2", world, OFF).rmse[0])
    rms = [np.sqrt(np.mean(np.square(v), axis=0)) for v in (errors, bounds)]
    assert np.all(rms[0] < 3 * rms[1])
    assert np.all(np.array(bounds) > 0)


def test_from_the_exact_start_the_bound_is_nothing_and_from_5_cm_above_what_is_printed():
    bounds = [bound_errors("2", draw_world("2", s, 0), s).rmse[0, 0] * 100 for s in (SETTINGS, OFF)]
    assert bounds[0] < 0.01
    assert bounds[1] > max(row[0] for row in PRINTED["2"].values())


def outcome(**rmse):
    names = {"EKF": "EKF", "PI": "PI-EKF", "all": "A-EKF (all)"}
    values = np.array([np.tile(np.array(v, float)[:, None], 3) for v in rmse.values()])
    none = np.zeros(values.shape[:2])
    names = tuple(names[k] for k in rmse)
    return Outcome(values, none, np.zeros_like(values), none, names, none[0])


def test_orders_are_counted_right():
    made_up = outcome(EKF=[3, 3, 1, np.inf], all=[2, 4, 2, 2], PI=[1, 1, 3, 1])
    shares = order_share(made_up, CLAIMED, "A-EKF (all)")
    np.testing.assert_array_equal(shares, 0.5)
    assert better_shares(made_up, "PI-EKF", "EKF")[1] == 0.75
    # Case 4 prints PI-EKF < EKF < A-EKF for R and alpha, EKF < PI-EKF < A-EKF for theta.
    assert printed_order_shares(made_up, "4", "A-EKF (all)") == [0.25, 0.0, 0.25]
    small = outcome(EKF=[0.0, 0.001, 1.0])
    assert beats_printed(small, "2", "EKF") == pytest.approx(2 / 3)


def test_the_grid_has_every_reading_once_the_settings_own_first():
    settings = LayoutSettings(layouts=1)
    asked = grid_questions(settings)
    assert len({name for question in asked.values() for name in question.blocks()}) == len(asked)
    assert {case: len(settings.readings(case)) for case in STUDIED} == {"1": 48, "2": 144, "4": 64}
    assert settings.read(settings.readings("2")[0]) == settings.paper
    mine = layout_settings({"assumed": {"stop_radius": 0.1}, "grid": {"faults": [4]}})
    assert mine.axis("stop_radius") == (0.1, 0.05, 0.15, 0.25)
    assert mine.axis("faults") == (2, 4)
    assert mine.readings("2")[0].stop_radius == 0.1


def test_the_literal_reading_of_q_agrees_with_the_issue():
    """Q n x n and exact start: Case 4 has EKF .481 .013 .007 over 100 layouts."""
    literal = PaperSettings(assumed=Assumed(meaning_of_Q="state"))
    ran = run_block(Question(literal, "4", ("EKF",), 100))
    median = np.median(ran["rmse"][0], axis=0) * [100, 1, 1]
    np.testing.assert_allclose(median, [0.481, 0.013, 0.007], rtol=0.1)


def test_settings_go_where_they_belong():
    settings = layout_settings({"varied": 5, "assumed": {"faults": 3}}, layouts=7, seed=4)
    assert (settings.varied, settings.layouts, settings.paper.seed) == (5, 7, 4)
    assert settings.paper.assumed.faults == 3


def test_the_study_writes_its_page_and_goes_on_from_its_blocks(tmp_path, here, monkeypatch):
    short = ("--set", "assumed.longest=1", "--set", "assumed.circle_time=1")
    few = ("--set", "grid.stop_radius=[0.15]", "--set", "grid.faults=[1]")
    few += (
        "--set",
        'grid.meaning_of_Q=["input"]',
        "--set",
        "grid.initial_error=[[0.05,0.1,0.1]]",
        "--set",
        "grid.circle_turn_rate=[0.2]",
    )
    words = ["study", "layouts", "--runs", "4", *short, *few, "--out", tmp_path / "out"]
    sizes = ["--set", "varied=2", "--set", "robust=2"]
    short_ones = {
        "Pi 0.5": VARIANTS["Pi 0.5"],
        LONG: {"assumed": {"circle_time": 2}},
        FAULTY: VARIANTS[FAULTY],
        LONG_FAULTY: {"assumed": {"circle_time": 2, "circle_faults": 2}},
    }
    monkeypatch.setattr("homeward.lab.studies.paper.layouts.VARIANTS", short_ones)
    answer = done(call(*words, *sizes))
    page = (tmp_path / "out" / "layouts.html").read_text()
    for text in ("4 random layouts", "Only four layouts: ", "Median error of R"):
        assert text in page
    # Every link of the contents leads somewhere.
    links = re.findall(r'<a href="#([^"]+)">', page)
    assert len(links) > 8
    assert all(f'id="{link}"' in page for link in links)
    for name in FIGURES:
        assert (tmp_path / "out" / f"{name}.png").read_bytes().startswith(b"\x89PNG")
    table = np.genfromtxt(tmp_path / "out" / "layouts.csv", delimiter=",", dtype=str)
    assert len(table) == 1 + 3 * 2 * (4 * len(FILTERS) + 2 * len((ROBUST, BOUND)))

    def compute(function, arguments, processes):
        raise AssertionError(f"{len(arguments)} blocks computed again")

    monkeypatch.setattr("homeward.lab.studies.blocks.finish.on_processes", compute)
    values = {"assumed": {"longest": 1, "circle_time": 1}, "varied": 2, "robust": 2}
    values["grid"] = {"stop_radius": [0.15], "faults": [1], "circle_turn_rate": [0.2]}
    values["grid"] |= {"initial_error": [[0.05, 0.1, 0.1]], "meaning_of_Q": ["input"]}
    study = study_layouts(layout_settings(values, 4), StudyBlocks(open_store(tmp_path / "out")))
    assert headline(study) in answer.stdout
    for _, draw in FIGURES.values():
        assert faults(draw(study)) == [], draw.__name__
    decided = claims(study)
    assert {c.decision for c in decided} <= {
        *("holds", "holds in most layouts", "holds in part", "does not hold"),
        *("possible", "unlikely"),
    }
    for c in decided:
        assert any(character.isdigit() for character in c.figure)
    assert len(grid_table(study)) == 1 + 8 + 16 + 8
    assert any("large perturbations" in c.claim for c in decided)
    decisive = {row[0]: row for row in deciding_table(study)[1:]}
    assert "0.2 rad/s: " in decisive["4"][-2]
    assert "1: " in decisive["2"][6]
    assert decisive["2"][2].endswith(" of 16")
    off = study.reading("2", initial_error=(0.05, 0.1, 0.1))
    assert "--set 'assumed.initial_error=[0.05,0.1,0.1]'" in command(study, off)


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["paper", "--workers", "2", "--scheduler", "tcp://x:1"], "give one of"),
        (["layouts", "--set", "varied=0"], "varied"),
        (["layouts", "--set", "assumed.speed=1"], "speed"),
        (["layouts", "--runs", "0"], "layouts"),
    ],
)
def test_wrong_options_are_one_line(tmp_path, words, complaint):
    answer = call("study", *words, "--out", tmp_path / "x")
    assert complaint in refused(answer)
    assert not (tmp_path / "x").exists()
