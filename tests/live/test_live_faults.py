"""Errors that nobody expects, full disks, and absurd numbers: the session goes on."""

import errno
import json
import math
import subprocess
import sys

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from live_rig import Rig, driving, texts

from homeward.drives.drive import HomeBearing
from homeward.errors import InternalError
from homeward.estimator import Status
from homeward.live.localisation import MAX_HOMES
from homeward.live.messages import (
    MAX_LENGTH,
    MAX_SIGMA,
    MAX_SPEED,
    MIN_SIGMA,
    BearingsIn,
    EventOut,
    GoHome,
    OdometryIn,
    SetHome,
    parse,
)
from homeward.live.recording import Recorder, replay
from homeward.live.session import Session
from homeward.localizer.localizer import Localizer

HOME = {"a": 0.1, "b": 1.0, "c": 2.0}


def said(session):
    return [out.text for out in session.process() if isinstance(out, EventOut)]


def test_an_unexpected_error_fails_the_goal_and_begins_the_map_again(monkeypatch):
    rig = Rig().until(driving)
    before = rig.session.localisation.estimator

    def broken(*_):
        raise IndexError("tuple index out of range")

    monkeypatch.setattr(before, "bearings", broken)
    rig.until(lambda rig: rig.state == "failed", 5.0)
    (text,) = [text for text in texts(rig) if "internal error" in text]
    assert text == "internal error, the map was begun again: IndexError: tuple index out of range"
    assert rig.session.driver.reason == text
    assert rig.standing()
    assert rig.session.localisation.estimator is not before
    rig.until(lambda rig: rig.session.localisation.fix.estimate.status is Status.MAPPING)


def test_a_map_that_cannot_be_begun_again_waits_for_a_home(monkeypatch):
    session = Session(homes={"home": {i: HomeBearing(b) for i, b in HOME.items()}})

    def broken(*_):
        raise ZeroDivisionError

    monkeypatch.setattr(session.localisation.estimator, "odometry", broken)
    monkeypatch.setattr("homeward.live.localisation.make_estimator", broken)
    session.receive(OdometryIn(t=0.0, v=0.0, omega=0.0), 0.0)
    assert "internal error" in said(session)[0]
    assert session.localisation.estimator is None
    monkeypatch.undo()
    session.receive(SetHome(bearings=HOME), 0.1)
    assert said(session) == ["home 'home' has three landmarks"]
    assert isinstance(session.localisation.estimator, Localizer)


@pytest.mark.parametrize("where", ["receive", "tick"])
def test_an_unexpected_error_of_the_quick_side_fails_the_drive(monkeypatch, where):
    rig = Rig().until(driving)

    def broken(*_):
        raise ValueError("math domain error")

    with monkeypatch.context() as broke:
        broke.setattr(rig.session._twists, "add" if where == "receive" else "pose", broken)
        twist = OdometryIn(t=rig.robot.t, v=0.0, omega=0.0)
        quick = {"receive": lambda: rig.session.receive(twist, rig.robot.t)}
        quick["tick"] = lambda: rig.session.tick(rig.robot.t)
        with pytest.raises(InternalError, match="math domain error"):
            quick[where]()
    assert rig.state == "failed"
    rig.step()
    assert rig.standing()


class FullDisk:
    """A file on a disk that is full after some lines."""

    def __init__(self, file, lines):
        self._file, self._left = file, lines

    def write(self, text):
        self._left -= 1
        if self._left < 0:
            raise OSError(errno.ENOSPC, "No space left on device")
        self._file.write(text)

    def flush(self):
        self._file.flush()

    def close(self):
        self._file.close()


def test_a_full_disk_ends_the_recording_and_not_the_session(tmp_path):
    rig = Rig()
    settings_of = rig.session.settings, rig.robot.drive.settings, {}
    recorder = Recorder(tmp_path / "r", *settings_of)
    recorder._file = FullDisk(recorder._file, 100)
    rig.session.watch(recorder.keep)
    rig.until(driving)
    (text,) = [text for text in texts(rig) if "recording" in text]
    assert "No space left on device" in text
    assert "No space left on device" in recorder.close()
    same, other = replay(tmp_path / "r" / "session.jsonl")
    assert same > 10
    assert other in (None, "none")


def test_homes_are_bounded():
    session = Session()
    for k in range(MAX_HOMES + 5):
        session.receive(SetHome(bearings=HOME, name=f"home {k}"), 0.0)
        words = said(session)
    assert words == [f"already {MAX_HOMES} homes; replace one of them by its name"]
    assert len(session.localisation.homes) == MAX_HOMES
    session.receive(SetHome(bearings={"a": 0.3}, name="home 3"), 0.0)
    assert said(session) == ["home 'home 3' has one landmark"]


def extreme(largest):
    some = [0.0, -largest, largest, 1e-300, -1e-9, 1.0, 0.01 * largest]
    return st.sampled_from(some) | st.floats(-largest, largest)


LENGTH, SPEED = extreme(MAX_LENGTH), extreme(MAX_SPEED)
SIGMA = st.sampled_from([MIN_SIGMA, MAX_SIGMA, 1.0]) | st.floats(MIN_SIGMA, MAX_SIGMA)
SEEN = st.dictionaries(st.sampled_from("abcde"), LENGTH, max_size=5)
KINDS = {
    "odometry": {"v": SPEED, "omega": SPEED},
    "bearings": {"bearings": SEEN},
    "home": {"bearings": SEEN},
    "start": dict.fromkeys(("x", "y", "heading"), LENGTH)
    | dict.fromkeys(("sigma", "sigma_heading"), SIGMA),
    "mount": dict.fromkeys(("x", "y"), extreme(20.0)) | {"yaw": extreme(math.tau)},
    "go_to": dict.fromkeys(("x", "y"), LENGTH),
    **{kind: {} for kind in ("look_round", "store_home", "turn_home", "go_home", "reset")},
}
MESSAGE = st.one_of(
    *(st.fixed_dictionaries({"type": st.just(kind), **keys}) for kind, keys in KINDS.items())
)
STEP = st.sampled_from([0.0, 0.02, 0.1, 1.0, 100.0, -5.0, 1e9])


@settings(max_examples=40, deadline=None, suppress_health_check=list(HealthCheck))
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@given(st.lists(st.tuples(STEP, MESSAGE), min_size=3, max_size=20))
def test_no_message_with_extreme_numbers_ends_a_session(script):
    session, t = Session(), 0.0
    session.receive(SetHome(bearings=HOME), 0.0)
    for k, (step, message) in enumerate(script):
        if abs(t + step) < 1e10:
            t += step
        stamp = {"t": t} if message["type"] in ("odometry", "bearings") else {}
        session.receive(parse(json.dumps(message | stamp)), 0.02 * k)
        list(session.process())
        session.tick(0.02 * k)
        session.diagnostics(0.02 * k)


def test_the_field_s_absurd_messages_end_no_process(data_dir):
    files = sorted((data_dir / "field" / "25-live-faults").glob("*.jsonl"))
    if not files:
        pytest.skip("no field cases")
    command = [sys.executable, "-m", "homeward", "live"]
    text = "".join(file.read_text() for file in files)
    done = subprocess.run(command, input=text, capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stderr) == (0, "")
    assert "must be at most 10000" in done.stdout


def test_an_error_while_a_line_is_taken_leaves_no_deaf_process(tmp_path):
    code = (
        "from homeward.live import session\n"
        "class Broken(session.TwistHistory):\n"
        "    def add(self, *_): raise ValueError('math domain error')\n"
        "session.TwistHistory = Broken\n"
        "from homeward.cli.main import app\n"
        "app()\n"
    )
    lines = [OdometryIn(t=0.1, v=0.0, omega=0.0), BearingsIn(t=0.1, bearings={}), GoHome()]
    text = "".join(m.model_dump_json() + "\n" for m in lines)
    command = [sys.executable, "-c", code, "live"]
    done = subprocess.run(command, input=text, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    assert "math domain error" in done.stdout
    assert '"type":"estimate"' in done.stdout
