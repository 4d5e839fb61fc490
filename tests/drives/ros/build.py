"""Builders of messages for tests, alike for ROS 1 and ROS 2."""

import math

import numpy as np
from drives.ros.rig import NANO

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


def joints(log, stamp, names, **values):
    """A JointState with some of position, velocity and effort."""
    values = dict.fromkeys(("position", "velocity", "effort"), np.empty(0)) | values
    header = log.header(stamp, "")
    return log.make("sensor_msgs/msg/JointState", header=header, name=list(names), **values)


def stamps(n, start=EPOCH, step=0.1):
    return [start * SECOND + round(i * step * SECOND) for i in range(n)]


def transforms(log, stamp, frames):
    """A TFMessage of {(parent, child): (x, y, z)} with zero quaternions, or a quaternion too."""
    return log.make(
        "tf2_msgs/msg/TFMessage",
        transforms=[
            log.make(
                "geometry_msgs/msg/TransformStamped",
                header=log.header(stamp, parent),
                child_frame_id=child,
                transform={
                    "translation": dict(zip("xyz", map(float, values), strict=False)),
                    "rotation": dict(zip("xyzw", map(float, values[3:]), strict=False)),
                },
            )
            for (parent, child), values in frames.items()
        ],
    )
