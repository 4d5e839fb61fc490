"""Guessing the reader from what is there."""

import math

import numpy as np
import pytest
import test_mrclam
from refusals import refusal
from valid_drive import VALID, put

from homeward.drives.importers.mrclam import read_mrclam
from homeward.drives.importers.reading import understand
from homeward.drives.opening import open_drive, save_drive
from homeward.drives.plausibility import OUTSIDE, remark_other_units
from homeward.drives.ros.info import log_info


@pytest.fixture
def drive_folder(tmp_path):
    return put(tmp_path / "plain", drive_yaml=None, truth_csv=None)


@pytest.fixture
def mrclam_folder(tmp_path):
    return test_mrclam.put(tmp_path / "mrclam")


def test_late_bearings_are_put_on_time_by_whoever_reads_them(tmp_path):
    folder, log, topics = put(tmp_path / "run"), tmp_path / "run.mcap", tmp_path / "topics.yaml"
    first = open_drive(folder)
    save_drive(first, log)
    late = b"bearings_late: 0.05\n"
    put(folder, drive_yaml=late + VALID["drive.yaml"])
    topics.write_bytes(b"drive: {bearings_late: 0.05}\n")
    for drive in (open_drive(folder), open_drive(log, topics=topics)):
        assert drive.sightings.t.tolist() == (first.sightings.t - 0.05).tolist()
        assert drive.odometry.t.tolist() == first.odometry.t.tolist()
        assert any("corrected by the 0.05 s" in line for line in drive.remark_lines)
        assert drive.settings.bearings_late is None
    save_drive(open_drive(folder), tmp_path / "copy")
    copied = open_drive(tmp_path / "copy")
    assert copied.sightings.t.tolist() == drive.sightings.t.tolist()


def test_tables_that_are_no_drive_yet_are_sent_to_import(tmp_path):
    (tmp_path / "wheels.CSV").write_text("time;speed\n")
    for place in (tmp_path, tmp_path / "wheels.CSV"):
        way = f"homeward import {tmp_path / 'wheels.CSV'} --out out/{place.stem}"
        assert f"convert its tables with `{way}`" in refusal(open_drive, place)


def test_a_bag_folder_with_a_home_csv_is_a_bag(tmp_path):
    """Unless it has the odometry.csv of a drive folder; `import` names the right command."""
    log, bag = tmp_path / "run.mcap", tmp_path / "bag"
    drive = open_drive(put(tmp_path / "run"))
    save_drive(drive, log)
    bag.mkdir()
    (bag / "home.csv").write_text("landmark,bearing\na,0.25\n")
    log.rename(bag / "run.mcap")
    topics, imported = bag / "topics.yaml", lambda path: understand([path])
    topics.write_text("home: {csv: home.csv}\n")
    assert open_drive(bag, topics=topics).home["a"].bearing == 0.25
    assert log_info(bag).kind.startswith("ROS 2 bag folder")
    for path in (bag, bag / "run.mcap"):
        assert "use `homeward run " in refusal(imported, path)
    assert f"use `homeward run {tmp_path / 'run'}`" in refusal(imported, tmp_path / "run")
    assert "give the files in it" in refusal(imported, tmp_path)
    (bag / "odometry.csv").write_text("t,v,omega\n0,0.1,0\n")
    assert log_info(bag).kind.startswith("drive folder")


def test_home_that_the_drive_saw_itself_is_seen_on_time(tmp_path):
    folder, late = tmp_path / "run", b"home: {during: [0.2, 0.57]}\nbearings_late: 0.05\n"
    drive = open_drive(put(folder, home_csv=None, truth_csv=None, drive_yaml=late))
    assert {i: seen.bearing for i, seen in drive.home.items()} == {"a": 0.4}


def test_an_mrclam_folder_is_imported_first(mrclam_folder):
    assert f"homeward import mrclam {mrclam_folder} --robot" in refusal(open_drive, mrclam_folder)


def test_refuses_what_no_reader_knows(tmp_path):
    assert refusal(open_drive, tmp_path / "absent") == "no such file or folder"
    (tmp_path / "empty").mkdir()
    assert refusal(open_drive, tmp_path / "empty") == (
        "neither a folder of images (images.csv) "
        "nor a drive folder (odometry.csv, bearings.csv, home.csv) "
        "nor a log (a ROS bag, an MCAP file or a .wpilog file)"
    )
    (tmp_path / "file.txt").write_text("hello")
    assert refusal(open_drive, tmp_path / "file.txt").startswith(
        "neither a folder of images (images.csv) nor a drive folder"
    )


def test_of_a_folder_of_logs_one_is_to_be_named(tmp_path):
    (tmp_path / "monday.bag").write_bytes(b"#ROSBAG V2.0\n")
    assert refusal(open_drive, tmp_path) == "a folder of logs; give one: 'monday.bag'"


def stamped(folder, odometry, bearings):
    """Give a drive folder twists and bearings at these times."""
    (folder / "odometry.csv").write_text("\n".join(["t,v,omega", *(f"{t},1,0" for t in odometry)]))
    rows = ["t,landmark,bearing", *(f"{t},a,0.5" for t in bearings)]
    (folder / "bearings.csv").write_text("\n".join(rows))
    return folder


@pytest.mark.parametrize(
    ("odometry", "bearings", "first", "last"),
    [
        ((0, 20), (5000, 5020), "bearings is 4,980.0 s", "odometry"),  # another clock
        ((0.1, 20), (100, 20000), "bearings is 80.0 s", "odometry"),  # milliseconds
        ((1.7e9, 1.7e9 + 20), (0, 20), "odometry is 1,699,999,980.0 s", "bearings"),
    ],
)
def test_clocks_that_do_not_overlap_are_refused(drive_folder, odometry, bearings, first, last):
    words = refusal(open_drive, stamped(drive_folder, odometry, bearings))
    assert words.startswith(f"the first of the {first} after the last of the {last}; ")
    assert "use stamps of one clock in seconds" in words


def test_clocks_of_other_drives_are_compared_too(mrclam_folder):
    (mrclam_folder / "Robot1_Measurement.dat").write_text("100 63 1.0 0.5\n")
    late = refusal(read_mrclam, mrclam_folder, 1, test_mrclam.HOME)
    assert "is 89.5 s after the last of the odometry" in late


@pytest.mark.parametrize(
    ("odometry", "bearings"),
    [
        ((0, 20), (19, 20, 30)),  # partly
        ((0, 1, 600, 601), (300, 310)),  # while odometry is silent
        ((0, 20), (24, 25)),  # a little late
        ((0, 20), ()),
    ],
)
def test_gaps_are_no_reason_to_refuse(drive_folder, odometry, bearings):
    drive = open_drive(stamped(drive_folder, odometry, bearings))
    assert drive.sightings.t.size == len(bearings)
    assert not drive.remarks


def test_most_bearings_beyond_odometry_are_remarked(drive_folder):
    drive = open_drive(stamped(drive_folder, (0, 20), np.arange(0, 2000, 4)))
    assert drive.remarks == {OUTSIDE: 500 - 7}


@pytest.mark.parametrize(
    ("rate", "a_second", "unit"),
    [
        (10, 1e3, "milliseconds"),
        (100, 1e3, "milliseconds"),
        (100, 1e6, "microseconds"),
        (50, 1e9, "nanoseconds"),
        (0.1, 1e9, "other units"),
    ],
)
def test_stamps_in_smaller_units_are_remarked(drive_folder, rate, a_second, unit):
    """Of odometry and bearings alike: that they are of one clock does not make it right."""
    t = 1.7e9 + np.arange(40) / rate
    times = np.round(t * a_second).astype(np.int64).tolist()
    (remark, number), *rest = open_drive(stamped(drive_folder, times, times)).remarks.items()
    assert (number, rest) == (40, [])
    step = f"{round(a_second / rate):,}.0 s"
    assert remark.startswith(f"odometry rows with a median interval of {step}")
    assert remark.endswith(f"convert the stamps to seconds if they are in {unit}")


@pytest.mark.parametrize(
    "t",
    [
        np.arange(100) * 1.0,  # one a second
        1.7e9 + np.arange(100) / 50,
        np.append(np.arange(50) / 10, 3600 + np.arange(50) / 10),  # an hour's gap
        np.arange(5) * 100.0,  # too few to tell
    ],
)
def test_stamps_in_seconds_are_not_remarked(t):
    remarks = {}
    remark_other_units(t, remarks)
    assert not remarks


def test_ground_truth_in_another_frame_is_transformed_by_home_in_it(drive_folder):
    (drive_folder / "truth.csv").write_text("t,x,y,heading\n0,1,2,1.5\n1,1,3,1.5\n")
    (drive_folder / "drive.yaml").write_text(f"truth: {{home: [1, 1, {math.pi / 2}]}}\n")
    drive = open_drive(drive_folder)
    np.testing.assert_allclose(drive.truth.x, [1.0, 2.0], atol=1e-12)
    np.testing.assert_allclose(drive.truth.y, 0.0, atol=1e-12)
    np.testing.assert_allclose(drive.truth.heading, 1.5 - math.pi / 2, atol=1e-12)
    assert drive.settings.truth is None
    (drive_folder / "truth.csv").unlink()
    assert "no ground truth; remove the key" in refusal(open_drive, drive_folder)
