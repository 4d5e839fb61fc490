"""Maps over two numbers of a filter: the layout study's runs, counted whatever the blocks."""

import csv
import json

import numpy as np
import pytest
import yaml
from cli.commands import call, done, refused
from lab.studies.chores import in_this_process

from homeward.io.reading import shipped_yaml
from homeward.lab.report.paper.map import cells, draw_map, headline
from homeward.lab.studies.blocks.finish import StudyBlocks
from homeward.lab.studies.blocks.store import store_of
from homeward.lab.studies.paper import map as maps
from homeward.lab.studies.paper.cases import run_many
from homeward.lab.studies.paper.layouts import changed
from homeward.lab.studies.paper.map import FAR_M, run_map, with_engine
from homeward.lab.studies.paper.map_settings import load_map
from homeward.lab.studies.paper.world import draw_world
from homeward.lab.studies.study.settings import load_study

QUICK = {
    "name": "quick",
    "filter": "PI-EKF",
    "case": "2",
    "runs": 4 * 120,
    "set": {"assumed.initial_error": [0.05, 0.1, 0.1], "assumed.longest": 8},
    "map": {
        "printed.Pi": {"from": 0.01, "to": 0.2, "number": 2},
        "printed.M": {"from": 0.01, "to": 1, "number": 2},
    },
}


@pytest.fixture(autouse=True)
def here(monkeypatch):
    monkeypatch.setattr("homeward.lab.studies.blocks.finish.on_processes", in_this_process)


def written(folder, **changes):
    path = folder / "my.yaml"
    path.write_text(yaml.safe_dump({**QUICK, **changes}, sort_keys=False))
    return path


def computed(folder, name="out", **changes):
    settings = with_engine(load_map(str(written(folder, **changes)), {}))
    return run_map(settings, StudyBlocks(store_of(settings, folder / name)))


def test_a_cell_is_the_layout_study_in_distribution(tmp_path):
    found = computed(tmp_path)
    settings = found.settings
    worlds = [draw_world("2", settings.paper, k) for k in range(found.runs)]
    ekf = run_many("EKF", "2", worlds, settings.paper)
    across, up = (axis.values for axis in settings.map.values())
    for i, j in np.ndindex(2, 2):
        cell = changed(settings.paper, {"printed": {"Pi": across[j], "M": up[i]}})
        other = run_many("PI-EKF", "2", worlds, cell)
        logs = np.log(other.rmse / ekf.rmse).mean(axis=1)
        sigma = np.hypot(found.ratio_sigma[i, j], logs.std() / np.sqrt(logs.size))
        assert abs(np.log(found.ratio[i, j]) - logs.mean()) < 4 * sigma + 1e-4
        share = np.mean(other.final_distance > FAR_M[0])
        assert abs(found.far[i, j, 0] - share) < 4 * np.sqrt(0.5 / found.runs)
    # Pi and M as numbers act by their product, so two corners of such a map say different things.
    assert found.ratio[1, 1] > 1.2 * found.ratio[0, 0]


def test_counts_do_not_depend_on_the_blocks(tmp_path, monkeypatch):
    whole = computed(tmp_path, runs=4 * 50)
    monkeypatch.setattr(maps, "AT_ONCE", 17)
    parts = computed(tmp_path, "parts", runs=4 * 50)
    for name in ("far", "better", "diverged", "reference_far"):
        np.testing.assert_array_equal(getattr(whole, name), getattr(parts, name), err_msg=name)
    np.testing.assert_allclose(whole.ratio, parts.ratio, rtol=1e-12)


def test_finished_blocks_are_not_computed_again(tmp_path, monkeypatch):
    first = computed(tmp_path, runs=8)
    monkeypatch.setattr("homeward.lab.studies.blocks.finish.on_processes", None)
    np.testing.assert_array_equal(computed(tmp_path, runs=8).ratio, first.ratio)


def test_the_command_leaves_a_picture_and_every_cell(tmp_path):
    file, out = written(tmp_path), tmp_path / "out"
    said = json.loads(done(call("study", file, "--runs", 30, "--out", out, "--json")).stdout)
    assert said["summary"].startswith("PI-EKF, Case 2: 4 cells of 8 runs each")
    with open(said["table"], newline="") as stream:
        head, *rows = csv.reader(stream)
    assert head[:3] == ["printed.Pi", "printed.M", "runs"]
    assert len(rows) == 4
    assert (out / "map.png").read_bytes().startswith(b"\x89PNG")
    assert "another study" in refused(call("study", file, "--runs", 60, "--out", out))


def test_an_a_ekf_is_mapped_with_one_parameter_too(tmp_path):
    axes = {key: {"from": 0.01, "to": 1, "number": 2} for key in ("printed.P0", "printed.Qd")}
    told = {"filter": "A-EKF (one)", "case": "3 (one fault)", "map": axes, "runs": 8}
    found = computed(tmp_path, **told, engine="interpreter", set={"assumed.longest": 1})
    assert found.ratio.shape == (2, 2)
    assert "3 (one fault)" in headline(found)
    assert len(cells(found)) == 5
    assert len(draw_map(found).axes) == 4


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"map": {"printed.Pi": QUICK["map"]["printed.Pi"]}}, "map: name two keys"),
        ({"map": {**QUICK["map"], "assumed.faults": {"from": 1, "to": 2, "number": 2}}}, "faults"),
        ({"map": {"printed.Pi": {"from": 0, "to": 1, "number": 3}}}, "from"),
        ({"filter": "robust"}, "filter"),
        ({"set": {"assumed.nothing": 1}}, "nothing"),
        ({"set": {"measurements": "images"}}, "measurements"),
        ({"set": {"printed.sample_time": 1e-9}}, "100,000 bearings in a run"),
        ({"runs": 0}, "runs"),
    ],
)
def test_what_cannot_be_mapped_is_refused_in_a_line(tmp_path, changes, words):
    assert words in refused(call("study", written(tmp_path, **changes), "--out", tmp_path / "out"))
    assert not (tmp_path / "out").exists()


def test_shipped_maps_can_be_computed_and_studies_are_none():
    for name in shipped_yaml("maps"):
        assert load_map(name, {"runs": 7}).each == 1
    assert load_map("peers", {}) is None
    assert load_study("peers").name == "peers"
