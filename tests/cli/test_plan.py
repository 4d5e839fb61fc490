"""`homeward plan` as a user would call it."""

import csv

import pytest
import yaml
from commands import call, done, refused

from homeward.io.reading import shipped
from homeward.lab.planning.analysis import analyse
from homeward.lab.planning.settings import load_plan
from homeward.lab.report.plan import plan_summary

FILES = {
    "plan.html",
    "plan.yaml",
    "floor.csv",
    *(f"{name}.{kind}" for name in ("begin", "accuracy", "hidden") for kind in ("png", "svg")),
}


@pytest.fixture
def example(tmp_path):
    """The example, on a coarse grid, with one change."""

    def write(**changes):
        tree = yaml.safe_load(shipped("plans", "warehouse.yaml").read_text())
        file = tmp_path / "plan.yaml"
        file.write_text(yaml.safe_dump({**tree, "grid": 0.8, **changes}))
        return file

    return write


def test_the_example(tmp_path, example):
    out = tmp_path / "out"
    answer = done(call("plan", example(), "--out", out))
    for part in ("Homing can begin on", "any one", "most important"):
        assert part in answer.stdout
    assert {p.name for p in out.iterdir()} == FILES
    page = (out / "plan.html").read_text()
    assert "<script" not in page
    assert "http" not in page.replace("http-equiv", "").replace("http://www.w3.org", "")
    with (out / "floor.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert 80 < len(rows) < 15 * 10
    assert {row["begins"] for row in rows} == {"yes", "no"}
    assert all(row["position_sigma"] for row in rows if row["begins"] == "yes")
    repeated = analyse(load_plan(str(out / "plan.yaml")))
    assert [k == "yes" for k in (row["begins"] for row in rows)] == repeated.begins.tolist()


@pytest.mark.parametrize(
    ("place", "words"),
    [
        ("5,3", "Homing can begin at (5, 3): "),
        ("11.5,7", "Homing cannot begin at (11.5, 7): three landmarks in common"),
        ("9.6,0.3", "limit 0.30 m"),
    ],
)
def test_a_place_is_told_whether_homing_can_begin_there(tmp_path, monkeypatch, place, words):
    monkeypatch.chdir(tmp_path)
    answer = call("plan", "warehouse", "--from", place)
    assert words in " ".join(answer.stdout.split())
    assert answer.exit_code == ("cannot" in answer.stdout)
    assert not list(tmp_path.iterdir())


def test_one_place_has_the_result_of_the_map(example):
    plan = load_plan(str(example(grid=1.0)))
    view = analyse(plan)
    for k in (0, len(view.score) // 2):
        one = analyse(plan, place=tuple(view.places[k].tolist()))
        assert (one.begins, one.common) == (view.begins[k], view.common[k])
        assert one.position == pytest.approx(view.position[k])


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"landmarks": {}}, "No landmarks"),
        ({"landmarks": {"a": [0, 5], "b": [0, 2]}}, "on a circle through them"),
        ({"landmarks": {"a": [0, 5], "b": [0, 2], "c": [0, 7]}}, "the limit is 4"),
        ({"limits": {"position": 1e-6}}, "exceed the limits"),
        ({"drive": {"length": 1e-9}}, "is not observable anywhere"),
        ({"sensor": {"range": [0.0, 0.1]}}, "No landmark is visible from home"),
    ],
)
def test_poor_plans_get_a_clear_statement(example, changes, words):
    assert words in plan_summary(analyse(load_plan(str(example(grid=1.0, **changes)))))


@pytest.mark.parametrize(
    "marks", [{}, {"$x^{<b>": [0, 5], "日本 🏠": [0, 2], "": [3, 0], "d\n": [0, 1]}]
)
def test_pages_of_no_landmarks_and_of_odd_names(tmp_path, example, marks):
    done(call("plan", example(landmarks=marks, grid=1.0), "--out", tmp_path / "out"))
    assert "<b>" not in (tmp_path / "out" / "plan.html").read_text()


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({"outline": [[0, 0], [5, 0]]}, "outline"),
        ({"outline": [[0, 0], [5, 5], [5, 0], [0, 5]]}, "self-intersection"),
        ({"home": {"x": 3, "y": 1.6}}, "inside shelves.0"),
        ({"landmarks": {"far": [99, 9]}}, "landmarks.far"),
        ({"landmarks": {"here": [1.2, 3.4]}}, "landmarks.here"),
        ({"landmarks": {"a": [float("nan"), 1]}}, "landmarks.a"),
        ({"sensor": {"bearing_sigma": 0}}, "sensor.bearing_sigma"),
        ({"sensor": {"range": [3, 1]}}, "minimum, maximum"),
        ({"grid": 0}, "grid"),
        ({"grid": 0.0001}, "grid"),
        ({"drive": {"length": 1000}}, "drive.length"),
        ({"colour": "red"}, "colour"),
    ],
)
def test_wrong_plans_are_one_line(tmp_path, example, changes, word):
    answer = call("plan", example(**changes), "--out", tmp_path / "out")
    assert word in refused(answer)
    assert not (tmp_path / "out").exists()
