"""Where home and truth come from, which clock counts, and topics files."""

import math

import pytest
from drives.ros.build import EPOCH, SECOND, odometry, pose, stamps, twist
from drives.ros.rig import bearings_message

from homeward.drives.ros.info import log_info
from homeward.errors import InputError


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
    with pytest.raises(InputError, match="the robot moves at home"):
        made(standing_then_driving, "home: {during: [1.0, 3.5]}\n", odometry_too=False)
    with pytest.raises(InputError, match="length of the drive"):
        made(standing_then_driving, "home: {during: [50.0, 60.0]}\n", odometry_too=False)


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


@pytest.mark.parametrize("topic", ["/ground_truth/pose", "/vicon/robot/odom"])
def test_a_pose_topic_named_as_ground_truth_is_used_for_scoring_and_not_as_odometry(made, topic):
    def fill(log):
        for t in stamps(10):
            placed = pose(log, 2.0, 3.0, 0.5)
            if topic.endswith("odom"):
                message = odometry(log, t, 0.9, 0.9, 2.0, 3.0, 0.5)
            else:
                kind = "geometry_msgs/msg/PoseStamped"
                message = log.make(kind, header=log.header(t, "world"), pose=placed)
            log.write(topic, t, message)

    drive = made(fill)
    assert drive.odometry.v == pytest.approx([0.2] * 10)
    assert drive.truth.x == pytest.approx([2.0] * 10)
    assert made(fill, "truth: {topic: /odom}\n").truth.x == pytest.approx([0.0] * 10)


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


def test_clocks_that_cannot_be_are_refused_with_what_helps(made, tmp_path):
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
        (unset, "no stamps"),
        (set_back, "runs backwards"),
    ):
        with pytest.raises(InputError, match=words) as caught:
            made(fill)
        assert "clock: receive" in str(caught.value)
        assert log_info(tmp_path / "log.mcap").remarks[-1].endswith(f"{caught.value.what}.")
        assert made(fill, "clock: receive\n").sightings.t.size


def test_a_topic_with_stamps_seconds_older_than_those_of_the_odometry_is_noted(made):
    def fill(log, delay):
        for t in stamps(9):
            log.write("/b", t, bearings_message(log, t - round(delay * SECOND), ["a"], [0.5]))

    (remark,) = (r for r in made(lambda log: fill(log, 3.0)).remarks if "reached" in r)
    assert "/b reached the recorder 3.0 s after their stamps, but those of /odom 0.0 s" in remark
    assert not any("reached" in r for r in made(lambda log: fill(log, 0.5)).remarks)


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
        ("odometry: {topic: /none}\n", "no topic /none; choose one of: /odom"),
        ("bearings: {topic: /odom}\n", "read as odometry .* cannot be used under bearings"),
        ("odometry: {topic: /odom, use: scent}\n", "odometry.use"),
        ("home: {}\n", "one of during, spin, at, topic, csv"),
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
