"""Bearings of a robot that rolls and pitches, in logs with its orientation."""

import math

import numpy as np
import pytest
from drives.ros.build import odometry, point, stamps
from scipy.spatial.transform import Rotation

from homeward.drives.measure import TAN_ELEVATION

PLACES = {"high": (2.0, 1.0, 1.5), "level": (2.0, -1.0, 0.0), "behind": (-1.0, 2.0, -0.5)}
"""Positions of landmarks in the level frame at the camera, along the robot's axes [m]."""
YAW = 0.4
"""That of the camera [rad]."""
TRUE = {name: math.atan2(y, x) - YAW for name, (x, y, _) in PLACES.items()}
TOPICS = """bearings: {{topic: "/tags/*"{more}}}
drive: {{sensor: {{yaw: 0.4}}}}
tilt: /{tilt}
"""


def turn_of(k):
    """Rotation from the robot to the level frame in message k, which also has a heading."""
    return Rotation.from_euler("ZYX", [1.0, 0.15 * math.sin(k), 0.2 * math.cos(k)])


def quaternion(log, k):
    parts = dict(zip("xyzw", turn_of(k).as_quat().tolist(), strict=True))
    return log.make("geometry_msgs/msg/Quaternion", **parts)


def imu(log, t, k):
    zero = log.make("geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=0.0)
    none = np.zeros(9)
    return log.make(
        "sensor_msgs/msg/Imu",
        header=log.header(t, "imu_link"),
        orientation=quaternion(log, k),
        orientation_covariance=none,
        angular_velocity=zero,
        angular_velocity_covariance=none,
        linear_acceleration=zero,
        linear_acceleration_covariance=none,
    )


def positions(log):
    """Write the landmarks in the frame of the tilted camera, and the tilt."""
    for k, t in enumerate(stamps(10)):
        log.write("/imu", t, imu(log, t, k))
        level = Rotation.from_euler("Z", 1.0).inv() * turn_of(k)
        for name, place in PLACES.items():
            seen = Rotation.from_euler("Z", -YAW).apply(level.inv().apply(place))
            header = log.header(t, "camera")
            kind = "geometry_msgs/msg/PointStamped"
            log.write(f"/tags/{name}", t, log.make(kind, header=header, point=point(log, *seen)))


def bearings_by_name(drive):
    found = drive.sightings
    return {name: found.bearing[found.landmark == name] for name in PLACES}


def test_the_tilt_of_the_robot_is_taken_out_of_positions(made):
    drive = made(positions, TOPICS.format(more="", tilt="imu"))
    for name, found in bearings_by_name(drive).items():
        assert found == pytest.approx([TRUE[name]] * 10, abs=1e-9)
    assert drive.remarks["bearings corrected for the roll and pitch of the robot"] == 30
    plain = made(positions, TOPICS.format(more="", tilt="imu").replace("tilt: /imu\n", ""))
    errors = [np.abs(found - TRUE[name]) for name, found in bearings_by_name(plain).items()]
    assert np.max(errors) > 0.1


def test_the_tilt_is_read_from_the_orientation_of_odometry(made):
    def fill(log):
        positions(log)
        for k, t in enumerate(stamps(10)):
            message = odometry(log, t, 0.2, 0.1)
            message.pose.pose.orientation = quaternion(log, k)
            log.write("/state", t, message)

    drive = made(fill, "odometry: {topic: /odom}\n" + TOPICS.format(more="", tilt="state"))
    assert bearings_by_name(drive)["high"] == pytest.approx([TRUE["high"]] * 10, abs=1e-9)


def test_without_an_elevation_the_tilt_is_noise_and_large_ones_are_reported(made):
    def fill(log):
        for k, t in enumerate(stamps(10)):
            log.write("/imu", t, imu(log, t, 0 if k < 5 else math.pi / 2))
            log.write(
                "/bearings",
                t,
                log.make(
                    "homeward_msgs/msg/Bearings",
                    header=log.header(t, "camera"),
                    landmarks=["a", "b"],
                    bearings=np.array([0.1, 0.2]),
                    sigmas=np.array([0.01, 0.02]),
                    residue=0.0,
                ),
            )

    drive = made(fill, "tilt: /imu\n")
    assert drive.sightings.bearing.tolist() == [0.1, 0.2] * 10
    expected = np.hypot([0.01, 0.02], TAN_ELEVATION * 0.2)
    assert drive.sightings.sigma[:2] == pytest.approx(expected)
    (words,) = (words for words in drive.remarks if "unreliable" in words)
    assert "tilted by more than 5 degrees" in words
    assert drive.remarks[words] == 20


def test_a_tilt_needs_a_topic_of_orientations(made):
    with pytest.raises(Exception, match="cannot be used under tilt"):
        made(positions, TOPICS.format(more="", tilt="tags/high"))
