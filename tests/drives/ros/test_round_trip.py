"""A drive through a log and back is the same drive, to the last bit."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from homeward.drives.drive import Drive, HomeBearing, Odometry, Sightings, Truth
from homeward.drives.folder import write_folder
from homeward.drives.opening import open_drive, save_drive
from homeward.drives.ros.stamps import NANO, epoch_of, seconds, split
from homeward.drives.settings import DriveSettings, OdometryNoise, Sensor, Start
from homeward.errors import InputError

SUFFIXES = (".mcap", ".bag", ".db3")


def bits(array):
    return array.tolist() if array.dtype == object else (array.dtype, array.tobytes())


def assert_same(a: Drive, b: Drive):
    for part in ("odometry", "sightings", "truth"):
        mine, theirs = getattr(a, part), getattr(b, part)
        assert (mine is None) == (theirs is None), part
        for name, values in vars(mine).items() if mine is not None else ():
            assert bits(values) == bits(getattr(theirs, name)), (part, name)
    assert list(a.home) == list(b.home)
    assert [repr(v) for v in a.home.values()] == [repr(v) for v in b.home.values()]
    assert a.settings == b.settings


def awkward(start=0.1 + 0.2):
    """Numbers that need every bit, sightings in an odd order, ids that need care."""
    rng = np.random.default_rng(1)
    t = np.sort(start + np.cumsum(rng.random(30)))
    ids = np.empty(6, object)
    ids[:] = ["b", "a", "b", "tür 7", "a,b", '"']
    return Drive(
        "awkward",
        Odometry(t, rng.standard_normal(30), rng.standard_normal(30) * 1e-300),
        Sightings(
            t[[3, 3, 3, 4, 5, 5]],
            ids,
            np.array([math.pi, np.nextafter(-math.pi, 0), 0.1, -0.0, 5e-324, 1 / 3]),
            np.array([np.nan, 0.01, np.nan, 1e-9, np.nan, 2.0]),
        ),
        {"b": HomeBearing(1 / 7), "tür 7": HomeBearing(-1 / 3, 0.1)},
        DriveSettings(
            sensor=Sensor(x=0.1 + 0.2, bearing_sigma=1 / 3),
            odometry=OdometryNoise(speed_sigma=1e-17),
            start=Start(R=1 / 3, theta=-2.0, alpha=1e300),
        ),
        Truth(t + 1e-10, t * math.pi, -t, 100 * t),
    )


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("start", [0.1 + 0.2, -17.3, 1.7e9 + 1 / 3, 5e9 + 1 / 3])
def test_every_bit_survives_at_any_epoch(tmp_path, suffix, start):
    drive = awkward(start)
    save_drive(drive, tmp_path / f"log{suffix}")
    assert_same(drive, open_drive(tmp_path / f"log{suffix}"))


def test_through_all_forms_and_back_to_the_same_folder(tmp_path):
    first = tmp_path / "first"
    write_folder(awkward(), first)
    last = first
    for number, suffix in enumerate((".mcap", ".bag", ".db3", "", ".mcap", "")):
        target = tmp_path / f"{number}{suffix}"
        save_drive(open_drive(last), target)
        last = target
    for file in first.iterdir():
        assert file.read_bytes() == (last / file.name).read_bytes(), file.name


def test_a_drive_without_the_optional_things(tmp_path):
    t = np.array([0.0, 0.1])
    drive = Drive(
        "bare", Odometry(t, t, t), Sightings(t, np.array(["a", "b"], object), t, t + np.nan), {}
    )
    for suffix in SUFFIXES:
        save_drive(drive, tmp_path / f"bare{suffix}")
        assert_same(drive, open_drive(tmp_path / f"bare{suffix}"))


def test_nothing_is_overwritten(tmp_path):
    target = tmp_path / "log.mcap"
    target.write_text("irreplaceable")
    with pytest.raises(InputError, match="exists already"):
        save_drive(awkward(), target)
    assert target.read_text() == "irreplaceable"
    full = tmp_path / "full"
    full.mkdir()
    (full / "thesis.tex").write_text("irreplaceable")
    with pytest.raises(InputError, match="exists already"):
        save_drive(awkward(), full)


def test_a_failed_write_leaves_nothing(tmp_path):
    drive = awkward()
    drive.odometry.v[7] = np.nan
    with pytest.raises(InputError, match="not finite"):
        save_drive(drive, tmp_path / "log.mcap")
    drive = awkward()
    drive.sightings.landmark[0] = "\ud800"
    with pytest.raises(InputError):
        save_drive(drive, tmp_path / "log.mcap")
    assert list(tmp_path.iterdir()) == []


@given(st.floats(-1e12, 1e12), st.integers(0, 2**31 - 1))
@settings(max_examples=100, deadline=None)
def test_a_time_comes_back_from_stamp_and_residue(t, epoch):
    stamp, residue = split(t, epoch)
    assert 0 <= stamp < 2**31 * NANO
    assert seconds(stamp, epoch, residue) == t


@given(st.integers(0, 2**31 * NANO - 1), st.integers(0, 30 * 86400 * NANO))
@settings(max_examples=100, deadline=None)
def test_a_stamp_comes_back_from_a_time_in_seconds(first, later):
    stamps = np.array([first, min(first + later, 2**31 * NANO - 10**9)])
    stamps.sort()
    epoch = epoch_of(stamps) or 0
    for stamp in stamps.tolist():
        assert split(seconds(stamp, epoch), epoch) == (stamp, 0.0)
