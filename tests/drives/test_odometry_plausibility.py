"""Odometry whose motion is unknown for an interval: found, written, read and used."""

import dataclasses
import math

import numpy as np
import pytest

from homeward.drives.drive import Drive, HomeBearing, Odometry, Sightings
from homeward.drives.folder import read_folder
from homeward.drives.importers.reading import drive_of, understand
from homeward.drives.opening import open_drive, save_drive
from homeward.drives.plausibility import (
    odometry_from_poses,
    rounding_error,
    without_implausible,
)
from homeward.drives.settings import DriveSettings, Start
from homeward.errors import InputError
from homeward.odometry.history import dead_reckoning
from homeward.registry import make_estimator
from homeward.track import run

T = np.arange(100) / 10


def jumping(at=50):
    """Poses of a robot at 0.3 m/s that jump by 2 m; shape (n, 3)."""
    x = 0.3 * T + 2.0 * (at < np.arange(T.size))
    return np.column_stack([x, np.zeros_like(x), np.zeros_like(x)])


def drive_of_odometry(odometry):
    seen = Sightings.of_rows([(t, i, 0.1, math.nan) for t in T.tolist() for i in "abcd"])
    home = {i: HomeBearing(0.3 * k) for k, i in enumerate("abcd")}
    return Drive("x", odometry, seen, home)


@pytest.mark.parametrize("direction", [(1.0, 0.0), (0.0, 1.0)])
def test_a_pose_that_jumps_is_unknown_motion_ahead_and_sideways(direction):
    rows, remarks = jumping(), {}
    rows[:, :2] = np.outer(0.3 * T, (1, 0)) + np.outer(rows[:, 0] - 0.3 * T, direction)
    odometry = odometry_from_poses(T, rows, remarks)
    assert np.flatnonzero(np.isnan(odometry.v)).tolist() == [50]
    ((reason, number),) = remarks.items()
    assert number == 1
    assert "the first at 5.00 s" in reason


@pytest.mark.parametrize("vy", [0.2, -0.02, 0.001, 0.0])
def test_poses_of_a_robot_that_strafes_have_its_sideways_speed(vy):
    """A slower sideways motion is no strafing: the twists are as without it."""
    t = np.append(T, T[-1] + 0.1)
    given = Odometry(t, 0.3 + 0.1 * np.sin(t), np.cos(t), np.full(t.size, vy))
    remarks = {}
    found = odometry_from_poses(t, np.stack(dead_reckoning(given, t), axis=1), remarks)
    expected = vy if abs(vy) > 0.01 else 0.0
    assert found.vy[:-1] == pytest.approx(np.full(T.size, expected), abs=1e-12)
    assert found.v[:-1] == pytest.approx(given.v[:-1])
    assert sum(remarks.values()) == (t.size if expected else 0)


@pytest.mark.parametrize("rate", [1.0, 10.0, 100.0])
def test_noise_brisk_driving_bursts_and_slow_updates_are_plausible(rate):
    rng = np.random.default_rng(0)
    t = np.arange(0.0, 100.0, 1 / rate)
    v = np.where(t % 7 < 3, 0.0, 1.5) + 0.1 * rng.standard_normal(t.size)
    omega = np.where(t % 5 < 2, 0.0, 1.5) + 0.1 * rng.standard_normal(t.size)
    remarks = {}
    without_implausible(Odometry(t, v, omega), remarks)
    x = np.concatenate([[0.0], np.cumsum(v[:-1] / rate)])
    poses = np.column_stack([x, 0 * x, 0 * x])
    odometry_from_poses(t, poses, remarks)
    hold = np.arange(t.size) // 10 * 10
    odometry_from_poses(t, poses[hold], remarks)
    if rate > 1.0:
        burst = t[hold] + 1e-3 / rate * (np.arange(t.size) - hold)
        odometry_from_poses(burst, poses, remarks)
    assert remarks == {}


@pytest.mark.parametrize("name", ["folder", "log.mcap", "log.bag", "log.db3"])
def test_unknown_motion_comes_back_from_files(tmp_path, name):
    odometry = odometry_from_poses(T, jumping(), {})
    save_drive(drive_of_odometry(odometry), tmp_path / name)
    back = open_drive(tmp_path / name)
    for column in ("t", "v", "omega"):
        ours, theirs = getattr(odometry, column), getattr(back.odometry, column)
        assert np.array_equal(ours, theirs, equal_nan=True)
    if name == "folder":
        assert ",,\n" in (tmp_path / name / "odometry.csv").read_text()


def test_half_a_twist_is_refused_and_a_spike_in_a_folder_is_unknown(tmp_path):
    v = np.full(T.size, 0.3)
    v[30] = 300.0
    save_drive(drive_of_odometry(Odometry(T, v, np.zeros(T.size))), tmp_path / "d")
    drive = read_folder(tmp_path / "d")
    assert np.flatnonzero(np.isnan(drive.odometry.v)).tolist() == [30]
    assert any("implausible" in reason for reason in drive.remarks)
    table = tmp_path / "d" / "odometry.csv"
    table.write_text("t,v,omega\n0,1,0\n1,1,\n2,1,0\n")
    with pytest.raises(InputError, match=r"row 3: omega: empty; leave all"):
        read_folder(tmp_path / "d")


def test_import_of_poses_that_jump(tmp_path):
    poses = np.column_stack([T, jumping()])
    odom, seen, home = (tmp_path / f"{name}.csv" for name in ("odom", "bearings", "home"))
    np.savetxt(odom, poses, delimiter=",", header="t,x,y,heading", comments="")
    seen.write_text("t,landmark,bearing\n" + "".join(f"{t},a,0.1\n" for t in T.tolist()))
    home.write_text("landmark,bearing\na,0.1\n")
    drive = drive_of(understand([odom, seen, home]), "x")
    assert np.flatnonzero(np.isnan(drive.odometry.v)).tolist() == [50]
    assert any("implausible" in reason for reason in drive.remarks)


def test_dead_reckoning_goes_on_with_the_last_known_twist():
    odometry = odometry_from_poses(T, jumping(), {})
    end = dead_reckoning(odometry, T)
    assert end.x == pytest.approx(0.3 * T)
    lost = Odometry(T, np.full(T.size, np.nan), np.full(T.size, np.nan))
    assert dead_reckoning(lost, T).x == pytest.approx(0.0)


@pytest.mark.usefixtures("lab")
@pytest.mark.parametrize("name", ["ekf", "schmidt"])
def test_filters_widen_over_unknown_motion(name):
    odometry = Odometry(T, np.full(T.size, 0.3), np.zeros(T.size))
    v = odometry.v.copy()
    v[50:55] = np.nan
    unknown = Odometry(T, v, np.where(np.isnan(v), np.nan, 0.0))
    growth = []
    for known in (odometry, unknown):
        drive = drive_of_odometry(known)
        start = Start(R=1.0, theta=0.5, alpha=0.5)
        settings = drive.settings.model_copy(update={"start": start})
        none = Sightings.of_rows(())
        drive = Drive("x", known, none, drive.home, settings)
        track = run(drive, make_estimator(name, drive))
        assert np.isfinite(track.x).all()
        growth.append(float(track.sigmas[-1, 0]))
    assert growth[1] > growth[0]


def test_a_speed_that_is_always_zero_while_the_robot_turns_is_remarked():
    remarks = {}
    without_implausible(Odometry(T, np.zeros(T.size), np.full(T.size, 0.3)), remarks)
    assert [*remarks.values()] == [T.size]
    assert "its speed is missing" in next(iter(remarks))


@pytest.mark.parametrize(
    ("v", "omega", "unit"),
    [
        (250.0, 0.3, "mm/s"),
        (0.25, 17.0, "deg/s"),
        (0.25, 0.3, None),
        (9.0, 1.5, None),
        (25.0, 0.0, None),
    ],
)
def test_rates_in_other_units_are_remarked(v, omega, unit):
    remarks = {}
    without_implausible(Odometry(T, np.full(T.size, v), np.full(T.size, omega)), remarks)
    assert [why for why in remarks if "convert the" in why and (unit or "") in why] == list(remarks)
    assert bool(remarks) is (unit is not None)


def test_rounded_speeds_have_a_remark_and_an_uncertain_scale(tmp_path):
    sample = dataclasses.replace(open_drive("sample"), settings=DriveSettings())
    o = sample.odometry
    for step, sigma in ((0.1, 0.1), (0.01, None)):
        speed = np.round(o.v / step) * step
        rounded = dataclasses.replace(sample, odometry=dataclasses.replace(o, v=speed))
        save_drive(rounded, tmp_path / f"{step}")
        drive = open_drive(tmp_path / f"{step}")
        assert any(f"in steps of {step} m/s" in words for words in drive.remarks) == bool(sigma)
        found = drive.settings.odometry.speed_scale_sigma
        assert found is None if sigma is None else found > sigma


def test_speeds_that_were_commanded_are_not_rounded():
    t = np.arange(0.0, 60.0, 0.05)
    speed = np.select([t % 20.0 < 5.0, t % 20.0 < 12.0], [0.0, 0.2], 0.4)
    assert rounding_error(Odometry(t, speed, np.zeros(t.size))) == (0.0, 0.0)
