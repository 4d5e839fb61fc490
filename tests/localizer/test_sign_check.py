"""Bearings that run clockwise, or turn rates that do: found out, and never where all is right."""

import math

import numpy as np
import pytest
from rig import Rig, eight, ring, still

from homeward.control import Twist
from homeward.drives.drive import HomeBearing
from homeward.localizer.inputs.sign_check import SignCheck
from homeward.localizer.localizer import Localizer
from homeward.localizer.motion.twists import Twists
from homeward.reasons import Reason


def watched(law, marks, noise=0.0, gyro=0.0, yaw=0.0, sign=1.0, seconds=60.0):
    """Senses after a drive past landmarks, each seen five times a second."""
    rng, sign_check = np.random.default_rng(0), SignCheck(yaw)
    x, y, psi, twists = 0.0, 0.0, 0.3, Twists()
    for k in range(round(10 * seconds)):
        t, twist = k / 10, law(k / 10)
        twists.add(t, twist.v, twist.omega + gyro * rng.normal() / math.sqrt(0.1))
        if k % 2 == 0:
            d = np.array(marks) - [x, y]
            bearings = np.arctan2(d[:, 1], d[:, 0]) - psi - yaw + noise * rng.normal(size=len(d))
            seen = {str(i): sign * float(b) for i, b in enumerate(bearings)}
            sign_check.bearings(t, seen, twists.heading(t), twist.v)
        x, y = x + 0.1 * twist.v * math.cos(psi), y + 0.1 * twist.v * math.sin(psi)
        psi += 0.1 * twist.omega
    return sign_check


NEAR = list(ring(12, 0, 0.5, 1.5).values())
FAR = list(ring(12, 1, 3.0, 30.0).values())


def backward(t):
    """A figure of eight, driven backward."""
    return Twist(-0.2, eight(t).omega)


def round_and_round(_):
    """A wide circle to the left."""
    return Twist(0.5, 0.25)


@pytest.mark.parametrize("law", [eight, backward, round_and_round, lambda _: Twist(0.0, 0.5)])
@pytest.mark.parametrize("marks", [NEAR, FAR])
@pytest.mark.parametrize("yaw", [0.0, 0.5])
def test_right_bearings_are_right_however_near_the_landmarks(law, marks, yaw):
    assert not watched(law, marks, 0.02, 0.02, yaw).reversed


@pytest.mark.parametrize("law", [eight, backward, round_and_round, lambda _: Twist(0.0, 0.5)])
def test_bearings_that_run_clockwise_are_not(law):
    assert watched(law, FAR, 0.02, 0.02, sign=-1.0).reversed


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_noise_of_a_robot_that_stands_is_no_sign(sign):
    assert not watched(still, FAR, noise=0.05, gyro=0.2, sign=sign).reversed
    # As much noise hides no sign of one that turns.
    assert watched(eight, FAR, noise=0.05, gyro=0.2, sign=sign).reversed is (sign < 0)


def test_a_straight_way_tells_nothing():
    assert not watched(lambda _: Twist(0.3, 0.0), NEAR, 0.02, sign=-1.0).reversed


@pytest.mark.parametrize("wrong", ["bearings", "turn rates"])
def test_there_is_no_pose_in_the_mirror_and_the_reason_is_told(wrong):
    rig = Rig(ring(10), promise=None)
    if wrong == "bearings":
        home = {n: HomeBearing(-b.bearing, b.sigma) for n, b in rig.home.items()}
        rig.localizer = Localizer(home, **rig.settings.robot)
        answer = rig.drive(60, see=lambda seen: {n: -b for n, b in seen.items()})
    else:
        feel = rig.localizer.odometry
        rig.localizer.odometry = lambda t, v, omega: feel(t, v, -omega)
        answer = rig.drive(60)
    assert (answer.pose, answer.reason) == (None, Reason.SIGNS_REVERSED.words)
    assert "must be anti-clockwise." in rig.localizer.notes[-1]


def test_a_drive_with_all_signs_right_has_no_such_note():
    rig = Rig(ring(10))
    answer = rig.drive(40)
    assert answer.reason != Reason.SIGNS_REVERSED.words
    assert not any("anti-clockwise" in note for note in rig.localizer.notes)
