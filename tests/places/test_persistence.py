"""Persistence of a landmark: it fades, is learnt, and falls where it is missed."""

import numpy as np
import pytest

from homeward.places.persistence import (
    MIN_HIDDEN,
    LandmarkPersistence,
    missed_probability,
    tally,
    usual_rate,
)


def test_what_was_just_seen_stays_and_what_was_long_ago_may_not():
    seen = LandmarkPersistence(0.0, 0.0)
    stays = [seen.stays(day, 0.1) for day in (0, 1, 10, 100)]
    assert stays == sorted(stays, reverse=True)
    assert stays[1] == pytest.approx(10 / 11)
    assert stays[-1] < 0.1


def test_rates_are_learnt_of_each_landmark():
    rng, rates = np.random.default_rng(0), {}
    for rate in (0.02, 0.5):
        s = LandmarkPersistence(0.0, 0.0)
        for day in range(1, 200):
            s = s.seen_elsewhere(day) if rng.random() < 1 - np.exp(-rate) else s.seen_in_place(day)
        rates[rate] = s.rate(0.1)
    assert rates[0.02] == pytest.approx(0.02, rel=0.7)
    # Of several moves in a day one is seen.
    assert rates[0.5] == pytest.approx(1 - np.exp(-0.5), rel=0.3)


def test_one_that_is_missed_is_gone_and_one_that_is_back_was_not():
    s, beliefs = LandmarkPersistence(0.0, 0.0), []
    for day in (1.0, 2.0, 3.0):
        s = s.was_missed(day, 0.05, 0.1)
        beliefs.append(s.stands)
    assert beliefs[0] > 0.5 > beliefs[1] > beliefs[2]
    back = s.seen_in_place(4.0)
    assert (back.stands, back.returned, back.missed) == (1.0, 1, 0)


def test_being_hidden_costs_nothing_and_few_looks_say_little():
    assert missed_probability(0.5, 1000) == MIN_HIDDEN
    assert missed_probability(0.1, 2) == pytest.approx(0.81)
    assert missed_probability(0.9, 0) == 1.0


def test_a_place_in_which_much_moves_expects_as_much_of_a_new_landmark():
    still = [LandmarkPersistence(0.0, 30.0, watched=30.0) for _ in range(40)]
    busy = [LandmarkPersistence(0.0, 30.0, watched=30.0, moved=6) for _ in range(40)]
    assert usual_rate(*tally(still)) < 0.005 < 0.1 < usual_rate(*tally(busy))
