"""A live session under load: clients that send as fast as they can, next to a robot and a stop.

`python -m benchmarks.live_load [--seconds 6]` starts `homeward live`. A robot sends odometry at
50 Hz and bearings at 15 Hz and asks for the way home; another client engages and releases the
emergency stop. The command prints the rate of commands, the longest gap between two of them, and
the time from the stop until a command names it, without load and with three further clients that
send odometry, lines that are no messages, or empty lines without a pause; over TCP and WebSocket.
"""

import contextlib
import json
import multiprocessing
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from benchmarks import monte_carlo

ODOMETRY_HZ, BEARINGS_HZ = 50.0, 15.0
STOP_EVERY_S = 0.5
HOME = {"a": 0.3, "b": 1.4, "c": 2.7, "d": -2.1, "e": -0.8}
LOADS = {
    "odometry": b'{"type":"odometry","t":%d,"v":0.1,"omega":0.0}',
    "garbage": b"nonsense %d",
    "empty lines": b"",
}


class Link:
    """A client; `send` takes a message, `lines` yields those received."""

    def __init__(self, port: int, websocket: bool) -> None:
        self._websocket: Any = None
        self._open = contextlib.ExitStack()
        if websocket:
            from websockets.sync.client import connect

            address = f"ws://127.0.0.1:{port}"
            self._websocket = self._open.enter_context(connect(address, compression=None))
        else:
            self._socket = socket.create_connection(("127.0.0.1", port))
        self.send(type="hello", version=1)

    def send(self, **message: Any) -> None:
        line = json.dumps(message)
        if self._websocket is not None:
            self._websocket.send(line)
        else:
            self._socket.sendall(line.encode() + b"\n")

    def flood(self, line: bytes) -> None:
        """Send a line again and again, without a pause, until the server hangs up."""
        lines = [line % k if b"%d" in line else line for k in range(2000)]
        if self._websocket is None:
            raw, block = self._socket, b"\n".join(lines) + b"\n"
        else:  # text frames whose mask is zero
            raw = self._websocket.socket
            block = b"".join(bytes((0x81, 0x80 | len(x))) + bytes(4) + x for x in lines)
        with contextlib.suppress(OSError):
            while True:
                raw.sendall(block)

    def lines(self) -> Iterator[str | bytes]:
        with contextlib.suppress(Exception):  # the other side hung up
            if self._websocket is not None:
                yield from self._websocket
            else:
                yield from self._socket.makefile("rb")

    def close(self) -> None:
        self._open.close()
        if self._websocket is None:
            with contextlib.suppress(OSError):
                self._socket.shutdown(socket.SHUT_RDWR)
            self._socket.close()


def flood(port: int, websocket: bool, line: bytes) -> None:
    """Load the server until it closes the link or this process is killed."""
    link = Link(port, websocket)
    reading = threading.Thread(target=lambda: [None for _ in link.lines()], daemon=True)
    reading.start()
    link.flood(line)
    time.sleep(60.0)  # do not connect again


def measure(port: int, websocket: bool, seconds: float) -> tuple[np.ndarray, np.ndarray, int]:
    """Return arrival times of commands [s], latencies of stops [s], and number of lost stops."""
    robot, stopper = Link(port, websocket), Link(port, websocket)
    commands: list[float] = []
    stopped = threading.Event()

    def receive() -> None:
        for line in robot.lines():
            message = json.loads(line)
            if message["type"] == "command":
                commands.append(time.perf_counter())
                if message["reason"] == "emergency stop":
                    stopped.set()

    def drain() -> None:
        for _ in stopper.lines():
            pass

    end = threading.Event()

    def drive() -> None:
        k, began = 0, time.perf_counter()
        while not end.is_set():
            t = k / ODOMETRY_HZ
            robot.send(type="odometry", t=t, v=0.0, omega=0.0)
            if k % round(ODOMETRY_HZ / BEARINGS_HZ) == 0:
                robot.send(type="bearings", t=t, bearings=HOME)
            k += 1
            end.wait(max(0.0, began + k / ODOMETRY_HZ - time.perf_counter()))

    actions: list[Callable[[], None]] = [receive, drain, drive]
    robot.send(type="home", bearings=HOME)
    robot.send(type="go_home")
    threads = [threading.Thread(target=act, daemon=True) for act in actions]
    for thread in threads:
        thread.start()
    latencies, lost = [], 0
    began = time.perf_counter()
    while time.perf_counter() - began < seconds:
        time.sleep(STOP_EVERY_S)
        stopped.clear()
        asked = time.perf_counter()
        stopper.send(type="estop", engaged=True)
        if stopped.wait(2.0):
            latencies.append(time.perf_counter() - asked)
        else:
            lost += 1
        stopper.send(type="estop", engaged=False)
        stopper.send(type="go_home")
    end.set()
    threads[-1].join()
    arrived = np.array([t for t in commands if began <= t <= began + seconds]) - began
    robot.close()
    stopper.close()
    return np.r_[0.0, arrived, seconds], np.array(latencies), lost


def row(websocket: bool, load: str, seconds: float) -> str:
    where = "--websocket" if websocket else "--tcp"
    command = [sys.executable, "-m", "homeward", "live", where, "0"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as live:
        assert live.stderr is not None
        port = int(live.stderr.readline().split()[-1])
        errors: list[str] = []
        reading = threading.Thread(target=lambda: errors.extend(live.stderr or ()))
        reading.start()
        given = (port, websocket, LOADS.get(load, b""))
        number = 3 if load in LOADS else 0
        floods = [multiprocessing.Process(target=flood, args=given) for _ in range(number)]
        for process in floods:
            process.start()
        time.sleep(1.0)
        try:
            commands, latencies, lost = measure(port, websocket, seconds)
        finally:
            for process in floods:
                process.kill()
                process.join()
            live.terminate()
            reading.join()
    ms = 1e3 * latencies if latencies.size else np.array([np.nan])
    return (
        f"{'WebSocket' if websocket else 'TCP':<10}{load:<12}"
        f"{(commands.size - 2) / seconds:>12.1f}{1e3 * np.diff(commands).max():>10.0f}"
        f"{np.median(ms):>10.0f}{ms.max():>8.0f}{lost:>9}{sum(map(len, errors)):>10}"
    )


def main() -> None:
    options = monte_carlo.parsed(__doc__, seconds=6.0)
    print(f"{'over':<10}{'load':<12}{'commands/s':>12}{'gap [ms]':>10}", end="")
    print(f"{'stop [ms]':>10}{'worst':>8}{'lost':>9}{'stderr B':>10}")
    for websocket in (False, True):
        for load in ("none", *LOADS):
            print(row(websocket, load, options.seconds), flush=True)


if __name__ == "__main__":
    main()
