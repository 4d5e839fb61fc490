"""The window: what it keeps when keyframes leave it, and what many landmarks ask for."""

import math

import numpy as np
import pytest
from rig import Rig, Wheels, ring

from homeward.localizer.inputs.bearing_noise import CorrelatedErrors, WeighedFrame
from homeward.localizer.map.sightings import LANDMARK
from homeward.localizer.map.smoother import Smoother
from homeward.localizer.map.state import Marginal
from homeward.localizer.motions import NC, TURN_SLIP, Motion, camera_after
from homeward.localizer.smoothing import bridged
from homeward.localizer.tunables import MAX_TESTED

SIGMAS = np.array([0.02, 0.002, 0.02, 0.05, 0.05, 0.001, 0.001])
MOUNT_SIGMAS = np.array([0.01, 0.02, 0.02])
POINTS = np.array([[3.0, 1.0], [-1.0, 3.0], [2.0, -2.5]])
MOUNT = np.array([0.1, 0.0, 0.0])


def circle(rng, keyframes):
    """A window that was solved after a drive in a circle, and the twists' odometry."""
    odometry = Wheels()
    window = Smoother(SIGMAS, np.full(NC, 1e-9), MOUNT_SIGMAS, CorrelatedErrors(), 0.0)
    for point in POINTS:
        window.add_landmark(point + 0.02 * rng.normal(size=2))
    for k in range(keyframes):
        window.add_sightings(seen(rng, window))
        move_on(odometry, window, k + 1.0)
    window.add_sightings(seen(rng, window))
    return window, odometry


def move_on(odometry, window, t):
    """Drive for a second up to t; return the motion, of which there is a keyframe now."""
    odometry.restart(t - 1.0)
    for i in range(10):
        odometry.add(t - 1.0 + 0.1 * i, 0.4, 0.3)
    motion = odometry.advance(t, window.state.calibration)
    window.add_keyframe(t, motion)
    return motion


def seen(rng, window):
    """Sightings of all landmarks from the newest keyframe, noisy."""
    x, y, psi = window.poses[-1]
    eye = np.array([x, y]) + 0.1 * np.array([math.cos(psi), math.sin(psi)])
    bearings = np.arctan2(*(POINTS - eye).T[::-1]) - psi + 0.005 * rng.normal(size=len(POINTS))
    sigmas = np.full(len(POINTS), 0.005)
    look = WeighedFrame(0.0, [str(i) for i in range(len(POINTS))], bearings, sigmas)
    camera = camera_after(Motion.identity(), MOUNT, window.state.calibration)
    rows = window.frames.add(window.newest, camera.uncalibrated, camera.jacobian, look)
    rows[:, LANDMARK] = np.arange(len(POINTS))
    return rows


@pytest.mark.parametrize("rounding", [1e-20, -1e-20])
def test_rounding_does_not_decide_the_variance_of_a_slip_that_nothing_observes(rounding):
    window, odometry = (
        Smoother(SIGMAS, np.zeros(NC), MOUNT_SIGMAS, CorrelatedErrors(), 0.0),
        Wheels(),
    )
    for k in range(4):  # straight on, without landmarks
        odometry.restart(float(k))
        odometry.add(float(k), 0.4, 0.0)
        window.add_keyframe(k + 1.0, odometry.advance(k + 1.0, window.state.calibration))
        mean = window.state.mean.copy()
        mean[3 + TURN_SLIP] = rounding
        window.state = Marginal(mean, window.state.covariance)
        window.solve()
        assert window.state.calibration_variances[TURN_SLIP] == pytest.approx(
            SIGMAS[TURN_SLIP] ** 2
        )


def test_closing_keyframes_at_once_keeps_what_they_said():
    rng = np.random.default_rng(4)
    window, _ = circle(rng, 12)
    window.solve()
    before = window.state
    window.marginalise(7)
    window.solve()
    after = window.state
    assert len(window.poses) == 6
    assert after.mean == pytest.approx(before.mean, abs=2e-3)
    assert np.diag(after.covariance) == pytest.approx(np.diag(before.covariance), rel=0.02)


def test_a_bridge_ends_where_it_must_and_is_sure_there():
    odometry = Wheels()
    for i in range(20):
        odometry.add(0.1 * i, 0.3, 0.4)
    odometry.restart(0.0)
    nothing = np.zeros(NC)
    half, end = odometry.motion(1.0, nothing), odometry.motion(2.0, nothing)
    off = np.array([-0.005, 0.015, 0.05])  # a turn on the way swings the end to the left
    there, covariance = bridged(end, end, off)
    assert there == pytest.approx(end.delta + off, abs=1e-6)
    assert np.abs(covariance).max() < 1e-8
    on_the_way, covariance = bridged(half, end, off)
    assert 0 < on_the_way[2] - half.delta[2] < off[2]
    assert np.linalg.eigvalsh(covariance).min() > 0
    assert np.trace(covariance) < np.trace(half.covariance)


def test_of_very_many_landmarks_those_beyond_the_first_are_judged_too():
    rig = Rig(ring(60, near=1.5, far=5.0), seed=2, faults={"L7": 0.4, "L33": -0.3, "L58": 0.5})
    rig.drive(40)
    known = rig.localizer.chart.map.landmarks
    assert len(known.shared_with_home(known.mapped)) == MAX_TESTED
    evaluate = {m.landmark for m in rig.localizer.landmarks() if m.moved is not None}
    assert len(evaluate) > MAX_TESTED
    assert rig.moved() == {"L7", "L33", "L58"}
    assert rig.error() < 0.1
