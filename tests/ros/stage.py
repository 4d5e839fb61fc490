"""Real nodes of ROS 2 in other processes, by the rclpy wheels from PyPI."""

import json
import os
import signal
import subprocess
import threading
import time
from pathlib import Path

from live_rig import SCENARIO

from homeward.lab.simulation.live_robot import LiveRobot
from homeward.lab.simulation.simulate import load_scenario

ROOT = Path(__file__).resolve().parents[2]
HERE = Path(__file__).parent
PARAMETERS = ROOT / "ros" / "homeward_ros" / "config" / "homeward.yaml"
DOMAIN = os.getpid() % 90 + 1
"""DDS domain, so that parallel runs are separate."""


def has_tf(python):
    """Whether tf2_msgs could be made."""
    imported = subprocess.run([python, "-c", "import tf2_msgs.msg"], capture_output=True)
    return imported.returncode == 0


class Running:
    """A process that writes JSON lines."""

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
        remap = parameters.pop("remap", None)
        result = [
            word for k, v in parameters.items() if v is not None for word in ("-p", f"{k}:={v}")
        ]
        result = ["--params-file", str(PARAMETERS), *result]
        result += [] if remap is None else ["-r", remap]
        since = len(self.witness.lines)
        self.node = Running(self.python, "-m", "homeward.ros", "--ros-args", *result, quiet=True)
        self.hear("/diagnostics", longest=120.0, since=since)  # a busy machine takes long to start
        return self.node

    def send(self, **what):
        self.witness.say(json.dumps(what))

    def hear(self, topic, condition=lambda value: True, longest=60.0, since=None):
        since = len(self.witness.lines) if since is None else since

        def fits(line):
            return line["topic"] == topic and condition(line["value"])

        return self.witness.until(fits, longest, since)[1]

    def look_round(self, least=8.0):
        """Drive in circles until localised, for at least `seconds`."""
        self.send(twist=[0.15, 0.3])
        time.sleep(least)
        self.hear("/homeward/said", lambda s: s.get("status") == "localised")
        self.send(twist=None)

    def go(self):
        self.send(call="go_home")
        self.hear("cmd_vel", lambda c: c[0] > 0.1)

    def memory(self):
        """Of the node [byte]."""
        pages = Path(f"/proc/{self.node.process.pid}/statm").read_text().split()[1]
        return int(pages) * os.sysconf("SC_PAGE_SIZE")

    def time_to_stop(self, longest=5.0):
        """Time until the moving robot stops, by its own clock [s]."""
        began = len(self.robot.lines)
        t = self.robot.lines[-1][1]["t"]
        return self.robot.until(lambda r: r["v"] < 1e-6, longest, began)[1]["t"] - t

    def end(self):
        for part in (self.node, self.witness, self.robot):
            part.end(signal.SIGINT if part is self.node else signal.SIGKILL)
