"""A robot that sends its images to the node, which detects the tags."""

import math
import re
import statistics
import sys
import time
from itertools import pairwise

import numpy as np
import pytest
from ros.stage import Stage


@pytest.fixture
def stage(ros, tmp_path):
    (tmp_path / "session.yaml").write_text("bearings_timeout: 0.4\n")
    packed = "kilted" in ros  # each kind by one of them
    stage = Stage(
        ros,
        tmp_path,
        ("picture_node.py", "compressed" if packed else "image"),
        home=None,  # it turns there
        session=tmp_path / "session.yaml",
        bearings_topic="image",
        bearings_type=f"sensor_msgs/msg/{'Compressed' * packed}Image",
        camera_info_topic="camera_info",
        tag_size=0.2,
    )
    yield stage
    stage.end()


def drive_about(stage):
    """Drive a little and look round, and so on: each tag is seen from several places."""
    for twist, seconds in (((0.15, 0.3), 4.0), ((0.0, 0.8), 8.0)) * 3:
        stage.send(twist=twist)
        time.sleep(seconds)
    stage.send(twist=(0.0, 0.4))
    stage.hear("/homeward/said", lambda s: s.get("status") == "localised", 30.0)
    stage.send(twist=None)


def test_home_by_a_turn_and_back_again_by_pictures(stage):
    stage.hear("/homeward/said", lambda s: "no home yet" in s.get("reason", ""), 30.0, 0)
    x, y, z, sigma, frame = stage.hear("/homeward/tag_0", since=0)["value"]
    away = np.random.default_rng(0).uniform(1.6, 2.6)  # of the first tag in picture_node.py
    assert frame == "camera_optical_frame"
    assert abs(math.hypot(x, y, z) - away) < 0.03
    assert 0.0 < sigma < 0.1
    stage.send(call="turn_home")
    stored = stage.hear("/homeward/said", lambda s: "is stored" in s.get("text", ""), 40.0)
    number, _, rest = stored["value"]["text"].partition("stored: ")[2].partition(" ")
    assert int(number) >= 12
    turned = int(re.fullmatch(r"home bearings from a rotation of (\d+) degrees,.*", rest)[1])
    # 1.05 turns at 0.5 rad/s: at the end, pictures may be 0.5 s late (largest_lag), and commands
    # 0.2 s, after which the base stops.
    assert 363 <= turned <= 386
    drive_about(stage)
    stage.go()
    stage.hear("/homeward/said", lambda s: s.get("state") == "arrived", 40.0)
    time.sleep(0.3)
    distance = stage.robot.lines[-1][1]["distance"]
    gaps = [x["at"] for _, x in list(stage.witness.lines) if x["topic"] == "/homeward/map_to_odom"]
    steps = [b - a for a, b in pairwise(gaps)]
    sys.stderr.write(
        f"\n{distance:.3f} m off; map to odom every {1e3 * statistics.median(steps):.1f} ms, "
        f"99 % {1e3 * sorted(steps)[int(0.99 * len(steps))]:.1f} ms\n"
    )
    assert distance < 0.06
