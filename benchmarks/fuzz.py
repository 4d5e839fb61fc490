"""Fuzz test of all readers and of live sessions.

`python -m benchmarks.fuzz [--part NAME] [--runs 2000] [--first 0]`. Corrupted files give a value,
or an error message of one line; sessions (`--part sessions`) go on without an internal error. Case
k of a part depends only on the seed k, so that `--first k --runs 1` repeats it. Any exception but a
`HomewardError`, more than `MAX_S` or more memory than `MAX_MEMORY` is a failure, and gives exit
status 1.
"""

import io
import math
import random
import re
import resource
import signal
import struct
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from benchmarks import fuzz_sessions, monte_carlo
from benchmarks.inputs.data_logs import small_log
from homeward.drives.drive import Drive, HomeBearing, Odometry, Sightings, Truth
from homeward.drives.importers.mrclam import read_mrclam
from homeward.drives.opening import open_drive, save_drive
from homeward.drives.ros.decoding import Decoder
from homeward.drives.ros.kinds import ODOMETRY
from homeward.drives.ros.log import Channel
from homeward.drives.ros.settings import LogSettings
from homeward.drives.ros.writing import DEFINITIONS
from homeward.drives.settings import DriveSettings
from homeward.errors import HomewardError
from homeward.geometry.frames import Pose
from homeward.io.reading import shipped_yaml
from homeward.io.settings import read_settings, settings_yaml
from homeward.lab.planning.settings import load_plan
from homeward.lab.simulation.render.room.settings import load_room
from homeward.lab.simulation.simulate import PRESETS, load_scenario, scenario_yaml
from homeward.lab.studies.blocks.store import BlockStore
from homeward.lab.studies.study.plan import load_study, make_plan
from homeward.registry import make_estimator
from homeward.runs.single_run import load_run
from homeward.vision.cameras.image_files import read_grey
from homeward.vision.recorded.settings import read_image_settings

MAX_S = 30.0
"""Maximum processor time of a case; on a busy machine it may take `MAX_WAIT` times as long [s]."""
MAX_WAIT = 10.0
MAX_MEMORY = 2 * 2**30  # in addition to the memory of the process at its start [bytes]
SPOILERS = {
    "binary": [b"\xff" * 4, b"\x00" * 8, b"\xff\xff\xff\x7f", b"\x80", b"\x01", b"\n"],
    "numbers": [b"nan", b"inf", b"-1", b"1e308", b"1e999", b"9" * 5000, b"0x" + b"f" * 40, b"1j"],
    "text": [b"\x1b[31m", "\u202e".encode(), b"\xed\xa0\x80", b"$\\frac$", b"=cmd()", b"x" * 3000],
    "csv": [b",", b'"', b"\r", b"\n\n", b",,", b" "],
    "yaml": [b"[" * 60, b"{", b"}", b": ", b"- ", b"&a ", b"*a", b"<<: ", b"!!int ", b"!!float x",
             b"!!timestamp x", b"2001-99-99", b"~", b"|\n", b"? ", b"---\n", b"%", b"\t", b'"\\0"'],
    "definition": [b"p/T ", b"[]", b"[0]", b"[9999]", b"<=3", b"sequence<", b">", b"(", b"<<", b"*",
                   b"module ", b"struct ", b"const ", b"{", b"};", b"::", b"@a(", b"//", b"/*",
                   b"=" * 80 + b"\n", b"MSG: ", b"float64 ", b"__class__", b"string "],
}  # fmt: skip
TWIST = b"\x00\x01\x00\x00" + struct.pack("<iIIBxxx3d", 1, 0, 1, 0, 0.0, 0.1, 0.0)
PAYLOADS = {"msg": TWIST, "idl": TWIST + struct.pack("<3dI", 1, 2, 3, 0)}
"""A message of `DEFINITIONS`, and one of `CODE`."""
CODE = b"""\
module homeward_msgs { module msg {
  module Odometry_Constants { const long A = -3; };
  typedef double double__3[3];
  @verbatim (language="comment", text="a " "twist")
  struct Odometry { std_msgs::msg::Header header; double residue; @unit (value="m/s") double v;
    double omega; double__3 more; sequence<string, 4> names; };
}; };
"""


@dataclass(frozen=True)
class Part:
    """One reader, valid inputs, and suitable kinds of corruption, or a generator of cases."""

    valid: Callable[[], list[bytes]]
    read: Callable[[bytes, Path], Any]  # reads the bytes, in an empty folder
    spoilers: tuple[str, ...] = ()
    made: Callable[[int], bytes] | None = None
    """Returns the case of a seed; None: a valid input, corrupted."""


def small_drive() -> Drive:
    """Return a drive of two seconds."""
    t = np.arange(20) / 10
    ids = np.array(["a", "crate 7"] * 10, object)
    seen = Sightings(t, ids, np.linspace(-1, 1, 20), np.full(20, 0.01))
    home = {"a": HomeBearing(0.1), "crate 7": HomeBearing(-1.0, 0.01)}
    truth = Truth(t, t * 0.1, t * 0, t * 0)
    settings = DriveSettings.model_validate(
        {"sensor": {"x": 0.2}, "start": {"R": 1, "theta": 0, "alpha": 0}}
    )
    return Drive("x", Odometry(t, t * 0 + 0.1, t * 0), seen, home, settings, truth)


def _saved(suffix: str) -> list[bytes]:
    with tempfile.TemporaryDirectory() as folder:
        save_drive(small_drive(), path := Path(folder) / f"x{suffix}")
        return [path.read_bytes()]


def _log(data: bytes, folder: Path) -> None:
    (path := folder / "log").write_bytes(data)
    open_drive(path)


def _bag_folder(data: bytes, folder: Path) -> None:
    (folder / "x.db3").write_bytes(valid("db3")[0])
    (folder / "metadata.yaml").write_bytes(data)
    open_drive(folder)


def _definition(syntax: str, definition: bytes, folder: Path) -> None:
    text = definition.decode("utf-8", "replace")
    Decoder().decode(Channel("/t", ODOMETRY, "cdr", text, syntax), PAYLOADS[syntax])


def _definitions() -> list[bytes]:
    parts = (
        "std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id",
        "builtin_interfaces/Time\nint32 sec\nuint32 nanosec",
    )
    text = DEFINITIONS[ODOMETRY] + "".join("=" * 80 + "\nMSG: " + part + "\n" for part in parts)
    return [text.encode()]


@cache
def _files_of_drive() -> dict[str, bytes]:
    with tempfile.TemporaryDirectory() as folder:
        save_drive(small_drive(), place := Path(folder) / "drive")
        return {file.name: file.read_bytes() for file in place.iterdir()}


def _in_folder(spoilt_name: str, data: bytes, folder: Path) -> None:
    for name, content in _files_of_drive().items():
        (folder / name).write_bytes(data if name == spoilt_name else content)
    open_drive(folder)


def _settings(data: bytes, folder: Path) -> None:
    """Pass the file to every reader of settings, as if files were mixed up."""
    (path := folder / "settings.yaml").write_bytes(data)
    readers: tuple[Callable[[], Any], ...] = (
        lambda: settings_yaml(read_settings(path, DriveSettings)),
        lambda: settings_yaml(read_settings(path, LogSettings)),
        lambda: scenario_yaml(load_scenario(str(path))),
        lambda: load_room(str(path)),
        lambda: load_plan(str(path)),
        lambda: BlockStore(
            folder / "out", make_plan(load_study(str(path))).study.model_dump(mode="json"), "m"
        ),
        lambda: load_run(path),
        lambda: read_image_settings(path),
    )
    for read in readers:
        try:
            read()
        except HomewardError:
            continue


def _all_settings() -> list[bytes]:
    drive = settings_yaml(small_drive().settings)
    topics = "odometry: {topic: /odom}\nbearings: [{topic: /tags, camera: /info}]\nclock: receive\n"
    run = "drive: sample\nestimator: robust\nsettings: {gate: 3.0}\nstart: [1, 0, 0]\n"
    study = "runs: 2\nscenario: paper-homing\ngrid: {noise.bearing_sigma: [0.01, 0.02]}\n"
    study += "estimators: [robust, {estimator: ekf, label: x, grid: {guard: [0.01]}}]\n"
    images = "camera: {model: cylindrical}\nhome: home.png\nlandmarks: 20\n"
    scenes = scenario_yaml(PRESETS["warehouse"]), scenario_yaml(load_room("living-room"))
    texts = [drive, topics, run, study, images, *scenes]
    shipped_files = [*shipped_yaml("plans").values(), *shipped_yaml("studies").values()]
    return [text.encode() for text in texts] + [file.read_bytes() for file in shipped_files]


def _pictures() -> list[bytes]:
    picture = Image.fromarray(np.random.default_rng(0).integers(0, 255, (32, 64), np.uint8))
    packed = []
    for kind in ("PNG", "JPEG", "BMP", "TIFF", "PPM", "WEBP", "GIF"):
        picture.save(out := io.BytesIO(), kind)
        packed.append(out.getvalue())
    return packed


def _picture(data: bytes, folder: Path) -> None:
    (path := folder / "x").write_bytes(data)
    read_grey(path)


def _block(data: bytes, folder: Path) -> None:
    store = BlockStore(folder / "out", {"runs": 1}, "study.yaml")
    (folder / "out" / "blocks" / "b.npz").write_bytes(data)
    assert ("b" in store) in (True, False)


def _blocks() -> list[bytes]:
    with tempfile.TemporaryDirectory() as folder:
        store = BlockStore(Path(folder) / "out", {"runs": 1}, "study.yaml")
        store.save("b", {"x": np.arange(10.0), "words": np.array(["", "why"])})
        return [(Path(folder) / "out" / "blocks" / "b.npz").read_bytes()]


MRCLAM = {
    "Barcodes.dat": b"1 5\n2 14\n6 72\n7 27\n",
    "Landmark_Groundtruth.dat": b"6 1.0 2.0 0.1 0.1\n7 -1.0 2.0 0.1 0.1\n",
    "Robot1_Odometry.dat": b"0.0 0.1 0.0\n1.0 0.1 0.0\n2.0 0.1 0.0\n",
    "Robot1_Measurement.dat": b"0.5 72 1.0 0.3\n0.9 27 1.2 -0.3\n1.5 14 1.0 0.1\n",
    "Robot1_Groundtruth.dat": b"0.0 0 0 0\n1.0 0.1 0 0\n",
}


def _mrclam(data: bytes, folder: Path) -> None:
    named = data.partition(b"\n")[0].decode("ascii", "replace").removeprefix("# ")
    for name, text in MRCLAM.items():
        (folder / name).write_bytes(data if name == named else text)
    read_mrclam(folder, 1, Pose(0.0, 0.0, 0.0))


def _of_mrclam() -> list[bytes]:
    return [b"# " + name.encode() + b"\n" + text for name, text in MRCLAM.items()]


def _estimator(data: bytes, folder: Path) -> None:
    """Pass numbers and other values in any order; every estimate must be finite."""
    chance = random.Random(data)
    odd = [math.nan, math.inf, 1e308, -1e308, 10**400, 1j, None, "x", [1.0], np.float32(1), True]
    estimator = make_estimator(chance.choice(["robust", "ekf"]), small_drive(), {})
    t = 0.0
    for _ in range(30):
        t += chance.choice([0.1, 0.1, 0.1, -0.5, 0.0, 1e6])
        a, b, c = (
            chance.choice(odd) if chance.random() < 0.1 else chance.uniform(-2, 2) for _ in "abc"
        )
        at = chance.choice(odd) if chance.random() < 0.05 else t
        try:
            if chance.random() < 0.5:
                estimator.odometry(at, a, b)
            else:
                answer = estimator.bearings(at, {"a": a, "crate 7": b}, {"a": c})
                assert answer.covariance is None or np.isfinite(answer.covariance).all()
        except HomewardError:
            continue
    assert len(estimator.landmarks()) >= 2
    estimator.estimate(t)


def _csv(name: str) -> Part:
    return Part(
        lambda: [_files_of_drive()[name]],
        lambda data, folder: _in_folder(name, data, folder),
        ("csv", "numbers", "text"),
    )


PARTS = {
    "bag": Part(lambda: _saved(".bag"), _log, ("binary", "definition")),
    "mcap": Part(lambda: _saved(".mcap"), _log, ("binary",)),
    "db3": Part(lambda: _saved(".db3"), _log, ("binary", "definition")),
    "wpilog": Part(lambda: [small_log()], _log, ("binary",)),
    "metadata": Part(
        lambda: [b"rosbag2_bagfile_information:\n  version: 5\n  relative_file_paths: [x.db3]\n"
                 b"  compression_mode: ''\n  compression_format: ''\n"],
        _bag_folder, ("yaml", "text"),
    ),
    "msg": Part(_definitions, lambda d, f: _definition("msg", d, f), ("definition", "numbers")),
    "idl": Part(lambda: [CODE], lambda d, f: _definition("idl", d, f), ("definition", "numbers")),
    "odometry": _csv("odometry.csv"),
    "bearings": _csv("bearings.csv"),
    "home": _csv("home.csv"),
    "drive": _csv("drive.yaml"),
    "mrclam": Part(_of_mrclam, _mrclam, ("csv", "numbers", "text")),
    "settings": Part(_all_settings, _settings, ("yaml", "numbers", "text")),
    "pictures": Part(_pictures, _picture, ("binary",)),
    "block": Part(_blocks, _block, ("binary",)),
    "estimator": Part(lambda: [b"x"], _estimator, ("binary",)),
    "sessions": Part(
        lambda: [fuzz_sessions.clean()], fuzz_sessions.play, made=fuzz_sessions.changed
    ),
}  # fmt: skip
ONCE_FAILED = {"db3": (164, 287), "estimator": (0, 5), "sessions": (16, 42)}
"""Seeds of earlier failures, by part; `tests/test_fuzz.py` repeats them."""


@cache
def valid(name: str) -> list[bytes]:
    return PARTS[name].valid()


def spoilt(name: str, seed: int) -> bytes:
    if (made := PARTS[name].made) is not None:
        return made(seed)
    chance = random.Random(f"{name} {seed}")
    data = bytearray(chance.choice(valid(name)))
    fillings = [f for kind in PARTS[name].spoilers for f in SPOILERS[kind]]
    for _ in range(chance.choice([1, 1, 2, 4, 8])):
        at = chance.randrange(len(data) + 1)
        end = min(len(data), at + chance.choice([0, 1, 2, 4, 16, 200]))
        match chance.randrange(6):
            case 0:
                data[at:end] = chance.choice(fillings)
            case 1:  # in place of a word
                words = list(re.finditer(rb"[\w.+-]+", bytes(data)))
                if words:
                    word = chance.choice(words)
                    data[word.start() : word.end()] = chance.choice(fillings)
            case 2:
                data[at:end] = bytes(data[at:end]) * chance.choice([2, 3, 100])
            case 3:
                data[at:end] = bytes(chance.randrange(256) for _ in range(end - at))
            case 4:
                data[at:end] = b""
            case _:
                del data[max(at, 1) :]
    return bytes(data)


class TooLong(BaseException):
    """A case exceeds its time."""


@contextmanager
def within(seconds: float) -> Iterator[None]:
    """Raise `TooLong` in the block after some seconds of processor time, or `MAX_WAIT` of them."""

    def ring(*_: object) -> None:
        raise TooLong

    timers = {
        signal.SIGPROF: (signal.ITIMER_PROF, seconds),
        signal.SIGALRM: (signal.ITIMER_REAL, MAX_WAIT * seconds),
    }
    before = {number: signal.signal(number, ring) for number in timers}
    for timer, limit in timers.values():
        signal.setitimer(timer, limit)
    try:
        yield
    finally:
        for number, (timer, _) in timers.items():
            signal.setitimer(timer, 0)
            signal.signal(number, before[number])


def try_case(name: str, seed: int) -> str:
    """Return the outcome of a case: read, refused, or a description of the failure."""
    data = spoilt(name, seed)
    with tempfile.TemporaryDirectory() as folder:
        try:
            with within(MAX_S):
                PARTS[name].read(data, Path(folder))
            return "read"
        except HomewardError as error:
            one_line = len(str(error).splitlines()) == 1 and str(error).isprintable()
            return "refused" if one_line else f"more than a line: {error}"
        except TooLong:
            return f"more than {MAX_S:g} s"
        except Exception as error:
            places = traceback.extract_tb(error.__traceback__)
            place = ([p for p in places if "homeward" in p.filename] or places)[-1]
            return f"{type(error).__name__} at {place.filename}:{place.lineno}: {error}"[:300]


def main() -> int:
    options = monte_carlo.parsed(__doc__, part=PARTS, runs=2000, first=0)
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    most = pages * resource.getpagesize() + MAX_MEMORY
    resource.setrlimit(resource.RLIMIT_AS, (most, most))
    failures = 0
    for name in options.part:
        begin, came, slowest = time.perf_counter(), Counter[str](), (0.0, 0)
        for seed in range(options.first, options.first + options.runs):
            start = time.perf_counter()
            outcome = try_case(name, seed)
            slowest = max(slowest, (time.perf_counter() - start, seed))
            came[outcome if outcome in ("read", "refused") else "failed"] += 1
            if outcome not in ("read", "refused"):
                failures += 1
                repeat = f"--part {name} --first {seed} --runs 1"
                print(f"{name} {seed}: {outcome} ({repeat})", flush=True)
        took = time.perf_counter() - begin
        figures = ", ".join(f"{number:,} {what}" for what, number in sorted(came.items()))
        print(
            f"{name}: {figures} in {took:.0f} s, slowest {slowest[0]:.2f} s (seed {slowest[1]})",
            flush=True,
        )
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
