"""The leaderboard: who is ranked how, and that it runs."""

import numpy as np
import pytest
from lab.studies.chores import in_this_process

from benchmarks.leaderboard import __main__ as command
from benchmarks.leaderboard.board import by_family, entries, overall, page
from benchmarks.leaderboard.families import HELD_OUT, Family, numbers
from benchmarks.leaderboard.runs import BASELINE, every, one
from benchmarks.monte_carlo import Run

GOOD = {"pose": 1.0, "wrong": 0.0, "rmse": 0.1, "nees": 3.0, "to_bound": 1.0, "seconds": 0.1}


def rows_of(name, number, **changes):
    draw = np.random.default_rng(0)
    found = []
    for k in range(number):
        rmse = changes.get("rmse", 0.1) * float(draw.lognormal(0.0, 0.3))
        row = {"family": "f", "number": k, "estimator": name}
        found.append(row | GOOD | changes | {"rmse": rmse})
    return found


def test_failures_rank_before_errors(monkeypatch):
    precise = rows_of("precise", 20, rmse=0.01)
    precise[3]["wrong"] = 0.9
    precise[4] = {"family": "f", "number": 4, "estimator": "precise", "error": "ValueError: no"}
    precise[5]["pose"] = 0.4
    rows = rows_of("robust", 20) + precise + rows_of("poor", 20, rmse=0.3)
    names = ["robust", "poor", "precise"]
    monkeypatch.setattr("benchmarks.leaderboard.board.given", lambda name: "nothing")
    table = overall(entries(rows, names, ["f"]))
    assert [row[0] for row in table] == ["estimator", "robust", "poor", "precise"]
    assert [row[2] for row in table[1:]] == ["0 % of 20", "0 % of 20", "15 % of 20"]
    # The same noise in both: the ratio is exact, and certain.
    assert table[2][5] == "3 (3 to 3)"
    assert table[2][6] == "< 0.001"
    assert by_family(rows, names, {"f": Family("", one)})[1][3].endswith("(15 %)")
    text = page(rows, names, {"f": Family("flat", one)}, "x")
    assert "Simulated drives: 20 in 1 families" in text
    assert "- precise: ValueError: no" in text


def test_it_runs_and_continues_from_what_is_kept(tmp_path, monkeypatch):
    monkeypatch.setattr("homeward.lab.studies.blocks.finish.on_processes", in_this_process)
    rows = every([("table", 0)], ["robust"], 1, tmp_path / "kept")
    assert rows[0]["rmse"] < 0.05
    assert rows[0]["pose"] > 0.5
    both = every([("table", 0)], ["robust", BASELINE], 1, tmp_path / "kept")
    assert [row["estimator"] for row in both] == ["robust", BASELINE]
    assert both[0] == rows[0]  # to the processor time: it was not run again


def test_an_estimator_that_fails_is_a_row():
    row = one(Run("table", "benchmarks.fuzz:nothing_there", 0))
    assert "has no nothing_there" in row["error"]


def test_the_command_writes_the_page(tmp_path, monkeypatch, capsys):
    out = tmp_path / "board.md"
    words = ["--family", "table", "--estimator", f"robust,{BASELINE}", "--quick", "--jobs", "1"]
    monkeypatch.setattr("sys.argv", ["leaderboard", *words, "--out", str(out)])
    command.main()
    text = out.read_text()
    assert text in capsys.readouterr().out
    said = "`python -m benchmarks.leaderboard --quick --family table --estimator robust"
    assert said in text
    assert str(tmp_path) not in text


def test_real_drives_are_either_for_development_or_held_out():
    known, held_out = (Family("", one, real=True, held_out=k, copies=4) for k in (False, True))
    assert [len(numbers(known, 2, k)) for k in (True, False)] == [8, 0]
    assert [len(numbers(held_out, 2, k)) for k in (True, False)] == [0, 8]
    assert numbers(Family("", one), 3, False)[0] == HELD_OUT


@pytest.mark.parametrize("name", ["utias-6", "utias-6-moved", "utias-6-half"])
def test_real_drives_are_those_of_the_data(data_dir, name):
    from benchmarks.leaderboard.families import real

    if not (data_dir / "MRCLAM_Dataset6").is_dir():
        pytest.skip("no MRCLAM_Dataset6 in the data folder")
    trial = real()[name].make(1)
    assert trial.drive.truth is not None
    assert len(trial.moved) == (3 if name == "utias-6-moved" else 0)
    assert np.isinf(trial.bound).all()
