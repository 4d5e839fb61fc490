"""Home stored by a turn on the spot, or by several looks, while the session goes."""

import math

import pytest
from drives.home.turning import TOLD, turned
from live_rig import Rig, driving

from homeward import HomeScan, InputError, Localizer
from homeward.drives.settings import DriveSettings, Sensor
from homeward.estimator import Status
from homeward.geometry.angles import wrap
from homeward.live.home_capture import HomeCapture
from homeward.live.messages import (
    Answer,
    BearingsIn,
    Cancel,
    EStop,
    EventOut,
    GoHome,
    GoTo,
    LookRound,
    OdometryIn,
    SetHome,
    StoreHome,
    TurnHome,
)
from homeward.live.place_session import PlaceSession
from homeward.live.recording import SESSION, Recorder, read_drive, replay
from homeward.live.session import Session
from homeward.live.settings import LiveSettings

NARROW = {
    "trajectory.spin": 0.5,
    "landmarks.count": 16,
    "visibility.field_of_view": 1.2,
}


HOME = SetHome(bearings={"a": 0.1, "b": 1.5, "c": -2.0})


def events(rig):
    return [e.text for e in rig.answers if isinstance(e, EventOut)]


def test_a_turn_about_a_point_beside_the_centre_moves_the_robot_sideways():
    """The centre is at the camera, 0.12 m ahead of that point."""
    ahead = Sensor(x=0.12, bearing_sigma=0.009)
    odometry, sightings, true = turned(3, sensor=ahead, view=math.tau)
    capture = HomeCapture()
    capture.begin(DriveSettings(sensor=Sensor(bearing_sigma=0.009), odometry=TOLD))
    frames = list(sightings.stamps())
    for t, omega in zip(odometry.t.tolist(), odometry.omega.tolist(), strict=True):
        capture.odometry(t, OdometryIn(t=t, v=0.0, omega=omega, vy=0.12 * omega))
        while frames and frames[0][0] <= t:
            stamp, seen, _ = frames.pop(0)
            capture.bearings(stamp, BearingsIn(t=stamp, bearings=seen))
    found, *_ = capture.captured()
    assert max(abs(wrap(b.bearing - true[name])) for name, b in found.items()) < 0.02


def test_a_robot_that_sees_seventy_degrees_turns_once_at_home_and_finds_back(tmp_path):
    robot = Rig(0, **NARROW).robot.drive.settings
    recorder = Recorder(tmp_path / "drive", LiveSettings(), robot, {})
    rig = Rig(0, keep=recorder.keep, **NARROW)
    rig.until(lambda r: events(r))
    assert "home 'home' is stored: 16 home bearings from a rotation of 37" in events(rig)[0]
    turned = rig.robot.t
    assert 12.0 < turned < 16.0
    assert all(c.v == 0.0 and 0.0 <= c.omega <= 0.5 for _, c in rig.commands)
    rig.until(lambda r: r.player.ending, 110.0)
    assert rig.player.ending.state == "arrived", rig.player.ending
    assert rig.robot.distance < 0.06
    recorder.close()
    file = tmp_path / "drive" / SESSION
    answers = sum(isinstance(a, Answer) for a in rig.answers)
    assert replay(file) == (answers, None)
    drive = read_drive(file)
    assert len(drive.home) == 16
    assert drive.odometry.t[0] == pytest.approx(turned, abs=0.1)


def test_frames_that_are_late_at_the_end_of_a_turn_do_not_displace_the_robot():
    rig, waiting = Rig(0, settings=LiveSettings(bearings_timeout=0.4), **NARROW), []

    def late(message):
        """Deliver frames late by 0.4 s."""
        if isinstance(message, BearingsIn):
            waiting.append(message)
            return []
        out = [message]
        while isinstance(message, OdometryIn) and waiting and message.t - waiting[0].t > 0.39:
            out.append(waiting.pop(0))
        return out

    rig.spoil, home = late, rig.robot.pose
    rig.until(events)
    assert "16 home bearings from a rotation of 36" in events(rig)[0]
    start = rig.session.localisation.drive.settings.start
    error = wrap(rig.robot.pose.heading - home.heading - start.alpha)
    # The robot has turned for two periods since the last twist at 0.5 rad/s.
    assert abs(error) < 2 * rig.robot.period * 0.5 + 3 * start.sigma_alpha


@pytest.mark.parametrize("message", [Cancel(), EStop(engaged=True)])
def test_a_turn_that_is_broken_off_stores_nothing(message):
    rig = Rig(1, **NARROW).until(lambda r: r.robot.t > 3.0)
    assert rig.commands[-1][1].state == "driving"
    rig.session.receive(message, rig.robot.t)
    rig.step()
    assert rig.standing()
    assert rig.commands[-1][1].state == "failed"
    assert rig.session.localisation.homes == {}
    rig.session.receive(EStop(engaged=False), rig.robot.t)
    rig.session.receive(GoHome(), rig.robot.t)
    for _ in range(50):
        rig.step()
        assert rig.standing()


def test_who_is_sent_elsewhere_looks_at_home_no_more():
    session = Session()
    session.receive(HOME, 0.0)
    session.receive(LookRound(), 0.0)
    session.receive(GoTo(x=1.0, y=0.0), 0.0)
    for k in range(60):
        t, v = 0.1 * k, 0.5 if k < 30 else 0.0
        session.receive(OdometryIn(t=t, v=v, omega=0.0), t)
        session.receive(BearingsIn(t=t, bearings={"a": 0.1, "b": 0.02 * min(k, 30)}), t)
    session.receive(StoreHome(name="there"), 6.0)
    said = [out for out in session.process() if isinstance(out, EventOut)]
    assert said[-1].text == "home 'there' has two landmarks"  # of the last second, standing


def test_a_robot_that_drives_away_meanwhile_gets_no_home_and_an_error():
    session = Session()
    session.receive(LookRound(), 0.0)
    for k in range(100):
        session.receive(OdometryIn(t=0.1 * k, v=0.2, omega=0.1), 0.1 * k)
        session.receive(BearingsIn(t=0.1 * k, bearings={"a": 0.1 * k}), 0.1 * k)
        list(session.process())
    session.receive(StoreHome(), 10.0)
    (said,) = session.process()
    assert (said.type, said.text[:24]) == ("error", "the robot does not turn ")
    assert session.localisation.homes == {}


def short_looks(take, bearings, view=1.0):
    """Stand and look 1 s, turn by 45 deg, and so on, once round; what each sample is given to."""
    heading, t = 0.0, 0.0
    for _ in range(9):
        for k in range(40):
            omega = math.pi / 4 if k >= 20 else 0.0
            take(OdometryIn(t=t, v=0.0, omega=omega))
            if k < 20 and k % 2 == 0:
                seen = {i: math.remainder(b - heading, math.tau) for i, b in bearings.items()}
                seen = {i: b for i, b in seen.items() if abs(b) < view / 2}
                take(BearingsIn(t=t, bearings=seen))
            heading += 0.05 * omega
            t += 0.05


BEARINGS = {str(k): math.remainder(0.3 + 0.7 * k, math.tau) for k in range(9)}


def test_several_short_looks_are_a_home_too():
    session = Session()
    session.receive(LookRound(), 0.0)

    def take(message):
        session.receive(message, message.t)
        list(session.process())

    short_looks(take, BEARINGS)
    session.receive(StoreHome(name="dock"), 99.0)
    (said,) = session.process()
    assert said.text.startswith("home 'dock' is stored: 9 home bearings from a rotation of 3")
    home = session.localisation.homes["dock"]
    assert {i: h.bearing for i, h in home.items()} == pytest.approx(BEARINGS, abs=0.01)
    assert session.localisation.fix.estimate.status is Status.WAITING


def test_from_python():
    looks = HomeScan(sensor={"bearing_sigma": 0.01})

    def take(message):
        if isinstance(message, OdometryIn):
            looks.odometry(message.t, message.v, message.omega)
        else:
            looks.bearings(message.t, message.bearings)

    short_looks(take, BEARINGS)
    home = looks.home()
    assert {i: h.bearing for i, h in home.items()} == pytest.approx(BEARINGS, abs=0.01)
    Localizer(home, sensor={"bearing_sigma": 0.01})


def test_looks_at_no_time_are_left_out():
    looks = HomeScan()
    looks.odometry(math.nan, 0.0, 0.0)
    for k in range(200):
        turned = 0.03 * k
        looks.odometry(0.05 * k, 0.0, 0.6)
        looks.bearings(
            0.05 * k, {"door": float(wrap(1.0 - turned)), "desk": float(wrap(-2.0 - turned))}
        )
    assert looks.home()["door"].bearing == pytest.approx(1.0, abs=0.01)


def test_looks_that_never_end_are_refused_and_so_are_none():
    looks = HomeScan()
    with pytest.raises(InputError, match="no bearings or no odometry"):
        looks.home()
    for k in range(80):
        looks.odometry(10.0 * k, 0.0, 0.0)
    with pytest.raises(InputError, match="more than 600 s"):
        looks.home()


def test_a_turn_replaces_the_drive_home():
    rig = Rig(2, **NARROW).until(driving, 110.0)
    rig.session.receive(TurnHome(name="other"), rig.robot.t)
    rig.step()
    assert rig.commands[-1][1].v == 0.0
    replaced = len(rig.commands)
    rig.until(lambda rig: rig.state == "turned")
    end = rig.robot.t + 2.0
    rig.until(lambda rig: rig.robot.t > end)
    assert {command.v for _, command in rig.commands[replaced:]} == {0.0}


def test_the_first_home_of_a_place_may_be_one_of_a_turn_and_the_next_ones_are_in_its_map():
    rig = Rig(3, place=PlaceSession("hall", 20000.0, True), **NARROW).until(driving, 110.0)
    assert "home 'home' is stored" in events(rig)[0]
    rig.session.receive(LookRound(), rig.robot.t)
    rig.session.receive(StoreHome(name="dock"), rig.robot.t)
    rig.step()
    assert "home 'dock' stored" in events(rig)[-1]
    assert rig.session.localisation.place.homes == ("dock",)
