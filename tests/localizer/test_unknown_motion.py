"""Odometry that is wrong, dead, absent or slow: unknown motion, and what the notes report."""

import math
from pathlib import Path

import numpy as np
import pytest
from rig import DT, Rig, eight, ring, still

from homeward.drives.drive import Drive, Odometry, Sightings, Truth
from homeward.drives.landmarks import KnownLandmarks, SurveyedLandmark
from homeward.drives.plausibility import with_clock_remarks
from homeward.drives.settings import Sensor
from homeward.estimator import Status
from homeward.geometry.angles import wrap
from homeward.localizer.inputs.agreement import DeadOdometry, Plausibility
from homeward.localizer.inputs.bearing_noise import BearingNoise
from homeward.localizer.localizer import Localizer
from homeward.odometry.history import TwistHistory, dead_reckoning
from homeward.odometry.validity import MAX_TWIST_VALIDITY_S, TWIST_VALIDITY_S, twist_validity
from homeward.reasons import Rejection


def off(rig):
    """Error of the last position [m], and in standard deviations."""
    answer, truth = rig.answers[-1]
    error = np.array([answer.pose.x - truth.x, answer.pose.y - truth.y])
    return np.hypot(*error), math.sqrt(error @ np.linalg.solve(answer.covariance[:2, :2], error))


@pytest.mark.parametrize("wrong", [(190.0, 0.0), (3.0, 0.0), (-90.0, 900.0), (math.inf, 0.0)])
def test_one_impossible_twist_does_not_move_the_pose(wrong):
    rig = Rig(ring(8))
    rig.drive(40)
    rig.localizer.odometry(rig.t - 0.01, *wrong)
    after = rig.localizer.estimate(rig.t + 0.08)
    assert math.hypot(after.pose.x - rig.pose.x, after.pose.y - rig.pose.y) < 0.15
    rig.drive(5)
    assert off(rig)[0] < 0.1
    assert rig.localizer.counts.rejected == {Rejection.BAD_ODOMETRY: 1}
    assert any("impossible motion 1 times" in note for note in rig.localizer.notes)


def test_nan_means_unknown_motion_until_the_next_twist():
    twists = TwistHistory()
    for k in range(10):
        twists.add(0.1 * k, 1.0, 0.5)
    twists.add(1.0, math.nan, math.nan)
    assert twists.heading(1.5) == pytest.approx(0.5)
    assert twists.unknown_time(1.5) == pytest.approx(0.5)
    twists.add(2.0, 1.0, 0.5)
    assert twists.unknown_time(2.5) == 0.0
    assert twists.heading(2.5) == pytest.approx(0.75)
    rig = Rig(ring(8))
    rig.drive(40)
    before = rig.localizer.estimate(rig.t).sigmas
    rig.localizer.odometry(rig.t, math.nan, math.nan)
    assert (rig.localizer.estimate(rig.t + 0.5).sigmas > 3.0 * before).all()
    assert not rig.localizer.counts.rejected


def test_a_real_change_of_speed_is_accepted_soon_and_noise_at_once():
    check = Plausibility()
    assert [check.accepts(0.1 * k, 3.0 * (k > 4), 0.0) for k in range(9)].count(False) <= 2
    noisy, rng = Plausibility(), np.random.default_rng(0)
    assert (
        np.mean([noisy.accepts(0.02 * k, v, 0.0) for k, v in enumerate(rng.normal(size=500))])
        > 0.95
    )


def surveyed(rig):
    """Give a rig's localiser a survey of its landmarks in the home frame."""
    known = {n: SurveyedLandmark(x=x, y=y) for n, (x, y) in rig.landmarks.items()}
    known = KnownLandmarks(frame="home", landmarks=known)
    rig.localizer = Localizer(rig.home, known=known, **rig.settings.robot)


def drive_dead(rig, seconds, twist=(0.0, 0.0), law=eight):
    """Drive on while odometry repeats one twist."""
    first = len(rig.answers)
    for _ in range(round(seconds / DT)):
        rig.localizer.odometry(rig.t, *twist)
        rig.drive(DT, law, feel=False)
    return rig.answers[first:]


def test_zeros_with_a_survey_give_poses_from_bearings_and_a_note():
    rig = Rig(ring(8), promise=None)
    surveyed(rig)
    late = drive_dead(rig, 20)[50:]
    assert np.mean([a.status is Status.LOCALISED for a, _ in late]) > 0.9
    assert off(rig)[0] < 0.15
    assert rig.wrong_share(len(rig.answers) - len(late)) < 0.02
    assert any("no motion all the time, but bearings changed" in n for n in rig.localizer.notes)
    drive_dead(rig, 8, law=still)
    drive_dead(rig, 2)
    assert rig.answers[-1][0].pose is not None
    assert off(rig)[1] < 4.0


def test_zeros_from_some_time_on_are_reported():
    rig = Rig(ring(8), promise=None)
    rig.drive(40)
    drive_dead(rig, 15)
    assert any("no motion from" in note for note in rig.localizer.notes)


def test_zeros_without_a_survey_are_the_reason():
    rig = Rig(ring(8), promise=None)
    answer, _ = drive_dead(rig, 30)[-1]
    assert "odometry reports no motion, but bearings changed" in answer.reason


def test_no_odometry_at_all_with_a_survey_gives_poses():
    rig = Rig(ring(8), promise=None)
    surveyed(rig)
    rig.drive(20, feel=False)
    assert rig.answers[-1][0].status is Status.LOCALISED
    assert off(rig)[0] < 0.15


def test_noise_that_is_not_given_is_estimated_from_resections():
    rig = Rig(ring(12, 0, 3.0, 6.0), promise=None)
    rig.settings = rig.settings.model_copy(update={"sensor": Sensor()})
    surveyed(rig)
    noise = np.random.default_rng(1)

    def blurred(seen):
        near = sorted(seen, key=lambda name: abs(seen[name]))[:7]
        return {name: float(wrap(seen[name] + 0.1 * noise.normal())) for name in near}

    for _ in range(40):
        rig.drive(1.0, eight, feel=False, see=lambda _: {})
        rig.keep(rig.localizer.bearings(rig.t, blurred(rig.look())))
    with_bearings = rig.answers[5::6][13:]
    assert np.mean([answer.pose is not None for answer, _ in with_bearings]) > 0.8
    assert rig.wrong_share() < 0.02


@pytest.mark.parametrize("has_moved", [False, True])
def test_odometry_that_never_moved_stays_dead_where_bearings_do_not_show_it(has_moved):
    dead, noise = DeadOdometry(), BearingNoise(0.01, 0.01)
    dead.odometry(-0.1, 0.5 * has_moved, 0.0)
    for k in range(400):
        t = 0.1 * k
        dead.odometry(t, 0.0, 0.0)
        dead.bearings(t, {f"L{i}": i + 0.2 * min(t, 10.0) for i in range(6)}, {}, noise)
        assert dead.is_dead or not 5.0 < t < 10.0
    assert dead.is_dead is not has_moved


@pytest.mark.parametrize("outliers", [0.0, 0.3])
def test_a_robot_that_stands_among_walkers_has_no_dead_odometry(outliers):
    rig = Rig(ring(10), promise=None)

    def walking(seen):
        for i, name in enumerate(list(seen)[:4]):
            seen[name] += 0.3 * math.sin(0.3 * rig.t + i)
        random = rig.rng.uniform(-math.pi, math.pi, len(seen))
        return {
            n: r if rig.rng.random() < outliers else b
            for (n, b), r in zip(seen.items(), random, strict=True)
        }

    for _ in range(600):
        rig.localizer.odometry(rig.t, 0.0, 0.0)
        rig.drive(DT, still, walking, feel=False)
    assert not any("no motion" in note for note in rig.localizer.notes)


def test_odometry_that_lags_is_not_dead():
    dead, noise = DeadOdometry(), BearingNoise(0.01, 0.01)
    for k in range(200):
        t = 0.1 * k
        dead.odometry(t, 0.5 if t > 10.0 else 0.0, 0.0)
        dead.bearings(t, {f"L{i}": i + 0.3 * max(t - 9.4, 0.0) for i in range(6)}, {}, noise)
        assert not dead.is_dead


def test_slow_twists_hold_until_the_next_and_dropouts_do_not():
    assert twist_validity([0.1] * 20) == TWIST_VALIDITY_S
    assert twist_validity([2.0] * 20) == 3.0
    assert twist_validity([60.0] * 20) == MAX_TWIST_VALIDITY_S
    t = np.arange(0.0, 40.0, 2.0)
    slow = Odometry(t, np.full(t.size, 0.5), np.zeros(t.size))
    assert dead_reckoning(slow, np.array([38.0])).x[0] == pytest.approx(19.0)
    gone = Odometry(np.array([0, 0.1, 0.2, 0.3, 0.4, 0.5, 9.5]), np.full(7, 0.5), np.zeros(7))
    assert dead_reckoning(gone, np.array([9.5])).x[0] == pytest.approx(0.75)


def test_slow_twists_leave_no_unknown_motion():
    twists = TwistHistory()
    for k in range(10):
        twists.add(2.0 * k, 0.5, 0.1)
    assert twists.unknown_time(19.9) == 0.0
    assert twists.unknown_time(30.0) == pytest.approx(9.0)


def test_slow_odometry_is_remarked():
    t, seen = np.arange(0.0, 40.0, 2.0), Sightings.of_rows([(1.0, "a", 0.1, math.nan)])
    odometry = Odometry(t, np.ones(t.size), np.zeros(t.size))
    truth = Truth(t, t, 0.0 * t, 0.0 * t)
    drive = with_clock_remarks(Drive("slow", odometry, seen, {}, truth=truth), Path())
    assert [words.split(" s")[0] + " s" for words in drive.remarks] == [
        "odometry rows with a median interval of 2.0 s",
        "rows of ground truth with a median interval of 2.0 s",
    ]


def test_dead_odometry_is_found_by_a_camera_of_less_than_half_a_hertz():
    dead, noise = DeadOdometry(), BearingNoise(0.01, 0.01)
    for k in range(600):
        t = 0.1 * k
        dead.odometry(t, 0.0, 0.0)
        if k % 25 == 0:
            dead.bearings(t, {f"L{i}": i + 0.05 * t for i in range(6)}, {}, noise)
    assert dead.is_dead
