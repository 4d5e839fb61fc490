"""A fleet of ten robots in one place, in real time.

`python -m benchmarks.places.shared [--robots 10] [--seconds 100] [--seed 0] [--cores 2]
[--mqtt mqtt://127.0.0.1]`, with a broker there (`mosquitto`): robots drive in the warehouse of
`benchmarks.places`, of which the merger has the map of one drive on the day before; each is a
process of `homeward live`. One robot has mirrored bearings, and one a wheel scale of 1.15. Three
landmarks are pushed by 1 m, one after the other, and the merger is killed (SIGKILL) at 80 % of the
time, and started again 2 s later. Times count from the second robot's first sighting of a landmark
in its new position, and from its sixth that shows the move: the directions of both positions differ
by the innovation gate, and no localiser decides anything about a landmark from fewer. `--join`
measures joining places of 400 and 2,000 landmarks instead, and `--messages` the
merger alone, with visits of robots that do not localise, in a place of 40 landmarks.
"""

import json
import math
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import defaultdict
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from benchmarks.monte_carlo import parsed
from benchmarks.places.days import visit
from benchmarks.places.exchange import PUSH, exchanged, join
from benchmarks.places.warehouse import BEARING_SIGMA, HOME, Warehouse
from homeward.drives.drive import Drive
from homeward.drives.folder import write_folder
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose, bearing, between
from homeward.live.fleet.merging import LIVE
from homeward.live.messages import BearingsIn, OdometryIn, line_of
from homeward.localizer.tunables import GATE, MIN_SIGHTINGS
from homeward.places.files import load_place, save_place
from homeward.places.place import DAY_S, Place

STAGGER_S = 1.0  # between the starts of two robots
PUSH_AT, KILL_AT = (0.3, 0.45, 0.6), 0.8  # shares of the time
NEAR = 0.25  # distance from the landmark at which its position is known [m]
FIVE = 5
MIRRORED, SCALED, SCALE = 1, 2, 1.15
Timed = list[tuple[float, str]]
"""Messages with their time since the robot started [s]."""


@dataclass
class Robot:
    """A process of `homeward live`, and its answers."""

    process: subprocess.Popen[str]
    messages: Timed
    ready: threading.Event = field(default_factory=threading.Event)
    five_at: float = math.inf
    localised_at: float = math.inf
    status: str = ""
    events: list[tuple[float, str]] = field(default_factory=list)


@dataclass
class Push:
    """A landmark that is pushed during the run."""

    landmark: str
    at: float
    """When [s]."""
    new: tuple[float, float]
    seen: defaultdict[int, list[tuple[float, bool]]] = field(
        default_factory=lambda: defaultdict(list)
    )
    """By robot, when it saw the landmark there [s], and whether that shows the move."""
    known: dict[int, float] = field(default_factory=dict)
    """By robot, when it first had the landmark there [s]."""


def messages(drive: Drive, pushes: list[Push], robot: int) -> Timed:
    """Return the messages of the drive of a robot, in which landmarks are pushed."""
    assert drive.truth is not None
    truth, rng, began = drive.truth, np.random.default_rng(0), robot * STAGGER_S
    found: Timed = []
    for row in zip(drive.odometry.t, drive.odometry.v, drive.odometry.omega, strict=True):
        t, v, omega = map(float, row)
        found.append((t, line_of(OdometryIn(t=t, v=v, omega=omega))))
    for t, seen, _ in drive.sightings.stamps():
        frame = dict(seen)
        for push in pushes:
            if t + began < push.at:
                continue
            frame.pop(push.landmark, None)
            i = int(np.searchsorted(truth.t, t).clip(0, len(truth.t) - 1))
            pose = Pose(float(truth.x[i]), float(truth.y[i]), float(truth.heading[i]))
            angle = float(bearing(pose, *push.new))
            near = math.dist(pose[:2], push.new) < 6.0 and abs(angle) < math.radians(120)
            if near and rng.random() < 0.9:
                frame[push.landmark] = angle + float(rng.normal(0.0, BEARING_SIGMA))
                off = wrap(angle - bearing(pose, *np.subtract(push.new, PUSH)))
                push.seen[robot].append((t + began, bool(abs(off) > GATE * BEARING_SIGMA)))
        found.append((float(t), line_of(BearingsIn(t=float(t), bearings=frame))))
    return sorted(found, key=lambda m: m[0])


def spoilt(timed: Timed, mirrored: bool, scale: float) -> Timed:
    """Return the messages of a robot with mirrored bearings, or a wrong wheel scale."""
    found = []
    for t, line in timed:
        message = json.loads(line)
        if mirrored and message["type"] == "bearings":
            message["bearings"] = {n: -b for n, b in message["bearings"].items()}
        elif message["type"] == "odometry":
            message["v"] *= scale
        found.append((t, json.dumps(message) + "\n"))
    return found


def shape_error(place: Place, truth: dict[str, np.ndarray]) -> tuple[float, float]:
    """Return RMSE and worst error of the landmarks after a rigid alignment [m]."""
    names = [n for n in place.map.names if n in truth]
    at = place.map.positions[[place.map.names.index(n) for n in names]]
    there = np.array([truth[n] for n in names])
    a, b = (p - p.mean(axis=0) for p in (at, there))
    a, b = a @ [1.0, 1.0j], b @ [1.0, 1.0j]
    turn = np.vdot(a, b)
    off = np.abs(a * turn / abs(turn) - b)
    return float(np.sqrt(np.mean(off**2))), float(off.max())


def cpu(process: subprocess.Popen[str]) -> float:
    """Return the CPU time of a process [s]."""
    fields = Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


class Run:
    """One run of the benchmark."""

    def __init__(
        self, number: int, seconds: float, seed: int, cores: int, mqtt: str, work: Path
    ) -> None:
        self.number, self.seconds, self.mqtt, self.work = number, seconds, mqtt, work
        self.cores = sorted(os.sched_getaffinity(0))[-cores:]
        self.folder = work / "hall"
        hall = Warehouse(seed)
        _, place = visit(hall.drive(), None, time.time() / DAY_S - 1.0)
        self.name = f"place{os.getpid()}"  # a broker still has the messages of earlier runs
        save_place(replace(place, name=self.name), self.folder)
        home = Pose(HOME.x, HOME.y, HOME.heading)
        own = {n: between(home, Pose(*p, 0.0)) for n, p in hall.places.items()}
        self.truth = {n: np.array(p[:2]) for n, p in own.items()}
        drives = []
        for i in range(number):
            hall.day = i + 1
            drives.append(hall.drive())
        self.before = shape_error(place, self.truth)
        self.pushes = list[Push]()
        for share in PUSH_AT:
            name = self._often_seen(drives, share * seconds)
            new = self.truth[name] = self.truth[name] + PUSH
            self.pushes.append(Push(name, share * seconds, tuple(new.tolist())))
        self.server = self._serve()
        self.began, self.robots = time.monotonic(), list[Robot]()
        for i, drive in enumerate(drives):
            timed = messages(drive, self.pushes, i)
            timed = spoilt(timed, i == MIRRORED, SCALE if i == SCALED else 1.0)
            write_folder(drive, work / f"robot{i}")
            self.robots.append(Robot(self._live(i), timed))

    def _often_seen(self, drives: list[Drive], at: float) -> str:
        """Return the landmark that robots see most after a time, mapped before and in place."""
        seen = list[str]()
        for i, drive in enumerate(drives):
            t = drive.sightings.t - at + i * STAGGER_S
            if i not in (MIRRORED, SCALED):
                seen += set(drive.sightings.landmark[(t > 0.0) & (t < 6.0)].tolist())
        known = {*load_place(self.folder).map.names} - {p.landmark for p in self.pushes}
        return max(sorted(known & {*seen}), key=lambda n: (seen.count(n), n))

    def _pinned(self) -> None:
        os.sched_setaffinity(0, self.cores)

    def _serve(self) -> "subprocess.Popen[str]":
        arguments = ["place", "serve", str(self.folder), "--mqtt", self.mqtt]
        server = self._start(arguments, stdout=subprocess.PIPE)
        assert server.stdout is not None
        server.stdout.readline()
        threading.Thread(target=server.stdout.read, daemon=True).start()
        return server

    def _live(self, i: int) -> "subprocess.Popen[str]":
        robot = self.work / f"robot{i}" / "drive.yaml"
        arguments = ["live", "--place", self.name, "--update", "--robot-file", str(robot)]
        arguments += ["--mqtt", self.mqtt, "--user", f"robot{i}"]
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
        return self._start(arguments, **pipes)

    def _start(self, arguments: list[str], **pipes: int) -> "subprocess.Popen[str]":
        return subprocess.Popen(
            [sys.executable, "-u", "-m", "homeward", *arguments],
            text=True,
            preexec_fn=self._pinned,
            env=os.environ | {"XDG_STATE_HOME": str(self.work / "state")},
            **pipes,  # type: ignore[call-overload]
        )

    @property
    def now(self) -> float:
        return time.monotonic() - self.began

    def _feed(self, i: int) -> None:
        robot = self.robots[i]
        assert robot.process.stdin is not None
        seen = set[str]()
        for t, line in robot.messages:
            at = t + i * STAGGER_S
            if at > self.seconds:
                break
            time.sleep(max(at - self.now, 0.0))
            robot.process.stdin.write(line)
            robot.process.stdin.flush()
            if '"bearings"' in line[:20]:
                seen |= json.loads(line)["bearings"].keys()
            if len(seen) >= FIVE:
                robot.five_at = min(robot.five_at, self.now)

    def _listen(self, i: int) -> None:
        robot = self.robots[i]
        assert robot.process.stdout is not None
        for line in robot.process.stdout:
            robot.ready.set()
            message = json.loads(line)
            match message["type"]:
                case "estimate":
                    robot.status = message["status"]
                    if robot.status == "localised":
                        robot.localised_at = min(robot.localised_at, self.now)
                case "event" | "error":
                    robot.events.append((self.now, message["text"]))
                    self._note(i, message["text"])
                case "landmarks":
                    for m in message["landmarks"]:
                        for push in self.pushes:
                            if m["landmark"] == push.landmark and self.now > push.at:
                                at = m.get("x"), m.get("y")
                                if None not in at and math.dist(at, push.new) < NEAR:
                                    push.known.setdefault(i, self.now)

    def _note(self, i: int, text: str) -> None:
        """Note whether an update of the place has the new position of a landmark."""
        if "updated" not in text:
            return
        for part in text.replace(" and ", ", ").split("), "):
            if " moved (" in part or " new (" in part:
                names = part.replace("(", " ").replace(")", " ").replace(",", " ").split()
                for push in self.pushes:
                    if push.landmark in names and self.now > push.at:
                        push.known.setdefault(i, self.now)

    def run(self) -> None:
        """Drive, and print the figures."""
        hearing = [threading.Thread(target=self._listen, args=(i,)) for i in range(self.number)]
        for thread in hearing:
            thread.start()
        for robot in self.robots:
            robot.ready.wait(120.0)
        self.began = time.monotonic()
        feeding = [threading.Thread(target=self._feed, args=(i,)) for i in range(self.number)]
        for thread in feeding:
            thread.start()
        time.sleep(max(15.0 - self.now, 0.0))
        began = self.now, [cpu(r.process) for r in self.robots], cpu(self.server)
        time.sleep(max(KILL_AT * self.seconds - self.now, 0.0))
        over = self.now - began[0]
        robots = [(cpu(r.process) - c) / over for r, c in zip(self.robots, began[1], strict=True)]
        server = (cpu(self.server) - began[2]) / over
        self.server.send_signal(signal.SIGKILL)
        self.server.wait()
        killed = self.now
        time.sleep(2.0)
        self.server = self._serve()
        for thread in feeding:
            thread.join()
        ends = list[str]()
        for robot in self.robots:
            assert robot.process.stdin is not None
            assert robot.process.stderr is not None
            robot.process.stdin.close()
            ends.append(robot.process.stderr.read().strip())
            robot.process.wait()
        for thread in hearing:
            thread.join()
        self.server.send_signal(signal.SIGTERM)
        self.server.wait()
        self._print(robots, server, killed, ends)

    def _print(self, robots: list[float], server: float, killed: float, ends: list[str]) -> None:
        good = [r for i, r in enumerate(self.robots) if i not in (MIRRORED, SCALED)]
        fix = [r.localised_at - r.five_at for r in good]
        print(
            f"fifth landmark to localised: median {np.median(fix):.1f} s, worst {max(fix):.1f} s "
            f"({len(good)} robots)"
        )
        self._print_delays("first sighting", 1, False)
        self._print_delays("sixth sighting that shows the move", MIN_SIGHTINGS, True)
        print(
            f"CPU on {len(self.cores)} cores: {self.number} robots {100 * sum(robots):.0f} %, "
            f"merger {100 * server:.0f} % of one core"
        )
        events = [(t - killed, text) for r in good for t, text in r.events]
        back = [t for t, text in events if t > 0.0 and text == "the visit is merged again"]
        lost = f"{len(back)} robots had no merger for up to {max(back):.1f} s" if back else ""
        localised = sum(r.status == "localised" for r in good)
        print(
            f"merger killed at {killed:.0f} s, started 2 s later:"
            f" {lost or 'no robot reported it'}; {localised} of {len(good)} localised at the end"
        )
        for i, end in enumerate(ends):
            kind = {MIRRORED: "mirrored bearings", SCALED: f"wheel scale {SCALE}"}.get(i, "right")
            print(f"  robot {i} ({kind}, {self.robots[i].status}): {end}")
        place = load_place(self.folder)
        left = list((self.folder / LIVE).glob("*.json"))
        print(
            f"visits merged: {sum(v.verdict == 'merged' for v in place.visits)}, left: {len(left)}"
        )
        for words, (rmse, worst) in (
            ("before", self.before),
            ("after", shape_error(place, self.truth)),
        ):
            print(f"map {words}: RMSE {100 * rmse:.1f} cm, worst landmark {100 * worst:.1f} cm")

    def _print_delays(self, words: str, number: int, must_show: bool) -> None:
        """Print the delays from such a sighting of each push by the second robot."""
        right, delays = {*range(self.number)} - {MIRRORED, SCALED}, list[float]()
        for push in self.pushes:
            seen = {i: [t for t, shows in push.seen[i] if shows >= must_show] for i in right}
            times = sorted((t[number - 1], i) for i, t in seen.items() if len(t) >= number)
            if len(times) < 2 or times[1][0] > self.seconds:
                print(f"{push.landmark}: no {words} of a second robot")
                continue
            (_, first), (since, second), *_ = times
            pair = first, second
            after = [max(push.known.get(i, math.inf) - since, 0) for i in right.difference(pair)]
            delays += after
            print(
                f"{push.landmark} pushed at {push.at:.0f} s, {words} of a second robot at"
                f" {since:.1f} s, in the maps of the first two"
                f" {' and '.join(f'{push.known.get(i, math.inf) - since:.1f}' for i in pair)} s"
                f" later, had by the others: median {np.median(after):.1f} s, worst"
                f" {max(after):.1f} s"
            )
        if delays:
            print(
                f"from the {words} of the second robot to all others: median"
                f" {np.median(delays):.1f} s, worst {max(delays):.1f} s"
            )


def main() -> None:
    counts = {"robots": 10, "seconds": 100.0, "seed": 0, "cores": 2}
    given = parsed(__doc__, **counts, mqtt="mqtt://127.0.0.1", join=False, messages=False)
    work = Path(tempfile.mkdtemp())
    try:
        print(f"load before: {os.getloadavg()[0]:.1f}")
        if given.join:
            for number in (400, 2000):
                join(number, given.mqtt, work)
        elif given.messages:
            exchanged(given.robots, given.mqtt, work)
        else:
            about = given.seconds, given.seed, given.cores, given.mqtt, work
            Run(given.robots, *about).run()
        print(f"load after: {os.getloadavg()[0]:.1f}")
    finally:
        shutil.rmtree(work, ignore_errors=True)


if __name__ == "__main__":
    main()
