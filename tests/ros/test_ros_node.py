"""The node of ROS 2 among real nodes in other processes, by the rclpy wheels from PyPI.

They need an environment of their own, which `make test-ros` has made here.
"""

import json
import math
import os
import shutil
import signal
import statistics
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from live_rig import SCENARIO

from homeward.drives.folder import read_folder
from homeward.live.recording import replay
from homeward.places.files import load_place, newest
from homeward.simulation.files import load_scenario
from homeward.simulation.live_robot import LiveRobot

ROOT = Path(__file__).resolve().parents[2]
HERE = Path(__file__).parent
RCLPY = os.environ.get("HOMEWARD_RCLPY", "9.1.2")
"""9.1.2 is Kilted's, 7.1.6 Jazzy's."""
MESSAGES = ("nav", "sensor", "geometry", "visualization", "diagnostic", "std", "lifecycle")
GENERATORS = (
    *("ament-cmake", "ament-package", "ament-cmake-include-directories", "ament-cmake-ros-core"),
    *("rosidl-default-generators", "rosidl-core-generators"),
)
"""What makes a message type; tf2_msgs has no wheel, so it is made of its one line."""
HOMINGS = int(os.environ.get("HOMEWARD_HOMINGS", "2"))


@pytest.fixture(scope="session")
def ros():
    """The Python of an environment with rclpy and homeward."""
    if "HOMEWARD_ROS" not in os.environ:
        pytest.skip("real nodes of ROS 2: make test-ros")
    place = Path(os.environ["HOMEWARD_ROS"]).resolve()
    python = place / "bin" / "python"
    if not (place / "installed").exists():
        subprocess.run([sys.executable, "-m", "venv", str(place)], check=True)
        wheels = [f"ros-rclpy[fastrtps]=={RCLPY}", "ros-std-srvs"]
        wheels += [f"ros-{name}-msgs" for name in MESSAGES]
        pip = [str(python), "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
        for what in (wheels, ["-c", "constraints.txt", "-e", "."]):
            made = subprocess.run([*pip, *what], cwd=ROOT, capture_output=True, text=True)
            if made.returncode:
                pytest.skip(f"rclpy cannot be installed here: {made.stderr.splitlines()[-1]}")
        make_tf2_msgs(place, python, pip)
        (place / "installed").touch()
    return str(python)


def make_tf2_msgs(place, python, pip):
    """Make tf2_msgs, with the very type hash of real robots; where that fails, do without."""
    if shutil.which("cmake") is None:
        return
    generators = [f"ros-{name}" for name in GENERATORS]
    subprocess.run([*pip, *generators, "catkin_pkg"], capture_output=True, check=True)
    environment = os.environ | {
        "PATH": f"{place / 'bin'}{os.pathsep}{os.environ['PATH']}",
        "AMENT_PREFIX_PATH": str(place),
    }
    build = place / "tf2_msgs"
    options = {
        "CMAKE_INSTALL_PREFIX": place,
        "CMAKE_PREFIX_PATH": place,
        "Python3_EXECUTABLE": python,
        "BUILD_TESTING": "OFF",
    }
    told = [f"-D{key}={value}" for key, value in options.items()]
    # It complains of folders of the machine that built the wheels, and is done all the same.
    for command in (
        ["cmake", "-S", str(HERE / "tf2_msgs"), "-B", str(build), *told],
        ["make", "-C", str(build), "install"],
    ):
        subprocess.run(command, env=environment, capture_output=True)


def has_tf(python):
    """Whether tf2_msgs could be made."""
    imported = subprocess.run([python, "-c", "import tf2_msgs.msg"], capture_output=True)
    return imported.returncode == 0


class Running:
    """A process that says a line of JSON a time."""

    def __init__(self, *command, quiet=False):
        paths = os.pathsep.join(map(str, (ROOT / "src", ROOT / "tests" / "live")))
        own = {"PYTHONPATH": paths, "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
        own |= {"ROS_DOMAIN_ID": str(os.getpid() % 90 + 1)}
        self.process = subprocess.Popen(
            command,
            env={**os.environ, **own},
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL if quiet else subprocess.PIPE,
            text=True,
        )
        self.lines, self._reader = [], None
        if not quiet:
            self._reader = threading.Thread(target=self._read, daemon=True)
            self._reader.start()

    def _read(self):
        for line in self.process.stdout:
            self.lines.append((time.monotonic(), json.loads(line)))

    def say(self, line):
        self.process.stdin.write(line + "\n")
        self.process.stdin.flush()

    def until(self, condition, longest, since=0):
        """The first line from `since` on that fulfils a condition."""
        end = time.monotonic() + longest
        while time.monotonic() < end:
            while since < len(self.lines):
                if condition(self.lines[since][1]):
                    return self.lines[since]
                since += 1
            assert self.process.poll() is None, "the process died"
            time.sleep(0.005)
        raise AssertionError(f"waited in vain; last: {[x[1] for x in self.lines[-3:]]}")

    def end(self, how=signal.SIGTERM):
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGCONT)
            self.process.send_signal(how)
            try:
                self.process.wait(20.0)
            except subprocess.TimeoutExpired:
                self.process.kill()
                self.process.wait()
                raise
        if self._reader is not None:
            self._reader.join()
            self.process.stdout.close()
        self.process.stdin.close()


class Stage:
    """A robot, a witness and homeward, each in a process of its own."""

    def __init__(self, python, tmp_path):
        self.python, self.tmp_path = python, tmp_path
        scenario = SCENARIO | {"seed": 0, "landmarks.count": 12}
        drive = LiveRobot(load_scenario("paper-homing", scenario)).drive
        rows = [f"{k},{home.bearing!r}" for k, home in enumerate(drive.home.values())]
        (tmp_path / "home.csv").write_text("\n".join(["landmark,bearing", *rows, ""]))
        self.robot = Running(python, str(HERE / "robot_node.py"), "0")
        self.witness = Running(python, str(HERE / "witness_node.py"))
        self.node = self.start()

    def start(self, **parameters):
        parameters = {"home": self.tmp_path / "home.csv", **parameters}
        told = [word for k, v in parameters.items() for word in ("-p", f"{k}:={v}")]
        told = ["--params-file", str(ROOT / "docs" / "do" / "ros" / "homeward.yaml"), *told]
        return Running(self.python, "-m", "homeward.ros", "--ros-args", *told, quiet=True)

    def tell(self, **what):
        self.witness.say(json.dumps(what))

    def hear(self, topic, condition=lambda value: True, longest=20.0, since=None):
        since = len(self.witness.lines) if since is None else since

        def fits(line):
            return line["topic"] == topic and condition(line["value"])

        return self.witness.until(fits, longest, since)[1]

    def look_round(self, least=8.0):
        """Drive in circles until localised, and so many seconds at least."""
        self.tell(twist=[0.15, 0.3])
        time.sleep(least)
        self.hear("/homeward/said", lambda s: s.get("status") == "localised")
        self.tell(twist=None)

    def go(self):
        self.tell(call="go_home")
        self.hear("cmd_vel", lambda c: c[0] > 0.1)

    def memory(self):
        """Of the node [byte]."""
        pages = Path(f"/proc/{self.node.process.pid}/statm").read_text().split()[1]
        return int(pages) * os.sysconf("SC_PAGE_SIZE")

    def stands(self, longest=5.0):
        """How long until the robot, which moves now, stands [s]; by its own clock."""
        began = len(self.robot.lines)
        t = self.robot.lines[-1][1]["t"]
        return self.robot.until(lambda r: r["v"] < 1e-6, longest, began)[1]["t"] - t

    def end(self):
        for part in (self.node, self.witness, self.robot):
            part.end(signal.SIGINT if part is self.node else signal.SIGKILL)


@pytest.fixture
def stage(ros, tmp_path):
    stage = Stage(ros, tmp_path)
    yield stage
    stage.end()


def test_the_robot_comes_home_though_a_landmark_is_moved_and_all_topics_tell(stage):
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
    told = {x["value"][3]: x["at"] for _, x in lines if x["topic"] == "/homeward/pose"}
    latencies = sorted(max(told[t] - asked[t], 0.0) for t in told if t in asked)
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


def test_the_robot_stands_when_the_node_is_killed_or_hangs_and_the_node_says_so_of_the_robot(stage):
    stage.look_round()
    stage.go()
    stage.node.process.kill()
    assert stage.stands() <= 0.3  # the base's own 0.2 s after the last command, and its step
    stage.node.end()
    stage.node = stage.start()
    stage.look_round()
    stage.go()
    stage.node.process.send_signal(signal.SIGSTOP)
    assert stage.stands() <= 0.3
    stage.node.process.send_signal(signal.SIGCONT)
    since = len(stage.witness.lines)
    stage.hear("cmd_vel", lambda c: c[0] > 0.1)
    stage.robot.process.kill()
    died = time.monotonic()
    stood = stage.hear("cmd_vel", lambda c: c == [0.0, 0.0], 5.0, since)["at"]
    assert stood - died <= 0.3
    stage.hear("/diagnostics", lambda text: "no odometry for" in text)


def test_a_place_lasts_from_node_to_node_and_homes_have_names(stage):
    stage.node.end()
    place = stage.tmp_path / "hall"
    stage.node = stage.start(place=place, place_update="true")
    stage.look_round(20.0)
    stage.tell(name=["store_home", "dock 3"])
    stage.hear("/homeward/said", lambda s: "home dock 3 is here" in s.get("text", ""))
    stage.tell(call="save_place")
    stage.hear("/homeward/said", lambda s: "hall: a new place, with" in s.get("text", ""))
    stage.go()
    stage.hear("/homeward/said", lambda s: s.get("state") == "arrived", 30.0)
    stage.node.end(signal.SIGINT)
    assert newest(place) == 2  # again at the end, whole
    assert list(load_place(place).homes) == ["home", "dock 3"]
    stage.node = stage.start(place=place)
    stage.tell(twist=[0.15, 0.3])
    stage.hear("/homeward/said", lambda s: s.get("status") == "localised", 10.0)
    stage.tell(twist=None)
    stage.tell(name=["go_home", "dock 3"])
    stage.hear("cmd_vel", lambda c: c[0] > 0.1)
    stage.hear("/homeward/said", lambda s: s.get("state") == "arrived", 30.0)
    dock = load_place(place).home_pose("dock 3")
    far = abs(math.hypot(dock.x, dock.y) - stage.robot.lines[-1][1]["distance"])
    assert far < 0.06
    stage.tell(call="save_place")
    stage.hear("/homeward/said", lambda s: "left as it is" in s.get("text", ""))


def test_the_node_waits_for_the_transform_that_tells_where_the_camera_sits(stage):
    if not has_tf(stage.python):
        pytest.skip("tf2_msgs could not be made")
    for frame, words in (("lens", "no bearings yet"), ("camera", "localised")):
        stage.node.end()
        stage.node = stage.start(camera_frame=frame)
        stage.tell(twist=[0.15, 0.3])
        time.sleep(3.0)
        stage.hear("/diagnostics", lambda text, words=words: words in text)


def test_services_and_lifecycle(stage):
    stage.look_round()
    stage.go()
    stage.tell(estop=True)
    assert stage.hear("/homeward/estop")["value"]
    assert stage.stands() <= 0.3
    stage.tell(call="go_home")
    stage.hear("/homeward/said", lambda s: s.get("state") == "held" and "stop" in s["reason"])
    stage.tell(estop=False)
    stage.hear("cmd_vel", lambda c: c[0] > 0.1)
    since = len(stage.witness.lines)
    stage.tell(transition="deactivate")
    assert stage.hear("/homeward/change_state", since=since)["value"]
    assert stage.stands() <= 0.3
    for transition in ("cleanup", "configure", "activate"):
        since = len(stage.witness.lines)
        stage.tell(transition=transition)
        assert stage.hear("/homeward/change_state", since=since)["value"]
    stage.hear("/diagnostics", lambda text: text.startswith("mapping"))
    time.sleep(1.5)
    stage.tell(call="store_home")
    stage.hear("/homeward/said", lambda s: "12 landmarks" in s.get("text", ""))
    stage.hear("/homeward/said", lambda s: s.get("pose") is not None)
    x, y, _ = stage.hear("/homeward/said", lambda s: s.get("pose") is not None)["value"]["pose"]
    assert math.hypot(x, y) < 0.02
