"""Wheels that slip or spin on the spot, with four mapped landmarks in view."""

import math

import numpy as np
import pytest
from rig import DT, EVERY, Rig, ring, still

from homeward.estimator import Status
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Twist, advance

SLIP = Twist(0.2, 0.35)
"""Odometry reports a bend of 36 degrees in 1.8 s that the robot does not drive."""


def ahead(seen):
    """The four landmarks nearest to the camera's axis."""
    return dict(sorted(seen.items(), key=lambda item: abs(item[1]))[:4])


def drive(rig, seconds, law, odometry, see=ahead):
    """Drive with odometry that reports another motion."""
    feel = rig.localizer.odometry
    for _ in range(round(seconds / DT / EVERY)):
        for _ in range(EVERY):
            feel(rig.t, *odometry(rig.t))
            rig.pose = advance(rig.pose, law(rig.t), DT)
            rig.t += DT
        rig.keep(rig.localizer.bearings(rig.t, see(rig.look()), rig.sigmas))


def errors(answers):
    """Errors of position [m] and heading [rad]; infinite without a pose."""
    return np.array(
        [
            (math.hypot(a.pose.x - p.x, a.pose.y - p.y), abs(wrap(a.pose.heading - p.heading)))
            if a.pose is not None
            else (math.inf, math.inf)
            for a, p in answers
        ]
    )


def beyond(answers):
    """Share of the poses whose heading has an error of more than 4 sigma."""
    off = [
        abs(wrap(a.pose.heading - p.heading)) > 4.0 * math.sqrt(a.covariance[2, 2])
        for a, p in answers
        if a.pose is not None
    ]
    return np.mean(off)


def test_spinning_wheels_leave_a_pose_and_no_false_one():
    rig = Rig(ring(8, 1), 1, promise=None)
    rig.drive(40, see=ahead)
    begun = len(rig.answers)
    drive(rig, 15, still, lambda _: Twist(0.5, 1.0))
    there = rig.answers[begun:]
    assert np.mean([a.pose is not None for a, _ in there]) > 0.9
    false = [
        a.status is Status.LOCALISED and error[1] > 0.3
        for (a, _), error in zip(there, errors(there), strict=True)
    ]
    assert np.mean(false) < 0.02
    assert beyond(there) < 0.02
    begun = len(rig.answers)
    rig.drive(10, see=ahead)
    assert rig.answers[begun + 10][0].pose is not None
    assert rig.error() < 0.1


@pytest.mark.parametrize("seed", range(2))
def test_the_pose_is_right_2_s_after_a_slip(seed):
    rig = Rig(ring(8, seed), seed, promise=None)
    rig.drive(40, see=ahead)
    drive(rig, 1.8, lambda _: Twist(0.2, 0.0), lambda _: SLIP)
    begun = len(rig.answers)
    rig.drive(15, see=ahead)
    after = rig.answers[begun:]
    position, heading = errors(after)[10:].T  # five answers a second
    assert np.mean((position < 0.3) & (heading < 0.2)) > 0.95
    assert beyond(after) < 0.05


def slip_twice(rig, seen_before):
    """Slip twice in a blind bend of 36 degrees, the first time with landmarks in view; or once."""
    rig.drive(40, see=ahead)
    if seen_before:
        drive(rig, 1.8, lambda _: Twist(0.2, 0.0), lambda _: SLIP)
        rig.drive(10, see=ahead)
    begun = len(rig.answers)
    drive(rig, 1.8, lambda _: Twist(0.2, 0.0), lambda _: SLIP, see=lambda _: {})
    return rig.answers[begun:]


def test_after_a_denied_motion_a_blind_robot_is_less_certain_and_coasts_sooner():
    once, again = (
        [slip_twice(Rig(ring(8, seed), seed, promise=None), seen_before) for seed in range(3)]
        for seen_before in (False, True)
    )
    assert np.mean([beyond(answers) for answers in once]) > 0.5  # nothing indicates a first slip
    assert all(beyond(answers) == 0.0 for answers in again)
    assert all(answers[-1][0].status is Status.COASTING for answers in again)
