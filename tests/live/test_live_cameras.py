"""A front and a rear camera at different positions, live."""

import math

import pytest
from two_cameras import simulated

from homeward.drives.settings import DriveSettings
from homeward.errors import InputError
from homeward.estimator import Status
from homeward.live import messages as msg
from homeward.live.home_capture import HomeCapture
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


def samples_of(drive):
    """Messages of a drive in order of time; the front camera has no name."""
    frames = zip(drive.sightings.stamps(), drive.sightings.cameras(), strict=True)
    samples = [
        msg.OdometryIn(t=t, v=v, omega=w, vy=vy)
        for t, v, w, vy in zip(*vars(drive.odometry).values(), strict=True)
    ]
    for (t, seen, _), camera in frames:
        name = "rear" if camera == "rear" else ""
        samples.append(msg.BearingsIn(t=t, bearings=seen, camera=name))
    return sorted(samples, key=lambda s: s.t)


def test_bearings_of_both_cameras_give_a_pose_near_the_truth():
    found, drive = live()
    for sample in samples_of(drive):
        found.do(sample, None)
    pose, true = found.fix.estimate.pose, drive.truth.at(found.fix.estimate.t)
    assert math.dist(pose[:2], true[:2]) < 0.15


def test_a_camera_without_extrinsics_is_refused():
    found, _ = live()
    found.do(msg.BearingsIn(t=0.0, bearings={"a": 0.1}, camera="left"), None)  # the first camera
    with pytest.raises(InputError, match="cameras 'left' and 'right': only one"):
        found.do(msg.BearingsIn(t=0.1, bearings={"a": 0.1}, camera="right"), None)


def test_the_map_continues_when_the_extrinsics_of_another_camera_arrive():
    """As those from tf, with the first message of a camera that starts late."""
    drive = simulated(5, seconds=30.0)
    home = {n: type(b)(b.bearing, b.sigma) for n, b in drive.home.items() if b.camera == "front"}
    robot = DriveSettings(sensor=drive.settings.sensor, odometry=drive.settings.odometry)
    found = Localisation("robust", robot, {"home": home})
    rear = msg.SetExtrinsics(camera="rear", x=-0.2, yaw=math.pi)
    seen_by_rear = 0
    for sample in samples_of(drive):
        if getattr(sample, "camera", "") == "rear" and sample.t < 15.0:
            continue
        if sample.t >= 15.0 and rear is not None:
            before = found.fix.estimate
            assert before.pose is not None
            found.do(rear, None)
            assert found.fix.estimate is before
            rear = None
        answer = found.do(sample, None)
        if getattr(sample, "camera", "") == "rear":
            seen_by_rear += sum(i.accepted for i in found.fix.estimate.innovations)
            assert answer.pose is not None
    assert seen_by_rear > 100
    pose, true = found.fix.estimate.pose, drive.truth.at(found.fix.estimate.t)
    assert math.dist(pose[:2], true[:2]) < 0.15
    assert found.drive.settings.cameras["rear"].x == -0.2


def test_new_extrinsics_of_a_camera_in_use_begin_the_map_again():
    found, drive = live()
    for sample in samples_of(drive)[:200]:
        found.do(sample, None)
    found.do(msg.SetExtrinsics(camera="rear", x=-0.3, yaw=math.pi), None)
    assert found.fix.estimate.status is Status.WAITING


def test_extrinsics_that_arrive_during_a_turn_at_home_count_for_it():
    drive = simulated(0, seconds=16.0, speed=0.0)
    before = DriveSettings(sensor=drive.settings.sensor, odometry=drive.settings.odometry)
    homes = []
    for robot in (drive.settings, before):
        capture = HomeCapture()
        capture.begin(robot)
        capture.set_robot(drive.settings)
        for sample in samples_of(drive):
            is_odometry = isinstance(sample, msg.OdometryIn)
            (capture.odometry if is_odometry else capture.bearings)(sample.t, sample)
        homes.append(capture.captured().seen)
    assert homes[0] == homes[1]
    assert len(homes[0]) == 14


def test_a_further_home_has_the_newest_bearings_of_any_camera():
    capture = HomeCapture()
    for t, camera in enumerate(("", "rear")):
        capture.bearings(t, msg.BearingsIn(t=t, bearings={"a": 0.1}, camera=camera))
        assert capture.newest.camera == camera
