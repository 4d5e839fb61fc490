"""Many landmarks in view, and ids without end: what a frame costs does not grow."""

import math

import numpy as np

from homeward.localizer.inputs.bearing_noise import ById
from homeward.localizer.localizer import Localizer
from homeward.localizer.tunables import MAX_IDS, MAX_IN_VIEW
from homeward.reasons import Rejection


def test_of_many_landmarks_in_view_the_same_are_used_in_every_frame():
    rng = np.random.default_rng(0)
    places = rng.uniform(-8.0, 8.0, (300, 2))

    def seen(x, y, heading):
        bearings = np.arctan2(places[:, 1] - y, places[:, 0] - x) - heading
        noisy = bearings + rng.normal(0.0, 0.01, len(places))
        return {f"L{i}": b for i, b in enumerate(noisy.tolist())}

    localizer, t, x, y, heading = Localizer(seen(0.0, 0.0, 0.0)), 0.0, 1.0, 0.0, 0.5
    for _ in range(40):
        for _ in range(10):
            localizer.odometry(t, 0.2, 0.3)
            x, y = x + 0.004 * math.cos(heading), y + 0.004 * math.sin(heading)
            heading, t = heading + 0.006, t + 0.02
        answer = localizer.bearings(t, seen(x, y, heading))
    assert answer.pose is not None
    assert math.hypot(answer.pose.x - x, answer.pose.y - y) < 0.1
    assert len(localizer.chart.map.landmarks.mapped) <= MAX_IN_VIEW
    assert localizer.counts.rejected[Rejection.BEYOND_MAX] == 40 * (300 - MAX_IN_VIEW)


def test_ids_without_end_are_forgotten():
    localizer, t = Localizer({"a": 0.1, "b": 1.0, "c": 2.0}), 0.0
    for k in range(300):
        t += 1.0
        localizer.odometry(t, 0.2, 0.1)
        localizer.bearings(t, {f"{k} {i}": 0.05 * i for i in range(30)})
    chart = localizer.chart
    most = max(MAX_IDS, 2 * 30 * 121) + 30
    for kept in (chart.noise._last, chart.map._seen, chart.map.landmarks._candidates):
        assert len(kept) <= most
    assert len(chart.noise._last) <= MAX_IDS + 30


def test_what_is_not_old_is_kept():
    kept = ById[int]({str(i): i for i in range(MAX_IDS + 1)})
    assert kept.prune(lambda value: value < 10)
    assert len(kept) == MAX_IDS - 9
    assert not kept.prune(lambda value: True)
