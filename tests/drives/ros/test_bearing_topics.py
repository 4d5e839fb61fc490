"""What each kind of message with landmarks tells, and cameras."""

import math

import numpy as np
import pytest
from cli.commands import call, done, refused
from drives.ros.build import EPOCH, SUFFIXES, point, pose, stamps
from drives.ros.rig import NANO, bearings_message
from rosbags.typesys import get_types_from_msg
from rosbags.typesys.store import Typestore

from homeward.drives.ros.presets import TAGS
from homeward.drives.ros.writing import typestore
from homeward.errors import InputError


def test_our_own_bearings_with_and_without_sigmas(made):
    def fill(log):
        t = stamps(2)
        log.write("/b", t[0], bearings_message(log, t[0], ["a", "b"], [0.5, -0.5]))
        log.write("/b", t[1], bearings_message(log, t[1], ["a"], [7.0], [0.02]))

    drive = made(fill, "bearings: {topic: /b, sigma: 0.1}\n")
    assert drive.sightings.landmark.tolist() == ["a", "b", "a"]
    assert drive.sightings.bearing.tolist() == pytest.approx([0.5, -0.5, 7.0 - math.tau])
    assert drive.sightings.sigma.tolist() == [0.1, 0.1, 0.02]
    with pytest.raises(InputError, match="1 of bearings"):
        made(
            lambda log: log.write(
                "/b", EPOCH * NANO, bearings_message(log, EPOCH * NANO, ["a", "b"], [0.5])
            )
        )


def test_points_one_topic_a_landmark(made):
    def fill(log):
        (t,) = stamps(1)
        kind = "geometry_msgs/msg/PointStamped"
        for name, frame, place in (
            ("door", "base_link", (2.0, 2.0, 9.0)),
            ("shelf", "camera_optical_frame", (1.0, 5.0, 1.0)),
            ("gone", "base_link", (math.nan, 0.0, 0.0)),
        ):
            header = log.header(t, frame)
            log.write(f"/mark/{name}", t, log.make(kind, header=header, point=point(log, *place)))

    with pytest.raises(InputError, match=r"/mark/shelf \(frame camera_optical_frame\): one of"):
        made(fill)
    drive = made(fill, "drive: {sensor: {yaw: 0.0}}\n")
    seen = dict(zip(drive.sightings.landmark, drive.sightings.bearing, strict=True))
    assert seen == pytest.approx({"door": math.pi / 4, "shelf": -math.pi / 4})
    assert sum(drive.remarks.values()) == 1


def pose_array(log, t, frame, places):
    poses = [pose(log, x, y) for x, y in places]
    return log.make("geometry_msgs/msg/PoseArray", header=log.header(t, frame), poses=poses)


def test_pose_arrays_number_their_landmarks(made):
    (t,) = stamps(1)
    places = [(1.0, 1.0), (0.0, 0.0), (-1.0, 0.0)]
    drive = made(lambda log: log.write("/poses", t, pose_array(log, t, "base_link", places)))
    assert drive.sightings.landmark.tolist() == ["0", "2"]
    assert drive.sightings.bearing.tolist() == pytest.approx([math.pi / 4, math.pi])
    with pytest.raises(InputError, match="in the fixed frame"):
        made(lambda log: log.write("/poses", t, pose_array(log, t, "map", places)))


def camera_info(log, t, distortion=()):
    lower = {"d": np.array(distortion, float), "k": np.array([500.0, 0, 320, 0, 500, 240, 0, 0, 1])}
    lower |= {"r": np.eye(3).ravel(), "p": np.array([400.0, 0, 300, 0, 0, 400, 240, 0, 0, 0, 1, 0])}
    if "D" in dict(log._store.fielddefs["sensor_msgs/msg/CameraInfo"][1]):
        lower = {name.upper(): value for name, value in lower.items()}
    region = {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False}
    return log.make(
        "sensor_msgs/msg/CameraInfo",
        header=log.header(t, "optical"),
        height=480,
        width=640,
        distortion_model="plumb_bob",
        binning_x=0,
        binning_y=0,
        roi=log.make("sensor_msgs/msg/RegionOfInterest", **region),
        **lower,
    )


def square(log, column, kind="apriltag_msgs/msg/Point", **more):
    """Corners of a tag whose middle is at (column, 100), as AprilTag 3 counts pixels."""
    at = [(-9.5, -9.5), (10.5, -9.5), (10.5, 10.5), (-9.5, 10.5)]
    return [log.make(kind, x=column + x, y=100.0 + y, **more) for x, y in at]


def tags(log, t, ids):
    found = [
        log.make(
            "apriltag_msgs/msg/AprilTagDetection",
            family="36h11",
            id=number,
            hamming=0,
            goodness=0.0,
            decision_margin=50.0,
            centre=log.make("apriltag_msgs/msg/Point", x=column, y=100.0),
            corners=square(log, column),
            homography=np.zeros(9),
        )
        for number, column in ids.items()
    ]
    kind = "apriltag_msgs/msg/AprilTagDetectionArray"
    return log.make(kind, header=log.header(t, "optical"), detections=found)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_fiducials_through_a_camera(made, suffix):
    def fill(log):
        t = stamps(2)
        log.write("/front/tags", t[0], tags(log, t[0], {7: 820.0, 3: 320.0}))
        log.write("/rear/camera_info", t[0], camera_info(log, t[0], [9.0]))
        log.write("/front/camera_info", t[1], camera_info(log, t[1]))

    drive = made(fill, suffix=suffix)
    assert drive.sightings.landmark.tolist() == ["7", "3"]
    assert drive.sightings.bearing.tolist() == pytest.approx([-math.pi / 4, 0.0])
    rectified = made(fill, "bearings: {topic: /front/tags, rectified: true}\n", suffix=suffix)
    assert rectified.sightings.bearing[0] == pytest.approx(-math.atan2(520, 400))
    told = "bearings: {topic: /front/tags, camera: {fx: 250, fy: 250, cx: 320, cy: 240}}\n"
    assert made(fill, told, suffix=suffix).sightings.bearing[0] == pytest.approx(-math.atan(2))


def test_the_size_of_tags_gives_ranges(made):
    def fill(log):
        (t,) = stamps(1)
        log.write("/tags", t, tags(log, t, {7: 820.0, 3: 320.0}))

    topic = "topic: /tags, camera: {fx: 250, fy: 250, cx: 320, cy: 240}"
    near = 0.16 * 250 / 20
    drive = made(fill, f"bearings: {{{topic}, tag_size: 0.16}}\n")
    assert drive.sightings.range == pytest.approx([math.sqrt(5.0) * near, near], rel=2e-3)
    drive = made(fill, f"bearings: {{{topic}, tag_size: {{'3': 0.08}}}}\n")
    assert drive.sightings.range == pytest.approx([math.nan, near / 2.0], rel=2e-3, nan_ok=True)


def test_fiducials_without_a_camera_say_what_they_need(made):
    (t,) = stamps(1)
    with pytest.raises(InputError, match="camera model"):
        made(lambda log: log.write("/tags", t, tags(log, t, {1: 5.0})))


@pytest.mark.parametrize("unit", [1.0, 640.0])
def test_detections_by_their_own_id_or_their_likeliest_class(made, unit):
    """In pixels, or in shares of the size of the image."""

    def fill(log):
        (t,) = stamps(1)
        make, zeros = log.make, np.zeros(36)
        covered = make(
            "geometry_msgs/msg/PoseWithCovariance", pose=pose(log, 0, 0), covariance=zeros
        )

        def detection(name, column, *classes):
            place = make("vision_msgs/msg/Point2D", x=column / unit, y=0.0)
            centre = make("vision_msgs/msg/Pose2D", position=place, theta=0.0)
            results = [
                make(
                    "vision_msgs/msg/ObjectHypothesisWithPose",
                    hypothesis=make("vision_msgs/msg/ObjectHypothesis", class_id=c, score=s),
                    pose=covered,
                )
                for c, s in classes
            ]
            box = make("vision_msgs/msg/BoundingBox2D", center=centre, size_x=1.0, size_y=1.0)
            header = log.header(t, "optical")
            kind = "vision_msgs/msg/Detection2D"
            return make(kind, header=header, results=results, bbox=box, id=name)

        found = [
            detection("chair 1", 620.0, ("chair", 0.9)),
            detection("", 320.0, ("lamp", 0.2), ("door", 0.7)),
            detection("", 320.0),
        ]
        kind = "vision_msgs/msg/Detection2DArray"
        log.write("/camera_info", t, camera_info(log, t))
        log.write("/found", t, make(kind, header=log.header(t, "optical"), detections=found))

    drive = made(fill)
    assert drive.sightings.landmark.tolist() == ["chair 1", "door"]
    assert drive.sightings.bearing.tolist() == pytest.approx([-math.atan(0.6), 0.0])
    assert drive.remarks.pop("sightings without an id, left out") == 1
    assert list(drive.remarks.values()) == [2] * (unit > 1.0)


def test_tags_without_corners_are_named_in_the_refusal(made, tmp_path):
    def fill(log):
        for t in stamps(3):
            message = tags(log, t, {7: 820.0})
            zero = log.make("apriltag_msgs/msg/Point", x=0.0, y=0.0)
            message.detections[0].corners = [zero] * 4
            log.write("/tags", t, message)
            log.write("/camera_info", t, camera_info(log, t))

    made(fill)
    words = refused(call("run", tmp_path / "log.mcap", "--home", "at:0.5"))
    assert "no sightings of landmarks in it" in words
    assert words.endswith(
        "3 tags whose four corners are one point, left out: their driver does not report corners"
    )


def test_corners_as_eight_numbers(made):
    """apriltag_msgs had corners without a type of their own."""
    (t,) = stamps(1)

    def fill(log):
        text = """std_msgs/Header header
apriltag_msgs/AprilTagDetection[] detections
================================================================================
MSG: apriltag_msgs/AprilTagDetection
int32 id
int32 hamming
float64[2] centre
float64[8] corners
"""
        kind, part = TAGS, TAGS.removesuffix("Array")
        log._store = Typestore()
        fields = dict(typestore(False).fielddefs)
        del fields[kind], fields[part]
        log._store.register(fields)
        log._store.register(get_types_from_msg(text, kind))
        corners = np.array([810.5, 90.5, 830.5, 90.5, 830.5, 110.5, 810.5, 110.5])
        tag = log.make(part, id=7, hamming=0, corners=corners)
        log.write("/tags", t, log.make(kind, header=log.header(t, "optical"), detections=[tag]))
        log.write("/camera_info", t, camera_info(log, t))

    seen = made(fill).sightings
    assert seen.landmark.tolist() == ["7"]
    assert seen.bearing.tolist() == pytest.approx([-math.pi / 4])


@pytest.mark.parametrize("suffix", [".mcap", ".db3"])
def test_detections_in_space_by_pose_or_box(made, suffix):
    def fill(log):
        (t,) = stamps(1)

        def detection(name, classes, box):
            results = [
                log.make(
                    "vision_msgs/msg/ObjectHypothesisWithPose",
                    hypothesis={"class_id": c, "score": s},
                    pose={"pose": pose(log, *place)},
                )
                for c, s, place in classes
            ]
            kind = "vision_msgs/msg/Detection3D"
            return log.make(kind, id=name, results=results, bbox={"center": pose(log, *box)})

        found = [
            detection("chair 1", [("chair", 0.9, (2.0, 2.0))], (0, 0)),
            detection("", [("lamp", 0.2, (9.0, 0.0)), ("door", 0.7, (0.0, 1.0))], (0, 0)),
            detection("box", [("box", 0.7, (0.0, 0.0))], (1.0, -1.0)),
        ]
        kind = "vision_msgs/msg/Detection3DArray"
        log.write("/found", t, log.make(kind, header=log.header(t, "base"), detections=found))

    seen = made(fill, suffix=suffix).sightings
    assert dict(zip(seen.landmark, seen.bearing, strict=True)) == pytest.approx(
        {"chair 1": math.pi / 4, "door": math.pi / 2, "box": -math.pi / 4}
    )


def test_tags_of_isaac_ros(made):
    def fill(log):
        (t,) = stamps(1)
        kind = "isaac_ros_apriltag_interfaces/msg/AprilTagDetectionArray"
        place = {"pose": {"pose": pose(log, -1.0, 0.0, z=1.0)}}
        tag = log.make(kind.removesuffix("Array"), id=7, pose=place)
        log.write(
            "/tag_detections", t, log.make(kind, header=log.header(t, "camera"), detections=[tag])
        )

    seen = made(fill).sightings
    assert dict(zip(seen.landmark, seen.bearing, strict=True)) == pytest.approx({"7": math.pi / 4})


def test_a_scan_has_no_ids(made, tmp_path):
    def fill(log):
        (t,) = stamps(1)
        log.write("/scan", t, log.make("sensor_msgs/msg/LaserScan", header=log.header(t, "laser")))

    with pytest.raises(InputError, match="/scan: a sensor_msgs/msg/LaserScan, whose points"):
        made(fill, "bearings: {topic: /scan}\n")
    assert "/scan: a sensor_msgs/msg/LaserScan" in done(call("info", tmp_path / "log.mcap")).output
