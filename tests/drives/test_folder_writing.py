"""The drive folder: what is written reads back, and a failed write leaves nothing behind."""

import dataclasses
import math
import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from valid_drive import VALID, put

from homeward.drives.drive import Drive, HomeBearing, Odometry, Sightings, Truth
from homeward.drives.folder import read_drive_settings, read_folder, write_folder
from homeward.drives.settings import DriveSettings, Mount, OdometryNoise, Sensor, Start
from homeward.errors import InputError
from homeward.io.table import is_identifier

finite = st.floats(allow_nan=False, allow_infinity=False)
offsets = st.floats(-20.0, 20.0)
angles = st.floats(-math.pi, math.pi, exclude_min=True)
sigmas = st.one_of(st.just(math.nan), st.floats(0, exclude_min=True, allow_infinity=False))
ids = st.text(min_size=1, max_size=8).filter(is_identifier)
slow = st.floats(-0.01, 0.01)
"""Plausible speeds: implausible ones are unknown motion to the reader."""
positive = st.floats(1e-300, 1e300)
deviation = st.floats(1e-300, math.pi)


def table(*columns, unique=False, min_size=0):
    """Draw rows, sorted by their first column, as a tuple of columns."""
    rows = st.lists(
        st.tuples(*columns),
        min_size=min_size,
        max_size=8,
        unique_by=(lambda row: row[0]) if unique else None,
    )
    return rows.map(
        lambda drawn: [
            np.array(column, object if column and isinstance(column[0], str) else None)
            for column in (
                zip(*sorted(drawn, key=lambda row: row[0]), strict=True)
                if drawn
                else [()] * len(columns)
            )
        ]
    )


drives = st.builds(
    Drive,
    name=st.just("run"),
    odometry=table(finite, slow, slow, slow, unique=True, min_size=1).map(lambda c: Odometry(*c)),
    sightings=table(finite, ids, angles, sigmas).map(lambda c: Sightings(*c)),
    home=st.dictionaries(ids, st.builds(HomeBearing, angles, sigmas), max_size=5),
    settings=st.builds(
        DriveSettings,
        sensor=st.builds(Sensor, x=offsets, yaw=angles, bearing_sigma=st.none() | deviation),
        home_sensor=st.none() | st.builds(Mount, y=finite),
        odometry=st.builds(OdometryNoise, turn_sigma=st.none() | positive),
        start=st.none() | st.builds(Start, R=positive, theta=finite, alpha=finite),
    ),
    truth=st.none()
    | table(finite, finite, finite, angles, unique=True, min_size=1).map(lambda c: Truth(*c)),
)


def bits(columns):
    """Return the columns of a dataclass of arrays as comparable bits."""
    return {
        name: values.tolist() if name in ("landmark", "camera") else values.astype(float).tobytes()
        for name, values in vars(columns).items()
    }


@settings(deadline=None, max_examples=60)
@given(drive=drives)
def test_what_is_written_reads_back_to_the_last_bit(tmp_path_factory, drive):
    folder = tmp_path_factory.mktemp("round") / "run"
    write_folder(drive, folder)
    back = read_folder(folder)
    assert bits(back.odometry) == bits(drive.odometry)
    assert bits(back.sightings) == bits(drive.sightings)
    assert (back.truth is None) == (drive.truth is None)
    if back.truth is not None:
        assert bits(back.truth) == bits(drive.truth)
    assert repr(back.home) == repr(drive.home)
    assert repr(back.settings) == repr(drive.settings)


def test_writes_only_what_is_known(tmp_path):
    drive = read_folder(
        put(tmp_path / "run", bearings_csv=b"t,landmark,bearing\n0,a,0\n", truth_csv=None)
    )
    write_folder(drive, tmp_path / "a" / "b" / "copy")
    copy = tmp_path / "a" / "b" / "copy"
    assert sorted(f.name for f in copy.iterdir()) == [
        "bearings.csv", "drive.yaml", "home.csv", "odometry.csv"
    ]  # fmt: skip
    assert (copy / "bearings.csv").read_bytes() == b"t,landmark,bearing\n0.0,a,0.0\n"
    assert (copy / "home.csv").read_bytes() == b"landmark,bearing\na,0.25\nc,-1.5\n"
    assert (copy / "drive.yaml").read_text() == (
        "sensor:\n  x: 0.2\n  bearing_sigma: 0.01\nstart:\n  R: 1.0\n  theta: 0.0\n  alpha: 0.0\n"
    )


def test_an_existing_folder_keeps_what_is_not_of_a_drive(tmp_path):
    folder = put(tmp_path / "old")
    (folder / "command.txt").write_text("mine")
    drive = read_folder(put(tmp_path / "run", drive_yaml=None, truth_csv=None))
    write_folder(drive, folder)
    assert (folder / "command.txt").read_text() == "mine"
    assert not (folder / "truth.csv").exists()
    assert not (folder / "drive.yaml").exists()
    assert bits(read_folder(folder).odometry) == bits(drive.odometry)


BAD = np.array([0.0, np.nan])
GOOD = np.array([0.0, 1.0])
NOTHING = Sightings(*(np.empty(0),) * 4)
UNWRITABLE = [
    (Drive("x", Odometry(GOOD, GOOD, BAD), NOTHING, {}), "odometry.csv: omega contains a number"),
    (Drive("x", Odometry(*(np.empty(0),) * 3), NOTHING, {}), "odometry.csv: no rows"),
    (Drive("x", Odometry(GOOD, GOOD, GOOD), NOTHING, {"a ": HomeBearing(0.0)}), "home.csv: landm"),
    (
        Drive("x", Odometry(GOOD, GOOD, GOOD), NOTHING, {}, truth=Truth(GOOD, GOOD, BAD, GOOD)),
        "truth.csv: y contains a number that is not finite",
    ),
]


@pytest.mark.parametrize(("drive", "message"), UNWRITABLE)
def test_a_failed_write_leaves_nothing_behind(tmp_path, drive, message):
    with pytest.raises(InputError) as caught:
        write_folder(drive, tmp_path / "new")
    assert str(caught.value).startswith(f"{tmp_path / 'new'}/{message}")
    assert list(tmp_path.iterdir()) == []
    folder = put(tmp_path / "old")
    with pytest.raises(InputError):
        write_folder(drive, folder)
    assert {f.name: f.read_bytes() for f in folder.iterdir()} == VALID
    assert list(tmp_path.iterdir()) == [folder]


def test_refuses_to_write_over_a_file(tmp_path):
    drive = read_folder(put(tmp_path / "run"))
    (tmp_path / "file").write_text("mine")
    for place in (tmp_path / "file", tmp_path / "file" / "below"):
        with pytest.raises(InputError, match="cannot be written"):
            write_folder(drive, place)
    assert (tmp_path / "file").read_text() == "mine"


def test_any_line_of_a_commented_drive_yaml_is_valid_without_its_comment_sign(tmp_path):
    given = DriveSettings(sensor=Sensor(x=0.2, bearing_sigma=0.01), epoch=1_700_000_000)
    drive = read_folder(put(tmp_path / "plain"))
    write_folder(dataclasses.replace(drive, settings=given), tmp_path / "run", commented=True)
    file = tmp_path / "run" / "drive.yaml"
    assert read_drive_settings(file) == given
    lines = file.read_text().splitlines()
    closed = [i for i, line in enumerate(lines) if re.match("#(  )?[a-z]", line)]
    keys = {lines[i].strip("# ").partition(":")[0] for i in closed}
    assert {"y", "yaw", "field_of_view", "speed_scale_sigma", "bearings_late", "home"} <= keys
    for i in closed:
        file.write_text("\n".join([*lines[:i], lines[i][1:], *lines[i + 1 :]]))
        assert read_drive_settings(file).sensor.x == 0.2
    assert all("[" in lines[i] for i in closed if "_sigma: " in lines[i])


def test_all_lines_of_a_commented_drive_yaml_are_valid_together_but_one_home_only(tmp_path):
    drive = read_folder(put(tmp_path / "plain"))
    write_folder(drive, tmp_path / "run", commented=True)
    file = tmp_path / "run" / "drive.yaml"
    head, *lines = file.read_text().split("sensor:")
    body = "sensor:" + "sensor:".join(lines).replace("\n#", "\n")
    homes = [line for line in body.splitlines() if line.startswith("home:")]
    assert len(homes) == 3
    for home in homes[1:]:
        body = body.replace(f"{home}\n", "")
    file.write_text(head + body)
    assert read_drive_settings(file).home.during == (0.0, 5.0)
