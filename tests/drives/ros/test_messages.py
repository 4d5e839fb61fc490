"""What each kind of message tells, as a drive has it."""

import math
from pathlib import Path

import numpy as np
import pytest
from drives.ros.rig import NANO, bearings_message
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from homeward.drives.opening import open_drive
from homeward.drives.ros.camera import Intrinsics
from homeward.drives.ros.log_file import LogFile, writing
from homeward.drives.ros.messages import DEFINITIONS, typestore
from homeward.errors import InputError

SECOND = NANO
EPOCH = 1_700_000_000
SUFFIXES = (".mcap", ".bag", ".db3")


def point(log, x, y, z):
    return log.make("geometry_msgs/msg/Point", x=float(x), y=float(y), z=float(z))


def pose(log, x, y, heading=0.0, z=0.0):
    turn = {"x": 0.0, "y": 0.0, "z": math.sin(heading / 2), "w": math.cos(heading / 2)}
    quaternion = log.make("geometry_msgs/msg/Quaternion", **turn)
    return log.make("geometry_msgs/msg/Pose", position=point(log, x, y, z), orientation=quaternion)


def twist(log, v, omega, sideways=0.0):
    vector = "geometry_msgs/msg/Vector3"
    return log.make(
        "geometry_msgs/msg/Twist",
        linear=log.make(vector, x=v, y=sideways, z=0.0),
        angular=log.make(vector, x=0.0, y=0.0, z=omega),
    )


def odometry(log, stamp, v, omega, x=0.0, y=0.0, heading=0.0, sideways=0.0):
    kind, zeros = "geometry_msgs/msg/{}WithCovariance", np.zeros(36)
    return log.make(
        "nav_msgs/msg/Odometry",
        header=log.header(stamp, "odom"),
        child_frame_id="base_link",
        pose=log.make(kind.format("Pose"), pose=pose(log, x, y, heading), covariance=zeros),
        twist=log.make(
            kind.format("Twist"), twist=twist(log, v, omega, sideways), covariance=zeros
        ),
    )


def stamps(n, start=EPOCH, step=0.1):
    return [start * SECOND + round(i * step * SECOND) for i in range(n)]


@pytest.fixture
def made(tmp_path):
    """Write a log by a function of it, and open it as a drive, perhaps with a topics file."""

    def make(fill, topics=None, suffix=".mcap", odometry_too=True):
        path = tmp_path / f"log{suffix}"
        path.unlink(missing_ok=True)
        with writing(path) as log:
            for t in stamps(10) if odometry_too else ():
                log.write("/odom", t, odometry(log, t, 0.2, 0.1))
            fill(log)
        if topics is not None:
            (tmp_path / "topics.yaml").write_text(topics)
        return open_drive(path, topics=None if topics is None else tmp_path / "topics.yaml")

    return make


# --- Odometry ---------------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_twist_of_odometry_by_header_stamps(made, suffix):
    drive = made(lambda log: None, suffix=suffix)
    assert drive.settings.epoch == EPOCH
    assert drive.odometry.t.tolist() == [i / 10 for i in range(10)]
    assert set(drive.odometry.v.tolist()) == {0.2}
    assert set(drive.odometry.omega.tolist()) == {0.1}


@pytest.mark.parametrize("kind", ["TwistStamped", "TwistWithCovarianceStamped", "Twist"])
def test_other_twists(made, kind):
    def fill(log):
        for t in stamps(5):
            plain = twist(log, 0.3, -0.2)
            if kind == "TwistWithCovarianceStamped":
                covered = {"twist": plain, "covariance": np.zeros(36)}
                plain = log.make("geometry_msgs/msg/TwistWithCovariance", **covered)
            if kind != "Twist":
                header = log.header(t, "base_link")
                plain = log.make(f"geometry_msgs/msg/{kind}", header=header, twist=plain)
            log.write("/speed", t, plain)

    drive = made(fill, odometry_too=False)
    assert drive.odometry.v.tolist() == [0.3] * 5
    assert drive.odometry.omega.tolist() == [-0.2] * 5


def test_poses_of_a_circle_become_its_twist(made):
    def fill(log):
        for i, t in enumerate(stamps(20)):
            a = 0.05 * i
            placed = pose(log, 2 * math.sin(a), 2 * (1 - math.cos(a)), a + 3.0 - 3.0)
            kind = "geometry_msgs/msg/PoseStamped"
            log.write("/pose", t, log.make(kind, header=log.header(t, "odom"), pose=placed))

    drive = made(fill, "odometry: {topic: /pose}\n", odometry_too=False)
    assert drive.odometry.v[:-1] == pytest.approx(1.0)
    assert drive.odometry.omega[:-1] == pytest.approx(0.5)


def test_odometry_without_a_twist_is_differentiated_and_backwards_is_backwards(made):
    def fill(log):
        for i, t in enumerate(stamps(10)):
            log.write("/odom", t, odometry(log, t, 0.0, 0.0, x=-0.05 * i, heading=0.0))

    drive = made(fill, odometry_too=False)
    assert drive.odometry.v[:-1] == pytest.approx(-0.5)


@pytest.mark.parametrize("by", ["position", "velocity"])
def test_wheels(made, by):
    def fill(log):
        for i, t in enumerate(stamps(10)):
            turned, nothing = np.array([0.5 * i, 1.0 * i, 9.0]), np.empty(0)
            values = {"position": nothing, "velocity": nothing, "effort": nothing}
            values[by] = turned if by == "position" else np.array([5.0, 10.0, 9.0])
            names = ["left_wheel", "right_wheel", "arm"]
            header = log.header(t, "")
            message = log.make("sensor_msgs/msg/JointState", header=header, name=names, **values)
            log.write("/joints", t, message)

    told = "odometry: {topic: /joints, wheel_radius: 0.1, track_width: 0.4"
    drive = made(fill, told + "}\n", odometry_too=False)
    assert drive.odometry.v[:-1] == pytest.approx(0.75)
    assert drive.odometry.omega[:-1] == pytest.approx(1.25)
    swapped = made(fill, told + ", left: [right_wheel], right: [left_wheel]}\n", odometry_too=False)
    assert swapped.odometry.omega[:-1] == pytest.approx(-1.25)
    with pytest.raises(InputError, match="wheel_radius"):
        made(fill, "odometry: {topic: /joints}\n", odometry_too=False)


def test_numbers_that_are_not_finite_and_sideways_speeds_are_counted(made):
    def fill(log):
        for i, t in enumerate(stamps(10)):
            v = math.nan if i == 3 else 0.2
            log.write("/odom", t, odometry(log, t, v, 0.1, sideways=0.1 if i > 7 else 0.0))

    drive = made(fill, odometry_too=False)
    assert drive.odometry.t.size == 9
    assert sorted(drive.remarks.values()) == [1, 2]


# --- Bearings ---------------------------------------------------------------------------------


def test_our_own_bearings_with_and_without_sigmas(made):
    def fill(log):
        t = stamps(2)
        log.write("/b", t[0], bearings_message(log, t[0], ["a", "b"], [0.5, -0.5]))
        log.write("/b", t[1], bearings_message(log, t[1], ["a"], [7.0], [0.02]))

    drive = made(fill, "bearings: {topic: /b, sigma: 0.1}\n")
    assert drive.sightings.landmark.tolist() == ["a", "b", "a"]
    assert drive.sightings.bearing.tolist() == pytest.approx([0.5, -0.5, 7.0 - math.tau])
    assert drive.sightings.sigma.tolist() == [0.1, 0.1, 0.02]
    with pytest.raises(InputError, match="1 bearings"):
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

    drive = made(fill)
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
    with pytest.raises(InputError, match="does not move with the robot"):
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


def tags(log, t, ids):
    corner = log.make("apriltag_msgs/msg/Point", x=0.0, y=0.0)
    found = [
        log.make(
            "apriltag_msgs/msg/AprilTagDetection",
            family="36h11",
            id=number,
            hamming=0,
            goodness=0.0,
            decision_margin=50.0,
            centre=log.make("apriltag_msgs/msg/Point", x=column, y=100.0),
            corners=[corner] * 4,
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


def test_fiducials_without_a_camera_say_what_they_need(made):
    (t,) = stamps(1)
    with pytest.raises(InputError, match="camera model"):
        made(lambda log: log.write("/tags", t, tags(log, t, {1: 5.0})))


def test_detections_by_their_own_id_or_their_likeliest_class(made):
    def fill(log):
        (t,) = stamps(1)
        make, zeros = log.make, np.zeros(36)
        covered = make(
            "geometry_msgs/msg/PoseWithCovariance", pose=pose(log, 0, 0), covariance=zeros
        )

        def detection(name, column, *classes):
            place = make("vision_msgs/msg/Point2D", x=column, y=0.0)
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
            detection("chair 1", 820.0, ("chair", 0.9)),
            detection("", 320.0, ("lamp", 0.2), ("door", 0.7)),
            detection("", 320.0),
        ]
        kind = "vision_msgs/msg/Detection2DArray"
        log.write("/camera_info", t, camera_info(log, t))
        log.write("/found", t, make(kind, header=log.header(t, "optical"), detections=found))

    drive = made(fill)
    assert drive.sightings.landmark.tolist() == ["chair 1", "door"]
    assert drive.sightings.bearing.tolist() == pytest.approx([-math.pi / 4, 0.0])
    assert drive.remarks == {"sightings without an id": 1}


@pytest.mark.parametrize(
    ("model", "k"),
    [
        ("plumb_bob", (-0.28, 0.07, 2e-4, 1e-5, 0.0)),
        ("rational_polynomial", (0.5, 0.1, 1e-4, 2e-4, 0.01, 0.8, 0.2, 0.03)),
        ("equidistant", (-0.02, 0.005, -0.001, 0.0002)),
    ],
)
def test_a_lens_is_undone(model, k):
    bearing, up = (
        g.ravel() for g in np.meshgrid(np.linspace(-0.7, 0.7, 15), np.linspace(-0.3, 0.3, 5))
    )
    x, y = np.tan(-bearing), up
    r2 = x * x + y * y
    if model == "equidistant":
        angle = np.arctan(np.sqrt(r2))
        a2 = angle**2
        scale = (
            angle
            * (1 + a2 * (k[0] + a2 * (k[1] + a2 * (k[2] + a2 * k[3]))))
            / np.sqrt(np.maximum(r2, 1e-30))
        )
        xd, yd = x * scale, y * scale
    else:
        k1, k2, p1, p2, k3, k4, k5, k6 = (*k, 0.0, 0.0, 0.0)[:8]
        radial = (1 + k1 * r2 + k2 * r2**2 + k3 * r2**3) / (1 + k4 * r2 + k5 * r2**2 + k6 * r2**3)
        xd = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
        yd = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    camera = Intrinsics(fx=500, fy=510, cx=320, cy=240, model=model, distortion=k)
    there = camera.bearings(500 * xd + 320, 510 * yd + 240)
    assert there == pytest.approx(bearing, abs=1e-6)


# --- Home, truth and clocks -------------------------------------------------------------------


def standing_then_driving(log):
    for i, t in enumerate(stamps(40)):
        log.write("/odom", t, odometry(log, t, 0.0 if i < 20 else 0.3, 0.0))
        wobble = 0.01 if i % 2 else -0.01
        seen = bearings_message(log, t, ["a", "b"], [math.pi - 0.001 + wobble, 0.5 - wobble])
        log.write("/b", t, seen)


def test_home_is_what_was_seen_while_standing_there(made):
    drive = made(standing_then_driving, "home: {during: [0.0, 1.95]}\n", odometry_too=False)
    assert drive.home["b"].bearing == pytest.approx(0.5)
    assert abs(drive.home["a"].bearing) == pytest.approx(math.pi - 0.001)
    with pytest.raises(InputError, match="does not stand"):
        made(standing_then_driving, "home: {during: [1.0, 3.5]}\n", odometry_too=False)
    with pytest.raises(InputError, match="nothing was seen"):
        made(standing_then_driving, "home: {during: [50.0, 60.0]}\n", odometry_too=False)


def test_home_from_a_csv_beside_the_topics_file(made, tmp_path):
    (tmp_path / "home.csv").write_text("landmark,bearing\na,0.25\n")
    drive = made(standing_then_driving, "home: {csv: home.csv}\n", odometry_too=False)
    assert drive.home["a"].bearing == 0.25


def test_truth_is_turned_into_the_home_frame(made):
    def fill(log):
        for t in stamps(3):
            placed = pose(log, 1.0, 3.0, math.pi / 2)
            kind = "geometry_msgs/msg/PoseStamped"
            log.write("/mocap", t, log.make(kind, header=log.header(t, "map"), pose=placed))

    drive = made(fill, "truth: {topic: /mocap, home: [1.0, 1.0, 1.5707963267948966]}\n")
    assert drive.truth.x == pytest.approx([2.0] * 3)
    assert drive.truth.y == pytest.approx([0.0] * 3, abs=1e-12)
    assert drive.truth.heading == pytest.approx([0.0] * 3, abs=1e-12)


def test_settings_of_the_drive_in_the_topics_file(made):
    drive = made(lambda log: None, "drive: {sensor: {x: 0.2, yaw: 0.1}}\n")
    assert (drive.settings.sensor.x, drive.settings.sensor.yaw) == (0.2, 0.1)


def test_receive_times_when_asked(made):
    def fill(log):
        for t in stamps(10):
            log.write("/odom", t + SECOND // 4, odometry(log, t, 0.2, 0.1))

    by_header = made(fill, odometry_too=False)
    by_recorder = made(fill, "clock: receive\n", odometry_too=False)
    assert by_header.odometry.t[0] == 0.0
    assert by_recorder.odometry.t[0] == 0.25


def test_a_topic_without_headers_is_put_on_the_clock_of_the_others(made):
    def fill(log):
        for t in stamps(10):
            # Headers of a simulation's clock, recorded by the wall's.
            log.write("/b", t, bearings_message(log, t - EPOCH * SECOND + SECOND, ["a"], [0.5]))
            log.write("/cmd_vel", t, twist(log, 0.2, 0.1))

    drive = made(fill, odometry_too=False)
    assert drive.settings.epoch is None
    assert drive.odometry.t == pytest.approx(drive.sightings.t)


def test_clocks_that_cannot_be_are_refused_with_what_helps(made):
    def other_clock(log):
        for t in stamps(5):
            log.write("/b", t, bearings_message(log, 5 * SECOND, ["a"], [0.5]))

    def unset(log):
        for t in stamps(5):
            log.write("/b", t, bearings_message(log, 0, ["a"], [0.5]))

    def set_back(log):
        for i, t in enumerate(stamps(10)):
            log.write(
                "/b", t, bearings_message(log, t - (5 * SECOND if i > 4 else 0), ["a"], [0.5])
            )

    for fill, words in (
        (other_clock, "different clocks"),
        (unset, "no times"),
        (set_back, "runs back"),
    ):
        with pytest.raises(InputError, match=words) as caught:
            made(fill)
        assert "clock: receive" in str(caught.value)
        assert made(fill, "clock: receive\n").sightings.t.size


def test_messages_slightly_out_of_order_are_put_in_order(made):
    def fill(log):
        t = stamps(10)
        for i in (0, 1, 3, 2, 4, 5, 6, 7, 8, 9):
            log.write("/odom", t[i], odometry(log, t[i], 0.1 * i, 0.0))

    drive = made(fill, odometry_too=False)
    assert drive.odometry.v.tolist() == [0.1 * i for i in range(10)]


def test_several_equal_topics_must_be_named(made):
    def fill(log):
        for t in stamps(5):
            log.write("/odom_filtered", t, odometry(log, t, 0.9, 0.0))

    with pytest.raises(InputError, match="/odom, /odom_filtered"):
        made(fill)
    assert made(fill, "odometry: {topic: /odom_filtered}\n").odometry.v[0] == 0.9


@pytest.mark.parametrize(
    ("topics", "words"),
    [
        ("odometry: {topic: /none}\n", "there are: /odom"),
        ("bearings: {topic: /odom}\n", "tells no bearings"),
        ("odometry: {topic: /odom, use: scent}\n", "odometry.use"),
        ("home: {}\n", "one of topic, csv and during"),
        ("home: {during: [3, 1]}\n", "from, until"),
        ("colour: red\n", "colour"),
        ("drive: {sensor: {x: far}}\n", "drive.sensor.x"),
        ("- 1\n", "not a mapping"),
    ],
)
def test_topics_files_that_cannot_be(made, topics, words):
    with pytest.raises(InputError, match=words) as caught:
        made(lambda log: None, topics)
    assert len(str(caught.value).splitlines()) == 1


def test_the_definitions_are_those_in_the_documentation():
    text = (Path(__file__).resolve().parents[3] / "docs" / "logs.md").read_text()
    for definition in DEFINITIONS.values():
        assert definition in text


def test_a_log_without_definitions_and_bags_of_several_compressed_files(tmp_path):
    import sqlite3

    from backports import zstd

    folder = tmp_path / "bag"
    folder.mkdir()
    for number in range(2):
        file = folder / f"part_{number}.db3"
        with writing(file) as log:
            for t in stamps(5, EPOCH + number):
                log.write("/odom", t, odometry(log, t, 0.2, 0.1))
        with sqlite3.connect(file) as database:
            database.execute("DROP TABLE message_definitions")
        database.close()
        (folder / f"{file.name}.zstd").write_bytes(zstd.compress(file.read_bytes()))
        file.unlink()
    (folder / "metadata.yaml").write_text(
        "rosbag2_bagfile_information: {relative_file_paths: [part_0.db3.zstd, part_1.db3.zstd], "
        "compression_mode: FILE, compression_format: zstd}\n"
    )
    drive = open_drive(folder)
    assert drive.odometry.t.tolist() == pytest.approx(
        [*np.arange(5) / 10, *(1 + np.arange(5) / 10)]
    )


def test_messages_compressed_one_by_one(tmp_path):
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer_made:
        pass
    writer = Writer(tmp_path / "packed", version=9, storage_plugin=StoragePlugin.SQLITE3)
    writer.set_compression(CompressionMode.MESSAGE, CompressionFormat.ZSTD)
    with writer:
        log = LogFile(writer, ros1=False)
        for t in stamps(5):
            log.write("/odom", t, odometry(log, t, 0.2, 0.1))
    assert open_drive(tmp_path / "packed").odometry.v.tolist() == [0.2] * 5
    assert writer_made.connections == []
    with pytest.raises(InputError, match="no topic with odometry"):
        open_drive(tmp_path / "bag")


def test_other_distributions_know_our_types():
    store = get_typestore(Stores.ROS2_JAZZY)
    for name, text in DEFINITIONS.items():
        store.register(get_types_from_msg(text, name))
        assert store.hash_rihs01(name) == typestore(ros1=False).hash_rihs01(name)
