"""Where the camera sits, where nobody told: found out, and left alone where it is as expected."""

import math

import numpy as np
import pytest
from rig import BEARING_SIGMA, Rig, ring

from homeward.drives.settings import DriveSettings, Sensor
from homeward.estimator import Status
from homeward.geometry.frames import Pose
from homeward.localizer.localizer import Localizer
from homeward.localizer.map.sightings import NC
from homeward.localizer.motion.extrinsics import Extrinsics
from homeward.localizer.motions import MOUNT
from homeward.localizer.output.pose import CommonErrors, PoseEstimate
from homeward.localizer.settings import LocalizerSettings
from homeward.localizer.tunables import GIVEN_WRONG


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


@pytest.mark.parametrize(
    ("mount", "seed"),
    [
        (Pose(0.2, 0.0, 0.0), 0),
        (Pose(-0.1, 0.15, 0.0), 1),
        (Pose(0.15, 0.0, 0.3), 0),
        (Pose(0.0, 0.0, 0.2), 1),
    ],
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
    (note,) = (n for n in rig.localizer.notes if "extrinsics" in n)
    said = ", ".join(f"{n}: {v:.2f}" for n, v in (("x", x), ("y", y), ("yaw", yaw)))
    assert said.replace("-0.00", "0.00") in note


def test_only_extrinsics_not_given_are_named():
    rig = mounted(Pose(0.2, 0.0, 0.3), 0, {"x": 0.2, "y": 0.0})
    rig.drive(60)
    (note,) = (n for n in rig.localizer.notes if "extrinsics" in n)
    assert "extrinsics (yaw) were not given" in note
    found = note.partition("drive.yaml: ")[2]
    assert float(found.removeprefix("yaw: ").removesuffix(".")) == pytest.approx(0.3, abs=0.03)


@pytest.mark.parametrize("seed", range(2))
def test_a_camera_at_the_centre_is_left_there(seed):
    rig = mounted(Pose(0.0, 0.0, 0.0), seed, {})
    rig.drive(60)
    assert not rig.localizer.chart.extrinsics.contradicted
    assert not any("extrinsics" in n for n in rig.localizer.notes)


def test_what_was_told_is_not_doubted():
    rig = mounted(Pose(0.2, 0.0, 0.3), 0, {"x": 0.2, "y": 0.0, "yaw": 0.3})
    rig.drive(60)
    assert np.abs(rig.localizer.chart.map.smoother.state.calibration[MOUNT]).max() < 0.02
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


def calibrated(own, seen=0.0):
    """A calibration by a map that alone would see the camera `seen` [m] ahead, within `own` [m]."""
    held = Extrinsics(DriveSettings(), LocalizerSettings()).sigmas
    mean, variances = np.zeros(NC), np.ones(NC)
    variances[MOUNT] = 1.0 / (held**-2.0 + np.array([1.0, own**-2.0, own**-2.0]))
    mean[MOUNT] = 0.0, seen * variances[MOUNT][1] / own**2, 0.0
    return mean, variances


def test_a_place_of_the_camera_that_is_assumed_is_as_uncertain_as_the_map_leaves_it():
    def sigma(own, seen=0.0):
        extrinsics = Extrinsics(DriveSettings(), LocalizerSettings())
        return math.sqrt(extrinsics.assumed_covariance(*calibrated(own, seen), 5.0)[0, 0])

    wrong = GIVEN_WRONG
    assert sigma(1e6) == pytest.approx(0.5 * math.sqrt(wrong), rel=0.01)  # it says nothing
    ratio = wrong / (1.0 - wrong) * (0.01 / 0.5) ** 2  # odds of elsewhere, ahead and aside
    assert sigma(0.01) == pytest.approx(0.01 * math.sqrt(ratio / (1.0 + ratio)), rel=0.01)
    assert sigma(0.01, 0.06) == pytest.approx(math.hypot(0.06, 0.01), rel=0.02)  # of 6 sigma
    assert np.all(np.diff([sigma(own) for own in (0.001, 0.01, 0.1, 1.0, 10.0)]) > 0.0)


def test_a_place_of_the_camera_that_is_told_or_estimated_is_not_assumed():
    told = Extrinsics(DriveSettings(sensor=Sensor(x=0.0, y=0.0)), LocalizerSettings())
    assert not told.assumed_covariance(*calibrated(0.1), 5.0).any()
    one = Extrinsics(DriveSettings(sensor=Sensor(x=0.0)), LocalizerSettings())
    x, y = np.diag(one.assumed_covariance(*calibrated(0.1), 5.0))
    assert x == 0.0 < y
    found = Extrinsics(DriveSettings(), LocalizerSettings())
    found.contradicted = True
    assert not found.assumed_covariance(*calibrated(0.1), 5.0).any()


@pytest.mark.parametrize("heading", [0.0, 1.0, math.pi, -2.0])
def test_an_error_of_the_cameras_place_matters_as_far_as_the_robot_is_turned_from_home(heading):
    camera = Pose(1.0, 2.0, heading)
    nothing = np.zeros((3, 3))
    off = np.array([0.03, -0.02])
    c, s = math.cos(heading), math.sin(heading)
    error = np.array([[c, -s], [s, c]]) @ off - off
    errors = CommonErrors(assumed_mount=np.outer(off, off))
    told = PoseEstimate(camera, nothing).after(None, errors)[0]
    assert told.covariance[:2, :2] == pytest.approx(np.outer(error, error), abs=1e-12)
    errors.same_camera = False
    other = PoseEstimate(camera, nothing).after(None, errors)[0]
    assert np.trace(other.covariance) == pytest.approx(off @ off)
