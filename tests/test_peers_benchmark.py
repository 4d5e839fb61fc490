"""Baselines of the benchmarks: exact without noise, wherever the camera is on the robot."""

from dataclasses import replace
from importlib.util import find_spec

import numpy as np
import pytest

from benchmarks.consistency.scenarios import SCENARIOS
from benchmarks.consistency.trial import Leg, trial, wandering
from benchmarks.leaderboard.runs import BASELINES, follow_one
from homeward.drives.settings import Mount, OdometryNoise, Sensor
from homeward.lab.simulation import scenario as sim
from homeward.lab.simulation.simulate import simulate
from homeward.registry import NEED_START
from homeward.runs.scoring import errors

MOUNT, HOME_MOUNT = Mount(x=0.5, y=-0.4, yaw=0.7), Mount(x=-0.3, y=0.2, yaw=-1.1)
KNOWN = OdometryNoise(speed_sigma=1e-3, turn_sigma=1e-3)
FILTERS = [n for n in NEED_START if n not in ("adaptive", "pi-ekf")]
"""adaptive is an EKF too, and slow; pi-ekf amplifies rounding errors, also of a central camera."""
LIMITS = dict.fromkeys(FILTERS, 0.05) | {"particle": 0.2}
"""Maximum error [m, rad] of filters: they integrate in steps, with the camera at the centre too."""
EXACT = 0.01  # that of the others


@pytest.fixture(scope="module")
def exact():
    """A drive without noise, its camera half a metre from the centre, and elsewhere at home."""
    course = wandering(
        3,
        0,
        40,
        (1.2, 2.0),
        speed=0.3,
        seconds=25.0,
        sensor=MOUNT,
        home_sensor=HOME_MOUNT,
        noise=sim.Noise(bearing_sigma=0.0, home_sigma=0.0),
        odometry=sim.OdometryErrors(speed_sigma=0.0, turn_sigma=0.0),
    )
    whole = trial(Leg(simulate(course)))
    sensor = Sensor(**MOUNT.model_dump(), bearing_sigma=2e-3)
    change = {"sensor": sensor, "odometry": KNOWN, "home_sensor": HOME_MOUNT}
    settings = whole.drive.settings.model_copy(update=change)
    return replace(whole, drive=replace(whole.drive, settings=settings))


@pytest.mark.parametrize("name", [*FILTERS, *BASELINES])
def test_every_peer_is_exact_without_noise_wherever_the_camera_is(exact, name):
    if ".graph:" in name and find_spec("gtsam") is None:
        pytest.skip("GTSAM is not installed: pip install -e '.[bench]'")
    track = follow_one(exact, name)
    off = errors(track, exact.drive.truth)
    late = off.t > 12.0
    assert late.any()
    assert off.position[late].max() < LIMITS.get(name, EXACT)
    assert np.abs(off.heading[late]).max() < LIMITS.get(name, EXACT)


def test_landmarks_that_walk_do_not_end_gtsam():
    if find_spec("gtsam") is None:
        pytest.skip("GTSAM is not installed: pip install -e '.[bench]'")
    whole = SCENARIOS["walkers"].make(6)
    off = errors(follow_one(whole, "benchmarks.peers.graph:lag"), whole.drive.truth)
    assert off.t[-1] > 0.9 * whole.drive.truth.t[-1]
    assert np.median(off.position) < 0.2
