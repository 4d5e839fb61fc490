"""Live sessions of `benchmarks.fuzz`: a simulated robot, with messages changed at random.

A case is text. Its first line describes the session; each other line is the host's time [s] and
a message, or one of `ACTIONS`. `play` runs it in this process.
"""

import contextlib
import itertools
import json
import math
import random
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np

from homeward.drives.drive import HomeBearing
from homeward.drives.settings import DriveSettings
from homeward.errors import HomewardError, InputError, InternalError
from homeward.geometry.frames import Pose, Twist, advance
from homeward.io.settings import validated
from homeward.live import messages as msg
from homeward.live.place_session import PlaceSession
from homeward.live.session import Session
from homeward.live.settings import LiveSettings

ACTIONS = "tick", "process", "diagnostics"
ODOMETRY_S, FRAME_S, TICK_S = 0.04, 0.08, 0.1
"""Intervals of odometry, of the frames of each camera, and of commands [s]."""
REAR = {"x": -0.2, "y": 0.05, "yaw": 3.0}
"""Extrinsics of a second camera."""
NUMBERS = [
    *(0.0, -0.0, 5e-324, -5e-324, 1e-300, 1e-9, 0.005, 1.0, -1.0, math.pi, -math.pi, math.tau),
    *(99.0, -99.0, 100.0, 1e4, -1e4, 9999.9, 1e5, 1e300, -1e300, math.inf, -math.inf, math.nan),
]
STAMPS = [0.0, 5e-324, -1e9, 1e9, 1.7e9, 9.9e10, -9.9e10, 1e11, 1e300, -1e300, math.nan, math.inf]
STEPS_S = [0.02, -0.02, 0.5, -0.5, 1.5, -1.5, 3.0, -3.0, -60.0, 60.0, 86400.0, -86400.0, 1e9, -1e9]
"""Steps of a clock [s]."""
IDS = ["", " ", " a", "a rear", "rear", "L0 rear", "é", "\u202e", "\x1b[31m", "x" * 200, "x" * 201]
IDS += ["=1+1", "<b>", '"', "\\", "nan", "1", "\U0001f916", "L0\n", "__class__", "a,b", "$\\frac$"]
GARBAGE = ["", "{", "[]", "null", '{"type":"odometry"}', '{"type":"no such"}', "\x00", "9" * 400]
GARBAGE += ['{"type":"bearings","t":0,"bearings":{"a":"0.1"}}', '{"type":"estop","engaged":1}']
REQUESTS: list[dict[str, Any]] = [
    *({"type": kind} for kind in ("reset", "cancel", "look_round", "begin_route", "save_place")),
    *({"type": kind} for kind in ("go_home", "store_home", "turn_home", "hello")),
    *({"type": kind, "name": "b"} for kind in ("go_home", "store_home", "turn_home")),
    *({"type": kind, "name": "round"} for kind in ("store_route", "follow_route")),
    {"type": "go_home", "dock": True},
    {"type": "go_to_landmark", "name": "L1"},
    {"type": "go_to_landmark", "name": "L0", "standoff": 0.0},
    {"type": "estop", "engaged": True},
    {"type": "estop", "engaged": False},
    {"type": "mount", "camera": "rear", **REAR},
    {"type": "home", "bearings": {}},
    {"type": "home", "bearings": {"L0": 0.1}, "name": "b"},
]
"""Messages without numbers of their own."""


class Line(NamedTuple):
    """A message, or an action, and the host's time [s]."""

    now: float
    what: dict[str, Any] | str

    @property
    def sample(self) -> dict[str, Any]:
        """The message of a line of `_samples`."""
        assert not isinstance(self.what, str)
        return self.what

    def with_values(self, values: dict[str, Any]) -> Self:
        return self._replace(what=self.sample | values)


Lines = list[Line]


def clean() -> bytes:
    """Return a session without changes, with home bearings, a drive and a request."""
    return _text(*_session(random.Random(0), two_cameras=True))


def changed(seed: int) -> bytes:
    """Return the session of a seed: a few kinds of changes, each rare or frequent."""
    chance = random.Random(f"sessions {seed}")
    head, lines = _session(chance, two_cameras=chance.random() < 0.4)
    for change in chance.sample(CHANGES, chance.choice([1, 2, 3, 5])):
        lines = change(lines, chance, chance.choice([0.01, 0.05, 0.2]))
    return _text(head, lines)


def play(data: bytes, folder: Path) -> None:
    """Run a session; raise the cause of any `InternalError`, or `AssertionError`."""
    first, *lines = data.decode().split("\n")
    head = json.loads(first)
    homes = {
        name: {i: HomeBearing(b) for i, b in seen.items()} for name, seen in head["homes"].items()
    }
    place = PlaceSession("hall", 20000.0, True, folder / "hall") if head["place"] else None
    settings = validated(LiveSettings, head["settings"])
    session = Session(settings, validated(DriveSettings, head["robot"]), homes, place)
    causes = _causes_in(session)
    for line in filter(None, lines):
        now, what = line.split(" ", 1)
        try:
            for out in _outputs(session, float(now), what):
                if not causes:
                    _check(out, settings)
        except InternalError as error:
            causes.append(error.__cause__ or error)
        if causes:
            raise causes[0]
    session.localisation.landmarks()
    with contextlib.suppress(HomewardError):  # too little was driven
        session.localisation.finalise()


def _outputs(session: Session, now: float, what: str) -> Iterator[msg.Output]:
    """Yield the outputs of one line of a session."""
    match what:
        case "process":
            yield from session.process()
        case "tick":
            command = session.tick(now)
            if command is not None:
                yield command
        case "diagnostics":
            session.request_landmarks()
            yield session.diagnostics(now)
        case _:
            try:
                message = msg.parse(what)
            except InputError:
                return
            session.receive(message, now)


def _causes_in(session: Session) -> list[BaseException]:
    """Return a list that gets the causes of errors in the slow part, whose events are text."""
    causes, do = list[BaseException](), session.localisation.do

    def noted(message: msg.Input | msg.PlaceChanged, odom: Pose | None) -> msg.Output | None:
        try:
            return do(message, odom)
        except InternalError as error:
            causes.append(error.__cause__ or error)
            raise

    session.localisation.do = noted  # type: ignore[method-assign]
    return causes


def _check(out: msg.Output, settings: LiveSettings) -> None:
    """Check that an output can be sent, that its numbers are finite, and a command's in limits."""
    line = msg.line_of(out)
    assert msg.line_of(msg.parse_output(line)) == line, out
    assert "null" not in line, out
    match out:
        case msg.EstimateOut(pose=pose, covariance=covariance):
            assert np.isfinite([*(pose or ()), *(covariance or ())]).all(), out
        case msg.Command(v=v, omega=omega):
            limits = settings.limits
            assert abs(v) <= limits.speed, out
            assert abs(omega) <= max(limits.turn_rate, limits.search), out
        case msg.EventOut(text=text):
            assert "internal error" not in text, out
            assert "view stopped" not in text, out


def _text(head: dict[str, Any], lines: Lines) -> bytes:
    rows = [json.dumps(head)]
    for now, what in lines:
        message = what if isinstance(what, str) else json.dumps(what)
        rows.append(f"{now!r} {message}".replace("\n", ""))
    return "\n".join(rows).encode("utf-8", "surrogatepass")


def _session(chance: random.Random, two_cameras: bool) -> tuple[dict[str, Any], Lines]:
    """Return the settings and messages of a robot that drives among landmarks from home on."""
    marks = {
        f"L{k}": (chance.uniform(2.0, 6.0), chance.uniform(-math.pi, math.pi))
        for k in range(chance.choice([4, 8, 8, 12, 20]))
    }
    places = {n: (r * math.cos(a), r * math.sin(a)) for n, (r, a) in marks.items()}
    noise = chance.choice([0.0, 0.003, 0.02])

    def frame(pose: Pose, camera: str, mount: dict[str, float]) -> dict[str, Any]:
        c, s = math.cos(pose.heading), math.sin(pose.heading)
        x = pose.x + c * mount["x"] - s * mount["y"]
        y = pose.y + s * mount["x"] + c * mount["y"]
        axis = pose.heading + mount["yaw"]
        seen = {
            n: math.remainder(math.atan2(b - y, a - x) - axis + chance.gauss(0.0, noise), math.tau)
            for n, (a, b) in places.items()
        }
        message: dict[str, Any] = {"type": "bearings", "t": 0.0, "bearings": seen}
        if with_ranges:
            message["ranges"] = {n: math.dist((x, y), places[n]) for n in seen}
        return message | ({"camera": camera} if camera else {})

    with_ranges = chance.random() < 0.3
    first = {"x": 0.0, "y": 0.0, "yaw": 0.0}
    robot: dict[str, Any] = {"sensor": {"bearing_sigma": 0.01} if chance.random() < 0.5 else {}}
    if with_ranges:
        robot["sensor"] |= {"range_sigma": 0.05}
    if chance.random() < 0.5:
        robot["odometry"] = {"speed_sigma": 0.02, "turn_sigma": 0.02}
    if two_cameras and chance.random() < 0.5:
        robot["cameras"] = {"rear": REAR}
    if chance.random() < 0.1:
        robot["bearings_late"] = 0.05
    if chance.random() < 0.3:
        robot["start"] = {"R": 0.001, "theta": 0.0, "alpha": 0.0}
    settings: dict[str, Any] = {}
    if chance.random() < 0.2:
        settings["smoothed_lag"] = chance.choice([0.1, 1.0, 5.0])
    if chance.random() < 0.1:
        settings["queue"] = 10
    home = frame(Pose(0.0, 0.0, 0.0), "", first)["bearings"]
    homes = {"home": home} if chance.random() < 0.8 else {}
    head = {
        "robot": robot,
        "settings": settings,
        "homes": homes,
        "place": chance.random() < 0.15,
    }
    lines: Lines = []
    if two_cameras and "cameras" not in robot:
        lines.append(Line(0.0, {"type": "mount", "camera": "rear", **REAR}))
    if not homes:
        lines.append(Line(0.0, {"type": "home", "bearings": home}))
    pose, begin, clock = Pose(0.0, 0.0, 0.0), 0.0, chance.choice([0.0, -5.0, 1e9, 1.7e9, 9.9e10])
    slow = chance.choice([1, 1, 1, 5])
    for seconds, twist in _legs(chance):
        for k in range(round(seconds / ODOMETRY_S)):
            now = begin + k * ODOMETRY_S
            sample = {"type": "odometry", "t": clock + now, "v": twist.v, "omega": twist.omega}
            lines.append(Line(now, sample))
            if k % round(FRAME_S / ODOMETRY_S) == 0:
                lines.append(Line(now, frame(pose, "", first) | {"t": clock + now}))
                if two_cameras:
                    rear = frame(pose, "rear", REAR) | {"t": clock + now + 0.03}
                    lines.append(Line(now + 0.03, rear))
            if k % slow == 0:
                lines.append(Line(now + 0.03, "process"))
            lines.append(Line(now + 0.03, "tick"))
            pose = advance(pose, twist, ODOMETRY_S)
        begin += round(seconds / ODOMETRY_S) * ODOMETRY_S
        request = chance.choice(REQUESTS) if chance.random() < 0.5 else {"type": "go_home"}
        lines += [Line(begin, "diagnostics"), Line(begin, request), Line(begin, "process")]
    return head, lines


def _legs(chance: random.Random) -> list[tuple[float, Twist]]:
    """Return the durations [s] and twists of a drive."""
    legs = [(chance.uniform(0.2, 1.5), Twist(0.0, 0.0))]
    longest = 5.0 if chance.random() < 0.1 else 2.0
    for _ in range(chance.choice([2, 3])):
        v = chance.choice([0.0, 0.5, 0.8, 0.8, -0.5])
        legs.append(
            (chance.uniform(0.3, longest), Twist(v, chance.choice([0.0, 0.4, -0.7, 1.2, 2.0])))
        )
    return legs


def _samples(lines: Lines, kind: str = "") -> list[int]:
    """Return the indices of samples, of one kind if given."""
    kinds = (kind,) if kind else ("odometry", "bearings")
    whats = enumerate(line.what for line in lines)
    return [i for i, what in whats if not isinstance(what, str) and what["type"] in kinds]


def _some(chance: random.Random, indices: list[int], share: float) -> list[int]:
    """Return a share of indices, at least one if there are any."""
    some = [i for i in indices if chance.random() < share]
    return some or indices[: len(indices) and 1]


def _swapped(lines: Lines, chance: random.Random, share: float) -> Lines:
    """Exchange the messages of neighbouring frames, or of odometry, or of both."""
    indices = _samples(lines, chance.choice(["bearings", "bearings", "odometry", ""]))
    lines = lines.copy()
    for a, b in itertools.pairwise(indices):
        if chance.random() < share:
            first, second = lines[a], lines[b]
            lines[a], lines[b] = second._replace(now=first.now), first._replace(now=second.now)
    return lines


def _late(lines: Lines, chance: random.Random, share: float) -> Lines:
    """Deliver samples later."""
    moved = set(_some(chance, _samples(lines), share))
    rest = [(float(i), line) for i, line in enumerate(lines) if i not in moved]
    rest += [(i + chance.choice([1.5, 5.5, 30.5, 200.5]), lines[i]) for i in moved]
    lines = [line for _, line in sorted(rest, key=lambda each: each[0])]
    nows = itertools.accumulate((line.now for line in lines), max)
    return [line._replace(now=now) for line, now in zip(lines, nows, strict=True)]


def _doubled(lines: Lines, chance: random.Random, share: float) -> Lines:
    """Deliver samples twice."""
    twice = set(_some(chance, _samples(lines), share))
    return [line for i, line in enumerate(lines) for _ in range(1 + (i in twice))]


def _dropped(lines: Lines, chance: random.Random, share: float) -> Lines:
    """Leave out an interval of one kind of samples."""
    indices = _samples(lines, chance.choice(["odometry", "bearings", ""]))
    begin = chance.randrange(len(indices))
    gone = set(indices[begin : begin + int(5 * share * len(indices)) + 1])
    return [line for i, line in enumerate(lines) if i not in gone]


def _changed_samples(
    change: Callable[[dict[str, Any], random.Random], dict[str, Any]], kind: str = ""
) -> Callable[[Lines, random.Random, float], Lines]:
    """Return a function that changes a share of the samples."""

    def changed_lines(lines: Lines, chance: random.Random, share: float) -> Lines:
        lines = lines.copy()
        for i in _some(chance, _samples(lines, kind), share):
            lines[i] = lines[i].with_values(change(lines[i].sample, chance))
        return lines

    return changed_lines


def _odd_numbers(what: dict[str, Any], chance: random.Random) -> dict[str, Any]:
    number = partial(chance.choice, NUMBERS)
    if what["type"] == "odometry":
        pose = {"pose": [number(), number(), number()]} if chance.random() < 0.3 else {}
        return {chance.choice(["v", "omega"]): number(), **pose}
    names = [*what["bearings"], "unseen"]
    key = chance.choice(["bearings", "bearings", "sigmas", "ranges", "range_sigmas"])
    odd = {n: number() for n in names[: chance.choice([1, 3, 99])]}
    if key != "bearings":
        odd = {n: abs(value) for n, value in odd.items()}
    return {key: what.get(key, {}) | odd}


def _odd_ids(what: dict[str, Any], chance: random.Random) -> dict[str, Any]:
    if chance.random() < 0.1:
        return {"camera": chance.choice([*IDS, "left"])}
    return {"bearings": what["bearings"] | {chance.choice(IDS): chance.uniform(-3.0, 3.0)}}


def _odd_sizes(what: dict[str, Any], chance: random.Random) -> dict[str, Any]:
    match chance.randrange(4):
        case 0:
            return {"bearings": {}, "ranges": {}}
        case 1:
            return {"bearings": dict(list(what["bearings"].items())[:1])}
        case 2:
            return {"bearings": dict.fromkeys(what["bearings"], 0.5)}
    number = chance.choice([60, 500, 501])
    return {"bearings": {f"L{k}": chance.uniform(-3.0, 3.0) for k in range(number)}}


def _rounded(lines: Lines, chance: random.Random, share: float) -> Lines:
    """Round all bearings, so that some repeat to the bit."""
    step = chance.choice([0.005, 0.02, math.radians(1.0), 0.3])
    lines = lines.copy()
    for i in _samples(lines, "bearings"):
        seen = {
            n: step * round(b / step) if math.isfinite(b) else b
            for n, b in lines[i].sample["bearings"].items()
        }
        lines[i] = lines[i].with_values({"bearings": seen})
    return lines


def _frozen(lines: Lines, chance: random.Random, share: float) -> Lines:
    """Repeat the bearings of earlier frames of the camera, all or some of them."""
    lines, indices = lines.copy(), _samples(lines, "bearings")
    for i in _some(chance, indices, 3.0 * share):
        k = indices.index(i)
        other = lines[chance.choice(indices[max(0, k - 6) : k + 1])].sample["bearings"]
        kept = {n: b for n, b in other.items() if chance.random() < 0.8}
        lines[i] = lines[i].with_values({"bearings": lines[i].sample["bearings"] | kept})
    return lines


def _equal_stamps(lines: Lines, chance: random.Random, share: float) -> Lines:
    """Give samples the stamp of an earlier one."""
    lines, indices = lines.copy(), _samples(lines, chance.choice(["odometry", "bearings", ""]))
    for before, i in itertools.pairwise(indices):
        if chance.random() < 2.0 * share:
            lines[i] = lines[i].with_values({"t": lines[before].sample["t"]})
    return lines


def _clock_steps(lines: Lines, chance: random.Random, share: float) -> Lines:
    """Let the clock of one kind of samples, or of all, step once or several times."""
    lines = lines.copy()
    for _ in range(chance.choice([1, 1, 2, 5])):
        indices = _samples(lines, chance.choice(["odometry", "bearings", "", ""]))
        step, begin = chance.choice(STEPS_S), chance.randrange(len(indices))
        number = chance.choice([1, 3, 10, len(indices)])
        for i in indices[begin : begin + number]:
            lines[i] = lines[i].with_values({"t": lines[i].sample["t"] + step})
    return lines


def _with_requests(lines: Lines, chance: random.Random, share: float) -> Lines:
    """Insert messages other than samples, with odd numbers in some."""
    made: Lines = []
    number = partial(chance.choice, NUMBERS)
    for line in lines:
        made.append(line)
        if chance.random() < 0.3 * share:
            number_of = chance.choice([1, 5, 40])
            numeric: list[dict[str, Any]] = [
                {"type": "obstacle", "distance": abs(number())},
                {"type": "go_to", "x": number(), "y": number()},
                {"type": "start", "x": number(), "y": number(), "heading": number()},
                {"type": "start", "x": 0.5, "y": 0.1, "heading": 0.2, "sigma": abs(number()),
                 "sigma_heading": abs(number())},
                {"type": "mount", "x": number(), "y": number(), "yaw": number(),
                 "camera": chance.choice(["", "rear", "left"])},
                {"type": "go_to_landmark", "name": "L2", "standoff": abs(number())},
                {"type": "home", "bearings": {f"L{k}": number() for k in range(number_of)},
                 "sigmas": {"L0": abs(number())}},
            ]  # fmt: skip
            made.append(Line(line.now, chance.choice([*REQUESTS, *numeric])))
    return made


def _with_garbage(lines: Lines, chance: random.Random, share: float) -> Lines:
    """Insert lines that are no messages."""
    made: Lines = []
    for line in lines:
        made.append(line)
        if chance.random() < share:
            made.append(Line(line.now, chance.choice(GARBAGE) or "{}"))
    return made


def _odd_host_times(lines: Lines, chance: random.Random, share: float) -> Lines:
    """Let the host be busy for some time, and process everything late."""
    made, late = [], 0.0
    for now, what in lines:
        if chance.random() < 0.05 * share:
            late += chance.choice([0.2, 1.0, 30.0, 4000.0])
        if what != "process" or chance.random() > share:
            made.append(Line(now + late, what))
    return made


CHANGES: list[Callable[[Lines, random.Random, float], Lines]] = [
    _swapped,
    _late,
    _doubled,
    _dropped,
    _changed_samples(_odd_numbers),
    _changed_samples(lambda what, chance: {"t": chance.choice(STAMPS)}),
    _changed_samples(lambda what, chance: {"t": what["t"] + chance.gauss(0.0, 0.1)}),
    _changed_samples(_odd_ids, "bearings"),
    _changed_samples(_odd_sizes, "bearings"),
    _rounded,
    _frozen,
    _equal_stamps,
    _clock_steps,
    _with_requests,
    _with_garbage,
    _odd_host_times,
]
