"""Studies: settings that name what is wrong, runs that repeat, resumption, failures, results."""

import json
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import yaml
from cli.commands import call, done, refused
from lab.studies.chores import draw_no_figures, in_this_process

from homeward.errors import InputError
from homeward.io.reading import shipped_yaml
from homeward.lab.report.study.maps import draw_maps, grids
from homeward.lab.report.study.page import headline, write_study
from homeward.lab.simulation.simulate import simulate
from homeward.lab.studies.blocks.finish import Where
from homeward.lab.studies.blocks.store import store_of
from homeward.lab.studies.study import runs as runs_module
from homeward.lab.studies.study.plan import StudySettings, load_study, make_plan
from homeward.lab.studies.study.results import _gather, to_dataset, write_netcdf
from homeward.lab.studies.study.runs import RUN, SERIES, run_block, run_seed
from homeward.lab.studies.study.statistics import quantiles, wilson
from homeward.lab.studies.study.summary import lines, over_time, summary, table
from homeward.registry import make_estimator
from homeward.runs.report.canvas import png, styled_figure, svg
from homeward.runs.scoring import score
from homeward.track import run as follow

QUICK = {
    "name": "quick",
    "runs": 4,
    "block": 2,
    "loop": "open",
    "scenario": "circle",
    "set": {"trajectory.duration": 4, "moved.count": 1},
    "grid": {"noise.bearing_sigma": [0.01, 0.05]},
    "estimators": ["ekf", {"estimator": "a-ekf", "grid": {"parameter_sigma": [0.1, 0.3]}}],
}


def written(folder, **changes):
    path = folder / "my.yaml"
    path.write_text(yaml.safe_dump({**QUICK, **changes}, sort_keys=False))
    return path


def plan_of(folder, **changes):
    return make_plan(load_study(str(written(folder, **changes))))


def computed(plan, folder):
    """Return the results of a plan computed in this process."""
    store = store_of(plan.study, folder)
    for name, block in plan.blocks().items():
        store.save(name, run_block(block))
    return _gather(plan, store)


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    folder = tmp_path_factory.mktemp("study")
    return computed(plan_of(folder), folder / "out")


def assert_same(a, b):
    for name in (*RUN, *SERIES):
        if name != "seconds":
            np.testing.assert_array_equal(a[name], b[name], err_msg=name)


def test_a_study_holds_every_combination(results):
    plan = results.plan
    assert [c.label for c in plan.cases] == ["noise.bearing_sigma 0.01", "noise.bearing_sigma 0.05"]
    assert [c.label for c in plan.contenders] == [
        "ekf",
        "a-ekf, parameter_sigma 0.1",
        "a-ekf, parameter_sigma 0.3",
    ]
    assert plan.cases[1].scenario.noise.bearing_sigma == 0.05
    assert plan.cases[1].scenario.trajectory.duration == 4
    assert results.run["position_rmse"].shape == (2, 3, 4)
    assert np.all(np.isfinite(results.run["position_rmse"]))
    assert not results.failed.any()


def test_an_axis_may_name_points_that_set_several_keys(tmp_path):
    grid = {"place": {"near": {"landmarks.distance": [1, 2]}, "far": {"landmarks.count": 9}}}
    plan = plan_of(tmp_path, grid=grid)
    assert [c.label for c in plan.cases] == ["place near", "place far"]
    assert plan.cases[1].scenario.landmarks.count == 9


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"estimators": []}, "estimators"),
        ({"estimators": ["kalman"]}, "use one of robust"),
        ({"estimators": [{"estimator": "ekf", "settings": {"gaet": 1}}]}, "gaet"),
        ({"estimators": ["ekf", "ekf"]}, "two have the name 'ekf'"),
        ({"runs": 0}, "runs"),
        ({"loop": "round"}, "loop"),
        ({"scenario": "no-such"}, "no-such"),
        ({"set": {"noise.bearing": 1}}, "noise.bearing"),
        ({"grid": {"noise.bearing_sigma": [0.1, -1]}}, "noise.bearing_sigma -1"),
        ({"grid": {"noise.bearing_sigma": []}}, "has no values"),
        ({"grid": {f"noise.{k}": list(range(30)) for k in "abcd"}}, "810,000 scenarios"),
        ({"runs": 1_000_000, "interval": 0.001}, "memory"),
        ({"interval": 1e-12}, "memory"),
        ({"nuns": 3}, "nuns"),
    ],
)
def test_what_is_wrong_is_named_in_one_line_before_anything_is_computed(tmp_path, changes, words):
    path = written(tmp_path, **changes)
    answer = call("study", path, "--out", tmp_path / "out")
    assert words in refused(answer)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("text", ["[1, 2]", "a: [", "\xff\xfe\x00", ""])
def test_files_that_are_no_study_are_one_line(tmp_path, text):
    path = tmp_path / "bad.yaml"
    path.write_bytes(text.encode("latin-1"))
    answer = call("study", path, "--out", tmp_path / "out")
    refused(answer)


def test_a_run_is_the_same_in_any_block_and_beside_any_other(tmp_path, results):
    larger = plan_of(tmp_path, block=3, runs=5, estimators=["pi-ekf", "ekf"])
    for name, block in larger.blocks().items():
        if name.startswith("scenario00001"):
            ours = run_block(block)
            part = slice(block.first, min(block.last, 4))
            there = {k: v[1, :1, part] for k, v in (results.run | results.series).items()}
            assert_same({k: ours[k][1:, : part.stop - part.start] for k in there}, there)


def test_a_run_is_the_drive_that_its_seed_makes(results):
    seed = run_seed(0, 2)
    scenario = results.plan.cases[0].scenario.model_copy(update={"seed": seed})
    simulation = simulate(scenario)
    estimator = make_estimator("ekf", simulation.drive, results.plan.contenders[0].settings)
    metrics = score(follow(simulation.drive, estimator), simulation.drive.truth)
    assert results.run["position_rmse"][0, 0, 2] == metrics.accuracy.position.rmse
    assert results.run["nees"][0, 0, 2] == metrics.accuracy.nees_mean
    assert len({run_seed(s, k) for s in range(30) for k in range(300)}) == 9000


def test_the_closed_loop_is_steered_by_each_estimator(tmp_path):
    plan = plan_of(
        tmp_path,
        loop="closed",
        scenario="paper-homing",
        runs=2,
        grid={},
        estimators=["robust", "ekf"],
        set={"trajectory.duration": 12},
    )
    run = computed(plan, tmp_path / "out").run
    assert run["reached_home"][0, 0].tolist() == [1.0, 1.0]
    assert np.all(run["final_distance"][0, 0] <= 0.1)
    assert np.all(run["duration"][0, 0] != run["duration"][0, 1])
    assert set(run["moved_right"][0, 0]) <= {0.0, 1.0}
    assert np.isnan(run["moved_right"][0, 1]).all()


def test_the_bound_lies_below_and_is_absent_where_it_is_not_known(tmp_path, results):
    assert np.all(results.run["position_bound"] > 0)
    rms = [np.sqrt(np.mean(np.square(results.run[k]))) for k in ("position_bound", "position_rmse")]
    assert rms[0] < rms[1]
    exact = plan_of(tmp_path, runs=1, grid={}, set={**QUICK["set"], "noise.home_sigma": 0})
    assert np.isnan(computed(exact, tmp_path / "out").run["position_bound"]).all()


def test_a_failed_run_is_told_and_ends_nothing(tmp_path, monkeypatch):
    plan = plan_of(tmp_path, grid={})
    bad = run_seed(0, 1)

    def sometimes(name, drive, settings):
        if name == "a-ekf" and drive_seed["now"] == bad:
            raise FloatingPointError("too\nbad")
        return make_estimator(name, drive, settings)

    drive_seed = {}

    def remember(scenario):
        drive_seed["now"] = scenario.seed
        return simulate(scenario)

    monkeypatch.setattr(runs_module, "make_estimator", sometimes)
    monkeypatch.setattr(runs_module, "simulate", remember)
    found = computed(plan, tmp_path / "out")
    assert found.failed[0].tolist() == [[False] * 4] + [[False, True, False, False]] * 2
    assert found.failure[0, 1, 1] == "FloatingPointError: too bad"
    assert np.isnan(found.run["position_rmse"][0, 1, 1])
    assert np.isfinite(found.run["position_rmse"][0, 0]).all()
    assert "2 of 12 runs failed" in headline(found)
    write_study(tmp_path / "out", found)
    assert "FloatingPointError: too bad" in (tmp_path / "out" / "study.html").read_text()


def test_a_world_that_cannot_be_built_fails_every_run(tmp_path):
    at = {f"L{i}": [20.0, float(i)] for i in range(3)}
    changes = {"landmarks": {"layout": "listed", "at": at}, "visibility.range": [0, 1]}
    plan = plan_of(tmp_path, grid={}, set=changes)
    found = computed(plan, tmp_path / "out")
    assert found.failed.all()
    assert "no landmark in view" in found.failure[0, 0, 0]
    assert table(found.plan, summary(found)) == [["scenario", "estimator", "failed"]] + [
        [found.plan.cases[0].label if j == 0 else "", c.label, "4 of 4"]
        for j, c in enumerate(found.plan.contenders)
    ]
    write_study(tmp_path / "out", found)


def test_results_are_one_file_with_units(tmp_path, results):
    xarray = pytest.importorskip("xarray")
    pytest.importorskip("h5netcdf")
    write_netcdf(results, tmp_path / "results.nc")
    with xarray.open_dataset(tmp_path / "results.nc", engine="h5netcdf") as data:
        assert dict(data.sizes) == {"scenario": 2, "estimator": 3, "run": 4, "time": 9}
        for name in (*RUN, *SERIES):
            assert {"units", "long_name"} <= data[name].attrs.keys()
        np.testing.assert_array_equal(data.position_rmse, results.run["position_rmse"])
        assert data["scenario_noise.bearing_sigma"].values.tolist() == [0.01, 0.05]
        assert data.seed.values.tolist() == [run_seed(0, k) for k in range(4)]
        again = StudySettings.model_validate(json.loads(data.attrs["study"]))
    assert again == results.plan.study
    assert to_dataset(results).time.units == "s"


def test_the_results_are_read_as_the_manual_shows(tmp_path, results, monkeypatch, capsys):
    pytest.importorskip("h5netcdf")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "out" / "my").mkdir(parents=True)
    write_netcdf(results, tmp_path / "out" / "my" / "results.nc")
    manual = (Path(__file__).resolve().parents[3] / "docs" / "do" / "studies.md").read_text("utf-8")
    (example,) = re.findall(r"```python\n(.*?)```", manual, re.DOTALL)
    exec(compile(example, "studies.md", "exec"), {})
    assert "ekf" in capsys.readouterr().out


def test_the_summary_counts_right():
    assert wilson(0, 0) == pytest.approx((np.nan, np.nan), nan_ok=True)
    low, high = wilson(8, 10)
    assert (low, high) == pytest.approx((0.4902, 0.9433), abs=1e-4)  # Wilson 1927
    assert wilson(5, 5)[1] == 1.0
    assert quantiles(np.array([3.0, np.nan, 1.0, np.inf, 2.0]))[[0, 2, 4]].tolist() == [
        1,
        2,
        np.inf,
    ]
    assert np.isnan(quantiles(np.array([np.nan]))).all()


def test_lines_and_means_over_time_are_those_of_the_runs(results):
    line = lines(results)[1]
    rmse = results.run["position_rmse"][0, 1]
    assert line.rmse == pytest.approx(np.sqrt(np.mean(rmse**2)))
    assert line.ratio > 1
    errors = results.series["position_error"][0, 1].astype(float)
    expected = np.sqrt(np.mean(errors[:, 4] ** 2))
    assert over_time(results, "position_error", 0, 1, root=True)[4] == pytest.approx(expected)


def test_a_study_repeats_from_the_study_yaml_that_it_wrote(tmp_path, monkeypatch):
    monkeypatch.setattr("homeward.lab.studies.blocks.finish.on_processes", in_this_process)
    path = written(tmp_path, runs=1, grid={}, estimators=["ekf"])
    done(call("study", path, "--out", tmp_path / "a"))
    assert {"results.nc", "study.html", "overview.png"} <= {
        p.name for p in (tmp_path / "a").iterdir()
    }
    again = load_study(str(tmp_path / "a" / "study.yaml"))
    assert again == load_study(str(path))
    more = call("study", path, "--out", tmp_path / "a", "--runs", "2")
    assert "runs was 1, is 2" in refused(more)


def test_somebody_elses_folder_is_left_alone(tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "thesis.tex").touch()
    answer = call("study", written(tmp_path), "--out", tmp_path / "out")
    assert answer.exit_code == 2
    assert [p.name for p in (tmp_path / "out").iterdir()] == ["thesis.tex"]


@pytest.mark.parametrize("how", [signal.SIGTERM, signal.SIGKILL])
def test_a_stopped_study_goes_on_from_its_finished_blocks(tmp_path, how, monkeypatch):
    path = written(tmp_path, runs=12, block=1, grid={}, estimators=["ekf"])
    out = tmp_path / "out"
    words = [sys.executable, "-c", "from homeward.cli.main import app; app()"]
    process = subprocess.Popen(
        [*words, "study", str(path), "--out", str(out)],
        stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        text=True,
    )
    blocks = out / "blocks"
    deadline = time.monotonic() + 240  # of a busy machine
    while len(list(blocks.glob("*.npz"))) < 2 and time.monotonic() < deadline:
        time.sleep(0.01)
    process.send_signal(how)
    _, complaint = process.communicate(timeout=240)
    if how == signal.SIGKILL:
        assert process.returncode == -signal.SIGKILL
    else:
        assert process.returncode == 130
        assert complaint.startswith("homeward: stopped")
        assert len(complaint.splitlines()) == 1
    kept = {p.name: p.stat().st_mtime_ns for p in blocks.glob("*.npz")}
    assert 2 <= len(kept) < 12
    assert not (out / "results.nc").exists()
    monkeypatch.setattr("homeward.lab.studies.blocks.finish.on_processes", in_this_process)
    draw_no_figures(monkeypatch)
    done(call("study", path, "--out", out))
    assert len(list(blocks.glob("*.npz"))) == 12
    assert {name: (blocks / name).stat().st_mtime_ns for name in kept} == kept


def test_who_names_no_study_is_told_of_all_that_ship_maps_too():
    with pytest.raises(InputError, match=r"a-ekf-tuning.*pi-ekf-tuning"):
        load_study("nonsense")


def test_studies_that_ship_are_valid():
    assert {"a-ekf-tuning", "pi-ekf-tuning"} <= shipped_yaml("studies").keys()
    for name in shipped_yaml("studies"):
        plan = make_plan(load_study(name))
        assert plan.study.name == name


def test_a_tuning_study_draws_its_map(tmp_path):
    values = {"proportional": [0.01, 0.1], "integral_gain": [0.1, 1.0]}
    entries = ["ekf", {"estimator": "pi-ekf", "grid": values}]
    plan = plan_of(tmp_path, runs=1, grid={}, estimators=entries)
    found = computed(plan, tmp_path / "out")
    (grid,) = grids(found)
    assert grid.axes == ("proportional", "integral_gain")
    assert png(draw_maps(found, grid)).startswith(b"\x89PNG")
    # As numbers they act by their product alone.
    rmse = found.run["position_rmse"][0, :, 0]
    assert rmse[2] == pytest.approx(rmse[3], rel=1e-9)
    assert rmse[1] != pytest.approx(rmse[4], rel=1e-3)


def test_both_kinds_of_workers_at_once_are_refused():
    with pytest.raises(InputError, match="give one of"):
        Where(scheduler="tcp://localhost:1", workers=2)


def test_a_figure_in_a_page_keeps_the_digits_of_its_numbers():
    with styled_figure(1.0) as figure:
        figure.text(0.123456789, 0.5, "0.00123456 m")
    assert "0.00123456 m" in svg(figure, "digits")
