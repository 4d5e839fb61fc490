"""The history of twists: late ones in their place, and the heading by them alone."""

import math

import pytest

from homeward.estimator import HOLD_S
from homeward.localizer.motion.twists import Twists


def history(order, omega=0.5, every=0.1):
    twists = Twists()
    for k in order:
        twists.add(every * k, 0.2, omega)
    return twists


@pytest.mark.parametrize("order", [range(10), [0, 3, 1, 2, 5, 4, 9, 8, 7, 6]])
def test_the_heading_does_not_depend_on_the_order_in_which_twists_came(order):
    assert history(order).heading(0.95) == pytest.approx(0.5 * 0.95)
    assert history(order).heading(0.35) == pytest.approx(0.5 * 0.35)


def test_a_twist_holds_no_longer_than_is_promised():
    assert history(range(1)).heading(100.0) == pytest.approx(0.5 * HOLD_S)


def test_a_twist_of_the_same_stamp_replaces_the_other():
    twists = history(range(3))
    twists.add(0.2, 0.2, 2.0)
    assert twists.before(5.0).omega == 2.0
    assert len(twists.between(0.0, 1.0)) == 3


def test_before_the_first_there_is_none():
    assert not Twists()
    assert Twists().newest == -math.inf
    assert Twists().heading(1.0) == 0.0
    assert history(range(3)).before(-1.0) is None


def test_what_is_forgotten_is_not_needed_for_later_headings():
    twists = history(range(100))
    twists.forget(5.0)
    assert twists.between(0.0, 4.0) == []
    assert twists.before(5.05).t == pytest.approx(5.0)
    assert twists.heading(9.95) == pytest.approx(0.5 * 9.95)
