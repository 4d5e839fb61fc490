"""Bearings that run clockwise, or turn rates that do: found out, and never where all is right."""

import dataclasses
import math

import numpy as np
import pytest
from rig import Rig, eight, ring, still
from two_cameras import SETTINGS, simulated

from homeward.drives.drive import HomeBearing
from homeward.drives.settings import DriveSettings, Mount, Sensor
from homeward.estimator import Status
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose, Twist, advance
from homeward.localizer.inputs.sign_check import SignCheck
from homeward.localizer.localizer import Localizer
from homeward.localizer.tunables import SIGN_LAGS_S
from homeward.odometry.history import TwistHistory
from homeward.reasons import Reason
from homeward.track import run


def watched(
    law,
    marks,
    noise=0.0,
    gyro=0.0,
    yaw=0.0,
    sign=1.0,
    seconds=60.0,
    off=0.0,
    view=math.tau,
    gain=1,
    vy=0.0,
    turn_scale=1.0,
    aside=1.0,
):
    """Senses after a drive past landmarks, each seen five times a second."""
    rng, sign_check = np.random.default_rng(0), SignCheck(Mount(yaw=yaw))
    x, y, psi, twists = 0.0, 0.0, 0.3, TwistHistory()
    for k in range(round(10 * seconds)):
        t, twist = k / 10, law(k / 10)
        omega = turn_scale * twist.omega + gyro * rng.normal() / math.sqrt(0.1)
        twists.add(t, gain * twist.v, omega, vy=aside * vy)
        if k % 2 == 0:
            d = np.array(marks) - [x, y]
            bearings = np.arctan2(d[:, 1], d[:, 0]) - psi - yaw - off
            bearings = np.array(wrap(bearings + noise * rng.normal(size=len(d))))
            seen = {str(i): sign * float(b) for i, b in enumerate(bearings) if abs(b) < view / 2}
            reckoned = [twists.reckoned(at) for at in (t - SIGN_LAGS_S).tolist()]
            sign_check.bearings(t, seen, np.array(reckoned).T)
        x, y, psi = advance(Pose(x, y, psi), twist, 0.1, vy)
    return sign_check


NEAR = list(ring(12, 0, 0.5, 1.5).values())
FAR = list(ring(12, 1, 3.0, 30.0).values())


def backward(t):
    """A figure of eight, driven backward."""
    return Twist(-0.2, eight(t).omega)


def weave(t):
    """Left and right bends, and straight pieces."""
    return Twist(0.2, 0.4 * math.sin(t / 4.0))


def round_and_round(_):
    """A wide circle to the left."""
    return Twist(0.5, 0.25)


def test_a_sideways_speed_to_the_right_is_named_and_no_yaw():
    found = watched(weave, NEAR, vy=0.2, aside=-1.0)
    assert found.is_wrong
    assert found.is_sideways_reversed
    assert "the sideways speed vy, which is positive to the left" in found.note()
    assert "yaw" not in found.note()
    assert "vy" not in watched(weave, NEAR, yaw=0.0, off=1.5).note()
    right = watched(weave, NEAR, vy=0.2)
    assert right.is_sideways_confirmed
    assert not right.is_wrong


@pytest.mark.parametrize("law", [eight, round_and_round, weave, backward])
@pytest.mark.parametrize("vy", [-0.2, 0.02, 0.2])
@pytest.mark.parametrize("turn_scale", [0.8, 1.0, 1.2])
def test_a_right_sideways_speed_is_never_accused(law, vy, turn_scale):
    found = watched(law, NEAR, 0.02, 0.02, vy=vy, turn_scale=turn_scale)
    assert not found.is_doubtful


@pytest.mark.parametrize("law", [eight, backward, round_and_round, lambda _: Twist(0.0, 0.5)])
@pytest.mark.parametrize("marks", [NEAR, FAR])
@pytest.mark.parametrize("yaw", [0.0, 0.5])
def test_right_bearings_are_right_however_near_the_landmarks(law, marks, yaw):
    assert not watched(law, marks, 0.02, 0.02, yaw).is_reversed


@pytest.mark.parametrize("law", [eight, backward, round_and_round, lambda _: Twist(0.0, 0.5)])
def test_bearings_that_run_clockwise_are_not(law):
    assert watched(law, FAR, 0.02, 0.02, sign=-1.0).is_reversed


@pytest.mark.parametrize("vy", [-0.3, 0.3])
def test_a_robot_that_also_moves_sideways_has_the_yaw_that_it_has(vy):
    for law in (eight, still, lambda _: Twist(0.0, 0.5)):
        assert not watched(law, NEAR, 0.02, 0.02, seconds=30.0, vy=vy).is_doubtful


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_noise_of_a_robot_that_stands_is_no_sign(sign):
    assert not watched(still, FAR, noise=0.05, gyro=0.2, sign=sign).is_reversed
    # As much noise hides no sign of one that turns.
    assert watched(eight, FAR, noise=0.05, gyro=0.2, sign=sign).is_reversed is (sign < 0)


def test_a_straight_way_tells_nothing():
    assert not watched(lambda _: Twist(0.3, 0.0), NEAR, 0.02, sign=-1.0).is_reversed


@pytest.mark.parametrize("wrong", ["bearings", "turn rates"])
def test_there_is_no_pose_in_the_mirror_and_the_reason_is_told(wrong):
    rig = Rig(ring(10), promise=None)
    if wrong == "bearings":
        home = {n: HomeBearing(-b.bearing, b.sigma) for n, b in rig.home.items()}
        rig.localizer = Localizer(home, **rig.settings.robot)
        answer = rig.drive(40, see=lambda seen: {n: -b for n, b in seen.items()})
    else:
        feel = rig.localizer.odometry
        rig.localizer.odometry = lambda t, v, omega: feel(t, v, -omega)
        answer = rig.drive(40)
    assert (answer.pose, answer.reason) == (None, Reason.SIGNS_REVERSED.words)
    assert "must be anti-clockwise." in rig.localizer.notes[-1]


def test_a_drive_with_all_signs_right_has_no_such_note():
    rig = Rig(ring(10))
    answer = rig.drive(40)
    assert answer.reason != Reason.SIGNS_REVERSED.words
    assert not any("anti-clockwise" in note for note in rig.localizer.notes)


@pytest.mark.parametrize("law", [eight, backward])
@pytest.mark.parametrize("degrees", [45, 90, -90, 135, 180])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_large_yaw_error_is_measured_in_either_sense(law, degrees, sign):
    sign_check = watched(law, FAR + NEAR, 0.02, 0.02, sign=sign, off=math.radians(degrees))
    assert sign_check.is_wrong
    assert sign_check.is_reversed is (sign < 0)
    error = math.remainder(sign_check.yaw_error - math.radians(degrees), math.tau)
    assert abs(error) < math.radians(15.0)


@pytest.mark.parametrize("off", [-20, 20])
def test_a_small_yaw_error_is_left_to_the_map(off):
    assert not watched(eight, FAR + NEAR, 0.02, 0.02, off=math.radians(off)).is_wrong


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_camera_of_60_degrees_suffices(sign):
    marks = list(ring(40, 2, 2.0, 5.0).values())
    sign_check = watched(weave, marks, 0.01, 0.02, sign=sign, view=math.radians(60.0))
    assert (sign_check.is_wrong, sign_check.is_reversed) == (sign < 0, sign < 0)
    rear = watched(weave, marks, 0.01, 0.02, off=math.pi, view=math.radians(60.0), seconds=120.0)
    assert (rear.is_reversed, abs(rear.yaw_error)) == (False, pytest.approx(math.pi))
    assert "yaw: 3.14159" in rear.note()


def test_a_speed_of_the_wrong_sign_is_named_as_the_other_cause():
    note = watched(eight, FAR + NEAR, 0.02, 0.02, gain=-1).note()
    assert "yaw: 3.14159" in note
    assert "the speed v has the wrong sign" in note


@pytest.mark.parametrize("turn_scale", [0.65, 0.8, 1.25, 1.6])
@pytest.mark.parametrize("law", [weave, lambda t: eight(0.7 * t)])
def test_a_wrong_scale_of_the_yaw_rate_is_no_wrong_yaw(law, turn_scale):
    """It is an error common to all bearings, as of a robot whose odometry is the command."""
    view, marks = math.radians(60.0), list(ring(16, 2, 2.0, 5.0).values())
    given = {"view": view, "turn_scale": turn_scale, "seconds": 300.0}
    assert not watched(law, marks, 0.01, 0.02, **given).is_doubtful
    given = {"turn_scale": turn_scale, "seconds": 60.0}
    for sign, off in ((-1.0, 0.0), (1.0, math.pi)):
        found = watched(law, marks, 0.01, 0.02, sign=sign, off=off, **given)
        assert (found.is_wrong, found.is_reversed) == (True, sign < 0)


@pytest.mark.parametrize("view", [60, 120])
@pytest.mark.parametrize("law", [round_and_round, lambda _: Twist(0.2, 0.4)])
@pytest.mark.parametrize("turn_scale", [0.95, 1.0])
def test_a_circle_contradicts_no_right_yaw(law, view, turn_scale):
    """Another yaw with another scale of the yaw rate fits a circle, too."""
    for seed in range(6):
        marks = list(ring(16, seed, 2.0, 5.0).values())
        given = {"view": math.radians(view), "turn_scale": turn_scale, "seconds": 200.0}
        assert not watched(law, marks, 0.01, 0.02, **given).is_doubtful


@pytest.mark.parametrize("turn_scale", [0.65, 1.6])
def test_odometry_that_turns_too_much_or_too_little_costs_no_pose(turn_scale):
    rig = Rig(ring(10), promise=None)
    feel = rig.localizer.odometry
    rig.localizer.odometry = lambda t, v, omega: feel(t, v, turn_scale * omega)
    rig.drive(60)
    assert Reason.CAMERA_YAW.words not in {answer.reason for answer, _ in rig.answers}
    assert Reason.SIGNS_REVERSED.words not in {answer.reason for answer, _ in rig.answers}


def test_a_wrong_yaw_that_a_rotation_on_the_spot_fits_is_found_once_the_robot_drives():
    def first_on_the_spot(t):
        return Twist(0.0, 0.5) if t < 120.0 else eight(t)

    off = math.pi / 2
    on_the_spot = watched(first_on_the_spot, FAR, 0.02, 0.02, off=off, seconds=120.0)
    assert not on_the_spot.is_doubtful
    assert watched(first_on_the_spot, FAR, 0.02, 0.02, off=off, seconds=180.0).is_wrong


def test_odometry_that_never_turns_decides_nothing():
    rng, sign_check = np.random.default_rng(3), SignCheck(Mount())
    for k in range(600):
        nothing = np.zeros(SIGN_LAGS_S.size)
        reckoned = np.stack([nothing, k / 50 - 0.1 * SIGN_LAGS_S, nothing])
        sign_check.bearings(k / 5, {"a": float(rng.uniform(-3, 3)), "b": k / 20}, reckoned)
    assert not sign_check.is_wrong


@pytest.mark.parametrize(("degrees", "given"), [(90, True), (180, False)])
def test_a_camera_that_looks_elsewhere_gives_no_pose_after_20_s(degrees, given):
    rig, turn = Rig(ring(12), promise=None), math.radians(degrees)
    home = {n: HomeBearing(float(wrap(b.bearing - turn)), b.sigma) for n, b in rig.home.items()}
    sensor = Sensor(x=0.0, y=0.0, yaw=0.0) if given else Sensor(x=0.0, y=0.0)
    rig.localizer = Localizer(home, **rig.settings.robot | {"sensor": sensor})
    answer = rig.drive(30, see=lambda seen: {n: float(wrap(b - turn)) for n, b in seen.items()})
    assert answer.reason == Reason.CAMERA_YAW.words
    assert f"they fit {degrees} degrees" in rig.localizer.notes[-1]
    localised = [a for a, _ in rig.answers if a.status is Status.LOCALISED and a.t > 120.0]
    assert not localised


def answered(drive):
    """Status and reason at the end of a drive of two cameras, and the notes."""
    localizer = Localizer(drive.home, **drive.settings.robot)
    track = run(drive, localizer)
    return track.status[-1], track.reason[-1], localizer.notes


@pytest.mark.parametrize(("camera", "words"), [("front", "Bearings"), ("rear", "of camera 'rear'")])
def test_of_two_cameras_that_with_clockwise_bearings_is_found(camera, words):
    drive = simulated(0, 20.0)
    seen = drive.sightings
    bearing = np.where(seen.camera == camera, -seen.bearing, seen.bearing)
    home = {
        name: dataclasses.replace(b, bearing=-b.bearing) if b.camera == camera else b
        for name, b in drive.home.items()
    }
    mirrored = dataclasses.replace(seen, bearing=bearing)
    status, reason, notes = answered(dataclasses.replace(drive, sightings=mirrored, home=home))
    assert (status, reason) == (Status.MAPPING, Reason.SIGNS_REVERSED.words)
    (note,) = (note for note in notes if "must be anti-clockwise" in note)
    assert f"{words} and turn rates" in note


def test_a_wrong_yaw_of_the_second_camera_is_found():
    cameras = {"rear": {"x": -0.2, "y": 0.0, "yaw": 0.0}}
    settings = DriveSettings(**{**SETTINGS, "cameras": cameras})
    status, reason, notes = answered(dataclasses.replace(simulated(0, 20.0), settings=settings))
    assert (status, reason) == (Status.MAPPING, Reason.CAMERA_YAW.words)
    (note,) = (note for note in notes if "do not fit" in note)
    assert "of camera 'rear' do not fit its yaw on the robot, 0 degrees: they fit 180" in note
    assert "`cameras: {rear: {yaw: 3.14159}}`" in note


def test_two_cameras_with_the_right_extrinsics_have_no_such_note():
    status, _, notes = answered(simulated(0))
    assert status is Status.LOCALISED
    assert not any("anti-clockwise" in note or "do not fit" in note for note in notes)
