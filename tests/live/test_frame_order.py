"""Frames that are late, repeated or empty, and clocks that are set back, in a live session."""

import json
import math

import numpy as np
import pytest
from live_rig import QUICK, Rig, driving

from homeward.control.driver import Driver
from homeward.control.goals import Belief, PointGoal
from homeward.control.limits import Limits
from homeward.drives.settings import DriveSettings
from homeward.estimator import Status
from homeward.geometry.frames import Pose
from homeward.live.home_capture import HomeCapture
from homeward.live.messages import Answer, BearingsIn, EventOut, OdometryIn, SetExtrinsics, parse
from homeward.live.session import Session
from homeward.odometry.validity import Clock
from homeward.reasons import Reason, Rejection

SEEN = {"a": 0.1, "b": 1.5, "c": -2.0}
HOME = {"type": "home", "bearings": SEEN}


def play(session, messages, now=0.0):
    """Outputs of a session for messages."""
    out = []
    for message in messages:
        session.receive(message, now)
        out += session.process()
    return out


def errors(outputs):
    return [out.text for out in outputs if isinstance(out, EventOut) and out.type == "error"]


def moving(t, camera="", **changes):
    """An odometry sample and a frame of a robot that turns."""
    sample = OdometryIn(t=t, v=0.2, omega=0.5)
    return [sample, BearingsIn(t=t, bearings=SEEN, camera=camera, **changes)]


def test_frames_out_of_order_that_repeat_a_bearing_are_no_error():
    session = Session()
    out = play(session, [parse(json.dumps(HOME))])
    for k in range(6):
        t, seen = 0.1 * k, {n: round(b - 0.05 * k, 2) for n, b in SEEN.items()}
        frame = BearingsIn(t=t, bearings=seen)
        late = BearingsIn(t=t - 0.02, bearings=seen)
        out += play(session, [OdometryIn(t=t, v=0.2, omega=0.5), frame, late])
    assert errors(out) == []
    assert len([o for o in out if isinstance(o, Answer)]) == 12
    assert session.localisation.estimator.counts.rejected[Rejection.LATE_BEARINGS] == 18


@pytest.mark.parametrize(("name", "localised"), [("frozen_math", 0), ("swapped_frames", 20)])
def test_the_field_s_frames_out_of_order_are_no_error(data_dir, name, localised):
    file = data_dir / "field" / "42-frames-out-of-order" / f"{name}.jsonl"
    if not file.is_file():
        pytest.skip("no field case 42")
    session, out = Session(), []
    for k, line in enumerate(file.read_text().splitlines()):
        out += play(session, [parse(line)], 0.05 * k)
    assert errors(out) == []
    answers = [o for o in out if isinstance(o, Answer)]
    assert sum(a.status is Status.LOCALISED for a in answers) >= localised


def test_a_camera_that_is_later_than_another_one_still_sees_landmarks():
    session = Session(robot=DriveSettings(cameras={"rear": {"yaw": math.pi}}))
    for k in range(40):
        t, away = 0.1 * k, {n: b - 0.05 * k for n, b in SEEN.items()}
        session.receive(OdometryIn(t=t, v=0.2, omega=0.5), t)
        session.receive(BearingsIn(t=t, bearings={}), t)
        session.receive(BearingsIn(t=t - 0.05, bearings=away, camera="rear"), t)
        session.tick(t)
    assert session._unseen.seconds < 0.2


def test_late_frames_do_not_count_as_landmarks_in_view():
    session = Session()
    for k in range(40):
        t = 0.1 * k
        session.receive(OdometryIn(t=t, v=0.2, omega=0.5), t)
        session.receive(BearingsIn(t=t, bearings={}), t)
        session.receive(BearingsIn(t=t - 0.05, bearings={"a": math.sin(k)}), t)
        session.tick(t)
    assert session._unseen.seconds > 3.0


def test_a_frozen_camera_is_detected_in_the_frames_that_are_not_late():
    session = Session()
    for k in range(20):
        t = 0.1 * k
        for message in moving(t):
            session.receive(message, t)
        session.receive(BearingsIn(t=t - 0.15, bearings={"a": math.sin(k)}), t)
    assert Reason.FROZEN.words in [fault.reason for fault in session.faults(1.9)]


def test_ids_and_names_of_cameras_are_not_mixed_up():
    session = Session()
    for k in range(20):
        t = 0.1 * k
        session.receive(OdometryIn(t=t, v=0.0, omega=0.5), t)
        for name, camera in (("a b", "c"), ("a", "b c")):
            seen = {name: 0.3 if camera == "c" else math.sin(k)}
            session.receive(BearingsIn(t=t, bearings=seen, camera=camera), t)
            assert t < 1.0 or session._frozen.is_frozen is (camera == "c")


@pytest.mark.parametrize("yaw", [0.0, math.pi / 2])
def test_extrinsics_that_arrive_live_are_those_of_the_frozen_camera_detector(yaw):
    """Straight ahead, and on a straight path, a working camera may see a bearing for long."""
    session = Session()
    session.receive(SetExtrinsics(yaw=yaw), 0.0)
    for k in range(30):
        t = 0.1 * k
        session.receive(OdometryIn(t=t, v=2.0, omega=0.0), t)
        # With the resolution of earlier bearings, which are finer than the rounding.
        session.receive(BearingsIn(t=t, bearings={"a": -yaw + 1e-5 * (k < 10) * k}), t)
        assert not session._frozen.is_frozen


def with_echo(delay, spoil):
    """Deliver frames late by `delay` [s], and after each what `spoil` makes of it."""
    waiting = []

    def changed(message):
        if isinstance(message, BearingsIn):
            waiting.append(message)
        if not isinstance(message, OdometryIn):
            return [] if isinstance(message, BearingsIn) else [message]
        out = [message]
        while waiting and message.t - waiting[0].t > delay:
            frame = waiting.pop(0)
            out += [frame, *spoil(frame)]
        return out

    return changed


ECHOES = {
    "none": lambda frame: [],
    "repeated": lambda frame: [frame],
    "late": lambda frame: [frame.model_copy(update={"t": frame.t - 0.1})],
    "empty": lambda frame: [frame.model_copy(update={"t": frame.t + 0.001, "bearings": {}})],
}


@pytest.mark.parametrize("echo", ECHOES)
def test_frames_without_effect_do_not_displace_the_robot(echo):
    rig = Rig(1, **QUICK)
    rig.spoil = with_echo(0.25, ECHOES[echo])
    rig.until(driving)
    off = []
    for _ in range(100):
        rig.step()
        pose, true = rig.session.belief(rig.robot.t).pose, rig.robot.pose
        if pose is not None:
            off.append(math.dist(pose[:2], true[:2]))
    assert len(off) > 80
    assert np.median(off) < 0.025


def test_an_answer_to_a_late_frame_is_not_a_lag_of_the_estimator():
    rig = Rig(1, **QUICK).until(driving)
    frame = BearingsIn(t=rig.robot.t - 0.8, bearings={"L1": 0.1})
    now = rig.robot.t
    assert play(rig.session, [frame], now)[0].t == frame.t
    assert rig.session.faults(now) == ()


def test_a_home_of_a_place_has_the_bearings_of_the_newest_stamp():
    capture = HomeCapture()
    for t, bearing in ((1.0, 0.1), (1.2, 0.3), (1.1, 0.2)):
        capture.bearings(t, BearingsIn(t=t, bearings={"a": bearing}))
    assert capture.newest.bearings == {"a": 0.3}


def test_a_clock_that_is_set_back_during_a_turn_at_home_does_not_turn_home():
    """The stamps before and after overlap."""
    capture, clock = HomeCapture(), Clock()
    capture.begin(DriveSettings())
    for k in range(360):
        now = 0.05 * k
        t = now if now < 7.0 else now - 3.0
        capture.odometry(clock.read(t), OdometryIn(t=t, v=0.0, omega=0.5))
        seen = {n: math.remainder(b - 0.5 * now, math.tau) for n, b in SEEN.items()}
        capture.bearings(clock.read(t), BearingsIn(t=t, bearings=seen))
    home = capture.captured().seen
    assert {n: seen.bearing for n, seen in home.items()} == pytest.approx(SEEN, abs=0.05)


def test_the_time_without_a_pose_has_no_number_before_the_first_pose():
    driver = Driver(Limits())
    driver.go(0.0, PointGoal("there", 1.0, 0.0))
    belief = Belief(Status.UNVERIFIED, Pose(0.0, 0.0, 0.0), np.eye(3))
    driver.command(0.02, belief)
    assert (driver.reason, driver.value) == ("lost, not localised: unverified", None)
