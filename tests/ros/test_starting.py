"""A node with invalid parameters reports why, in one line, and ends."""

import subprocess

import pytest
from ros.stage import ROOT


@pytest.mark.parametrize(
    ("result", "words"),
    [
        ("home_in_map:=[1, 2, 0]", "home_in_map"),
        ("home_in_map:=[1.0, 2.0]", "home_in_map: must be [x, y, heading] in m and rad"),
        ("home:=/there/is/no/home.csv", "cannot be read: No such file"),
        (
            "bearings_type:=apriltag_msgs/msg/AprilTagDetectionArray",
            "No module named 'apriltag_msgs'; install its ROS package",
        ),
    ],
)
def test_what_cannot_be_is_said_in_one_line(ros, result, words):
    command = [ros, "-m", "homeward.ros", "--ros-args", "-p", result]
    ended = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120)
    (line,) = ended.stderr.splitlines()
    assert words in line
    assert ended.returncode == 2
