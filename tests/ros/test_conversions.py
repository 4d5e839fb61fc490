"""Messages of ROS 2 as a session takes them; these are mere objects with their fields."""

import math
from types import SimpleNamespace as Message

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from homeward.drives.cameras.lens import Lens
from homeward.drives.cameras.tag_pose import tag_poses
from homeward.errors import InputError
from homeward.geometry.frames import Pose, compose
from homeward.live.messages import Answer, Command
from homeward.ros import conversions
from homeward.ros.conversions import (
    StampConverter,
    fill_covariance,
    obstacle_in,
    odometry_in,
    start_in,
    tag_out,
    tilt_in,
)


def scan(ranges, angle_min, farthest=8.0):
    step = math.tau / len(ranges)
    return Message(
        ranges=ranges, angle_min=angle_min, angle_increment=step, range_min=0.1, range_max=farthest
    )


@pytest.mark.parametrize("angle_min", [-math.pi, 0.0])
@pytest.mark.parametrize("degrees", [-15, 0, 15])
def test_obstacles_ahead_are_seen_by_scanners_that_begin_behind_and_ahead(angle_min, degrees):
    ranges = [5.0] * 360
    ranges[round(degrees - math.degrees(angle_min)) % 360] = 0.4
    assert obstacle_in(scan(ranges, angle_min), 0.35).distance == 0.4


@pytest.mark.parametrize(
    ("ahead", "free"), [(-math.inf, 0.0), (math.inf, 8.0), (math.nan, 8.0), (0.05, 8.0), (3.0, 3.0)]
)
def test_infinite_ranges_follow_rep_117(ahead, free):
    assert obstacle_in(scan([ahead] * 360, 0.0), 0.35).distance == free


def test_a_scanner_with_infinite_range_reports_a_free_path():
    assert obstacle_in(scan([math.inf] * 8, 0.0, math.inf), 0.35).distance > 1e3


def test_the_orientation_of_an_imu_is_a_tilt_and_a_missing_one_is_refused():
    x, y, z, w = Rotation.from_euler("ZYX", [1.0, -0.2, 0.1]).as_quat()
    tilt = tilt_in(Message(orientation=Message(x=x, y=y, z=z, w=w)), 3.0)
    assert (tilt.t, tilt.roll, tilt.pitch) == pytest.approx((3.0, 0.1, -0.2))
    with pytest.raises(InputError, match=r"^roll: must be"):
        tilt_in(Message(orientation=Message(x=0.0, y=0.0, z=0.0, w=0.0)), 3.0)


def test_a_number_that_is_none_is_refused_in_plain_words():
    zero = Message(x=0.0, y=0.0, z=0.0, w=1.0)
    message = Message(
        header=Message(frame_id="odom"),
        child_frame_id="base_link",
        pose=Message(pose=Message(position=zero, orientation=zero)),
        twist=Message(twist=Message(linear=Message(x=math.nan, y=0.0), angular=zero)),
    )
    with pytest.raises(InputError, match=r"^v: must be finite, not nan$"):
        odometry_in(message, 0.0)


def test_a_sideways_speed_is_read_from_odometry_and_published_in_commands(monkeypatch):
    place, turn = Message(x=1.0, y=2.0, z=0.0), Message(x=0.0, y=0.0, z=0.0, w=1.0)
    twist = Message(linear=Message(x=0.3, y=-0.2), angular=Message(z=0.1))
    message = Message(
        pose=Message(pose=Message(position=place, orientation=turn)), twist=Message(twist=twist)
    )
    heard = odometry_in(message, 1.0)
    assert (heard.v, heard.vy, heard.omega) == (0.3, -0.2, 0.1)
    blank = lambda: Message(linear=Message(x=0.0, y=0.0), angular=Message(z=0.0))  # noqa: E731
    monkeypatch.setattr(conversions, "message_class", lambda _: blank)
    said = []
    publishers = conversions.Publishers(Message())
    monkeypatch.setattr(publishers, "_parameter", lambda _: False)
    monkeypatch.setattr(publishers, "_line", lambda _: None)
    publishers._out["cmd_vel"] = Message(publish=said.append)
    command = {"v": 0.1, "vy": 0.15, "omega": 0.2, "state": "driving", "reason": "", "hold": 0.2}
    publishers.command(Command(**command))
    assert (said[0].linear.x, said[0].linear.y, said[0].angular.z) == (0.1, 0.15, 0.2)


def test_stamps_are_from_the_first_ones_second_whoever_comes_first():
    clock = StampConverter()
    assert clock.of_unix(1_700_000_000.25) == 0.25
    assert clock.seconds(Message(sec=1_700_000_001, nanosec=500_000_000)) == 1.5


HOME = Pose(10.0, 5.0, math.pi / 2)


def initial_pose(x, y, heading, frame):
    turn = Message(x=0.0, y=0.0, z=math.sin(heading / 2), w=math.cos(heading / 2))
    pose = Message(position=Message(x=x, y=y, z=0.0), orientation=turn)
    covariance = [0.0] * 36
    covariance[0], covariance[35] = 0.25, 0.04
    return Message(header=Message(frame_id=frame), pose=Message(pose=pose, covariance=covariance))


@pytest.mark.parametrize("frame", ["map", "/map", ""])
def test_an_initial_pose_in_the_map_is_a_start_in_the_home_frame(frame):
    start = start_in(initial_pose(*compose(HOME, Pose(1.0, 0.5, 0.3)), frame), "map", HOME)
    assert (start.x, start.y, start.heading) == pytest.approx((1.0, 0.5, 0.3))
    assert (start.sigma, start.sigma_heading) == (0.5, 0.2)


def test_an_initial_pose_in_another_frame_is_refused():
    with pytest.raises(InputError, match="its frame is 'odom', not 'map'"):
        start_in(initial_pose(0.0, 0.0, 0.0, "odom"), "map", HOME)


def test_a_tag_is_in_the_optical_frame_of_its_camera(monkeypatch):
    blank = lambda: Message(**dict.fromkeys("xyzw"))  # noqa: E731
    inner = Message(pose=Message(position=blank(), orientation=blank()), covariance=None)
    monkeypatch.setattr(conversions, "message_class", lambda _: lambda: Message(pose=inner))
    sheet = np.array([[600.0, 320], [680, 320], [680, 400], [600, 400]])  # 80 px: 1 m away
    lens = Lens(fx=500, fy=500, cx=600, cy=360)
    (tag,) = tag_poses(sheet[None], 0.3, np.array([0.16]), lens, (0, 0))
    found = tag_out(tag, "header")
    place, turn = found.pose.pose.position, found.pose.pose.orientation
    assert (place.x, place.y, place.z) == pytest.approx((0.08, 0.0, 1.0), abs=1e-6)
    assert (turn.x, turn.y, turn.z, abs(turn.w)) == pytest.approx((0.0, 0.0, 0.0, 1.0), abs=1e-6)
    along, aside = found.pose.covariance[14], found.pose.covariance[0]
    assert along > 3 * aside  # the distance is the least accurate


def test_the_covariance_turns_with_the_map():
    known = {"t": 0.0, "status": "localised", "reason": "", "pose": (0.0, 0.0, 0.0)}
    answer = Answer(**known, covariance=(4.0, 0.0, 1.0, 9.0, 0.0, 2.0))
    target = Message(covariance=[0.0] * 36)
    fill_covariance(target, answer, HOME)  # ahead of home is to the left in the map
    found = [target.covariance[k] for k in (0, 7, 35, 5, 11)]
    assert found == pytest.approx([9.0, 4.0, 2.0, 0.0, 1.0])
