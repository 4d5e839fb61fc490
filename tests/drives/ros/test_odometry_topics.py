"""What each kind of odometry message tells."""

import math
import re

import numpy as np
import pytest
from drives.ros.build import EPOCH, SUFFIXES, joints, odometry, pose, stamps, twist
from rosbags.typesys import get_types_from_msg

from homeward.errors import InputError


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
            turned = [0.5 * i, 1.0 * i, 9.0] if by == "position" else [5.0, 10.0, 9.0]
            names = ["left_wheel", "right_wheel", "arm"]
            log.write("/joints", t, joints(log, t, names, **{by: np.array(turned)}))

    told = "odometry: {topic: /joints, wheel_radius: 0.1, track_width: 0.4"
    drive = made(fill, told + "}\n", odometry_too=False)
    assert drive.odometry.v[:-1] == pytest.approx(0.75)
    assert drive.odometry.omega[:-1] == pytest.approx(1.25)
    swapped = made(fill, told + ", left: [right_wheel], right: [left_wheel]}\n", odometry_too=False)
    assert swapped.odometry.omega[:-1] == pytest.approx(-1.25)
    with pytest.raises(InputError, match="no message contains odometry"):
        made(fill, told + ", left: [paddle], right: [oar]}\n", odometry_too=False)
    with pytest.raises(InputError, match="wheel_radius"):
        made(fill, "odometry: {topic: /joints}\n", odometry_too=False)


def test_joints_of_mecanum_and_omni_wheels(made):
    """0.3 m/s ahead, 0.2 m/s to the left and 0.5 rad/s, by wheels of 0.1 m."""
    v, vy, omega = 0.3, 0.2, 0.5
    reach = (0.4 + 0.6) / 2
    corners = {
        "front_left_joint": v - vy - reach * omega,
        "back_right_joint": v - vy + reach * omega,
        "back_left_joint": v + vy - reach * omega,
        "front_right_joint": v + vy + reach * omega,
    }
    angles = {f"omni_{k}": math.pi / 3 + k * math.tau / 3 for k in range(3)}
    circle = {k: vy * math.cos(a) - v * math.sin(a) + 0.2 * omega for k, a in angles.items()}
    mecanum = "wheel_radius: 0.1, track_width: 0.4, wheelbase: 0.6, roller_angle: 0.7854"
    omni = "wheel_radius: 0.1, omni_radius: 0.2, omni: [omni_0, omni_1, omni_2]"
    for wheels, given in ((corners, mecanum), (circle, omni)):

        def fill(log, wheels=wheels):
            for t in stamps(10):
                turning = np.array(list(wheels.values())) / 0.1
                log.write("/joints", t, joints(log, t, list(wheels), velocity=turning))

        found = made(fill, f"odometry: {{topic: /joints, {given}}}\n", odometry_too=False).odometry
        for rate, expected in ((found.v, v), (found.vy, vy), (found.omega, omega)):
            assert rate == pytest.approx(expected, rel=1e-4)
    lacks = mecanum.replace("wheelbase: 0.6, ", "")
    with pytest.raises(InputError, match="wheelbase"):
        made(fill, f"odometry: {{topic: /joints, {lacks}}}\n", odometry_too=False)


def test_wheel_positions_in_ticks(made):
    def fill(log):
        for i, t in enumerate(stamps(10)):
            ticks = np.array([50.0 * i, 100.0 * i])
            log.write("/joints", t, joints(log, t, ["left", "right"], position=ticks))

    wheels = "wheel_radius: 0.1, track_width: 0.4, ticks_per_turn: 1000"
    drive = made(fill, f"odometry: {{topic: /joints, {wheels}}}\n", odometry_too=False)
    assert drive.odometry.v[:-1] == pytest.approx(0.075 * math.tau)
    assert drive.odometry.omega[:-1] == pytest.approx(0.125 * math.tau)


ACKERMANN_DRIVE = """float32 steering_angle
float32 steering_angle_velocity
float32 speed
float32 acceleration
float32 jerk
"""


@pytest.mark.parametrize("stamped", [True, False])
def test_ackermann_speed_and_steering_angle(made, stamped):
    def fill(log):
        plain = "ackermann_msgs/msg/AckermannDrive"
        kind = plain + "Stamped" * stamped
        log._store.register(get_types_from_msg(ACKERMANN_DRIVE, plain))
        if stamped:
            text = "std_msgs/Header header\nackermann_msgs/AckermannDrive drive\n"
            log._store.register(get_types_from_msg(text, kind))
        for t in stamps(10):
            drive = log.make(plain, steering_angle=0.25, speed=0.5)
            fields = {"header": log.header(t, ""), "drive": drive}
            log.write("/car", t, log.make(kind, **fields) if stamped else drive)

    drive = made(fill, "odometry: {topic: /car, wheelbase: 0.5}\n", odometry_too=False)
    assert drive.odometry.v == pytest.approx(0.5)
    assert drive.odometry.omega == pytest.approx(math.tan(0.25))
    with pytest.raises(InputError, match=r"/car: .* needs wheelbase; give the geometry"):
        made(fill, "odometry: {topic: /car}\n", odometry_too=False)


@pytest.mark.parametrize("child", ["base_link", "base_footprint"])
def test_transforms_from_odom_to_the_robot(made, child):
    def fill(log):
        for i, t in enumerate(stamps(10)):
            turned = {"z": math.sin(0.02 * i), "w": math.cos(0.02 * i)}
            moved = {"translation": {"x": 0.05 * i, "y": 0.0}, "rotation": turned}
            frames = {"header": log.header(t, "/odom"), "child_frame_id": child}
            here = log.make("geometry_msgs/msg/TransformStamped", **frames, transform=moved)
            frames = {"header": log.header(t, child), "child_frame_id": "camera"}
            mount = log.make("geometry_msgs/msg/TransformStamped", **frames, transform=moved)
            log.write("/tf", t, log.make("tf2_msgs/msg/TFMessage", transforms=[mount, here]))

    drive = made(fill, "odometry: {topic: /tf}\n", odometry_too=False)
    assert drive.odometry.t.size == 10
    assert drive.odometry.v[:-1] == pytest.approx(0.5, abs=0.04)
    assert drive.odometry.omega[:-1] == pytest.approx(0.4)
    with pytest.raises(InputError, match=r"/tf: no transform from world to robot; name the frames"):
        made(fill, "odometry: {topic: /tf, frames: [world, robot]}\n", odometry_too=False)
    with pytest.raises(InputError, match=r"odom -> base_link, use odometry: \{topic: /tf\}"):
        made(fill, odometry_too=False)


def imu_and_odometry(measured, turning=0.6):
    """Odometry at 10 Hz that turns left and right, and an IMU at 50 Hz with a function of it."""

    def fill(log):
        for i, t in enumerate(stamps(1500, step=0.02)):
            rate = turning * math.sin(0.01 * i)
            rates = {"x": 9.0, "y": 9.0, "z": measured(rate)}
            header = log.header(t, "imu")
            log.write(
                "/imu",
                t,
                log.make(
                    "sensor_msgs/msg/Imu",
                    header=header,
                    angular_velocity=rates,
                    **{
                        f"{name}_covariance": np.zeros(9)
                        for name in ("orientation", "angular_velocity", "linear_acceleration")
                    },
                ),
            )
            if i % 5 == 0:
                log.write("/odom", t, odometry(log, t, 0.2, 1.1 * rate))

    return fill


@pytest.mark.parametrize(
    ("measured", "note"),
    [
        (lambda rate: rate + 0.01, r"1\.1 x they fit"),
        (lambda rate: -rate, "sign inverted"),
        (lambda rate: math.degrees(rate), "converted from deg/s"),
    ],
)
def test_yaw_rate_of_an_imu_replaces_that_of_the_odometry(made, measured, note):
    topics = "odometry: {topic: /odom, yaw_rate: /imu}\n"
    drive = made(imu_and_odometry(measured), topics, odometry_too=False)
    expected = 0.6 * np.sin(0.5 * (drive.odometry.t + 0.05))  # the mean until the next stamp
    assert drive.odometry.omega[:-1] == pytest.approx(expected[:-1], abs=0.012)
    assert any(re.search(note, reason) for reason in drive.remarks)


@pytest.mark.parametrize(
    ("measured", "topic", "complaint"),
    [
        (lambda rate: 0.1 * math.cos(123.0 * rate), "/imu", "/imu: the yaw rate contradicts"),
        (lambda rate: 5.5 * rate, "/imu", "/imu: the yaw rate of the odometry is 0.2 x this one"),
        (lambda rate: 0.0, "/imu", "/imu: the yaw rate is constant"),
        (lambda rate: math.nan, "/imu", "/imu: no message contains yaw rates with finite"),
        (lambda rate: rate, "/odom", "/odom is a nav_msgs/msg/Odometry.*under yaw_rate"),
        (lambda rate: rate, "/nothing", "/nothing"),
    ],
)
def test_an_imu_that_contradicts_the_odometry_is_refused(made, measured, topic, complaint):
    topics = f"odometry: {{topic: /odom, yaw_rate: {topic}}}\n"
    with pytest.raises(InputError, match=complaint):
        made(imu_and_odometry(measured), topics, odometry_too=False)


def test_numbers_that_are_not_finite_are_counted_and_sideways_speeds_are_read(made):
    def fill(log):
        for i, t in enumerate(stamps(10)):
            v = math.nan if i == 3 else 0.2
            log.write("/odom", t, odometry(log, t, v, 0.1, sideways=0.1 if i > 7 else 0.0))

    drive = made(fill, odometry_too=False)
    assert drive.odometry.vy.tolist() == [0.0] * 7 + [0.1] * 2
    assert list(drive.remarks.values()) == [1]
