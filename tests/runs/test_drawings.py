"""Figures to look at: labels that collide with nothing and are whole, and notes."""

from dataclasses import replace

import numpy as np
import pytest
from figure_faults import faults
from made_up_study import made_up_study

from homeward.lab.planning.analysis import analyse
from homeward.lab.planning.settings import Plan
from homeward.lab.report.plan import draw_accuracy, draw_begin, draw_hidden
from homeward.lab.report.study.maps import draw_maps, grids
from homeward.lab.report.study.page import (
    MARK,
    PAGE,
    below_bound,
    draw_nees,
    draw_overview,
    draw_rmse,
    note_below,
    write_study,
)
from homeward.lab.studies.study.summary import summary, table
from homeward.runs.report.canvas import legend_below, styled_figure, svg, svg_file, uncrowd

LONG = "the one whose label says everything that there is to say of it, and then some more"


@pytest.mark.parametrize(
    ("decades", "label"), [(0.05, "A-EKF"), (1.0, "A-EKF"), (7.0, "A-EKF"), (7.0, LONG)]
)
def test_no_label_of_a_study_collides_or_is_cut(tmp_path, decades, label):
    results = made_up_study(tmp_path, decades, label)
    for draw in (draw_overview, draw_rmse, draw_nees):
        assert faults(draw(results)) == [], draw.__name__


def test_no_label_of_a_map_over_settings_collides_or_is_cut(tmp_path):
    grid = {
        "parameter_sigma": [0.0003, 0.001, 0.003, 0.01, 0.03],
        "parameter_walk": [0.0, 0.00125, 0.05],
        "parameters": [["L1"], ["L1", "L2"], ["L1", "L2", "L3"], ["L1", "L2", "L3", "L4"]],
    }
    entries = ["ekf", {"estimator": "a-ekf", "grid": grid}]
    results = made_up_study(tmp_path, 3.0, estimators=entries, grid={})
    (found,) = grids(results)
    assert faults(draw_maps(results, found)) == []


def test_two_grids_of_one_estimator_are_two_maps(tmp_path):
    values = {"parameter_sigma": [0.1, 0.2], "parameter_walk": [0.0, 0.01]}
    entries = [
        {"estimator": "a-ekf", "label": label, "settings": {"gate": gate}, "grid": values}
        for label, gate in (("gated", 0.99), ("open", None))
    ]
    results = made_up_study(tmp_path, estimators=["ekf", *entries], grid={})
    gated, ungated = grids(results)
    assert [*gated.contenders] == [1, 2, 3, 4]
    assert [*ungated.contenders] == [5, 6, 7, 8]
    assert gated.caption != ungated.caption


def test_the_mean_nees_of_one_run_may_be_farther_off_than_that_of_many(tmp_path):
    results = made_up_study(tmp_path)
    many, *rest = results.plan.cases
    one = replace(results.plan, cases=(many, *(replace(case, runs=1) for case in rest)))
    figure = draw_nees(replace(results, plan=one))
    wide, narrow = (figure.axes[k].patches[0].get_height() for k in (1, 0))
    assert wide > narrow


def test_a_page_explains_the_figures_that_it_has_alone(tmp_path):
    many = {"estimator": "a-ekf", "grid": {"parameter_sigma": [0.01 * k for k in range(1, 26)]}}
    for name, estimators, there in (("few", ["ekf"], True), ("many", ["ekf", many], False)):
        write_study(tmp_path / name, made_up_study(tmp_path, estimators=estimators, grid={}))
        page = (tmp_path / name / PAGE).read_text()
        assert ("Dashed: bound of the drives" in page) == there


def test_crowded_ticks_are_left_out_and_others_stay():
    with styled_figure(2.0) as figure:
        crowded, roomy = figure.subplots(1, 2)
        for axes, places in ((crowded, range(0, 200_000, 10_000)), (roomy, range(4))):
            axes.set_xlim(min(places), max(places))
            axes.set_xticks(list(places), [f"{place:,}" for place in places])
        assert faults(figure)
        uncrowd(figure)
        assert faults(figure) == []
        kept = [(t.get_loc(), t.label1.get_text()) for t in crowded.xaxis.get_major_ticks()]
        assert len(roomy.get_xticks()) == 4
    assert 2 <= len(kept) < 20
    assert all(f"{at:,.0f}" == text for at, text in kept), "each label stays at its place"


def test_a_legend_takes_as_many_columns_as_there_is_room_for():
    for words, columns in (("short", 4), ("a label of a middling length, it is", 2), (LONG, 1)):
        with styled_figure(3.0) as figure:
            axes = figure.add_subplot()
            legend_below(figure, [axes.plot([0, 1], label=f"{words} {k}")[0] for k in range(5)])
            assert figure.legends[0]._ncols == columns
            assert len(figure.legends) == 1
            assert faults(figure) == []


def test_words_of_a_table_are_whole(tmp_path):
    results = made_up_study(tmp_path)
    head = table(results.plan, summary(results))[0]
    assert "runtime [s]" in head
    assert "RMSE / bound" in head


def test_who_lies_below_its_bound_is_noted(tmp_path):
    rng = np.random.default_rng(1)
    bounds = rng.uniform(0.9, 1.1, 40)
    assert below_bound(1.2 * bounds, bounds) == ""
    assert below_bound(0.8 * bounds, bounds) == "80.0 % of it, significant"
    assert below_bound(0.8 * bounds[:5], bounds[:5]) == "80.0 % of it, not significant"
    assert below_bound(np.full(4, np.nan), bounds[:4]) == ""
    assert note_below({"a": "", "b": ""}) == ""
    assert "b (80.0 % of it, not significant)" in note_below(
        {"a": "", "b": "80.0 % of it, not significant"}
    )
    results = made_up_study(tmp_path)
    results.run["position_rmse"][:] = 2.0 * results.run["position_bound"]
    assert MARK not in said(draw_overview(results))
    results.run["position_rmse"][1, 0] /= 4.0
    assert said(draw_overview(results)).count(MARK) == 2, "the estimator, and the legend"


def said(figure):
    """Return all texts of a figure."""
    axes = figure.axes[0]
    words = [t.get_text() for t in axes.get_yticklabels()]
    marks = [str(line.get_marker()) for line in figure.legends[0].get_lines()]
    return " ".join([*words, *marks])


@pytest.fixture(scope="module")
def plan_view():
    rng = np.random.default_rng(4)
    marks = {f"L{k}": tuple(p) for k, p in enumerate(rng.uniform(0.2, 5.8, (7, 2)))}
    values = {
        "name": "hall",
        "outline": [(0, 0), (36, 0), (36, 6), (0, 6)],
        "landmarks": marks,
        "home": {"x": 1.0, "y": 1.2, "heading": 0.4},
        "grid": 1.0,
    }
    return analyse(Plan.model_validate(values))


@pytest.mark.parametrize("draw", [draw_begin, draw_accuracy])
def test_a_map_of_a_plan_has_axes_and_a_scale(plan_view, draw):
    figure = draw(plan_view)
    assert faults(figure) == []
    panel = figure.axes[0]
    assert (panel.get_xlabel(), panel.get_ylabel()) == ("x [m]", "y [m]")
    (bar,) = [a for a in panel.artists if type(a).__name__ == "AnchoredSizeBar"]
    length = bar.size_bar.get_children()[0].get_width()
    assert bar.txt_label.get_text() == f"{length:g} m"
    assert length == 5
    assert [t.get_text() for t in panel.get_xticklabels() if t.get_text()]


def test_a_map_whose_width_is_rounded_down_has_a_scale():
    width = 512.3 - 112.3
    assert width < 400.0
    values = {
        "outline": [(112.3, 0), (512.3, 0), (512.3, 40), (112.3, 40)],
        "landmarks": {"a": (120.0, 3.0), "b": (130.0, 30.0), "c": (150.0, 20.0)},
        "home": {"x": 140.0, "y": 10.0},
        "grid": 20.0,
    }
    (bar,) = draw_begin(analyse(Plan.model_validate(values))).axes[0].artists
    assert bar.txt_label.get_text() == "50 m"


def test_a_floor_of_one_row_of_points_is_drawn():
    values = {
        "outline": [(0, 0), (100, 0), (100, 1), (0, 1)],
        "landmarks": {"a": (10, 1), "b": (20, 0), "c": (0, 0.2), "d": (5, 0), "e": (3, 1)},
        "home": {"x": 0.5, "y": 0.5},
        "grid": 1.0,
    }
    view = analyse(Plan.model_validate(values))
    limit, known = view.plan.limits.position, view.position[np.isfinite(view.position)]
    assert view.floor.inside.shape == (1, 100)
    assert known.min() < limit < known.max()
    assert len(draw_accuracy(view).axes) == 4


def test_small_maps_of_a_plan_have_one_scale(plan_view):
    figure = draw_hidden(plan_view)
    assert faults(figure) == []
    bars = [a for p in figure.axes for a in p.artists if type(a).__name__ == "AnchoredSizeBar"]
    assert len(bars) == 1


def test_a_drawing_in_a_page_has_no_ground_and_as_a_file_a_white_one():
    with styled_figure(1.0) as figure:
        figure.add_subplot().plot([0, 1])
    drawing = svg(figure, "a line")
    assert "fill: #ffffff" not in drawing
    assert '<rect width="100%" height="100%" fill="white"/>' in svg_file(drawing)
    assert "<rect width" not in drawing
