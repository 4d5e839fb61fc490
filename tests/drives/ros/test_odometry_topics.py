"""What each kind of odometry message tells."""

import math

import numpy as np
import pytest
from drives.ros.build import EPOCH, SUFFIXES, odometry, pose, stamps, twist

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
    with pytest.raises(InputError, match="no message contains odometry"):
        made(fill, told + ", left: [paddle], right: [oar]}\n", odometry_too=False)
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
