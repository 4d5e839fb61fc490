"""Where the camera sits, where nobody told: found out, and left alone where it is as expected."""

import math

import numpy as np
import pytest
from rig import BEARING_SIGMA, Rig, ring

from homeward.drives.drive import DriveSettings, Sensor
from homeward.estimator import Status
from homeward.frames import Pose
from homeward.localizer.localizer import Localizer
from homeward.localizer.map.sightings import NC
from homeward.localizer.motion.extrinsics import Extrinsics
from homeward.localizer.motion.preintegration import MOUNT
from homeward.localizer.settings import LocalizerSettings


def mounted(mount, seed, told):
    """A robot with a camera there, and what its drive says of that."""
    rig = Rig(ring(10, seed), seed=seed, mount=mount)
    home, rig.pose = rig.pose, Pose(0.0, 0.0, 0.0)
    bearings = rig.look()
    rig.pose = home
    stored = {n: type(b)(bearings[n], BEARING_SIGMA) for n, b in rig.home.items()}
    sensor = Sensor(bearing_sigma=BEARING_SIGMA, **told)
    rig.localizer = Localizer(stored, **rig.settings.robot | {"sensor": sensor})
    return rig


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize(
    "mount", [Pose(0.2, 0.0, 0.0), Pose(-0.1, 0.15, 0.0), Pose(0.15, 0.0, 0.3), Pose(0.0, 0.0, 0.2)]
)
def test_a_camera_that_is_not_at_the_centre_is_found_out(mount, seed):
    rig = mounted(mount, seed, {})
    assert rig.drive(60).status is Status.LOCALISED
    assert rig.error() < 0.1
    assert rig.wrong_share() < 0.25  # in one bend it cannot be told
    assert rig.wrong_share(len(rig.answers) // 2) == 0
    assert not rig.moved()
    window = rig.localizer.chart.map.smoother
    yaw, x, y = window.state.calibration[MOUNT]
    assert (x, y, yaw) == pytest.approx(tuple(mount), abs=0.03)
    (note,) = (n for n in rig.localizer.notes if "camera" in n)
    said = ", ".join(f"{n}: {v:.2f}" for n, v in (("x", x), ("y", y), ("yaw", yaw)))
    assert said.replace("-0.00", "0.00") in note


def test_only_what_nobody_told_is_named():
    rig = mounted(Pose(0.2, 0.0, 0.3), 0, {"x": 0.2, "y": 0.0})
    rig.drive(60)
    (note,) = (n for n in rig.localizer.notes if "camera" in n)
    assert "camera (yaw) was taken to be 0" in note
    found = note.partition("would be ")[2]
    assert float(found.removeprefix("yaw: ").removesuffix(".")) == pytest.approx(0.3, abs=0.03)


@pytest.mark.parametrize("seed", range(3))
def test_a_camera_at_the_centre_is_left_there(seed):
    rig = mounted(Pose(0.0, 0.0, 0.0), seed, {})
    rig.drive(60)
    assert not rig.localizer.chart.extrinsics.contradicted
    assert not any("camera" in n for n in rig.localizer.notes)


def test_what_was_told_is_not_doubted():
    rig = mounted(Pose(0.2, 0.0, 0.3), 0, {"x": 0.2, "y": 0.0, "yaw": 0.3})
    rig.drive(60)
    assert np.abs(rig.localizer.chart.map.state.calibration[MOUNT]).max() < 0.02
    assert rig.error() < 0.05
    wrong = Extrinsics(DriveSettings(sensor=Sensor(x=0.5, y=0.0, yaw=0.0)), LocalizerSettings())
    assert not wrong.test(*told_by_map(np.array([0.5, 0.5, 0.5]), 1e4, wrong.sigmas))


def told_by_map(off, information, sigmas):
    """A calibration that has the camera off (3,), by so much information; variances, scale."""
    mean, variances = np.zeros(NC), np.ones(NC)
    both = information + sigmas**-2.0
    mean[MOUNT], variances[MOUNT] = off * information / both, 1.0 / both
    return mean, variances, 3.0


def test_it_is_denied_by_what_the_map_says_on_its_own():
    drive, settings, sigma = DriveSettings(), LocalizerSettings(), 0.05
    for off in np.random.default_rng(0).normal(0.0, sigma, (2000, 3)):  # as far off as by chance
        extrinsics = Extrinsics(drive, settings)
        assert not extrinsics.test(*told_by_map(off, sigma**-2.0, extrinsics.sigmas))
        assert not extrinsics.contradicted
    for axis in range(3):
        extrinsics, off = Extrinsics(drive, settings), np.zeros(3)
        off[axis] = 8.0 * sigma
        now = told_by_map(off, sigma**-2.0, extrinsics.sigmas)
        assert extrinsics.test(*now)
        assert extrinsics.contradicted
        assert not extrinsics.test(*now)  # a second time
        assert (extrinsics.sigmas > 0.25).all()
    vague = Extrinsics(DriveSettings(), LocalizerSettings())
    assert not vague.test(*told_by_map(np.full(3, 1e4), 1e-3, vague.sigmas))
    assert not vague.test(*told_by_map(np.full(3, 0.02), 1e8, vague.sigmas))  # near enough
    assert math.isfinite(vague.sigmas.sum())
