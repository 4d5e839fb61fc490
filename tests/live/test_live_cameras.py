"""A front and a rear camera at different positions, live."""

import math

import pytest
from two_cameras import simulated

from homeward.drives.settings import DriveSettings
from homeward.errors import InputError
from homeward.live import messages as msg
from homeward.live.localisation import Localisation


def live():
    """A session that gets the extrinsics of the rear camera by a message; and its drive."""
    drive = simulated(5, seconds=20.0)
    home = {
        n: b if b.camera == "rear" else type(b)(b.bearing, b.sigma) for n, b in drive.home.items()
    }
    robot = DriveSettings(sensor=drive.settings.sensor, odometry=drive.settings.odometry)
    found = Localisation("robust", robot, {"home": home})
    found.do(msg.SetExtrinsics(camera="rear", x=-0.2, yaw=math.pi), None)
    found.do(msg.Reset(), None)
    return found, drive


def test_bearings_of_both_cameras_give_a_pose_near_the_truth():
    found, drive = live()
    frames = zip(drive.sightings.stamps(), drive.sightings.cameras(), strict=True)
    samples = [
        msg.OdometryIn(t=t, v=v, omega=w)
        for t, v, w in zip(*vars(drive.odometry).values(), strict=True)
    ]
    for (t, seen, _), camera in frames:
        name = "rear" if camera == "rear" else ""
        samples.append(msg.BearingsIn(t=t, bearings=seen, camera=name))
    for sample in sorted(samples, key=lambda s: s.t):
        found.do(sample, None)
    pose, true = found.fix.estimate.pose, drive.truth.at(found.fix.estimate.t)
    assert math.dist(pose[:2], true[:2]) < 0.15


def test_a_camera_without_extrinsics_is_refused():
    found, _ = live()
    found.do(msg.BearingsIn(t=0.0, bearings={"a": 0.1}, camera="left"), None)  # the first camera
    with pytest.raises(InputError, match="cameras 'left' and 'right': only one"):
        found.do(msg.BearingsIn(t=0.1, bearings={"a": 0.1}, camera="right"), None)
