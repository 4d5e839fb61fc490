"""A session corrects bearings for the roll and pitch of the robot."""

import math

import pytest
from scipy.spatial.transform import Rotation

from homeward.drives.measure import TAN_ELEVATION, UNRELIABLE
from homeward.drives.settings import DriveSettings
from homeward.live import messages as msg
from homeward.live.levelling import NO_TILT
from homeward.live.session import Session

ROLL, PITCH, YAW = 0.12, -0.2, 0.3
PLACES = {"high": (2.0, 1.0, 1.5), "level": (2.0, -1.0, 0.0)}
"""Positions of landmarks in the level frame at the camera, along the robot's axes [m]."""
HOME = {"high": 0.1, "level": 0.2}


def seen_tilted(t, **more):
    """Bearings and elevations from the frame of the tilted camera."""
    turn = Rotation.from_euler("ZYX", [0.0, PITCH, ROLL]).inv()
    places = {n: Rotation.from_euler("Z", -YAW).apply(turn.apply(p)) for n, p in PLACES.items()}
    return msg.BearingsIn(
        t=t,
        bearings={n: math.atan2(y, x) for n, (x, y, _) in places.items()},
        elevations={n: math.atan2(z, math.hypot(x, y)) for n, (x, y, z) in places.items()},
        **more,
    )


@pytest.fixture
def processed():
    """A session, and the bearings that its estimator gets."""
    robot = DriveSettings(sensor={"yaw": YAW, "bearing_sigma": 0.03})
    session, found = Session(robot=robot), []
    session.watch(lambda m: found.append(m) if isinstance(m, msg.BearingsIn) else None)

    def process(*messages):
        for message in (msg.SetHome(bearings=HOME), *messages):
            session.receive(message, 0.0)
        list(session.process())
        return found[-1], session

    return process


def test_bearings_with_elevations_are_those_of_a_level_robot(processed):
    seen, session = processed(msg.TiltIn(t=1.0, roll=ROLL, pitch=PITCH), seen_tilted(1.02))
    for name, (x, y, _) in PLACES.items():
        assert seen.bearings[name] == pytest.approx(math.atan2(y, x) - YAW, abs=1e-9)
    assert seen.sigmas == pytest.approx(dict.fromkeys(PLACES, 0.03))
    assert seen.elevations == {}  # a recording is levelled, too
    assert not session.counts


def test_without_an_elevation_the_tilt_adds_to_the_noise(processed):
    bearings = msg.BearingsIn(t=1.0, bearings=HOME, sigmas={"high": 0.01})
    seen, session = processed(msg.TiltIn(t=1.0, roll=0.0, pitch=0.12), bearings)
    assert seen.bearings == HOME
    assert seen.sigmas == {
        "high": pytest.approx(math.hypot(0.01, TAN_ELEVATION * 0.12)),
        "level": pytest.approx(math.hypot(0.03, TAN_ELEVATION * 0.12)),
    }
    assert session.diagnostics(0.0).counts[UNRELIABLE] == 2


def test_only_a_tilt_near_in_time_is_used_and_none_is_needed(processed):
    before = seen_tilted(1.0)
    seen, session = processed(before)
    assert seen.bearings == before.bearings
    assert not session.counts
    later = seen_tilted(1.7)
    seen, session = processed(msg.TiltIn(t=1.0, roll=ROLL, pitch=PITCH), later)
    assert seen.bearings == later.bearings
    assert session.diagnostics(0.0).counts[NO_TILT] == 2
