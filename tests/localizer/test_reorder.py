"""Samples that do not come in the order of their stamps, as on a robot whose camera thinks."""

import numpy as np
import pytest
from rig import EVERY, Rig, Wheels, ring

from homeward.estimator import Estimate, Status
from homeward.localizer.localizer import Localizer
from homeward.localizer.motions import CALIBRATION

NOTHING = np.zeros(len(CALIBRATION))


class Tape:
    """Stands in for an estimator, and keeps what it was told."""

    def __init__(self):
        self.twists, self.sights = [], []

    def odometry(self, *sample):
        self.twists.append(sample)

    def bearings(self, *sample):
        self.sights.append(sample)
        return Estimate(sample[0], Status.WAITING, "taped")


@pytest.fixture(scope="module")
def rig():
    rig = Rig(ring(8), promise=None)
    rig.localizer = Tape()
    rig.drive(40)
    return rig


def fed(rig, odometry_late=0.0, bearings_late=0.0):
    """A localiser that was fed a tape with both kinds as late as told [s], and its answers."""
    localizer = Localizer(rig.home)
    arrivals = [(s[0] + odometry_late, 0, s) for s in rig.localizer.twists]
    arrivals += [(s[0] + bearings_late, 1, s) for s in rig.localizer.sights]
    answers = []
    for _, kind, sample in sorted(arrivals, key=lambda a: (round(a[0], 6), a[1])):
        if kind == 0:
            localizer.odometry(*sample)
        else:
            answers.append(localizer.bearings(*sample))
    return localizer, answers


@pytest.mark.parametrize("late", [0.1, 0.3, 0.8])
def test_late_bearings_give_the_answers_that_they_give_in_order(rig, late):
    localizer, answers = fed(rig, bearings_late=late)
    ordered, expected = fed(rig)
    assert expected[-1].status is Status.LOCALISED
    assert [a.t for a in answers] == [a.t for a in expected]
    assert [a.pose for a in answers] == [a.pose for a in expected]
    assert localizer.counts == ordered.counts
    assert localizer.chart.noise.sigma == ordered.chart.noise.sigma


@pytest.mark.parametrize("late", [0.1, 0.3, 0.8])
def test_bearings_wait_for_late_odometry(rig, late):
    localizer, answers = fed(rig, odometry_late=late)
    assert sum(localizer.counts.rejected.values()) <= 8 * (1 + late / 0.2)
    assert answers[-1].status is Status.LOCALISED
    ordered = fed(rig)[1][-1].pose
    off = np.subtract(answers[-1].pose, ordered)
    assert np.hypot(*off[:2]) < 0.05 + 0.2 * late


def test_bearings_do_not_wait_for_odometry_that_is_gone(rig):
    localizer, _ = fed(rig, odometry_late=0.3)
    t, seen, sigmas = rig.localizer.sights[-1]
    used = localizer.counts.used
    for k in range(1, 20):
        localizer.bearings(t + 0.2 * k, seen, sigmas)
    assert localizer.counts.used > used + 8 * 6  # at keyframes: nobody knows the way from there


@pytest.mark.parametrize("kind", ["odometry", "bearings"])
def test_most_that_comes_too_late_is_told(rig, kind):
    answers = fed(rig, **{f"{kind}_late": 1.3})[1]
    assert answers[-1].pose is None
    assert f"most {kind} came too late, " in answers[-1].reason
    assert "feed samples in the order of their stamps" in answers[-1].reason


def motion(order, ahead=()):
    """The motion over twists that come in an order, with some of the times run past."""
    odometry = Wheels()
    odometry.restart(0.0)
    for k in order:
        assert odometry.accepts(k / 10)
        odometry.add(k / 10, 0.2 + 0.01 * k, 0.1 * k)
        if k in ahead:
            odometry.run_ahead(k / 10, NOTHING)
    return odometry, odometry.advance(2.0, NOTHING)


def test_twists_may_come_in_any_order_until_a_sighting_is_taken():
    rng = np.random.default_rng(0)
    order = [0, *sorted(range(1, 20), key=lambda k: k + 5 * rng.random())]
    assert order != sorted(order)
    odometry, mixed = motion(order, ahead=order[4::5])
    _, expected = motion(range(20))
    np.testing.assert_allclose(mixed.delta, expected.delta)
    np.testing.assert_allclose(mixed.covariance, expected.covariance, rtol=2e-2, atol=1e-9)
    assert odometry.accepts(2.0)
    assert not odometry.accepts(1.99)


def test_what_ran_ahead_is_forgotten_when_it_is_long_past():
    odometry = Wheels()
    odometry.restart(0.0)
    for k in range(100):
        odometry.add(k / 10, 0.2, 0.1)
        odometry.run_ahead(k / 10, NOTHING)
    assert odometry.accepts(8.9)
    assert not odometry.accepts(8.0)


def test_looks_that_see_nothing_say_nothing(rig):
    """Recordings have no rows for them: what they would change, no replay could repeat."""
    localizer, silent = Localizer(rig.home), Localizer(rig.home)
    for k, sight in enumerate(rig.localizer.sights):
        for twist in rig.localizer.twists[EVERY * k : EVERY * (k + 1)]:
            localizer.odometry(*twist)
            silent.odometry(*twist)
        if k % 3:
            assert localizer.bearings(*sight) == silent.bearings(*sight)
        else:
            assert localizer.bearings(sight[0], {}) == silent.estimate(sight[0])
    assert localizer.landmarks() == silent.landmarks()
