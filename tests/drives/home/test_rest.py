"""The proposal of the first rest as home."""

import dataclasses

import numpy as np
import pytest

from homeward.drives.folder import read_folder, write_folder
from homeward.drives.home.when import first_rest
from homeward.drives.opening import open_drive, sample_drive
from homeward.drives.ros.info import log_info
from homeward.errors import InputError


def resting(*spans):
    """The sample until 60 s without home, at rest in these intervals [s]."""
    drive = read_folder(sample_drive())
    o = drive.odometry.rows(drive.odometry.t < 60.0)
    moves = ~np.any([(o.t >= a) & (o.t < b) for a, b in spans], axis=0)
    o = dataclasses.replace(o, v=o.v * moves, omega=o.omega * moves)
    seen = drive.sightings.rows(drive.sightings.t < 60.0)
    return dataclasses.replace(drive, odometry=o, sightings=seen, home={})


def test_the_first_rest_of_two_seconds_counts():
    assert first_rest(resting((5.0, 6.5), (20.0, 23.0), (30.0, 40.0))) == pytest.approx((20, 23))
    assert first_rest(resting((20.0, 40.0))) == pytest.approx((20.0, 30.0))
    assert first_rest(resting((5.0, 6.5))) is None
    drive = resting((20.0, 23.0))
    away = (drive.sightings.t < 19.0) | (drive.sightings.t > 24.0)
    assert first_rest(dataclasses.replace(drive, sightings=drive.sightings.rows(away))) is None


def test_it_is_proposed_by_run_and_info_and_not_chosen(tmp_path):
    write_folder(resting((20.0, 23.0)), tmp_path / "drive")
    (tmp_path / "drive" / "home.csv").unlink()
    option = "--home during:20,23"
    with pytest.raises(InputError, match=f"at rest from 20 to 23 s, which is home with {option}"):
        open_drive(tmp_path / "drive")
    info = log_info(tmp_path / "drive")
    assert option in info.next
    assert any(line.startswith("The robot is at rest from 20 to 23 s") for line in info.remarks)
    assert open_drive(tmp_path / "drive", home_during=(20.0, 23.0)).home
