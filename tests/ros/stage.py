"""Real nodes of ROS 2 in other processes, by the rclpy wheels from PyPI.

They need environments of their own, which `make test-ros` lets this make.
"""

import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from live_rig import SCENARIO

from homeward.simulation.files import load_scenario
from homeward.simulation.live_robot import LiveRobot

ROOT = Path(__file__).resolve().parents[2]
HERE = Path(__file__).parent
DISTRIBUTIONS = {"jazzy": "7.1.6", "kilted": "9.1.2"}
"""With their rclpy; the other packages follow from it."""
CYCLONE = "11.0.1"
MESSAGES = ("nav", "sensor", "geometry", "visualization", "diagnostic", "std", "lifecycle")
DOMAIN = os.getpid() % 90 + 1
"""Of DDS: runs beside each other do not hear each other."""
PIP = ("-m", "pip", "install", "--quiet", "--disable-pip-version-check")
GENERATORS = {
    "jazzy": (
        *("ament-cmake-ros", "ament-cmake-gmock", "ament-cmake-gtest", "ament-cmake-pytest"),
        "python-cmake-module",
    ),
    "kilted": ("ament-cmake-ros-core",),
}
MAKERS = (
    *("ament-cmake", "ament-package", "ament-cmake-include-directories"),
    *("rosidl-default-generators", "rosidl-core-generators"),
)
"""What makes a message type; tf2_msgs has no wheel, so it is made of its one line."""


def environment(distribution):
    """The Python of an environment with rclpy and homeward, made when first asked for."""
    if "HOMEWARD_ROS" not in os.environ:
        pytest.skip("real nodes of ROS 2: make test-ros")
    place = Path(f"{os.environ['HOMEWARD_ROS']}-{distribution}").resolve()
    python = place / "bin" / "python"
    if not (place / "installed").exists():
        subprocess.run([sys.executable, "-m", "venv", str(place)], check=True)
        wheels = [f"ros-rclpy[fastrtps]=={DISTRIBUTIONS[distribution]}", "ros-std-srvs"]
        wheels += [f"ros-{name}-msgs" for name in MESSAGES]
        wheels += [f"ros-{name}" for name in (*MAKERS, *GENERATORS[distribution])]
        pip = [str(python), *PIP]
        installed(*pip, *wheels, "catkin_pkg")
        installed(*pip, "-c", "constraints.txt", "-e", ".[vision]")
        make_tf2_msgs(place, python)
        (place / "installed").touch()
    return str(python)


def cyclone():
    """Where another vendor's DDS is: it knows nothing of ROS, so this very Python speaks it."""
    if "HOMEWARD_ROS" not in os.environ:
        pytest.skip("real nodes of ROS 2: make test-ros")
    place = Path(f"{os.environ['HOMEWARD_ROS']}-cyclone").resolve()
    if not place.exists():
        installed(sys.executable, *PIP, "--target", str(place), f"cyclonedds=={CYCLONE}")
    return place


def installed(*command):
    """Install, or skip the test."""
    made = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    if made.returncode:
        pytest.skip(f"cannot be installed here: {made.stderr.splitlines()[-1]}")


def make_tf2_msgs(place, python):
    """Make tf2_msgs, with the very type hash of real robots; where that fails, do without."""
    if shutil.which("cmake") is None:
        return
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

    def __init__(self, *command, quiet=False, paths=(), **more):
        paths = os.pathsep.join(map(str, (ROOT / "src", ROOT / "tests" / "live", *paths)))
        own = {"PYTHONPATH": paths, "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
        own |= {"ROS_DOMAIN_ID": str(DOMAIN)} | more
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

    def __init__(self, python, tmp_path, robot=("robot_node.py", "0"), **parameters):
        self.python, self.tmp_path = python, tmp_path
        scenario = SCENARIO | {"seed": 0, "landmarks.count": 12}
        drive = LiveRobot(load_scenario("paper-homing", scenario)).drive
        rows = [f"{k},{home.bearing!r}" for k, home in enumerate(drive.home.values())]
        (tmp_path / "home.csv").write_text("\n".join(["landmark,bearing", *rows, ""]))
        self.robot = Running(python, str(HERE / robot[0]), *robot[1:])
        self.witness = Running(python, str(HERE / "witness_node.py"))
        self.start(**parameters)

    def start(self, **parameters):
        parameters = {"home": self.tmp_path / "home.csv", **parameters}
        told = [
            word for k, v in parameters.items() if v is not None for word in ("-p", f"{k}:={v}")
        ]
        told = ["--params-file", str(ROOT / "docs" / "do" / "ros" / "homeward.yaml"), *told]
        since = len(self.witness.lines)
        self.node = Running(self.python, "-m", "homeward.ros", "--ros-args", *told, quiet=True)
        self.hear("/diagnostics", longest=120.0, since=since)  # a busy machine takes long to start
        return self.node

    def tell(self, **what):
        self.witness.say(json.dumps(what))

    def hear(self, topic, condition=lambda value: True, longest=60.0, since=None):
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
