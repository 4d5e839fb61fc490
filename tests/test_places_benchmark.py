"""The peer of the places' benchmark is what it is said to be."""

import math

import numpy as np
import pytest

from benchmarks.places.persistence_filter import FALSE, MISSED, Persistence, PersistentResection

PLACES = {"a": (3.0, 0.5), "b": (0.4, 2.6), "c": (-2.0, -1.5), "d": (1.5, -2.5), "e": (-2.5, 1.0)}


def by_integration(rate, seen, now):
    """The posterior of one that goes at an unknown time, over a grid of all such times."""
    goes = (np.arange(400_000) + 0.5) * 1e-4
    weight = rate * np.exp(-rate * goes)
    for t, detected in seen:
        there = (1.0 - MISSED) if detected else MISSED
        weight = weight * np.where(goes > t, there, FALSE if detected else 1.0 - FALSE)
    return weight[goes > now].sum() / weight.sum()


@pytest.mark.parametrize(
    "seen",
    [[], [(0.5, True)], [(0.5, False), (0.7, False)], [(1.0, True), (2.0, False), (2.5, True)]],
)
def test_the_persistence_filter_is_the_posterior(seen):
    one = Persistence(0.3)
    for t, detected in seen:
        one.update(t, detected)
    assert one.probability(3.0) == pytest.approx(by_integration(0.3, seen, 3.0), rel=1e-3)


def test_what_was_moved_is_left_out_and_then_not_believed():
    pose = np.array([0.3, -0.2, 0.4])
    seen = {
        n: math.remainder(math.atan2(y - pose[1], x - pose[0]) - pose[2], math.tau)
        for n, (x, y) in PLACES.items()
    }
    seen["c"] += 0.8
    peer = PersistentResection(PLACES, 0.15, 0.01)
    for k in range(4):
        assert peer.look(float(k), seen) == pytest.approx(pose, abs=1e-6)
    assert peer.look(4.0, {n: seen[n] for n in ("a", "b", "c")}) is None  # c is believed no more
