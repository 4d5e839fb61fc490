"""Texts that a spreadsheet would execute as formulas, in tables that homeward writes and reads."""

import csv

import numpy as np
import pytest
from cli.commands import call, done, first_seconds

from homeward.drives.folder import read_folder, write_folder
from homeward.drives.opening import open_drive
from homeward.estimator import LandmarkEstimate
from homeward.io.table import identifiers, read_csv, write_csv
from homeward.runs.report.files import write_landmarks, write_tables

FORMULAS = [
    "=cmd|calc!A1",
    "=1+1",
    "+1+1",
    "-2+3",
    "@SUM(A1)",
    "\tx",
    "\rx",
    "\uff1d1+1",
    "'=1",
    "''-1+1",
    "-1_0",
    "-",
]
PLAIN = ["L1", "'", "'L1", "1=1", "-1.5", "+1e3", "-inf", "'L=1", "a-b", ""]


def cells(file):
    with file.open(newline="", encoding="utf-8") as stream:
        return [row[0] if row else "" for row in csv.reader(stream)]


@pytest.mark.parametrize("text", FORMULAS)
def test_a_formula_is_written_as_text(text, tmp_path):
    write_csv(tmp_path / "x.csv", [text], [[text, text, -1.5]])
    assert cells(tmp_path / "x.csv") == [f"'{text}"] * 2


def test_other_texts_and_numbers_are_unchanged(tmp_path):
    rows = [*([text] for text in PLAIN if text), [-1.5], [np.float64(-2.0)], [-3], [None], [True]]
    write_csv(tmp_path / "x.csv", ["id"], rows)
    expected = [*(text for text in PLAIN if text), "-1.5", "-2.0", "-3", "", "True"]
    assert cells(tmp_path / "x.csv")[1:] == expected


def test_every_id_is_read_as_it_was_written(tmp_path):
    ids = [text for text in (*FORMULAS, *PLAIN) if text and text.isprintable()]
    write_csv(tmp_path / "x.csv", ["id"], [[text] for text in ids])
    assert read_csv(tmp_path / "x.csv", {"id": identifiers})["id"].tolist() == ids


def test_landmarks_of_a_run_and_tables_have_no_formula(tmp_path):
    landmark = LandmarkEstimate("=cmd|calc!A1", -1.0, 2.0, sightings=3)
    write_landmarks(tmp_path / "landmarks.csv", [landmark])
    row = (tmp_path / "landmarks.csv").read_text().splitlines()[1]
    assert row.startswith("'=cmd|calc!A1,-1,2,")
    write_tables(tmp_path, [["a"], ["b"]], [["estimator", "error"], ["@label", -0.5]])
    assert (tmp_path / "table.csv").read_text() == "estimator,error\n'@label,-0.5\n"


def test_a_drive_with_formulas_as_ids_reads_back_and_runs(tmp_path):
    short = first_seconds(tmp_path / "short", 3.0)
    for name in ("bearings.csv", "home.csv"):
        text = (short / name).read_text()
        (short / name).write_text(text.replace("L06", "=cmd|calc!A1"))
    drive = open_drive(short)
    assert "=cmd|calc!A1" in drive.home
    write_folder(drive, tmp_path / "written")
    assert "'=cmd|calc!A1" in (tmp_path / "written" / "bearings.csv").read_text()
    again = read_folder(tmp_path / "written")
    assert again.home == drive.home
    assert again.sightings.landmark.tolist() == drive.sightings.landmark.tolist()
    done(call("run", tmp_path / "written", "--out", tmp_path / "out"))
    assert "=cmd|calc!A1" not in cells(tmp_path / "out" / "landmarks.csv")
    assert "'=cmd|calc!A1" in cells(tmp_path / "out" / "landmarks.csv")
