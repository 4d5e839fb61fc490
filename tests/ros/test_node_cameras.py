"""Cameras of the node: tags in /tf, and several cameras; messages are objects with their fields."""

import math
from itertools import pairwise
from types import SimpleNamespace as Message

import numpy as np
import pytest

from homeward.drives.ros.kinds import BEARINGS
from homeward.errors import InputError
from homeward.live.messages import BearingsIn
from homeward.ros import conversions
from homeward.ros.camera import FrameOrder, MessageCameras
from homeward.ros.conversions import StampConverter

PARAMETERS = {
    "topics": "",
    "bearings_topic": "bearings",
    "bearings_frames": "",
    "bearings_axes": "",
    "bearing_sigma": 0.0,
    "tag_size": 0.0,
    "rectified": False,
    "camera": "",
    "camera_info_topic": "",
    "camera_frame": "",
    "base_frame": "base_link",
}
TF = "tf2_msgs/msg/TFMessage"
MARKERS = "aruco_opencv_msgs/msg/ArucoDetection"
AHEAD = (-0.5, 0.5, -0.5, 0.5)
"""Rotation of an optical frame that looks along the x axis of its parent."""


@pytest.fixture(autouse=True)
def _no_ros(monkeypatch):
    monkeypatch.setattr(conversions, "message_class", lambda kind: None)


def cameras(**parameters):
    return MessageCameras(PARAMETERS | parameters)


def header(t, frame):
    sec, nanosec = divmod(round(t * 1e9), 10**9)
    return Message(stamp=Message(sec=sec, nanosec=nanosec), frame_id=frame)


def point(bearing, distance=2.0):
    return Message(x=-distance * math.sin(bearing), y=0.1, z=distance * math.cos(bearing))


def transform(t, parent, child, shift, turn=(0.0, 0.0, 0.0, 1.0)):
    rotation = Message(**dict(zip("xyzw", turn, strict=True)))
    motion = Message(translation=shift, rotation=rotation)
    return Message(header=header(t, parent), child_frame_id=child, transform=motion)


def markers(t, frame, **bearings):
    found = [Message(marker_id=i, pose=Message(position=point(b))) for i, b in bearings.items()]
    return Message(header=header(t, frame), markers=found, boards=[])


def read(found, number, message):
    return [one() for one in found.readers(number, message, StampConverter().seconds)]


def test_tags_in_tf_are_read_by_the_names_of_their_frames():
    found = cameras(bearings_type=TF, bearings_topic="/tf", bearings_frames="tag36h11:*")
    tags = [transform(5.5, "camera_optical", f"tag36h11:{i}", point(i / 10)) for i in (1, 2)]
    others = [transform(5.7, "odom", "base_link", point(0.0))]
    (frame,) = read(found, 0, Message(transforms=tags + others))
    assert frame.t == 0.5
    assert frame.bearings == pytest.approx({"1": 0.1, "2": 0.2})
    assert read(found, 0, Message(transforms=others)) == []
    with pytest.raises(InputError, match="bearings_frames"):
        cameras(bearings_type=TF, bearings_topic="/tf")


def two(tmp_path, text):
    (tmp_path / "topics.yaml").write_text(text)
    return cameras(bearings_type=MARKERS, topics=str(tmp_path / "topics.yaml"))


def test_bearings_of_two_cameras_are_those_of_the_first(tmp_path):
    """With extrinsics and a noise for each from the topics file."""
    found = two(
        tmp_path,
        "bearings: [{topic: /front, sigma: 0.01, sensor: {x: 0.2}},"
        " {topic: /rear, sigma: 0.03, sensor: {x: -0.2, yaw: 3.14159265}}]\n",
    )
    assert found.extrinsics().x == 0.2
    assert found.extrinsics() is None
    (front,) = read(found, 0, markers(1.0, "front_optical", a=0.5))
    (rear,) = read(found, 1, markers(1.0, "rear_optical", a=0.0))
    assert front.bearings == pytest.approx({"a": 0.5})
    assert abs(rear.bearings["a"]) == pytest.approx(math.pi)
    assert rear.ranges["a"] == pytest.approx(2.4, abs=0.01)
    assert (front.sigmas["a"], rear.sigmas["a"]) == (0.01, 0.03)


def test_extrinsics_of_two_cameras_from_transforms(tmp_path):
    found = two(tmp_path, "bearings: [{topic: /front}, {topic: /rear}]\nmount: {base: base}\n")
    assert found.needs_transforms
    with pytest.raises(InputError, match=r"no transforms .* connect front_optical to base yet"):
        read(found, 0, markers(1.0, "front_optical", a=0.5))
    shift = Message(x=0.2, y=0.0, z=0.5)
    turned = (-0.5, -0.5, 0.5, 0.5)  # looks backwards
    places = [
        transform(0.0, "base", "front_optical", shift, AHEAD),
        transform(0.0, "base", "rear_optical", shift, turned),
    ]
    found.add_transforms(Message(transforms=places))
    with pytest.raises(InputError, match="no message of the first camera, /front"):
        read(found, 1, markers(1.0, "rear_optical", a=0.0))
    read(found, 0, markers(1.0, "front_optical", a=0.5))
    assert found.extrinsics().x == 0.2
    (rear,) = read(found, 1, markers(1.0, "rear_optical", a=0.1))
    assert math.remainder(rear.bearings["a"] - 0.1 - math.pi, math.tau) == pytest.approx(
        0.0, abs=1e-6
    )


def test_frames_of_several_cameras_without_extrinsics_are_refused(tmp_path):
    found = two(tmp_path, "bearings: [{topic: /front}, {topic: /rear}]\n")
    read(found, 0, markers(1.0, "front_optical", a=0.5))
    with pytest.raises(InputError, match="'front_optical' and 'rear_optical' are several cameras"):
        read(found, 1, markers(1.0, "rear_optical", a=0.5))


def test_frames_of_cameras_with_different_delays_are_put_in_order():
    order, out = FrameOrder(2), []
    for camera, t in [(0, 0.0), (0, 0.1), (1, 0.0), (0, 0.2), (1, 0.1), (1, 0.15), (0, 0.5)]:
        out += order.add(camera, BearingsIn(t=t, bearings={f"{camera}": 0.0}))
    assert [round(frame.t, 3) for frame in out] == [0.0, 0.0, 0.1, 0.1, 0.15, 0.2]
    assert all(b.t > a.t for a, b in pairwise(out))
    (alone,) = FrameOrder(1).add(0, BearingsIn(t=1.0, bearings={}))
    assert alone.t == 1.0


def test_bearings_of_a_camera_apart_name_it_and_come_after_its_extrinsics(tmp_path):
    (tmp_path / "topics.yaml").write_text(
        "bearings: [{topic: /front, sensor: {x: 0.2}},"
        " {topic: /rear, sensor: {x: -0.2, yaw: 3.14159265}}]\n"
    )
    found = cameras(bearings_type=BEARINGS, topics=str(tmp_path / "topics.yaml"))

    def message(t, frame, bearing):
        return Message(
            header=header(t, frame), landmarks=["a"], bearings=np.array([bearing]), sigmas=[]
        )

    (rear,) = read(found, 1, message(1.0, "rear", 0.1))
    assert (rear.camera, rear.bearings) == ("/rear", {"a": 0.1})
    sent = [found.extrinsics(), found.extrinsics()]
    assert {(s.camera, s.x) for s in sent} == {("", 0.2), ("/rear", -0.2)}
    assert found.extrinsics() is None
    (front,) = read(found, 0, message(1.1, "front", 0.5))
    assert front.camera == ""
