"""Memory and latency of a long session: a robot drives in circles and home, repeatedly.

`python -m benchmarks.soak [--minutes 10] [--record FOLDER]` starts `homeward live` and connects
over TCP in real time, with odometry at 50 Hz and bearings at 30 Hz. With `--ros`, it starts the
ROS 2 node instead; this needs a Python with rclpy (`make test-ros` makes .venv-ros-jazzy). Memory
is that of the other process, once per second. Latency is from before bearings are sent until their
answer is parsed here.
"""

import asyncio
import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Self

import numpy as np

from benchmarks import monte_carlo
from homeward.lab.simulation.live_robot import LiveRobot, SimulatedRobotClient, play
from homeward.lab.simulation.simulate import load_scenario
from homeward.live.messages import Answer, BearingsIn, Input, OdometryIn, line_of, parse_output
from homeward.live.server import Address

WARM_S = 150.0
"""Time until the map's window of open keyframes is full; memory may grow until then [s]."""
SCENARIO = {
    "rates.odometry": 50.0,
    "rates.bearings": 30.0,
    "start.prior": False,
    "noise.bearing_sigma": 0.01,
    "moved.count": 0,
    "landmarks.count": 12,
}


class Shuttle(SimulatedRobotClient):
    """Drives in circles and home for a time, and measures the latency of answers."""

    def __init__(self, seconds: float, **changes: float) -> None:
        super().__init__(LiveRobot(load_scenario("paper-homing", SCENARIO | changes)), seconds)
        self.latencies: list[float] = []  # [s]
        self.endings: list[tuple[str, float]] = []
        """For each homing: "arrived" or "failed", and the distance from home [m]."""
        self._sent: dict[float, float] = {}

    def step(self) -> Iterator[Input]:
        for message in super().step():
            if isinstance(message, BearingsIn):
                self._sent[message.t] = time.perf_counter()
            yield message

    def on_message(self, message: object) -> None:
        super().on_message(message)
        if isinstance(message, Answer) and message.t in self._sent:
            self.latencies.append(time.perf_counter() - self._sent.pop(message.t))
        if self.ending is not None:
            self.endings.append((self.ending.state, self.robot.distance))
            self.restart()


def by_tcp(shuttle: Shuttle, record: Path | None) -> np.ndarray:
    command = [sys.executable, "-m", "homeward", "live", "--tcp", "0"]
    command += ["--record", str(record)] if record else []
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as live:
        assert live.stderr is not None
        port = int(live.stderr.readline().split()[-1])
        with Watch(live.pid) as memory:
            asyncio.run(play(shuttle, Address("127.0.0.1", port), 1.0, None, print))
        live.terminate()
    return np.array(memory.megabytes)


def by_ros(shuttle: Shuttle, record: Path | None) -> np.ndarray:
    import rclpy
    from nav_msgs.msg import Odometry
    from rclpy.node import Node
    from std_msgs.msg import String

    given = {"bearings_type": "std_msgs/msg/String", **({"record": record} if record else {})}
    options = [word for key, value in given.items() for word in ("-p", f"{key}:={value}")]
    rclpy.init()
    node = Node("soak")
    odometry = node.create_publisher(Odometry, "odom", 10)
    lines = {
        kind: node.create_publisher(String, topic, 10)
        for kind, topic in (("bearings", "bearings"), ("", "homeward/request"))
    }

    def send(message: Input) -> None:
        if isinstance(message, OdometryIn):
            twist = Odometry()
            stamp = round(message.t * 1e9)
            twist.header.stamp.sec, twist.header.stamp.nanosec = divmod(stamp, 10**9)
            twist.twist.twist.linear.x, twist.twist.twist.angular.z = message.v, message.omega
            twist.pose.pose.position.x = float("nan")  # there is no odometry frame
            odometry.publish(twist)
        else:
            lines.get(message.type, lines[""]).publish(String(data=line_of(message)))

    def receive(message: Any) -> None:
        shuttle.on_message(parse_output(message.data))

    node.create_subscription(String, "homeward/said", receive, 100)
    command = [sys.executable, "-m", "homeward.ros", "--ros-args", *options]
    with subprocess.Popen(command) as live:
        while lines[""].get_subscription_count() == 0:
            rclpy.spin_once(node, timeout_sec=0.1)
        send(shuttle.home())
        with Watch(live.pid) as memory:
            began = time.monotonic()
            while not shuttle.done:
                for message in shuttle.step():
                    send(message)
                while (left := began + shuttle.robot.t - time.monotonic()) > 0:
                    rclpy.spin_once(node, timeout_sec=left)
        live.terminate()
    return np.array(memory.megabytes)


class Watch:
    """The memory of a process, once per second [MB]."""

    def __init__(self, process: int) -> None:
        self.megabytes: list[float] = []
        self._file, self._end = Path(f"/proc/{process}/statm"), threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)

    def _watch(self) -> None:
        while not self._end.wait(1.0):
            pages = int(self._file.read_text().split()[1])
            self.megabytes.append(pages * os.sysconf("SC_PAGE_SIZE") / 1e6)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._end.set()
        self._thread.join()


def main() -> None:
    options = monte_carlo.parsed(__doc__, minutes=10.0, ros=False, record=Path)
    shuttle = Shuttle(60.0 * options.minutes)
    memory = (by_ros if options.ros else by_tcp)(shuttle, options.record)
    each = memory[29::30] if memory.size > 60 else memory
    print("memory [MB], every 30 s:" if memory.size > 60 else "memory [MB], every second:")
    print(" ".join(f"{m:.1f}" for m in each))
    warm = memory[int(min(WARM_S, memory.size / 2)) :]
    per_minute = 60.0 * float(np.polyfit(np.arange(warm.size), warm, 1)[0])
    print(f"growth after warming up: {per_minute:+.3f} MB/min, {warm[-1] - warm[0]:+.1f} MB in all")
    ms = 1e3 * np.array(shuttle.latencies)
    print(
        f"latency of {ms.size:,} answers: median {np.median(ms):.1f} ms, "
        f"99 % {np.quantile(ms, 0.99):.1f} ms, worst {ms.max():.1f} ms"
    )
    arrived = [far for state, far in shuttle.endings if state == "arrived"]
    far = f", error at most {100 * max(arrived):.1f} cm" if arrived else ""
    print(f"homings: {len(arrived)} of {len(shuttle.endings)} arrived{far}")
    print(f"load average: {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")


if __name__ == "__main__":
    main()
