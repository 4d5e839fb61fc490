"""The node of ROS 2 among real nodes in other processes."""

import math
import os
import signal
import statistics
import sys
import time

import pytest
from ros.stage import Stage, has_tf

from homeward.drives.folder import read_folder
from homeward.geometry.frames import Pose, compose
from homeward.live.recording import replay
from homeward.places.files import load_place, newest

HOMINGS = int(os.environ.get("HOMEWARD_HOMINGS", "2"))


def test_the_robot_comes_home_with_a_moved_landmark_and_all_topics_are_published(stage):
    stage.node.end()
    stage.node = stage.start(record=stage.tmp_path / "drive")
    distances = []
    for homing in range(HOMINGS):
        stage.look_round()
        if homing == 0:
            stage.hear("/homeward/map_to_odom", lambda v: v[:2] == ["map", "odom"])
            if has_tf(stage.python):
                stage.hear("/tf", lambda v: v[:2] == ["map", "odom"])
            stage.hear("/diagnostics", lambda text: text.startswith("localised"), since=0)
            stage.hear("/homeward/landmarks", lambda number: number >= 8, since=0)
            before = stage.memory()
        stage.go()
        if homing == 0:
            stage.robot.say("move")
        since = len(stage.witness.lines)
        stage.hear("/homeward/said", lambda s: s.get("state") == "arrived", 30.0, since)
        time.sleep(0.3)
        distances.append(stage.robot.lines[-1][1]["distance"])
    assert max(distances) < 0.05, distances
    lines = list(stage.witness.lines)
    asked = {x["value"]: x["at"] for _, x in lines if x["topic"] == "bearings"}
    result = {x["value"][3]: x["at"] for _, x in lines if x["topic"] == "/homeward/pose"}
    latencies = sorted(max(result[t] - asked[t], 0.0) for t in result if t in asked)
    assert len(latencies) > 100
    times = [x["at"] for _, x in lines if x["topic"] == "/homeward/map_to_odom"]
    rate = len(times) / (times[-1] - times[0])
    assert 25.0 < rate < 55.0  # 50 Hz, on a machine that has time
    grown = (stage.memory() - before) / 1e6
    stage.node.end()
    same, other = replay(stage.tmp_path / "drive" / "session.jsonl")
    assert other is None
    assert same > 200
    assert read_folder(stage.tmp_path / "drive").sightings.t.size > 1000
    slow = latencies[int(0.99 * len(latencies))]
    seconds = times[-1] - times[0]
    sys.stderr.write(
        f"\n{len(distances)} homings in {seconds:.0f} s, at most {max(distances):.3f} m; answers "
        f"after {1e3 * statistics.median(latencies):.1f} ms, 99 % {1e3 * slow:.1f} ms; "
        f"{grown:+.1f} MB; tf {rate:.1f} Hz\n"
    )


def test_the_robot_stops_when_the_node_is_killed_or_hangs(stage):
    stage.look_round()
    stage.go()
    stage.node.process.kill()
    assert stage.time_to_stop() <= 0.3  # the base's own 0.2 s after the last command, and its step
    stage.node.end()
    stage.node = stage.start()
    stage.look_round()
    stage.go()
    stage.node.process.send_signal(signal.SIGSTOP)
    assert stage.time_to_stop() <= 0.3
    stage.node.process.send_signal(signal.SIGCONT)
    since = len(stage.witness.lines)
    stage.hear("cmd_vel", lambda c: c[0] > 0.1)
    stage.robot.process.kill()
    died = time.monotonic()
    stopped = stage.hear("cmd_vel", lambda c: c == [0.0, 0.0], 5.0, since)["at"]
    assert stopped - died <= 0.3
    stage.hear("/diagnostics", lambda text: "no odometry for" in text)


def test_a_place_lasts_from_node_to_node_and_homes_have_names(stage):
    stage.node.end()
    place = stage.tmp_path / "hall"
    stage.node = stage.start(place=place, place_update="true")
    stage.look_round(20.0)
    stage.send(name=["store_home", "dock 3"])
    stage.hear("/homeward/said", lambda s: "home 'dock 3' stored" in s.get("text", ""))
    stage.send(call="save_place")
    stage.hear("/homeward/said", lambda s: "hall: a new place, with" in s.get("text", ""))
    stage.go()
    stage.hear("/homeward/said", lambda s: s.get("state") == "arrived", 30.0)
    stage.node.end(signal.SIGINT)
    assert newest(place) == 2  # again at the end, whole
    assert list(load_place(place).homes) == ["home", "dock 3"]
    stage.node = stage.start(place=place, dock="dock 3")
    stage.send(twist=[0.15, 0.3])
    stage.hear("/homeward/said", lambda s: s.get("status") == "localised", 30.0)
    stage.send(twist=None)
    stage.send(name=["go_home", "dock 3"])
    stage.hear("cmd_vel", lambda c: c[0] > 0.1)
    stage.hear("/homeward/said", lambda s: s.get("state") == "arrived", 30.0)
    dock = load_place(place).home_pose("dock 3")
    far = abs(math.hypot(dock.x, dock.y) - stage.robot.lines[-1][1]["distance"])
    assert far < 0.06
    seen = stage.hear("detected_dock_pose")["value"]
    assert math.hypot(*seen[:2]) < 0.1
    assert seen[2] == "base_link"
    stage.send(call="save_place")
    stage.hear("/homeward/said", lambda s: "read-only" in s.get("text", ""))


def test_the_node_waits_for_the_transform_of_the_camera(stage):
    if not has_tf(stage.python):
        pytest.skip("tf2_msgs could not be made")
    for frame, words in (("lens", "no bearings yet"), ("camera", "localised")):
        stage.node.end()
        stage.node = stage.start(camera_frame=frame)
        stage.send(twist=[0.15, 0.3])
        time.sleep(3.0)
        stage.hear("/diagnostics", lambda text, words=words: words in text)


def test_services_and_lifecycle(stage):
    stage.look_round()
    stage.go()
    stage.send(estop=True)
    assert stage.hear("/homeward/estop")["value"]
    assert stage.time_to_stop() <= 0.3
    stage.send(call="go_home")
    stage.hear("/homeward/said", lambda s: s.get("state") == "held" and "stop" in s["reason"])
    stage.send(estop=False)
    stage.hear("/homeward/said", lambda s: s.get("state") == "failed" and "stop" in s["reason"])
    stage.go()
    since = len(stage.witness.lines)
    stage.send(transition="deactivate")
    assert stage.hear("/homeward/change_state", since=since)["value"]
    assert stage.time_to_stop() <= 0.3
    for transition in ("cleanup", "configure", "activate"):
        since = len(stage.witness.lines)
        stage.send(transition=transition)
        assert stage.hear("/homeward/change_state", since=since)["value"]
    stage.hear("/diagnostics", lambda text: text.startswith("mapping"))
    time.sleep(1.5)
    stage.send(call="store_home")
    stage.hear("/homeward/said", lambda s: "12 landmarks" in s.get("text", ""))
    stage.hear("/homeward/said", lambda s: s.get("pose") is not None)
    x, y, _ = stage.hear("/homeward/said", lambda s: s.get("pose") is not None)["value"]["pose"]
    assert math.hypot(x, y) < 0.02


def test_in_amcls_place_the_pose_is_in_the_map_and_its_topics_and_services_work(stage):
    stage.node.end()
    stage.node = stage.start(
        home_in_map="[10.0, 5.0, 1.5]", transform_tolerance=5.0, remap="~/pose:=amcl_pose"
    )
    home, start = Pose(10.0, 5.0, 1.5), Pose(1.0, 0.5, 0.3)
    stage.send(start=list(compose(home, start)))
    said = stage.hear("/homeward/said", lambda s: s.get("pose") is not None, 30.0)["value"]
    assert math.hypot(said["pose"][0] - start.x, said["pose"][1] - start.y) < 0.5  # at rest
    stage.hear("amcl_pose", since=0)  # the first ones may be lost before it is discovered
    since = len(stage.witness.lines)
    said = stage.hear("/homeward/said", lambda s: s.get("pose") is not None, since=since)["value"]
    x, y, _ = compose(home, Pose(*said["pose"]))
    stage.hear("amcl_pose", lambda p: math.hypot(p[0] - x, p[1] - y) < 1e-6, since=since)
    rays = stage.hear(  # of a frame with most of the landmarks
        "/homeward/sightings", lambda r: math.hypot(r[0] - x, r[1] - y) < 0.5 and r[2] >= 5
    )
    assert rays["value"][3] == "map"
    frame = stage.hear("/homeward/map_to_odom")
    assert 1e-9 * frame["value"][-1] - time.time() == pytest.approx(5.0, abs=1.0)
    since = len(stage.witness.lines)
    stage.send(reinitialize=None)
    stage.hear("reinitialize_global_localization", since=since)
    stage.hear(  # without the start, at rest
        "/homeward/said", lambda s: s.get("type") == "estimate" and s.get("pose") is None
    )


def test_the_transform_is_withheld_while_the_pose_is_not_sure(stage):
    stage.node.end()
    stage.node = stage.start(withhold_transform="true")
    stage.look_round()
    stage.hear("/homeward/map_to_odom")
    stage.robot.process.kill()
    stage.hear("/diagnostics", lambda text: "no odometry for" in text)
    since = len(stage.witness.lines)
    time.sleep(1.0)
    later = [line["topic"] for _, line in stage.witness.lines[since:]]
    assert "/homeward/map_to_odom" not in later


def test_an_obstacle_stops_the_robot(stage):
    stage.node.end()
    stage.node = stage.start(scan_topic="scan")
    stage.send(scan=8.0)
    stage.look_round()
    stage.go()
    stage.send(scan=0.2)
    assert stage.time_to_stop() <= 0.5  # a scan every 0.05 s
    stage.hear("/homeward/said", lambda s: "an obstacle nearer than" in s.get("reason", ""))
    stage.send(scan=None)
    stage.hear("/homeward/said", lambda s: "no obstacle message for" in s.get("reason", ""))


def test_by_simulated_time_stamps_are_the_simulators_and_watchdogs_are_not(ros, tmp_path):
    began = 1000.0
    robot = ("robot_node.py", "0", str(began))
    stage = Stage(ros, tmp_path, robot, use_sim_time="true")
    try:
        stage.look_round()
        said = stage.hear("/homeward/map_to_odom")["value"][-1]
        now = began + stage.robot.lines[-1][1]["t"]
        assert abs(1e-9 * said - now) < 5.0  # Unix time is fifty years ahead
        stage.go()
        stage.robot.process.kill()  # which stops the clock, too
        stage.hear("cmd_vel", lambda c: c == [0.0, 0.0], 5.0)
        stage.hear("/diagnostics", lambda text: "no odometry for" in text)
    finally:
        stage.end()
