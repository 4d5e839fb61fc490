"""The leaderboard: who is ranked how, and that it runs."""

import numpy as np
import pytest
from lab.studies.chores import in_this_process

from benchmarks.consistency.scenarios import Family
from benchmarks.leaderboard import __main__ as command
from benchmarks.leaderboard.board import (
    Entry,
    by_family,
    common_rmse,
    entries,
    overall,
    page,
    ratio,
)
from benchmarks.leaderboard.families import FIRST, numbers
from benchmarks.leaderboard.runs import BASELINE, every, one
from benchmarks.monte_carlo import Run

TIMES = np.arange(10.0)


def row_of(name, number, error, **changes):
    """A run with an error at each time."""
    good = {"pose": 1.0, "beyond4": 0.0, "rmse": error, "first": 0.0, "seconds": 0.1}
    arrays = {"t": TIMES, "weight": np.ones(10), "position": np.full(10, error)}
    row = {"family": "f", "number": number, "estimator": name}
    return row | good | arrays | changes


def rows_of(name, number, error):
    draw = np.random.default_rng(0)
    return [row_of(name, k, error * float(draw.lognormal(0.0, 0.3))) for k in range(number)]


def test_failures_rank_before_errors(monkeypatch):
    precise = rows_of("precise", 20, 0.01)
    precise[3]["beyond4"] = 0.9
    precise[4] = {"family": "f", "number": 4, "estimator": "precise", "error": "ValueError: no"}
    precise[5]["pose"] = 0.4
    rows = rows_of("robust", 20, 0.1) + precise + rows_of("poor", 20, 0.3)
    names = ["robust", "poor", "precise"]
    monkeypatch.setattr("benchmarks.leaderboard.board.given", lambda name: "nothing")
    table = overall(entries(rows, names, ["f"]))
    assert [row[0] for row in table] == ["estimator", "robust", "poor", "precise"]
    assert [row[2] for row in table[1:]] == ["0 % of 20", "0 % of 20", "15 % of 20"]
    assert table[2][5:7] == ["3 (3 to 3)", "0 of 20"]  # the same noise in both
    assert by_family(rows, names, {"f": Family("", one)})[1][3].endswith("(15 %)")
    text = page(rows, names, {"f": Family("flat", one)}, "x", "a commit")
    assert "Simulated drives: 20 in 1 families" in text
    assert "- precise: ValueError: no" in text


def test_errors_are_of_the_common_times_of_all_that_did_not_fail():
    early = row_of("early", 0, 1.0, t=TIMES[:5], weight=np.ones(5), position=np.arange(5.0))
    late = row_of("late", 0, 1.0, t=TIMES[3:], weight=np.ones(7), position=np.ones(7))
    failed = row_of("failed", 0, 1.0, t=TIMES[9:], pose=0.1)
    assert common_rmse([early, late, failed]) == pytest.approx(
        [np.sqrt((9 + 16) / 2), 1.0, np.nan], nan_ok=True
    )


def test_drives_of_one_number_are_one_sample_of_an_interval():
    first, other = (
        Entry(name, [{"number": k % 3} for k in range(6)], np.array(rmse))
        for name, rmse in (("a", [2.0] * 6), ("b", [1.0, 1.0, 1.0, 4.0, 4.0, 4.0]))
    )
    assert ratio(first, other) == pytest.approx((1.0, 1.0, 1.0))


def test_it_runs_and_continues_from_what_is_kept(tmp_path, monkeypatch):
    monkeypatch.setattr("homeward.lab.studies.blocks.finish.on_processes", in_this_process)
    rows = every([("table", 0)], ["robust"], 1, tmp_path / "kept")
    assert rows[0]["rmse"] < 0.05
    assert rows[0]["pose"] > 0.5
    both = every([("table", 0)], ["robust", BASELINE], 1, tmp_path / "kept")
    assert [row["estimator"] for row in both] == ["robust", BASELINE]
    assert both[0]["seconds"] == rows[0]["seconds"]  # it was not run again


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
    said = "`python -m benchmarks.leaderboard --family table --estimator robust"
    assert said in text
    assert str(tmp_path) not in text
    by_hand = "\n## Peers\n\nBy hand.\n"
    out.write_text("# Leaderboard\n\nOld tables.\n" + by_hand)
    command.main()
    renewed = out.read_text()
    assert renewed.endswith(by_hand)
    assert said in renewed
    assert "Old tables" not in renewed


def test_simulated_drives_have_fresh_seeds_and_real_ones_their_robots():
    assert numbers(Family("", one), 3) == range(FIRST, FIRST + 3)
    assert numbers(Family("", one, real=True, copies=4), 2) == range(8)


@pytest.mark.parametrize("name", ["utias-6", "utias-6-moved", "utias-6-half"])
def test_real_drives_are_those_of_the_data(data_dir, name):
    from benchmarks.leaderboard.families import real

    if not (data_dir / "MRCLAM_Dataset6").is_dir():
        pytest.skip("no MRCLAM_Dataset6 in the data folder")
    trial = real()[name].drive(1)
    assert trial.drive.truth is not None
    assert len(trial.moved) == (3 if name == "utias-6-moved" else 0)
    assert np.isinf(trial.bound).all()
