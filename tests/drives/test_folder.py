"""The drive folder: what it accepts, and what it refuses and in which words."""

import math
import tracemalloc

import numpy as np
import pytest
from refusals import refusal
from valid_drive import VALID, put

from homeward.drives.folder import (
    BAD_RANGES,
    BEYOND_A_TURN,
    HOME_ADVICE,
    read_folder,
    write_folder,
)
from homeward.drives.ids import REPEATED_SIGHTINGS
from homeward.drives.importers.reading import understand
from homeward.drives.settings import DriveSettings
from homeward.io.table import CHUNK


def test_reads_every_file(tmp_path):
    drive = read_folder(put(tmp_path / "run"))
    assert drive.name == "run"
    np.testing.assert_array_equal(drive.odometry.t, [0.0, 0.5, 1.0])
    np.testing.assert_array_equal(drive.odometry.omega, [0.0, 0.2, -0.2])
    assert drive.sightings.landmark.tolist() == ["a", "b", "a"]
    np.testing.assert_array_equal(drive.sightings.bearing, [0.5, -0.5, 0.4])
    np.testing.assert_array_equal(drive.sightings.sigma, [0.01, np.nan, 0.02])
    assert [b.bearing for b in drive.home.values()] == [0.25, -1.5]
    assert all(math.isnan(b.sigma) for b in drive.home.values())
    assert drive.settings.sensor.x == 0.2
    assert drive.settings.start.R == 1.0
    assert drive.truth is not None
    np.testing.assert_array_equal(drive.truth.x, [1.0, 1.1])
    assert drive.remarks == {}


ODOMETRY_ROWS = [[0.0, 0.1, 0.0], [0.5, 0.1, 0.2], [1.0, 0.1, -0.2]]


@pytest.mark.parametrize(
    "content",
    [
        pytest.param(b"\xef\xbb\xbf" + VALID["odometry.csv"], id="byte order mark"),
        pytest.param(VALID["odometry.csv"].replace(b"\n", b"\r\n"), id="CRLF"),
        pytest.param(VALID["odometry.csv"].replace(b"\n", b"\r"), id="CR"),
        pytest.param(VALID["odometry.csv"] + b"\n\r\n  \n", id="blank lines at the end"),
        pytest.param(VALID["odometry.csv"].rstrip(), id="no line end at the end"),
        pytest.param(
            b"note,omega,t,v\nx,0.0,0.0,0.1\n\xc3\xa9,0.2,0.5,0.1\n,-0.2,1.0,0.1\n",
            id="other order and another column",
        ),
        pytest.param(b" t , v,omega\n0 , 1e-1,0\n5e-1,\t.1,.2\n1,0.1,-.2\n", id="white space"),
        pytest.param(b't,v,omega\n"0",0.1,0\n0.5,"0.1",0.2\n1,0.1,-0.2\n', id="quotes"),
    ],
)
def test_accepts(tmp_path, content):
    odometry = read_folder(put(tmp_path / "run", odometry_csv=content)).odometry
    np.testing.assert_array_equal(np.c_[odometry.t, odometry.v, odometry.omega], ODOMETRY_ROWS)


def test_of_equal_stamps_the_last_counts_and_is_counted(tmp_path):
    drive = read_folder(
        put(
            tmp_path / "run",
            odometry_csv=b"t,v,omega\n0,1,0\n0,2,0\n0,3,0\n1,4,0\n2,5,0\n2,6,0\n",
            truth_csv=b"t,x,y,heading\n0,1,0,0\n0,2,0,0\n1,3,0,0\n",
        )
    )
    np.testing.assert_array_equal(drive.odometry.t, [0, 1, 2])
    np.testing.assert_array_equal(drive.odometry.v, [3, 4, 6])
    np.testing.assert_array_equal(drive.truth.x, [2, 3])
    assert drive.remarks == {
        "odometry rows with a repeated stamp; the last counts": 3,
        "ground truth rows with a repeated stamp; the last counts": 1,
    }


def test_rows_that_are_a_little_late_are_sorted_as_in_a_log(tmp_path):
    """By 0.25 s, or written twice; an import and a log had sorted them, a folder was refused."""
    rows = b"0.5,0.1,0.2\n0.75,0.3,0\n0.5,0.1,0.2\n0.75,0.3,0\n1.0,0.1,-0.2\n"
    seen = b"t,landmark,bearing\n0.6,a,0.4\n0.35,b,-0.5\n0.6,a,0.4\n"
    true = b"t,x,y,heading\n1.0,1.1,0.0,0.1\n0.0,1.0,0.0,0.0\n"
    folder = put(
        tmp_path / "run", odometry_csv=b"t,v,omega\n" + rows, bearings_csv=seen, truth_csv=true
    )
    drive = read_folder(folder)
    assert drive.odometry.t.tolist() == [0.5, 0.75, 1.0]
    assert drive.odometry.v.tolist() == [0.1, 0.3, 0.1]
    assert drive.sightings.landmark.tolist() == ["b", "a", "a"]
    assert drive.truth.x.tolist() == [1.0, 1.1]
    assert drive.remarks == {
        "rows of bearings were out of order; sorted by time": 1,
        "repeated sightings of a landmark at one stamp; the last counts": 1,
        "rows of odometry were out of order; sorted by time": 1,
        "odometry rows with a repeated stamp; the last counts": 2,
        "rows of ground truth were out of order; sorted by time": 1,
    }


def test_a_survey_from_home_replaces_odometry_and_home_bearings(tmp_path):
    survey = b"frame: home\nlandmarks: {a: {x: 1, y: 2}, b: {x: 3, y: 4}}\n"
    folder = put(tmp_path / "run", landmarks_yaml=survey)
    for name in ("odometry.csv", "home.csv"):
        (folder / name).unlink()
    drive = read_folder(folder)
    assert drive.home == {}
    np.testing.assert_array_equal(drive.odometry.t, np.unique(drive.sightings.t))
    assert np.isnan(drive.odometry.v).all()
    assert "stamps of bearings without odometry" in drive.remark_lines[-1]
    (folder / "landmarks.yaml").unlink()
    assert "no odometry.csv, home.csv" in refusal(read_folder, folder)


def test_ids_are_any_printable_text(tmp_path):
    content = 't,landmark,bearing\n0,"door, left",0\n0, 7 ,0\n0,"a ""b""",0\n0,é,0\n'
    drive = read_folder(put(tmp_path / "run", bearings_csv=content.encode()))
    assert drive.sightings.landmark.tolist() == ["door, left", "7", 'a "b"', "é"]


def test_ids_that_move_together_may_be_numbers_and_a_wrong_one_is_reported(tmp_path):
    bearings = b"t,landmark,bearing\n0,42,0\n0,43,0\n"
    together = b"together: [[42, 43, 44]]\n"
    drive = read_folder(put(tmp_path / "run", bearings_csv=bearings, drive_yaml=together))
    assert drive.settings.together == (("42", "43", "44"),)
    assert any("drive.yaml without sightings in this drive: '44'" in r for r in drive.remarks)


@pytest.mark.parametrize("given", ["5", "[42, 43]", "[[]]", "{42: 43}", "[[1, [2]]]", "[null]"])
def test_groups_that_are_no_lists_of_ids_are_refused(tmp_path, given):
    folder = put(tmp_path / "run", drive_yaml=f"together: {given}\n".encode())
    assert "drive.yaml: together" in refusal(read_folder, folder)


def test_bearings_are_wrapped(tmp_path):
    given = [math.pi, -math.pi, 3.5, -7.0, 2000 * math.pi, -2001 * math.pi, 0.1]
    rows = "".join(f"0,a,{bearing!r}\n" for bearing in given)
    drive = read_folder(put(tmp_path / "run", bearings_csv=f"t,landmark,bearing\n{rows}".encode()))
    bearing = drive.sightings.bearing
    assert (bearing > -math.pi).all()
    assert (bearing <= math.pi).all()
    np.testing.assert_allclose(np.exp(1j * bearing), np.exp(1j * np.array(given)), atol=1e-12)
    assert bearing[0] == math.pi
    assert bearing[-1] == 0.1
    assert drive.remarks == {BEYOND_A_TURN: 3, REPEATED_SIGHTINGS: 6}


def test_of_sightings_of_one_landmark_at_one_stamp_the_last_counts(tmp_path):
    content = b"t,landmark,bearing\n0,a,1\n0,b,2\n0,a,3\n1,a,1\n"
    drive = read_folder(put(tmp_path / "run", bearings_csv=content))
    assert [seen for _, seen, _ in drive.sightings.stamps()] == [{"a": 3.0, "b": 2.0}, {"a": 1.0}]
    assert drive.remarks == {REPEATED_SIGHTINGS: 1}


HEADER = b"t,landmark,bearing,sigma\n"
HOSTILE = [
    ("odometry.csv", b"", "odometry.csv: empty file"),
    ("odometry.csv", b"\n\n", "odometry.csv: empty file"),
    ("odometry.csv", b"t,v,omega\n", "odometry.csv: no rows"),
    ("odometry.csv", b"t,v\n0,1\n", "odometry.csv, row 1: no column omega in the header 't,v'"),
    ("odometry.csv", b"0,0,0\n1,0,0\n", "odometry.csv, row 1: no column t, v, omega in the head"),
    ("odometry.csv", b"t;v;omega\n0;0;0\n", "odometry.csv, row 1: no column t, v, omega"),
    ("odometry.csv", b"t,v,omega,v\n0,0,0,0\n", "odometry.csv, row 1: the header has col"),
    ("odometry.csv", b"t,v,omega\n0,fast,0\n", "odometry.csv, row 2: v: must be a finite"),
    ("odometry.csv", b"t,v,omega\n0,0,0\n1,,0\n", "odometry.csv, row 3: v: empty"),
    ("odometry.csv", b"t,v,omega\n0,0,nan\n", "odometry.csv, row 2: omega: must be a finite"),
    ("odometry.csv", b"t,v,omega\n0,1e999,0\n", "odometry.csv, row 2: v: must be a finite"),
    ("odometry.csv", b"t,v,omega\n1_0,0,0\n", "odometry.csv, row 2: t: must be a finite"),
    ("odometry.csv", b"t,v,omega\n0,0\n", "odometry.csv, row 2: 2 fields, but the header has 3"),
    ("odometry.csv", b"t,v,omega\n0,0,0\n\n1,0,0,0\n", "odometry.csv, row 4: 4 fields, but the"),
    ("odometry.csv", b"t,v,omega\n1,0,0\n4,0,0\n3.5,0,0\n1.5,0,0\n",
     "odometry.csv, row 5: time runs backwards by 2.5 s: 1.5 after 4.0, by more than 1 s"),
    ("odometry.csv", b"t,v,omega\n0,0,0\n1,0\x00,0\n", "odometry.csv, row 3: v: must be a finite"),
    ("odometry.csv", "t,v,omega\n0,0,0\n".encode("utf-16"), "odometry.csv, row 1: not UTF-8 text"),
    ("odometry.csv", b"t,v,omega\n0,0,0\n1,\"0,0\n2,0,0\n", "odometry.csv, row 3: not CSV: "),
    ("odometry.csv", b"t,v,omega\n0,0," + b"0" * 200_000, "odometry.csv, row 2: not CSV: field la"),
    ("odometry.csv", b"t,v,omega\n0,0," + b"x" * 1000 + b"\n",
     "odometry.csv, row 2: omega: must be a finite"),
    ("bearings.csv", b"t,bearing\n", "bearings.csv, row 1: no column landmark in the header"),
    ("bearings.csv", HEADER + b"0,a\x00b,0.1,\n",
     "bearings.csv, row 2: landmark: unprintable characters"),
    ("bearings.csv", HEADER + b"0,\"a\nb\",0.1,\n",
     "bearings.csv, row 2: landmark: unprintable characters"),
    ("bearings.csv", HEADER + b"0,a,0.1,\n0,a,0.1,0\n",
     "bearings.csv, row 3: sigma: must be greater than 0, not '0.0'"),
    ("bearings.csv", HEADER + b"0,a,0.1,-0.1\n",
     "bearings.csv, row 2: sigma: must be greater than 0"),
    ("bearings.csv", HEADER + b"0,a,0.1,inf\n", "bearings.csv, row 2: sigma: must be a finite"),
    ("bearings.csv", HEADER + b"0,a,0.1,\n0,a,0.1,?\n",
     "bearings.csv, row 3: sigma: must be a finite"),
    ("bearings.csv", HEADER + b"0,a,1e300,\n",
     "bearings.csv, row 2: bearing: must be an angle in rad"),
    ("bearings.csv", HEADER + b"2,a,0,\n0,a,0,\n", "bearings.csv, row 3: time runs backwards by"),
    ("home.csv", b"landmark\na\n", "home.csv, row 1: no column bearing in the header 'landmark'"),
    ("home.csv", b"landmark,bearing\na,0\nb,0\n a,1\n",
     "home.csv, row 4: landmark: 'a' already has a row"),
    ("home.csv", b"landmark,bearing,sigma\na,0,-1\n",
     "home.csv, row 2: sigma: must be greater than 0"),
    ("truth.csv", b"t,x,y,heading\n", "truth.csv: no rows"),
    ("truth.csv", b"t,x,y\n0,0,0\n", "truth.csv, row 1: no column heading"),
    ("truth.csv", b"t,x,y,heading\n2,0,0,0\n0,0,0,0\n", "truth.csv, row 3: time runs backwards"),
    ("drive.yaml", b"sensor:\n  x: [1\n", "drive.yaml, row 3: not YAML: "),
    ("drive.yaml", b"- 1\n", "drive.yaml: not a mapping of keys to values"),
    ("drive.yaml", b"sensor: 5\n", "drive.yaml: sensor: must be keys and values, not 5"),
    ("drive.yaml", b"sensor: {x: 0,25, yaw: 0}\n", "drive.yaml: sensor.25: unknown key; the keys"),
    ("drive.yaml", b"senor:\n", "drive.yaml: senor: unknown key; did you mean"),
    ("drive.yaml", b"sensor: {x: 250}\n", "drive.yaml: sensor.x: must be at most 20, not 250"),
    ("drive.yaml", b"sensor: {yaw: 90}\n", "drive.yaml: sensor.yaw: must be at most 6.28"),
    ("drive.yaml", b"senor: {x: 1}\n", "drive.yaml: senor: unknown key; did you mean"),
    ("drive.yaml", b"sensor: {x: yes}\n", "drive.yaml: sensor.x: must be a number, not yes"),
    ("drive.yaml", b"sensor: {x: .nan}\n", "drive.yaml: sensor.x: must be a number, not .nan"),
    ("drive.yaml", b"sensor: {yaw: 1:30}\n", "drive.yaml: sensor.yaw: must be a number, not 1:30"),
    ("drive.yaml", b"sensor: {bearing_sigma: 0}\n", "drive.yaml: sensor.bearing_sigma: must be"),
    ("drive.yaml", b"start: {R: 1, theta: 0}\n", "drive.yaml: start.alpha: is required"),
    ("drive.yaml", b"\"a\\nb\": 1\n", "drive.yaml: 'a\\nb': unknown key"),
    ("drive.yaml", b"sensor: \xff\n", "drive.yaml: not YAML: "),
]  # fmt: skip


@pytest.mark.parametrize("turn", [b"6.2832", b"6.28319", b"6.283"])
def test_a_field_of_view_all_round_may_be_rounded(tmp_path, turn):
    settings = b"sensor: {field_of_view: %s, yaw: -%s}\n" % (turn, turn)
    folder = put(tmp_path / "run", drive_yaml=settings)
    assert read_folder(folder).settings.sensor.field_of_view == float(turn)


@pytest.mark.parametrize(("name", "content", "message"), HOSTILE)
def test_refuses(tmp_path, name, content, message):
    folder = put(tmp_path / "run", **{name.replace(".", "_"): content})
    assert refusal(read_folder, folder).startswith(message)


@pytest.mark.parametrize("end", [b"0.2", b"0.2,1.0,", b"0.2,1.0,-", b"0.2,1.0,1e-", b'0.2,1.0,"0'])
def test_a_last_row_that_is_cut_off_is_left_out_with_a_remark(tmp_path, end):
    rows = b"t,v,omega\n0,1.0,0.0\n0.1,1.0,0.0\n"
    drive = read_folder(put(tmp_path / "run", odometry_csv=rows + end))
    assert drive.odometry.t.tolist() == [0.0, 0.1]
    assert drive.remarks["last row of odometry.csv, which is cut off and left out"] == 1
    folder = put(tmp_path / "more", odometry_csv=rows + end + b"\n0.3,1.0,0.0\n")
    assert refusal(read_folder, folder).startswith("odometry.csv, row 4: ")


@pytest.mark.parametrize("end", [b"", b"0.2,1.0,"])
def test_null_characters_of_a_power_failure_are_left_out(tmp_path, end):
    rows = b"t,v,omega\n0,1.0,0.0\n0.1,1.0,0.0\n" + end + 5000 * b"\0"
    drive = read_folder(put(tmp_path / "run", odometry_csv=rows))
    assert drive.odometry.t.tolist() == [0.0, 0.1]
    assert set(understand([tmp_path / "run" / "odometry.csv"])) == {"odometry"}


def test_headers_of_joined_files_are_left_out_with_a_remark(tmp_path):
    rows = b"t,v,omega\n0,1,0\nt,v,omega\n0.1,1,0\n"
    drive = read_folder(put(tmp_path / "run", odometry_csv=rows))
    assert drive.odometry.t.tolist() == [0.0, 0.1]
    assert drive.remarks["repeated header lines of odometry.csv, left out"] == 1


def test_a_fault_far_down_a_long_file_is_found(tmp_path):
    rows = [b"%d,0,0" % i for i in range(5000)]
    rows[4321] = b"4321,0,zero"
    folder = put(tmp_path / "run", odometry_csv=b"t,v,omega\n" + b"\n".join(rows))
    assert (
        refusal(read_folder, folder)
        == "odometry.csv, row 4323: omega: must be a finite number, not 'zero'"
    )


def test_refuses_what_is_no_drive(tmp_path):
    assert refusal(read_folder, tmp_path / "absent") == "no such folder"
    (tmp_path / "empty").mkdir()
    assert refusal(read_folder, tmp_path / "empty").startswith(
        "not a complete drive folder: no odometry.csv, bear"
    )
    lacks = put(tmp_path / "lacks", home_csv=None)
    assert refusal(read_folder, lacks) == (
        f"not a complete drive folder: no home.csv; {HOME_ADVICE}"
    )
    (tmp_path / "file").write_text("t,v,omega\n")
    assert refusal(read_folder, tmp_path / "file") == "not a folder"
    folder = put(tmp_path / "nested", odometry_csv=None)
    (folder / "odometry.csv").mkdir()
    assert refusal(read_folder, folder) == "odometry.csv: not a regular file"
    folder = put(tmp_path / "yaml", drive_yaml=None)
    (folder / "drive.yaml").mkdir()
    assert refusal(read_folder, folder) == "drive.yaml: not a regular file"


def test_a_yaml_key_without_a_value_counts_as_absent(tmp_path):
    content = (
        b"# all of it is optional\nsensor:\n  # x: 1\nodometry: {speed_sigma: null}\nstart: ~\n"
    )
    drive = read_folder(put(tmp_path / "run", drive_yaml=content))
    assert drive.settings == DriveSettings()


def test_rows_of_several_chunks_are_read_in_order(tmp_path):
    n = 3 * CHUNK + 1
    rows = "".join(f"{i / 64},{i % 500},{i / n}\n" for i in range(n))
    folder = put(tmp_path / "run", bearings_csv=f"t,landmark,bearing\n{rows}".encode())
    sightings = read_folder(folder).sightings
    np.testing.assert_array_equal(sightings.t, np.arange(n) / 64)
    np.testing.assert_array_equal(sightings.bearing, np.arange(n) / n)
    assert sightings.landmark[-1] == str((n - 1) % 500)


def test_memory_is_that_of_the_numbers(tmp_path):
    n = 50_000
    rows = "".join(f"{i / 64},landmark {i % 500},{i / n}\n" for i in range(n))
    folder = put(tmp_path / "run", bearings_csv=f"t,landmark,bearing\n{rows}".encode())
    before = read_folder(folder)  # imports and growth of the table of interned ids do not count
    tracemalloc.start()
    try:
        read_folder(folder)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert before.sightings.t.size == n
    # Two numbers, an id and a row, once in pieces and once whole; rows of text would be 5 times it.
    assert peak < 3 * n * 4 * 8


def test_ranges_are_optional_and_those_not_above_zero_are_counted_and_left_out(tmp_path):
    text = "t,landmark,bearing,range,range_sigma\n"
    text += "0.1,a,0.5,2.5,0.1\n0.2,b,0.5,,\n0.3,a,0.5,0,\n0.4,a,0.5,-1,\n"
    drive = read_folder(put(tmp_path / "run", bearings_csv=text.encode()))
    np.testing.assert_array_equal(drive.sightings.range, [2.5, np.nan, np.nan, np.nan])
    np.testing.assert_array_equal(drive.sightings.range_sigma, [0.1, np.nan, np.nan, np.nan])
    assert drive.remarks[BAD_RANGES] == 2
    write_folder(drive, tmp_path / "again")
    again = read_folder(tmp_path / "again")
    np.testing.assert_array_equal(again.sightings.range, drive.sightings.range)
    assert np.isnan(read_folder(put(tmp_path / "bare")).sightings.range).all()
