"""Notes on home bearings: of a narrow camera, and of the opposite sign."""

import dataclasses
import math
import re

import pytest
from rig import Rig, ring

from homeward.localizer.home.turn_note import span
from homeward.localizer.localizer import Localizer
from homeward.reasons import Reason


def driven(seed, half_angle):
    """Rig after a drive; its home bearings are those within an angle ahead [rad]."""
    rig = Rig(ring(12), seed, promise=None)
    home = {n: b for n, b in rig.home.items() if abs(b.bearing) < half_angle}
    rig.localizer = Localizer(home, **rig.settings.robot)
    rig.drive(25.0)
    return rig.localizer


def heading_deviation(localizer):
    return math.degrees(math.sqrt(localizer.chart.home.hypotheses.best.covariance[2, 2]))


def test_the_gain_of_a_turn_at_home_is_that_of_bearings_of_all_landmarks():
    narrow, whole = driven(0, 0.8), driven(0, math.pi)
    (note,) = [n for n in narrow.notes if "turns on the spot" in n]
    now, then = map(float, re.findall(r"([0-9.]+) deg[. ]", note))
    assert now == pytest.approx(heading_deviation(narrow), rel=0.05)
    assert then == pytest.approx(heading_deviation(whole), rel=0.3)
    assert now > 5.0 * then
    assert not [n for n in whole.notes if "turns on the spot" in n]


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_home_bearings_of_the_opposite_sign_are_named_and_right_ones_never(seed, sign):
    rig = Rig(ring(12), seed, promise=None)
    for name in list(rig.home)[:3]:  # moved since
        seen = rig.home[name]
        rig.home[name] = dataclasses.replace(seen, bearing=seen.bearing + 0.5)
    home = {n: dataclasses.replace(b, bearing=sign * b.bearing) for n, b in rig.home.items()}
    rig.localizer = Localizer(home, **rig.settings.robot)
    rig.drive(25.0)
    named = [n for n in rig.localizer.notes if "fit the map with the opposite sign" in n]
    assert bool(named) == (sign < 0)
    now = rig.localizer.estimate(rig.t)
    assert (now.pose is None) == (sign < 0)
    assert (now.reason == Reason.HOME_MIRRORED.words) == (sign < 0)
    assert any(mark.moved for mark in rig.localizer.landmarks()) == (sign > 0)


@pytest.mark.parametrize(
    ("bearings", "angle"),
    [([0.4], 0.0), ([3.0, -3.0, 3.1], math.tau - 6.0), ([0.0, 2.0, 4.0], 4.0)],
)
def test_the_span_of_bearings_is_the_smallest_angle_that_contains_them(bearings, angle):
    assert span(bearings) == pytest.approx(angle)
