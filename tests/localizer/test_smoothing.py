"""The final pass says no more than the whole drive tells: other homes, home not fixed."""

import dataclasses
import math

import numpy as np
import pytest
from rig import BEARING_SIGMA, Rig, ring

from homeward.drives.folder import read_folder
from homeward.estimator import Status
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose, bearing
from homeward.localizer.localizer import Localizer
from homeward.localizer.smoothing import smooth
from homeward.track import run

ELSEWHERE = Pose(-1.2, 0.5, 0.3)
"""Another home, from which some landmarks were seen under their home bearings."""


def recorded(landmarks, faults, seconds=40):
    """A drive among landmarks, the home bearings of some of them being wrong."""
    rig = Rig(landmarks, seed=3, faults=faults).record()
    rig.drive(seconds)
    return rig.recorded(BEARING_SIGMA)


def seen_from_elsewhere(landmarks, names):
    """By how much home bearings of landmarks are wrong that were seen from another home [rad]."""
    marks = {n: landmarks[n] for n in names}
    return {
        n: float(wrap(bearing(ELSEWHERE, x, y) - math.atan2(y, x))) for n, (x, y) in marks.items()
    }


def deviations(track, truth):
    """How far the places of a track are off, of the rows with a pose [standard deviations]."""
    rows = track.has_pose & (track.t <= truth.t[-1])
    there = truth.at(track.t[rows])
    off = np.stack([track.x[rows] - there.x, track.y[rows] - there.y], axis=1)
    spread = track.covariance[rows, :2, :2]
    return np.sqrt((off * np.linalg.solve(spread, off[:, :, None])[:, :, 0]).sum(axis=1))


def test_a_clean_drive_is_localised_all_over():
    drive = recorded(ring(8), {})
    track = smooth(drive)
    assert track.has_pose.all()
    assert set(track.status) == {Status.LOCALISED}
    assert set(track.reason) == {"8 home bearings agree"}
    assert deviations(track, drive.truth).max() < 4.0
    assert track.sigmas[:, :2].max() < 0.1


def test_where_another_home_is_as_probable_no_row_is_called_localised():
    landmarks = ring(8)
    drive = recorded(landmarks, seen_from_elsewhere(landmarks, ["L0", "L2", "L4", "L6"]))
    track = smooth(drive)
    assert set(track.status) == {Status.UNVERIFIED}
    (reason,) = set(track.reason)
    assert reason.startswith("another home has probability ")
    assert 0.3 < float(reason.split()[-1]) <= 0.5  # less those nearby
    assert deviations(track, drive.truth).max() < 4.0  # the other home is in the covariance


@pytest.mark.parametrize(("number", "wrong"), [(4, ["L0"]), (5, ["L1", "L2"])])
def test_at_the_end_three_bearings_are_as_unsure_as_in_the_causal_run(number, wrong):
    landmarks = ring(number)
    drive = recorded(landmarks, seen_from_elsewhere(landmarks, wrong))
    causal, track = run(drive, Localizer(drive.home, **drive.settings.robot)), smooth(drive)
    assert (track.status[-1], track.reason[-1]) == (causal.status[-1], causal.reason[-1])
    assert track.status[-1] is Status.UNVERIFIED
    assert track.sigmas[-1] == pytest.approx(causal.sigmas[-1], rel=0.2)
    assert deviations(track, drive.truth).max() < 4.0


def test_home_on_the_circle_through_its_landmarks_is_not_fixed():
    angles = np.linspace(-2.6, 2.8, 8)
    landmarks = {
        f"L{i}": (2.0 + 2.0 * math.cos(a), 2.0 * math.sin(a)) for i, a in enumerate(angles.tolist())
    }
    drive = recorded(landmarks, {})
    track = smooth(drive)
    assert Status.LOCALISED not in track.status
    assert not track.has_pose.any()
    assert set(track.reason) == {"home is not located well enough yet; drive on, best in an arc"}


def heading_deviations(track, truth):
    """Heading errors of the rows with a pose [standard deviations]."""
    rows = track.has_pose & (track.t <= truth.t[-1])
    off = wrap(track.heading[rows] - truth.at(track.t[rows]).heading)
    return np.abs(off) / np.sqrt(track.covariance[rows, 2, 2])


@pytest.mark.parametrize(
    ("blind", "lost"),
    [(0.5, 0.01), (2.0, 0.15)],  # in the second, a new map begins
)
def test_after_a_slip_poses_are_right_or_absent(blind, lost):
    drive = recorded(ring(10), {}, seconds=60)
    begin = drive.odometry.t[0] + 20.0
    o, seen = drive.odometry, drive.sightings
    slips = (o.t >= begin) & (o.t < begin + 3.0)
    ahead = np.abs(seen.bearing) < 1.3
    dark = (seen.t >= begin) & (seen.t < begin + blind)
    drive = dataclasses.replace(
        drive,
        odometry=dataclasses.replace(o, omega=o.omega + 0.4 * slips),
        sightings=seen.rows(ahead & ~dark),
    )
    track = smooth(drive)
    off = heading_deviations(track, drive.truth)
    assert (off > 4.0).mean() < 0.01
    assert deviations(track, drive.truth).max() < 4.0
    assert track.has_pose[track.t > begin + 9.0].mean() > 0.85
    assert track.has_pose.mean() > 1.0 - lost


def test_a_simulated_robot_on_oil_is_smoothed_right_or_not_at_all(data_dir):
    folder = data_dir / "field" / "24-slip-smooth" / "drive"
    if not folder.is_dir():
        pytest.skip("no field/24-slip-smooth in the data folder")
    drive = read_folder(folder)
    track = smooth(drive)
    assert heading_deviations(track, drive.truth).max() < 4.0
    assert deviations(track, drive.truth).max() < 4.5
    assert track.has_pose.mean() > 0.93
    assert track.has_pose[(track.t > 97.3) & (track.t < 100.6)].all()  # on the oil, seeing nothing
