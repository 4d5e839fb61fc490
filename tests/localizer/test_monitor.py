"""The monitor says whether the robot is where the map says, and how it shows that it is not."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from homeward.estimator import Innovation
from homeward.localizer.inputs.bearing_noise import WeighedFrame
from homeward.localizer.map.gating import Gated
from homeward.localizer.map.state import Marginal
from homeward.localizer.motions import HEAD, NC, Motion
from homeward.localizer.recovery.monitor import Health, Monitor
from homeward.reasons import Reason

NAMES = [f"L{i}" for i in range(6)]


def known(heading_sigma=0.01, mapped=NAMES):
    """What a map says of a robot at the origin, amid landmarks 2 m away."""
    around = np.linspace(0.0, math.tau, len(NAMES), endpoint=False)
    places = 2.0 * np.stack([np.cos(around), np.sin(around)], axis=1)
    covariance = 1e-4 * np.eye(HEAD + 2 * len(NAMES))
    covariance[2, 2] = heading_sigma**2
    state = Marginal(np.concatenate([np.zeros(HEAD), places.ravel()]), covariance)
    landmarks = SimpleNamespace(
        mapped=mapped,
        positions=lambda names: places[: len(names)],
        ids=lambda names: np.array([NAMES.index(n) for n in names], int),
    )
    smoother = SimpleNamespace(state=state, p_static=np.ones(len(NAMES)), index=lambda ids: ids)
    return SimpleNamespace(smoother=smoother, landmarks=landmarks)


def drifted(shift=0.0, turn=0.0):
    """A motion to where the robot was, so uncertain in either way [m] and in its turn [rad]."""
    return Motion(np.zeros(3), np.diag([shift, shift, turn]) ** 2, np.zeros((3, NC)))


def seen(monitor, off, sigmas_off=10.0, names=NAMES):
    """What the monitor says when the first landmarks are off and the others are not."""
    innovations = [
        Innovation(n, sigmas_off * 0.01 * (i < off), 0.01, i >= off or sigmas_off < 4.0)
        for i, n in enumerate(names)
    ]
    frame = WeighedFrame(1.0, list(names), np.zeros(len(names)), np.full(len(names), 0.01))
    rows, result = np.zeros((0, 6)), SimpleNamespace(eye=np.zeros(3))
    fits = {i.landmark: i.accepted for i in innovations}
    gated = Gated(frame, drifted(), False, rows, result, innovations, fits, False)
    return monitor.assess_innovations(gated, known())


@pytest.mark.parametrize(
    ("motion", "health"),
    [
        (drifted(0.1, 0.1), Health.OK),
        (drifted(turn=1.0), Health.ODOMETRY_LOST),
        (drifted(shift=3.0), Health.ODOMETRY_LOST),
    ],
)
def test_odometry_that_predicts_no_bearing_is_lost(motion, health):
    assert Monitor(origin_given=False).assess_odometry(motion, known()) is health


def test_an_origin_that_nothing_holds_is_no_map():
    monitor, far = Monitor(origin_given=False), drifted(turn=1.0)
    assert monitor.assess_odometry(far, known(mapped=[])) is Health.NO_MAP
    assert monitor.assess_odometry(drifted(), known(1.0, mapped=[])) is Health.NO_MAP
    held = Monitor(origin_given=True)
    assert held.assess_odometry(drifted(), known(1.0, mapped=[])) is Health.OK
    assert monitor.assess_odometry(drifted(), known(1.0)) is Health.OK


def test_most_bearings_off_are_a_kidnapping_and_some_are_not():
    few, most = Monitor(origin_given=False), Monitor(origin_given=False)
    assert {seen(few, 2) for _ in range(10)} == {Health.OK}
    assert few.fits_badly is False
    assert Health.KIDNAPPED in [seen(most, 6) for _ in range(3)]
    assert most.fits_badly


def test_one_landmark_that_is_off_is_at_fault_and_not_the_robot():
    monitor = Monitor(origin_given=False)
    assert {seen(monitor, 1, names=["L0"]) for _ in range(20)} <= {Health.OK, Health.SLIPPED}
    assert monitor.moved_landmarks(["L0"]) == []  # nothing else tells where the robot is
    for _ in range(3):
        seen(monitor, 1)
    assert monitor.moved_landmarks(["L0"]) == ["L0"]


def test_large_innovations_that_pass_the_gate_may_be_a_slip():
    assert seen(Monitor(origin_given=False), 4, sigmas_off=3.5) is Health.SLIPPED


def test_a_lost_robot_is_looked_for_until_it_is_found():
    monitor = Monitor(origin_given=False)
    monitor.begin_search(5.0, Health.SCENE_CHANGED)
    search = monitor.search
    assert (monitor.is_lost, monitor.fits_well) == (True, False)
    assert monitor.reason is Reason.SCENE_CHANGED
    assert monitor.spells_lost == [(5.0, math.inf)]
    assert monitor.assess_odometry(drifted(turn=0.1), known()) is Health.LOST
    # Sight lines of a longer way do not hold together: the search begins anew, the spell does not.
    again = monitor.assess_odometry(drifted(turn=0.5), known())
    assert again is Health.ODOMETRY_LOST
    monitor.begin_search(8.0, again)
    assert monitor.search is not search
    assert monitor.reason is Reason.SCENE_CHANGED
    monitor.end_search(9.0, 1)
    assert (monitor.is_lost, monitor.spells_lost) == (False, [(5.0, 9.0)])


def test_a_few_bearings_in_a_row_that_do_not_fit_contradict_the_pose():
    monitor = Monitor(origin_given=False)
    suspected = []
    for off in (1, 1, 1, 0, 0, 0):  # one landmark in view
        seen(monitor, off, names=NAMES[:1])
        suspected.append(monitor.is_suspected)
    assert suspected == [False, False, True, True, True, False]


def test_bearings_of_a_third_of_the_landmarks_do_not_contradict_the_pose():
    monitor = Monitor(origin_given=False)
    for _ in range(10):
        seen(monitor, 2)
        assert not monitor.is_suspected
