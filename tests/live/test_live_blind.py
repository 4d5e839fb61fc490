"""A robot that sees no landmark, or whose camera is frozen."""

import math

import numpy as np
import pytest
from live_rig import Rig, driving

from homeward.control.limits import Limits
from homeward.drives.settings import OdometryNoise
from homeward.live.messages import (
    BearingsIn,
)
from homeward.live.session import Session
from homeward.live.settings import LiveSettings


def no_landmarks(message):
    """Remove all bearings from a frame."""
    return [
        message.model_copy(update={"bearings": {}}) if hasattr(message, "bearings") else message
    ]


def test_the_robot_stops_at_once_without_landmarks_for_longer_than_it_may_coast():
    rig = Rig(3).until(driving)
    began, before, rig.spoil = rig.robot.t, rig.robot.pose, no_landmarks
    rig.until(Rig.staying)
    assert rig.robot.t - began <= 2.0 + Limits().coast + 0.1  # localised for 2 s without bearings
    assert "no landmark in view for more than 3 s" in rig.commands[-1][1].reason
    assert math.dist(before[:2], rig.robot.pose[:2]) <= 3 * 0.25 * 1.1


def uncalibrated(rig, **limits):
    """A session for the robot of a rig of whose odometry no noise is given."""
    robot = rig.robot.drive.settings.model_copy(update={"odometry": OdometryNoise()})
    rig.session = Session(LiveSettings(limits=Limits(**limits)), robot)
    rig.session.receive(rig.player.home(), 0.0)
    return rig


def test_without_calibrated_odometry_a_blind_robot_stops_within_a_second():
    rig = uncalibrated(Rig(3)).until(driving)
    began, before, rig.spoil = rig.robot.t, rig.robot.pose, no_landmarks
    rig.until(Rig.staying)
    assert rig.robot.t - began <= Limits().coast + 0.1
    assert math.dist(before[:2], rig.robot.pose[:2]) <= 0.25 * 1.1
    assert "no landmark in view for more than 1 s" in rig.commands[-1][1].reason


def test_a_blind_robot_turns_once_round_on_the_spot_and_then_waits_and_gives_up():
    rig = uncalibrated(Rig(3)).until(driving)
    rig.spoil = no_landmarks
    rig.until(Rig.staying)
    there, headings = rig.robot.pose, []
    while rig.state == "driving":
        rig.step()
        headings.append(rig.robot.pose.heading)
    assert math.dist(there[:2], rig.robot.pose[:2]) < 0.01
    assert abs(np.unwrap(headings)[-1] - headings[0]) == pytest.approx(math.tau, abs=0.3)
    assert (rig.state, rig.commands[-1][1].omega) == ("held", 0.0)
    rig.until(lambda r: r.state != "held")
    assert rig.state == "failed"


def test_a_blind_robot_that_may_not_search_is_held():
    rig = uncalibrated(Rig(3), search=0.0).until(driving)
    rig.spoil = no_landmarks
    rig.until(Rig.staying)
    assert (rig.state, rig.commands[-1][1].omega) == ("held", 0.0)


def test_a_robot_that_sees_landmarks_again_when_it_turns_drives_on():
    rig = uncalibrated(Rig(3)).until(driving)
    sound, rig.spoil = rig.spoil, no_landmarks
    rig.until(Rig.staying)
    begun = rig.robot.t
    rig.until(lambda r: r.robot.t > begun + 1.0)
    assert "turning to see one" in rig.commands[-1][1].reason
    rig.spoil = sound
    rig.until(lambda r: r.player.ending)
    assert rig.player.ending.state == "arrived"


def frozen(jitter=0.0):
    """Repeat the bearings of the first frame with new stamps."""
    first, rng = [], np.random.default_rng(0)

    def spoil(message):
        if not isinstance(message, BearingsIn):
            return [message]
        first.append(message.bearings)
        seen = {n: b + jitter * rng.normal() for n, b in first[0].items()}
        return [message.model_copy(update={"bearings": seen})]

    return spoil


@pytest.mark.parametrize("calibrated", [True, False])
@pytest.mark.parametrize(
    ("jitter", "words"), [(0.0, "the camera is frozen"), (0.002, "unverified")]
)
def test_a_frozen_camera_stops_the_robot(calibrated, jitter, words):
    rig = Rig(2) if calibrated else uncalibrated(Rig(2))
    rig.until(driving)
    sound, rig.spoil, died = rig.spoil, frozen(jitter), rig.robot.t
    rig.until(Rig.standing)
    assert rig.robot.t - died <= (0.75 if jitter == 0.0 else 2.5)
    assert words in rig.commands[-1][1].reason
    if jitter == 0.0:
        rig.spoil = sound
        rig.until(lambda r: r.player.ending)
        assert rig.player.ending.state == "arrived"
