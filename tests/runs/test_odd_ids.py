"""Landmarks with any ids: every file and page is written, and the ids come back as they were."""

import csv

from runs.made_up_run import made_up

from homeward.runs.report.folder import write_run

ODD = (
    "9" * 5000,
    "=cmd|' /C calc'!A0",
    "+1",
    "@SUM(A1)",
    "-2+3",
    "$\\frac$",
    "mark 10",
    "mark 9",
    "٣",
)


def test_a_run_is_written_whatever_landmarks_are_called(tmp_path):
    drive, track = made_up(ids=ODD)
    write_run(tmp_path / "out", drive, track, {"drive": "made up"})
    with (tmp_path / "out" / "landmarks.csv").open(encoding="utf-8", newline="") as stream:
        assert {row["landmark"] for row in csv.DictReader(stream)} == set(ODD)
    assert (tmp_path / "out" / "report.html").stat().st_size > 0
