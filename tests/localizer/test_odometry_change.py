"""Odometry that changes: wheels that spin, or one that is blocked."""

import math

import numpy as np
import pytest
from localizer.rig import Rig, eight, ring

from homeward.estimator import Status
from homeward.localizer.map.learning.changes import scale_change
from homeward.localizer.recovery.monitor import has_other_scale
from homeward.reasons import Reason


def spinning(rig, change):
    """Let the wheels of a rig turn by another law (v, omega) than the robot moves."""
    feel = rig.localizer.odometry

    def felt(t, v, omega):
        feel(t, *change(v, omega))

    rig.localizer.odometry = felt
    return lambda: setattr(rig.localizer, "odometry", feel)


def longest_wrong(rig, since):
    """Return the longest time for which a pose is localised, and wrong by 0.3 m and 4 sigma [s]."""
    longest = now = 0.0
    for answer, true in rig.answers:
        off = None if answer.pose is None else np.subtract(answer.pose, true)[:2]
        wrong = answer.t >= since and answer.status is Status.LOCALISED and math.hypot(*off) > 0.3
        if wrong:
            wrong = off @ np.linalg.solve(answer.covariance[:2, :2], off) > 16.0
        now = now + 0.2 if wrong else 0.0
        longest = max(longest, now)
    return longest


def narrow(seen):
    """Return what a camera of 62 degrees sees."""
    return {n: b for n, b in seen.items() if abs(b) < math.radians(31.0)}


SPINS = {
    "half": lambda v, omega: (0.5 * v, omega),
    "one and a half": lambda v, omega: (1.5 * v, omega),
    "twice": lambda v, omega: (2.0 * v, omega),
    "three times": lambda v, omega: (3.0 * v, omega),
    "five times": lambda v, omega: (5.0 * v, omega),
}


@pytest.mark.parametrize("change", SPINS)
def test_wheels_that_spin_are_named_and_never_believed(change):
    rig = Rig(ring(12), told=False)
    rig.drive(60.0)
    began = rig.t
    stop = spinning(rig, SPINS[change])
    rig.drive(20.0)
    stop()
    rig.drive(20.0)
    reasons = {answer.reason for answer, _ in rig.answers if answer.t >= began}
    assert Reason.ODOMETRY_CHANGED.words in reasons
    assert longest_wrong(rig, began) <= 1.0
    assert rig.answers[-1][0].status is Status.LOCALISED
    assert rig.error() < 0.15


@pytest.mark.parametrize("change", SPINS)
def test_a_narrow_camera_does_not_believe_wheels_that_spin(change):
    rig = Rig(ring(16), promise=None)
    rig.drive(60.0, see=narrow)
    began = rig.t
    assert rig.answers[-1][0].status is Status.LOCALISED
    stop = spinning(rig, SPINS[change])
    rig.drive(20.0, see=narrow)
    stop()
    rig.drive(20.0, see=narrow)
    assert longest_wrong(rig, began) <= 1.0


def test_a_map_made_with_wheels_that_spin_has_another_scale():
    right, again, wrong = Rig(ring(8)), Rig(ring(8), 1), Rig(ring(8), promise=None)
    spinning(wrong, SPINS["twice"])
    maps = []
    for rig in (right, again, wrong):
        rig.drive(30.0)
        maps.append(rig.localizer.chart.map.landmarks)
    assert not has_other_scale(maps[0], maps[1])
    assert has_other_scale(maps[0], maps[2])


def test_right_odometry_is_never_said_to_have_changed():
    for seed in range(4):
        rig = Rig(ring(8, seed), seed)
        rig.drive(90.0)
        assert Reason.ODOMETRY_CHANGED.words not in {answer.reason for answer, _ in rig.answers}


def test_the_change_and_its_onset_are_those_of_the_wheels():
    rig = Rig(ring(12), promise=None)
    rig.drive(40.0)
    began, smoother = rig.t, rig.localizer.chart.map.smoother
    assert scale_change(smoother).square < 20.0
    spinning(rig, lambda v, omega: (v / 0.8, omega))
    rig.drive(2.0, eight)
    smoother = rig.localizer.chart.map.smoother
    found = scale_change(smoother)
    onset = smoother.stamps[found.keyframe - smoother.first]
    assert onset == pytest.approx(began, abs=1.0)
    assert found.size == pytest.approx(-0.2, abs=3.0 * found.sigma + 0.05)


def test_nothing_is_tested_in_a_window_without_landmarks_or_motions():
    rig = Rig(ring(8), promise=None)
    assert scale_change(rig.localizer.chart.map.smoother) is None
