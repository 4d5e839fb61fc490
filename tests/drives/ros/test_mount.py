"""Where the camera sits, out of /tf_static."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from drives.ros.build import point, pose, stamps, transforms
from drives.ros.rig import bearings_message
from scipy.spatial.transform import Rotation

from homeward.drives.cameras.camera import tilt_matrix
from homeward.drives.ros.info import log_info
from homeward.drives.ros.measurements.extrinsics import BODY_IN_OPTICAL, LEVEL, Transforms, mount
from homeward.drives.ros.presets import BEARINGS, POSE_ARRAY, TAGS
from homeward.drives.ros.settings import BearingsTopic, MountFrames
from homeward.errors import InputError
from homeward.geometry.frames import Pose, between, compose


def turn(yaw=0.0, pitch=0.0, roll=0.0):
    """Rz(yaw) Ry(pitch) Rx(roll)."""
    c, s = math.cos(yaw), math.sin(yaw)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ tilt_matrix(roll, pitch)


def told(parent, child, matrix=None, shift=(0.0, 0.0, 0.0), q=None):
    """A TransformStamped."""
    parts = q or Rotation.from_matrix(np.eye(3) if matrix is None else matrix).as_quat()
    inner = SimpleNamespace(
        rotation=SimpleNamespace(**dict(zip("xyzw", parts, strict=True))),
        translation=SimpleNamespace(**dict(zip("xyz", shift, strict=True))),
    )
    header = SimpleNamespace(frame_id=parent)
    return SimpleNamespace(header=header, child_frame_id=child, transform=inner)


def tree(*transforms):
    known = Transforms()
    for transform in transforms:
        known.put(transform)
    return known


def seen(known, camera="camera", kind=POSE_ARRAY, base="base_link"):
    return mount(known, MountFrames(camera=camera, base=base), kind, BearingsTopic(topic="b"))


@pytest.mark.parametrize("yaw", [0.0, 0.7, -3.0, math.pi / 2])
def test_a_chain_of_frames_tells_the_mount_and_an_optical_frame_looks_along_z(yaw):
    mast = turn(0.4)
    eye = mast.T @ turn(yaw)
    known = tree(
        told("/base_footprint", "base_link", shift=(5.0, 5.0, 0.1)),
        told("base_link", "mast", mast, (0.1, 0.2, 1.0)),
        told("mast", "camera", eye, tuple(mast.T @ (0.1, -0.3, 0.2))),
        told("camera", "camera_optical_frame", BODY_IN_OPTICAL.T),
    )
    for camera in ("camera", "/camera_optical_frame"):
        sits, _ = seen(known, camera)
        assert sits.pose == pytest.approx((0.2, -0.1, yaw))
    back, _ = seen(known, "base_footprint", base="mast")
    assert back.yaw == pytest.approx(-0.4)


def test_a_tilt_is_told_to_a_camera_and_refused_where_bearings_come_without_one():
    slightly, much = (tree(told("base_link", "camera", turn(1.0, p, 0.01))) for p in (0.03, 0.4))
    assert seen(slightly)[0].yaw == pytest.approx(1.0)
    with pytest.raises(InputError, match=r"camera is tilted by 22.9 deg in base_link"):
        seen(much, kind=BEARINGS)
    for kind in (TAGS, POSE_ARRAY):
        _, topic = seen(much, kind=kind)
        assert topic.tilt == pytest.approx({"pitch": 0.4, "roll": 0.01})
    for upside_down in (turn(0.3, 0.0, math.pi), turn(0.0, LEVEL + 0.01)):
        with pytest.raises(InputError, match="tilted"):
            seen(tree(told("base_link", "camera", upside_down)), kind=BEARINGS)


@pytest.mark.parametrize(
    "eye", [turn(0.3, 0.1, math.pi), turn(0.3, 0.0, -math.pi / 2), turn(0.0, -1.5)]
)
def test_a_camera_upside_down_on_its_side_or_to_the_ceiling_gives_level_bearings(made, eye):
    """The positions, seen in the axes of the camera, are ahead, to the left and above."""
    ahead_left_up = np.array([[3.0, 1.0, 0.5], [2.0, -1.5, 0.8]])

    def fill(log):
        for t in stamps(3):
            poses = [pose(log, *p[:2], z=p[2]) for p in ahead_left_up @ eye]
            log.write("/b", t, log.make(POSE_ARRAY, header=log.header(t, "camera"), poses=poses))
        log.write("/tf_static", t, static(log, t, eye, (0.2, 0.0)))

    drive = made(fill, suffix=".mcap")
    yaw = drive.settings.sensor.yaw
    expected = np.arctan2(ahead_left_up[:, 1], ahead_left_up[:, 0])
    assert np.asarray(drive.sightings.bearing[:2]) + yaw == pytest.approx(expected)
    assert drive.sightings.range[:2] == pytest.approx(np.hypot(*ahead_left_up[:, :2].T))


def test_the_base_frame_of_a_robot_with_a_prefix_is_found():
    known = tree(
        told("robot1/odom", "robot1/base_link"),
        told("robot1/base_link", "robot1/camera", shift=(0.3, 0.0, 0.0)),
    )
    assert seen(known, "robot1/camera")[0].pose == pytest.approx((0.3, 0.0, 0.0))
    assert seen(known, "robot1/camera", base="robot2/base_link") is None


def test_what_is_no_tree_is_refused_and_what_is_not_tied_yet_is_waited_for():
    assert seen(tree(told("base_link", "lidar"))) is None
    circle = tree(told("a", "camera"), told("camera", "a"))
    with pytest.raises(InputError, match="the frames form a loop"):
        seen(circle)
    for bad in (0.0, math.nan):
        with pytest.raises(InputError, match="a quaternion is zero"):
            tree(told("base_link", "camera", q=[bad] * 4))


def static(log, t, matrix, shift, camera="camera"):
    """A message of ROS that has a camera on the robot."""
    place = (*shift, 0.0, *Rotation.from_matrix(matrix).as_quat())
    return transforms(log, t, {("base_link", camera): place})


@pytest.mark.parametrize("suffix", [".mcap", ".db3"])  # tf2_msgs of ROS 1 is not written here
def test_a_log_tells_the_mount_where_its_topics_file_asks(made, suffix):
    def fill(log, pitch=0.0):
        for t in stamps(3):
            log.write("/b", t, bearings_message(log, t, ["a"], [0.5]))
            log.write("/tf_static", t, static(log, t, turn(0.3, pitch), (0.2, -0.1)))

    topics = "bearings: {topic: /b}\nmount: {camera: camera}\n"
    topics += "drive: {sensor: {x: 9.0, bearing_sigma: 0.01}}\n"
    sensor = made(fill, topics, suffix).settings.sensor
    assert sensor.pose == pytest.approx((0.2, -0.1, 0.3))
    assert sensor.bearing_sigma == 0.01
    assert made(fill, topics.replace("mount", "#"), suffix).settings.sensor.x == 9.0
    with pytest.raises(InputError, match="connect lens to base_link"):
        made(fill, topics.replace("camera}", "lens}"), suffix)
    with pytest.raises(InputError, match="tilted"):
        made(lambda log: fill(log, 0.5), topics, suffix)
    with pytest.raises(InputError, match="no topic /tf_static"):
        made(
            lambda log: log.write(
                "/b", stamps(1)[0], bearings_message(log, stamps(1)[0], ["a"], [0.5])
            ),
            topics,
            suffix,
        )


def test_frames_that_link_the_camera_give_the_extrinsics_with_a_remark(made):
    def fill(log, pitch=0.0, q=None, camera="camera"):
        for t in stamps(3):
            log.write("/b", t, bearings_message(log, t, ["a"], [0.5]))
            matrix = turn(0.3, pitch)
            message = static(log, t, matrix, (0.2, -0.1), camera)
            if q is not None:
                message.transforms[0].transform.rotation.w = q
            log.write("/tf_static", t, message)

    topics = "bearings: {topic: /b}\n"
    drive = made(fill, topics, ".mcap")
    assert drive.settings.sensor.pose == pytest.approx((0.2, -0.1, 0.3))
    (remark,) = (reason for reason in drive.remarks if "/tf_static" in reason)
    assert "camera (x 0.200 m, y -0.100 m, yaw 0.300 rad)" in remark
    of_topic = topics.replace("b}", "b, sensor: {x: 1.0}}")
    for given in (topics + "drive: {sensor: {x: 1.0}}\n", of_topic):
        drive = made(fill, given, ".mcap")
        assert drive.settings.sensor.x == 1.0
        assert not any("/tf_static" in reason for reason in drive.remarks)
    for other in ({"pitch": 0.5}, {"q": math.nan}, {"camera": "lidar"}):
        drive = made(lambda log, other=other: fill(log, **other), topics, ".mcap")
        assert drive.settings.sensor.pose == (0.0, 0.0, 0.0)


FRONT, REAR = (0.2, 0.1, 0.3), (0.2, 0.1, -2.5)
"""Extrinsics of two cameras [m, m, rad]."""


def of_two_cameras(log, place=None, mounts=(), rear="rear"):
    """Both see landmark a ahead; as a bearing, or as a `place` in space (m ahead, m left)."""
    for t in stamps(3):
        for k, frame in enumerate(("front", rear)):
            if place is None:
                message = bearings_message(log, t, [f"a{k}"], [0.1])
            else:
                kind, at = "geometry_msgs/msg/PointStamped", point(log, *place, 0.0)
                message = log.make(kind, header=log.header(t, frame), point=at)
            message.header.frame_id = frame
            log.write(f"/b{k}", t, message)
        for frame, (x, y, yaw) in mounts:
            log.write("/tf_static", t, static(log, t, turn(yaw), (x, y), frame))


def test_transforms_of_two_cameras_are_named_where_their_topics_are(made, tmp_path):
    """In the refusal, and in the topics file to complete of `homeward info`."""
    mounts = ("front", FRONT), ("rear", REAR)
    with pytest.raises(InputError, match=r"its sensor or all by /tf_static with mount: \{base"):
        made(lambda log: of_two_cameras(log, None, mounts))
    topics = log_info(tmp_path / "log.mcap").draft
    assert "mount: {base: base_link}" in topics
    drive = made(lambda log: of_two_cameras(log, None, mounts), topics)
    assert seen_by(drive) == pytest.approx({"a0": 0.1, "a1": 0.1 - 2.8})
    with pytest.raises(InputError, match=r"several, each with its sensor$"):
        made(of_two_cameras)


TWO = "bearings: [{{topic: /b0, {0}}}, {{topic: /b1, {1}}}]\n"


def sensor(pose):
    return "sensor: {{x: {}, y: {}, yaw: {}}}".format(*pose)


def seen_by(drive):
    return dict(zip(drive.sightings.landmark.tolist(), drive.sightings.bearing, strict=True))


def test_two_cameras_have_a_mount_each(made):
    """In the topics file or in /tf_static; bearings are given for the first camera."""
    by_hand = made(of_two_cameras, TWO.format(sensor(FRONT), sensor(REAR)))
    mounts = ("front", FRONT), ("rear", REAR)
    by_transforms = made(lambda log: of_two_cameras(log, None, mounts), TWO.format("", ""))
    one_each = made(of_two_cameras, TWO.format("", sensor(REAR)) + f"drive: {{{sensor(FRONT)}}}\n")
    for drive in (by_hand, by_transforms, one_each):
        assert drive.settings.sensor.pose == pytest.approx(FRONT)
        assert seen_by(drive) == pytest.approx({"a0": 0.1, "a1": 0.1 - 2.8})
    # A camera without a frame_id is one more, too; one frame on two topics is one camera.
    same = made(lambda log: of_two_cameras(log, rear="front"), TWO.format("", ""))
    assert seen_by(same) == pytest.approx({"a0": 0.1, "a1": 0.1})
    for words, rear, told, tf in (
        (r"/b0 \(frame front\): one of several cameras", "rear", ("", ""), ()),
        (r"/b1 \(frame rear\): one of several cameras", "rear", (sensor(FRONT), ""), ()),
        (r"/b1 \(frame not named\): one of", "", ("", ""), mounts),
    ):
        with pytest.raises(InputError, match=words):
            made(lambda log, r=rear, t=tf: of_two_cameras(log, None, t, r), TWO.format(*told))


def test_bearings_of_cameras_apart_keep_their_camera(made):
    behind = (-0.2, 0.1, 3.0)
    by_hand = made(of_two_cameras, TWO.format(sensor(FRONT), sensor(behind)))
    mounts = ("front", FRONT), ("rear", behind)
    by_transforms = made(lambda log: of_two_cameras(log, None, mounts), TWO.format("", ""))
    for drive in (by_hand, by_transforms):
        assert seen_by(drive) == pytest.approx({"a0": 0.1, "a1": 0.1})
        assert [*drive.sightings.cameras()] == ["", "/b1"] * 3
        assert drive.settings.sensor.pose == pytest.approx(FRONT)
        assert drive.settings.cameras["/b1"].pose == pytest.approx(behind)


def test_points_in_space_of_cameras_in_different_places(made):
    """What both see at one place has one bearing, however far apart they are."""
    topics = TWO.format(f"landmark: a0, {sensor(FRONT)}", f"landmark: a1, {sensor((-0.5, 0, 1))}")
    drive = made(lambda log: of_two_cameras(log, (3.0, 1.0)), topics)
    place = compose(Pose(-0.5, 0.0, 1.0), Pose(3.0, 1.0, 0.0))
    there = between(Pose(*FRONT), place)
    expected = {"a0": math.atan2(1.0, 3.0), "a1": math.atan2(there.y, there.x)}
    assert seen_by(drive) == pytest.approx(expected)


def test_one_landmark_seen_by_two_cameras_at_one_stamp_has_two_sightings(made):
    """Each with the noise of its camera, also after a round trip."""
    topics = TWO.format(
        f"landmark: a, sigma: 0.01, {sensor(FRONT)}",
        f"landmark: a, sigma: 0.03, {sensor((-0.5, 0, 1))}",
    )
    drive = made(lambda log: of_two_cameras(log, (3.0, 1.0)), topics)
    seen = drive.sightings
    assert seen.landmark.tolist() == ["a"] * 6
    assert seen.sigma.tolist() == [0.01, 0.03] * 3
    assert [len(ids) for _, ids, _ in seen.stamps()] == [1] * 6
    assert np.diff(seen.t)[::2] == pytest.approx([1e-9] * 3, rel=0.01)
    assert any("another camera saw" in remark for remark in drive.remarks)
    assert not any("repeated" in remark for remark in drive.remarks)
