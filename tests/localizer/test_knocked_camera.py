"""A camera that is knocked during a drive, while its yaw was given as known."""

import math

import pytest
from rig import BEARING_SIGMA, Rig, ring

from homeward.drives.settings import Sensor
from homeward.estimator import Status
from homeward.geometry.frames import Pose
from homeward.localizer.localizer import Localizer
from homeward.reasons import Reason


def robot(seed):
    """A robot whose camera is at its centre, as its drive says."""
    rig = Rig(ring(10, seed), seed=seed)
    sensor = Sensor(bearing_sigma=BEARING_SIGMA, x=0.0, y=0.0, yaw=0.0)
    rig.localizer = Localizer(rig.home, **rig.settings.robot | {"sensor": sensor})
    return rig


def reported(rig, since=0):
    """Which answers name the camera."""
    return [answer.reason == Reason.CAMERA_TURNED.words for answer, _ in rig.answers[since:]]


@pytest.mark.parametrize(("degrees", "seed"), [(5.0, 0), (-8.0, 1)])
def test_a_knocked_camera_is_reported_and_its_yaw_estimated(degrees, seed):
    rig = robot(seed)
    rig.drive(30)
    before = len(rig.answers)
    rig.mount = Pose(0.0, 0.0, math.radians(degrees))
    rig.drive(10)  # 2 m
    assert any(reported(rig, before))
    assert not any(reported(rig)[:before])
    assert rig.drive(20).status is Status.LOCALISED
    assert rig.error() < 0.06
    assert rig.wrong_share(before) < 0.1
    (note,) = (n for n in rig.localizer.notes if "was turned" in n)
    said = float(note.partition("yaw: ")[2].partition("}")[0])
    assert said == pytest.approx(math.radians(degrees), abs=0.015)


def test_a_robot_that_is_bumped_or_undisturbed_has_no_knocked_camera():
    rig = robot(3)
    rig.drive(30)
    x, y, heading = rig.pose
    rig.pose = Pose(x, y, heading + math.radians(8.0))
    rig.drive(20)
    assert not any(reported(rig))
    assert not any("was turned" in n for n in rig.localizer.notes)
