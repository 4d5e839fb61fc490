"""Samples that stop and begin again, a robot that was carried: found again, never sure before."""

import math

import numpy as np
import pytest
from rig import Rig, another_room, eight, ring, still

from homeward.estimator import Status
from homeward.geometry.frames import Pose, Twist
from homeward.reasons import Reason, Rejection


def carried(pose, metres, way):
    """A pose so far away in a direction, of the same heading."""
    return Pose(pose.x + metres * math.cos(way), pose.y + metres * math.sin(way), pose.heading)


def test_bearings_gone_for_a_minute_and_back():
    rig = Rig(ring(8))
    rig.drive(40)
    before = rig.localizer.estimate(rig.t).sigmas[:2].max()
    assert rig.drive(60, see=lambda _: {}).status is Status.COASTING
    assert rig.localizer.estimate(rig.t).sigmas[:2].max() > 1.5 * before
    assert rig.drive(15).status is Status.LOCALISED
    assert rig.error() < 0.1
    assert rig.wrong_share() == 0


def test_odometry_gone_and_back():
    rig = Rig(ring(8))
    rig.drive(40)
    rig.drive(20, feel=False)
    assert rig.drive(40).status is Status.LOCALISED
    assert rig.error() < 0.15
    assert rig.wrong_share() < 0.02


@pytest.mark.parametrize("law", [still, eight])
def test_odometry_that_begins_late_costs_its_delay_only(law):
    rig = Rig(ring(10))
    assert rig.drive(20, law, feel=False).pose is None
    before = rig.localizer.counts.rejected[Rejection.NO_ODOMETRY]
    assert before == 10 * len(rig.answers)
    assert rig.drive(6).status is Status.LOCALISED
    assert rig.error() < 0.1
    assert rig.drive(40).status is Status.LOCALISED
    assert rig.wrong_share() == 0
    assert rig.localizer.counts.rejected[Rejection.NO_ODOMETRY] == before


def test_a_robot_without_a_map_is_not_lost_in_it():
    rig = Rig(ring(10))
    rig.drive(1, still)
    rig.t += 60
    assert rig.drive(20).status is Status.LOCALISED
    assert rig.error() < 0.1
    assert rig.wrong_share() == 0


def test_odometry_of_a_fast_robot_gone_and_back():
    rig = Rig(ring(10, 0, 10.0, 20.0), pose=Pose(4.0, -2.0, 0.6))

    def fast(t):
        return Twist(2.0, eight(t).omega)

    rig.drive(40, fast)
    rig.drive(30, fast, feel=False)
    assert rig.drive(30, fast).status is Status.LOCALISED
    assert rig.error() < 0.3
    assert rig.wrong_share() < 0.01


def test_kidnapped_and_localised_again():
    rig = Rig(ring(10))
    rig.drive(30)
    rig.pose = Pose(-1.2, 1.0, -2.0)
    said = len(rig.answers)
    rig.drive(40)
    assert rig.error() < 0.15
    assert rig.answers[-1][0].status is Status.LOCALISED
    lying = [
        a.status is Status.LOCALISED and math.hypot(a.pose.x - p.x, a.pose.y - p.y) > 0.5
        for a, p in rig.answers[said:]
    ]
    # Nobody can know at once; it must not go on for more than a few seconds.
    assert sum(lying) * 0.2 < 5.0
    assert len(rig.localizer.charts) == 1
    assert rig.localizer.chart.map.smoother.newest > 40  # the map from before, not the other one


@pytest.mark.parametrize("blind_s", [0.1, 20])
def test_carried_to_where_nothing_of_the_map_is_in_sight_and_back(blind_s):
    rig = Rig(ring(10))
    near = another_room(rig)
    rig.drive(30, see=near)
    rig.drive(blind_s, still, see=lambda _: {})
    rig.pose = Pose(rig.pose.x + 40.0, rig.pose.y + 30.0, rig.pose.heading + 1.0)
    said = len(rig.answers)
    there = rig.drive(20, see=near)
    assert there.reason == Reason.SCENE_CHANGED.words
    assert not any(a.status in (Status.LOCALISED, Status.COASTING) for a, _ in rig.answers[said:])
    rig.pose = Pose(0.5, 0.3, -2.0)
    assert rig.drive(40, see=near).status is Status.LOCALISED
    assert rig.error() < 0.15


def test_a_narrow_camera_that_turns_away_from_all_it_saw_is_not_carried_off():
    rig, half = Rig(ring(40, 0, 2.0, 5.0)), math.radians(30)
    for omega in (0.3, 1.2, -2.5, 0.3):
        rig.drive(15, lambda _, w=omega: Twist(0.3, w), see=lambda seen: among(seen, half))
    reasons = {a.reason for a, _ in rig.answers}
    assert rig.answers[-1][0].pose is not None
    assert Reason.SCENE_CHANGED.words not in reasons


def among(seen, half):
    """What a camera sees that sees to both sides of its axis so far [rad]."""
    return {n: b for n, b in seen.items() if abs(b) < half}


@pytest.mark.parametrize(("metres", "seed"), [(0.4, 0), (1.5, 2)])
def test_shoved_without_turning(metres, seed):
    rig = Rig(ring(10, seed), seed)
    rig.drive(40)
    said, way = len(rig.answers), rig.rng.uniform(-math.pi, math.pi)
    rig.pose = carried(rig.pose, metres, way)
    rig.drive(30)
    assert rig.error() < 0.1
    assert rig.wrong_share(said) * 30 < 2.0  # so many seconds
    assert not rig.moved()


def test_wheels_that_slip():
    rig = Rig(ring(10, 1), 1)
    rig.drive(40)
    said, way = len(rig.answers), rig.pose.heading
    for _ in range(10):
        rig.drive(0.2)
        rig.pose = carried(rig.pose, 0.08, way)
    rig.drive(30)
    assert rig.error() < 0.1
    assert rig.wrong_share(said) * 32 < 5.0


def test_noisy_odometry_makes_the_map_not_larger():
    rig = Rig(ring(10, 1), 1, speed_sigma=0.08)
    rig.drive(60)
    known = {m.landmark: math.hypot(m.x, m.y) for m in rig.localizer.landmarks()}
    larger = [known[name] / math.hypot(*place) for name, place in rig.landmarks.items()]
    assert np.median(larger) == pytest.approx(1.0, abs=0.07)
    assert rig.wrong_share() < 0.02


def test_sightings_that_agree_by_chance_do_not_carry_the_robot_off():
    rig = Rig(ring(10))

    def some_at_random(seen):
        return {
            name: rig.rng.uniform(-math.pi, math.pi) if rig.rng.random() < 0.3 else b
            for name, b in seen.items()
        }

    rig.drive(40)
    said = len(rig.answers)
    rig.drive(60, see=some_at_random)
    assert rig.answers[-1][0].status is Status.LOCALISED
    assert rig.wrong_share(said) == 0


@pytest.mark.parametrize(("metres", "gap"), [(0.1, 0.0), (20.0, 7200.0)])
def test_found_again_in_a_place_of_any_size(metres, gap):
    start = Pose(0.8 * metres, -0.4 * metres, 0.6)
    rig = Rig(ring(10, 1, 2 * metres, 4 * metres), pose=start, speed_sigma=0.01 * metres)

    def eight_across(t):
        return Twist(0.1 * metres, 0.5 * eight(t).omega)

    rig.drive(40, eight_across)
    rig.t += gap
    rig.pose = Pose(-0.5 * metres, 0.9 * metres, 2.5)
    assert rig.drive(20, eight_across).status is Status.LOCALISED
    assert rig.error() < 0.1 * metres
    assert rig.wrong_share() < 0.1  # before anybody can know that it was lifted


@pytest.mark.parametrize("jump", [3600.0, -3600.0])
def test_a_clock_that_jumps_by_an_hour(jump):
    rig = Rig(ring(8))
    rig.drive(40)
    rig.t += jump
    rig.drive(30)
    assert rig.answers[-1][0].status is Status.LOCALISED
    assert rig.error() < 0.15
    assert rig.wrong_share() < 0.02


def test_standing_still_for_a_quarter_of_an_hour():
    rig = Rig(ring(8))
    rig.drive(40)
    sigma = rig.localizer.estimate(rig.t).sigmas[:2].max()
    rig.drive(900, still, see=lambda seen: seen if rig.rng.random() < 0.1 else {})
    assert rig.error() < 0.1
    assert rig.localizer.estimate(rig.t).sigmas[:2].max() < 3 * sigma
    rig.drive(20)
    assert rig.error() < 0.1
    assert rig.wrong_share() < 0.01
