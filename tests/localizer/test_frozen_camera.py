"""Frozen cameras, wheels that spin on the spot, and repeated messages."""

import math

import numpy as np
import pytest
from rig import START, Rig, eight, ring, still

from homeward.estimator import Status
from homeward.geometry.frames import Twist, advance, bearing
from homeward.localizer.inputs.agreement import FrozenCamera
from homeward.odometry.history import TwistHistory
from homeward.reasons import Reason, Rejection


def straight(_):
    """Twist of a robot that drives straight on."""
    return Twist(0.2, 0.0)


def frozen(rng=None, jitter=0.0, share=1.0):
    """Repeat the first frame, or a part of it, perhaps with jitter [rad]."""
    first = {}

    def see(seen):
        first.update({} if first else seen)
        kept = {n: b for n, b in first.items() if share == 1.0 or rng.random() < share}
        return {n: b + jitter * rng.normal() for n, b in kept.items()} if jitter else kept

    return see


def wrong(rig, since):
    """The answers that are localised, and farther off than 4 sigma."""
    return [
        answer
        for answer, truth in rig.answers[since:]
        if answer.status is Status.LOCALISED and _distance(answer, truth) > 4.0
    ]


def _distance(answer, truth):
    off = np.subtract(answer.pose[:2], truth[:2])
    return math.sqrt(off @ np.linalg.solve(answer.covariance[:2, :2], off))


@pytest.mark.parametrize(("law", "share"), [(straight, 1.0), (eight, 0.6)])
def test_a_frozen_camera_is_named_and_its_bearings_are_not_used(law, share):
    rig = Rig(ring(8, 1, 3.0, 5.0), promise=None)
    rig.drive(40.0)
    since = len(rig.answers)
    rig.drive(8.0, law, frozen(np.random.default_rng(0), share=share))
    assert not wrong(rig, since)
    answer = rig.answers[-1][0]
    assert (answer.status, answer.reason) == (Status.COASTING, Reason.FROZEN.words)
    assert rig.localizer.counts.rejected[Rejection.FROZEN] > 50
    assert rig.error() < 0.3
    rig.drive(10.0)
    assert rig.answers[-1][0].status is Status.LOCALISED


@pytest.mark.parametrize(("law", "jitter"), [(straight, 1e-6), (eight, 0.002)])
def test_a_camera_that_is_frozen_but_for_jitter_is_not_relied_on(law, jitter):
    rig = Rig(ring(8, 1, 3.0, 5.0), promise=None)
    rig.drive(40.0)
    since = len(rig.answers)
    rig.drive(10.0, law, frozen(np.random.default_rng(0), jitter))
    assert not wrong(rig, since)
    late = [answer for answer, _ in rig.answers[since + 5 :]]
    assert all(a.status is not Status.LOCALISED for a in late)
    assert Reason.CONTRADICTED.words in {a.reason for a in late}


@pytest.mark.parametrize("law", [straight, eight])
def test_wheels_that_spin_on_the_spot_leave_both_places_in_the_covariance(law):
    rig = Rig(ring(8, 2, 3.0, 5.0), promise=None)
    rig.drive(40.0)
    since, stood = len(rig.answers), rig.pose
    there = stood
    for _ in range(50):
        for _ in range(2):
            rig.localizer.odometry(rig.t, *law(rig.t))
            there = advance(there, law(rig.t), 0.1)
            rig.t += 0.1
        rig.keep(rig.localizer.bearings(rig.t - 0.1, rig.look()))
        answer = rig.answers[-1][0]
        if answer.reason == Reason.CONTRADICTED.words:
            assert answer.status is Status.UNVERIFIED
            assert max(_distance(answer, stood), _distance(answer, there)) < 4.0
    assert not wrong(rig, since)
    assert rig.answers[since + 6][0].reason == Reason.CONTRADICTED.words


def test_a_robot_that_stands_is_not_frozen_though_odometry_jitters():
    rig = Rig(ring(8, 3), promise=None)
    rig.drive(40.0)
    rig.drive(20.0, still, frozen())
    assert rig.answers[-1][0].status is Status.LOCALISED
    assert Rejection.FROZEN not in rig.localizer.counts.rejected


def test_a_robot_that_drives_and_sees_whole_degrees_is_not_frozen():
    def whole(seen):
        return {n: math.radians(round(math.degrees(b))) for n, b in seen.items()}

    rig = Rig(ring(8, 3), promise=None)
    rig.drive(60.0, eight, whole)
    assert Rejection.FROZEN not in rig.localizer.counts.rejected
    assert Reason.CONTRADICTED.words not in {a.reason for a, _ in rig.answers}
    assert rig.answers[-1][0].status is Status.LOCALISED
    since = len(rig.answers)
    rig.drive(8.0, straight, frozen())
    assert not wrong(rig, since)
    assert all(a.status is not Status.LOCALISED for a, _ in rig.answers[since + 10 :])


@pytest.mark.parametrize(
    ("law", "place", "alive"),
    [
        (straight, (50.0, 0.0), True),  # straight ahead
        (lambda _: Twist(0.2, 0.1), (0.0, 2.0), True),  # at the centre of a circle
        (lambda _: Twist(0.0, 0.3), (3.0, 0.0), False),
        (lambda _: Twist(0.2, -0.3), (3.0, 3.0), False),
    ],
)
def test_a_single_landmark_may_stay_where_the_motion_allows_that(law, place, alive):
    camera, twists, first = (
        FrozenCamera(),
        TwistHistory(),
        bearing(START._replace(x=0, y=0, heading=0), *place),
    )
    stale = False
    for k in range(40):
        twists.add(0.1 * k, *law(0.1 * k))
        t = 0.1 * k - 1e-3
        camera.add_bearings(t, {"a": first + 1e-5 * (k < 10) * k}, twists.at(t))
        stale |= camera.is_frozen
    assert stale is not alive


def test_the_same_message_twice_is_used_once_and_counted():
    once, twice = (Rig(ring(6, 4), promise=None) for _ in range(2))
    send = twice.localizer.bearings

    def repeated(t, sightings, sigmas=None):
        answer = send(t, sightings, sigmas)
        send(t, sightings, sigmas)
        return answer

    once.drive(20.0)
    twice.localizer.bearings = repeated
    twice.drive(20.0)
    assert [a for a, _ in twice.answers] == [a for a, _ in once.answers]
    counts = twice.localizer.counts
    assert counts.used == once.localizer.counts.used
    assert counts.rejected[Rejection.REPEATED_BEARINGS] == 6 * len(once.answers)


def test_two_cameras_at_one_stamp_are_no_repetition():
    rig = Rig(ring(6, 4), promise=None)
    for seen in ({"L0": 0.1, "L1": 0.2}, {"L2": 0.1}, {"L0": 0.1001}):
        rig.localizer.bearings(100.0, seen)
    assert Rejection.REPEATED_BEARINGS not in rig.localizer.counts.rejected
