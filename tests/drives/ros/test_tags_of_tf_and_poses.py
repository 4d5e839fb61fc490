"""Tags published as frames in /tf, and as one pose topic for each tag."""

import math
from dataclasses import replace

import numpy as np
import pytest
from cli.commands import call, done, refused
from drives.ros.build import odometry, pose, stamps, transforms
from rosbags.typesys import get_types_from_msg

from homeward.drives.cameras.camera import tilt_matrix
from homeward.drives.folder import read_folder
from homeward.drives.opening import open_drive, sample_drive
from homeward.drives.ros.writing import writing
from homeward.errors import InputError

CAMERA = "camera_optical_frame"
LEVEL_OPTICAL = (-0.5, 0.5, -0.5, 0.5)
"""Rotation of an optical frame that looks along the x axis of its parent."""
UNTIL = 5.0
"""Duration of the logs [s]."""


@pytest.fixture(scope="module")
def sample():
    """The sample drive, with integers as landmark ids."""
    drive = read_folder(sample_drive())
    ids = np.array([name.lstrip("L0") for name in drive.sightings.landmark], object)
    return replace(drive, sightings=replace(drive.sightings, landmark=ids))


def write_sample(path, sample, write_tags, setup=lambda log, t: None):
    """Write the odometry of the sample, and with `write_tags` its bearings {id: bearing}."""
    twists = sample.odometry.t, sample.odometry.v, sample.odometry.omega
    rows = [(t, (v, w)) for t, v, w in zip(*twists, strict=True)]
    seen = sample.sightings
    for t in np.unique(seen.t):
        now = seen.t == t
        rows.append((t, dict(zip(seen.landmark[now], seen.bearing[now], strict=True))))
    rows = [(round((t + 1000) * 1e9), row) for t, row in rows if t <= UNTIL]
    with writing(path) as log:
        setup(log, rows[0][0])
        for stamp, row in sorted(rows, key=lambda r: r[0]):
            if isinstance(row, tuple):
                log.write("/odom", stamp, odometry(log, stamp, *row))
            else:
                write_tags(log, stamp, row)


def optical(bearing, distance=3.0):
    return -distance * math.sin(bearing), 0.2, distance * math.cos(bearing)


def write_frames(log, t, seen, prefix="tag36h11:", parent=CAMERA, topic="/tf"):
    tags = {(parent, f"{prefix}{i}"): optical(b) for i, b in seen.items()}
    robot = {("base_link", f"wheel_{i}"): (0.1, i, 0.0, 0, 0, 0, 1) for i in range(4)}
    moving = {("odom", "base_link"): (t * 1e-9, 0, 0, 0, 0, 0, 1)}
    log.write(topic, t, transforms(log, t, moving | tags | robot))


def assert_same(drive, sample):
    """Assert that a drive has the bearings of the sample."""
    shift = drive.settings.epoch or 0
    found = rows_of(drive.sightings, shift - 1000)
    expected = {key: b for key, b in rows_of(sample.sightings).items() if key[0] <= UNTIL}
    assert found == pytest.approx(expected, abs=1e-9)


def rows_of(sightings, shift=0):
    t, bearings = np.round(sightings.t + shift, 6).tolist(), sightings.bearing
    return dict(zip(zip(t, sightings.landmark, strict=True), bearings, strict=True))


def mounted(topic):
    """A camera on the robot at (0.2, -0.1), by a transform in a topic."""

    def setup(log, t):
        frames = {
            ("base_link", "mast"): (0.2, 0.0, 0.5, 0, 0, 0, 1),
            ("mast", CAMERA): (0.0, -0.1, 0.2, *LEVEL_OPTICAL),
        }
        log.write(topic, t, transforms(log, t, frames))

    return setup


@pytest.mark.parametrize("suffix", [".mcap", ".db3"])  # tf2_msgs of ROS 1 is not written here
@pytest.mark.parametrize("topic", [None, "/tf", "/tf_static"])
def test_frames_that_look_like_tags_are_bearings(tmp_path, sample, topic, suffix):
    path = tmp_path / f"tf{suffix}"
    setup = mounted(topic) if topic else lambda log, t: None
    write_sample(path, sample, write_frames, setup)
    drive = open_drive(path)
    assert_same(drive, sample)
    found = drive.settings.sensor.pose
    assert found == pytest.approx((0.2, -0.1, 0.0) if topic else (0.0, 0.0, 0.0))
    assert ("x" in drive.settings.sensor.model_fields_set) == (topic is not None)


def test_frames_of_two_cameras_need_their_transforms(tmp_path, sample):
    def setup(log, t):
        frames = {
            ("base_link", "front_optical"): (0.2, 0.0, 0.5, *LEVEL_OPTICAL),
            ("base_link", "rear"): (0.2, 0.0, 0.5, 0, 0, 1, 0),
            ("rear", "rear_optical"): (0.0, 0.0, 0.0, *LEVEL_OPTICAL),
        }
        log.write("/tf_static", t, transforms(log, t, frames))

    def fill(log, t, seen):
        tags = {}
        for landmark, bearing in seen.items():
            is_ahead = abs(bearing) < math.pi / 2
            turned = bearing if is_ahead else bearing + math.pi
            parent = "front_optical" if is_ahead else "rear_optical"
            tags[parent, f"tag_{landmark}"] = optical(turned)
        log.write("/tf", t, transforms(log, t, dict(sorted(tags.items()))))

    write_sample(tmp_path / "two.mcap", sample, fill, setup)
    assert_same(open_drive(tmp_path / "two.mcap"), sample)
    write_sample(tmp_path / "alone.mcap", sample, fill)
    with pytest.raises(InputError, match="one of several cameras, without extrinsics"):
        open_drive(tmp_path / "alone.mcap")


@pytest.mark.parametrize("topic", ["/tf", "/tf_static"])
def test_positions_of_a_tilted_camera(tmp_path, sample, topic):
    """The camera is pitched by 0.5 rad, and tags are 1 m above or below it."""
    half = 0.25

    def setup(log, t):
        frames = {
            ("base_link", "mast"): (0.2, 0.0, 0.5, 0, math.sin(half), 0, math.cos(half)),
            ("mast", CAMERA): (0.0, 0.0, 0.0, *LEVEL_OPTICAL),
        }
        log.write(topic, t, transforms(log, t, frames))

    def fill(log, t, seen):
        tags = {}
        for landmark, bearing in seen.items():
            level = 3 * math.cos(bearing), 3 * math.sin(bearing), 1.0 if int(landmark) % 2 else -1.0
            x, y, z = tilt_matrix(0.0, 2 * half).T @ level
            tags[CAMERA, f"tag_{landmark}"] = (-y, -z, x)
        log.write("/tf", t, transforms(log, t, tags))

    write_sample(tmp_path / "tilted.mcap", sample, fill, setup)
    drive = open_drive(tmp_path / "tilted.mcap")
    assert_same(drive, sample)
    assert drive.settings.sensor.pose == pytest.approx((0.2, 0.0, 0.0))


@pytest.mark.parametrize("prefix", ["tag_", "fiducial_", "ar_marker_", "front/tag36h11:"])
def test_names_of_tag_frames(tmp_path, sample, prefix):
    def fill(log, t, seen):
        write_frames(log, t, seen, prefix)

    write_sample(tmp_path / "tf.mcap", sample, fill)
    assert_same(open_drive(tmp_path / "tf.mcap"), sample)


def test_info_prints_the_frames_and_a_topics_file(tmp_path, sample):
    path, topics = tmp_path / "tf.mcap", tmp_path / "topics.yaml"
    write_sample(path, sample, write_frames)
    result = done(call("info", path))
    num_tags = np.unique(sample.sightings.landmark[sample.sightings.t <= UNTIL]).size
    found = f"frames in /tf: tag36h11:* ({num_tags} frames in {CAMERA})"
    assert found in result.stdout
    text = result.stdout.partition("to change them):\n")[2].partition("Next: ")[0]
    assert "frames: tag36h11:*" in text
    topics.write_text(text)
    assert_same(open_drive(path, topics=topics), sample)


def test_ambiguous_and_missing_frames_are_refused(tmp_path, sample):
    def two(log, t, seen):
        write_frames(log, t, seen)
        write_frames(log, t, seen, "marker_")

    path, topics = tmp_path / "two.mcap", tmp_path / "topics.yaml"
    write_sample(path, sample, two)
    line = refused(call("run", path, "--out", tmp_path / "out"))
    assert "/tf: several sets of frames look like tags: marker_* (" in line
    assert 'as in {topic: /tf, frames: "marker_*"}' in line
    topics.write_text('bearings: {topic: /tf, frames: "tag36h11:*"}\n')
    assert_same(open_drive(path, topics=topics), sample)
    for text, words in (
        ('{topic: /tf, frames: "tag_*"}', r"no frame in /tf matches tag_\*"),
        ('{topic: /tf, frames: "tag*_*"}', r"more than one \*"),
        ('{topic: /odom, frames: "tag_*"}', "frames are for tf2_msgs/msg/TFMessage"),
        ('{topic: /tf, frames: "tag_*", landmark: a}', "remove landmark"),
    ):
        topics.write_text(f"bearings: {text}\n")
        with pytest.raises(InputError, match=words):
            open_drive(path, topics=topics)


def test_parts_of_the_robot_and_fixed_frames_are_no_tags(tmp_path, sample):
    def fill(log, t, seen):
        write_frames(log, t, seen, parent="map")

    path, topics = tmp_path / "robot.mcap", tmp_path / "topics.yaml"
    write_sample(path, sample, fill)
    assert not open_drive(path).sightings.t.size
    topics.write_text("bearings: {topic: /tf}\n")
    with pytest.raises(InputError, match="no frames look like tags; name the frames"):
        open_drive(path, topics=topics)
    topics.write_text('bearings: {topic: /tf, frames: "tag36h11:*"}\n')
    with pytest.raises(InputError, match="in the fixed frame map"):
        open_drive(path, topics=topics)


def test_a_camera_that_moves_on_the_robot_is_refused(tmp_path, sample):
    def fill(log, t, seen):
        write_frames(log, t, seen)
        pan = 0.1 * math.sin(t * 1e-9)
        turn = {("base_link", CAMERA): (0, 0, 0, 0, 0, math.sin(pan), math.cos(pan))}
        log.write("/tf", t, transforms(log, t, turn))

    write_sample(tmp_path / "pan.mcap", sample, fill)
    with pytest.raises(InputError, match=f"/tf: {CAMERA} moves between"):
        open_drive(tmp_path / "pan.mcap")


def write_poses(log, t, seen, kind="PoseStamped", frame=CAMERA):
    for landmark, bearing in seen.items():
        x, y, z = optical(bearing)
        placed = pose(log, x, y, z=z) if frame == CAMERA else pose(log, z, -x)
        if kind != "PoseStamped":
            placed = {"pose": placed}
        message = log.make(f"geometry_msgs/msg/{kind}", header=log.header(t, frame), pose=placed)
        log.write(f"/tag_{landmark}/pose", t, message)


@pytest.mark.parametrize("suffix", [".mcap", ".bag"])
@pytest.mark.parametrize("frame", [CAMERA, "base_link"])
@pytest.mark.parametrize("kind", ["PoseStamped", "PoseWithCovarianceStamped"])
def test_a_pose_topic_for_each_tag(tmp_path, sample, kind, frame, suffix):
    def fill(log, t, seen):
        write_poses(log, t, seen, kind, frame)

    path, topics = tmp_path / f"poses{suffix}", tmp_path / "topics.yaml"
    write_sample(path, sample, fill)
    topics.write_text('bearings: {topic: "/tag_*/pose"}\n')
    assert_same(open_drive(path, topics=topics), sample)
    assert not open_drive(path).sightings.t.size  # may be poses of anything
    assert (
        'Topics /tag_*/pose can be used as bearings: {topic: "/tag_*/pose"}.'
        in done(call("info", path)).stdout
    )


def test_pose_topics_without_an_id_or_in_a_fixed_frame_are_refused(made):
    def fill(log, frame=CAMERA):
        for t in stamps(3):
            write_poses(log, t, {"1": 0.1}, frame=frame)

    drive = made(fill, "bearings: {topic: /tag_1/pose, landmark: door}\n")
    assert drive.sightings.landmark.tolist() == ["door"] * 3
    for topic, words in (
        ("{topic: /tag_1/pose}", "add landmark: ID to it"),
        ('{topic: "/mark_*/pose"}', r"no topic /mark_\*/pose of geometry_msgs/msg/PointStamped"),
    ):
        with pytest.raises(InputError, match=words):
            made(fill, f"bearings: {topic}\n")
    with pytest.raises(InputError, match="in the fixed frame map"):
        made(lambda log: fill(log, "map"), 'bearings: {topic: "/tag_*/pose"}\n')


ALVAR = """std_msgs/Header header
ar_track_alvar_msgs/AlvarMarker[] markers
================================================================================
MSG: ar_track_alvar_msgs/AlvarMarker
std_msgs/Header header
uint32 id
uint32 confidence
geometry_msgs/PoseStamped pose
"""
OLD_APRILTAG = """apriltags_ros/AprilTagDetection[] detections
================================================================================
MSG: apriltags_ros/AprilTagDetection
int32 id
float64 size
geometry_msgs/PoseStamped pose
"""
HEADERS = {"array": (0, 0, 1), "tag": (0, 1, 0), "pose": (1, 0, 0)}
"""Which of the headers of pose, tag and array have a frame."""


@pytest.mark.parametrize("suffix", [".mcap", ".bag"])
@pytest.mark.parametrize(
    ("kind", "tags", "where"),
    [
        *(("ar_track_alvar_msgs/msg/AlvarMarkers", "markers", where) for where in HEADERS),
        ("apriltags_ros/msg/AprilTagDetectionArray", "detections", "pose"),
    ],
)
def test_arrays_of_tags_with_a_header_each(tmp_path, sample, kind, tags, where, suffix):
    of_pose, of_tag, of_array = HEADERS[where]

    def fill(log, t, seen):
        if kind not in log._store.fielddefs:
            text = ALVAR if tags == "markers" else OLD_APRILTAG
            log._store.register(get_types_from_msg(text, kind))

        def header(is_given):
            return log.header(t, CAMERA) if is_given else log.header(0, "")

        found = []
        for landmark, bearing in [*seen.items(), (255, 0.0)][: None if tags == "markers" else -1]:
            x, y, z = optical(bearing)
            stamped = {"header": header(of_pose), "pose": pose(log, x, y, z=z)}
            more = {"header": header(of_tag)} if tags == "markers" else {}
            found.append({"id": int(landmark), "pose": stamped, **more})
        part = kind.replace("Markers", "Marker").replace("DetectionArray", "Detection")
        more = {"header": header(of_array)} if tags == "markers" else {}
        message = log.make(kind, **{tags: [log.make(part, **each) for each in found]}, **more)
        log.write("/ar_pose_marker", t, message)

    write_sample(tmp_path / f"tags{suffix}", sample, fill)
    drive = open_drive(tmp_path / f"tags{suffix}")
    assert_same(drive, sample)
    assert ("sightings without an id, left out" in drive.remarks) == (tags == "markers")


@pytest.mark.parametrize(
    ("case", "log", "topics"),
    [
        ("09-tf-only", "tf", None),
        ("09-tf-only", "tf", "tf.yaml"),
        ("06-ros2-aruco", "ros2_aruco", "ros2_aruco.yaml"),
        ("06-ros2-aruco", "aruco_opencv", None),
        ("07-alvar", "alvar", "alvar.yaml"),
    ],
)
def test_field_cases_with_the_bearings_of_the_sample(data_dir, sample, case, log, topics):
    folder = data_dir / "field" / case
    if not folder.is_dir():
        pytest.skip(f"no field/{case} in the data folder")
    drive = open_drive(folder / log, topics=topics and folder / topics)
    assert rows_of(drive.sightings) == pytest.approx(rows_of(sample.sightings), abs=1e-6)
