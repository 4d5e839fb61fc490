"""The noise of bearings that nobody gave, by their second differences."""

import math

import numpy as np
import pytest

from homeward.localizer.inputs.bearing_noise import BearingNoise, valid_sigma
from homeward.localizer.inputs.reorder import BearingFrame
from homeward.localizer.map.sightings import COLUMNS, GAP, LANDMARK, OWN, SIGMA, scale_noise


def seen_noise(sigma, rate, given=None, seconds=10.0, wrong=0.0):
    """Drive a bend past five landmarks, seen so many times a second with a noise."""
    rng = np.random.default_rng(0)
    marks = rng.uniform(2.0, 4.0, 5) * np.exp(1j * rng.uniform(-math.pi, math.pi, 5))
    noise, speed, omega = BearingNoise(given, 0.02), 0.3, 0.4
    for t in np.arange(0.0, seconds, 1.0 / rate).tolist():
        at = speed / omega * 1j * (1 - np.exp(1j * omega * t))
        bearings = np.angle((marks - at) * np.exp(-1j * omega * t)) + sigma * rng.normal(size=5)
        lost = rng.random(5) < wrong
        bearings[lost] = rng.uniform(-math.pi, math.pi, int(lost.sum()))
        frame = BearingFrame(t, {f"L{i}": float(b) for i, b in enumerate(bearings)}, {})
        noise.add_bearings(frame, omega * t)
    return noise


@pytest.mark.parametrize("sigma", [0.03, 0.06, 0.15])
@pytest.mark.parametrize("rate", [2.0, 5.0, 30.0])
def test_it_is_told_without_a_map_while_the_robot_turns(sigma, rate):
    assert seen_noise(sigma, rate, seconds=30.0).sigma == pytest.approx(sigma, rel=0.2)


@pytest.mark.parametrize("wrong", [0.1, 0.2])
def test_some_wrong_ids_do_not_matter_much(wrong):
    assert seen_noise(0.05, 5.0, wrong=wrong).sigma == pytest.approx(0.05, rel=0.25)


def test_it_is_never_believed_to_be_less_than_the_default_and_differences_doubt_nothing_given():
    assert seen_noise(0.001, 5.0).sigma == 0.02
    assert seen_noise(0.1, 5.0, given=0.03).sigma == 0.03
    assert seen_noise(0.1, 5.0).typical == pytest.approx(0.1, rel=0.2)


def test_deviations_of_new_bearings_and_of_most_of_them():
    noise, told = BearingNoise(None, 0.02), {"a": 0.001, "b": 0.004, "c": 0.003}
    assert noise.typical == 0.02
    assert noise.sigmas(["a", "z"], told).tolist() == [0.001, 0.02]
    noise.sigmas(["a", "b", "c"], told)
    noise.sigmas([], {})
    assert noise.typical == 0.003


def test_sightings_too_rare_to_be_linear_in_time_tell_nothing():
    assert seen_noise(0.1, 0.9).sigma == 0.02


def test_what_can_be_a_deviation():
    assert valid_sigma(0.01) == 0.01
    assert valid_sigma(1e200) == math.pi
    assert all(math.isnan(valid_sigma(s)) for s in (0.0, -1.0, math.nan, math.inf, 1e-300))


class Left:
    """A window of which nothing but what it leaves of bearings is asked."""

    def __init__(self, scale, count=100):
        self.sightings = np.zeros((count, COLUMNS))
        self.sightings[:, SIGMA] = self.sightings[:, OWN] = 0.01
        self.off = 0.01 * scale * np.random.default_rng(0).normal(size=count)

    def told_to(self, noise):
        """Let the noise follow what is left."""
        own, whole, gaps, of = (self.sightings[:, c] for c in (OWN, SIGMA, GAP, LANDMARK))
        return noise.update(self.off, own, whole, gaps, of, 1)


def test_given_deviations_are_doubted_by_what_a_map_leaves_and_believed_again():
    noise = BearingNoise(0.01, 0.02)
    assert (noise.confirmed, noise.scale) == (False, 1.0)
    assert Left(1.2).told_to(noise) == 1.0
    assert (noise.confirmed, noise.scale) == (True, 1.0)
    bad = Left(5.0)
    scale_noise(bad.sightings, bad.told_to(noise))
    assert not noise.confirmed  # what was made of them has been too sure
    assert noise.scale == pytest.approx(5.0, rel=0.2)
    assert noise.sigma == pytest.approx(0.01 * noise.scale)
    assert bad.sightings[0, OWN] == pytest.approx(0.01 * noise.scale)
    bad.told_to(noise)
    assert noise.confirmed
    better = Left(0.2)
    scale_noise(better.sightings, noise.scale)
    scale_noise(better.sightings, better.told_to(noise))
    assert noise.scale == 1.0
    assert better.sightings[0, OWN] == pytest.approx(0.01)


def test_a_camera_that_becomes_worse_on_the_way_is_doubted():
    noise, worse = BearingNoise(0.01, 0.02), Left(1.0, 3000)
    worse.told_to(noise)
    assert noise.scale == 1.0
    worse.off[-400:] *= 4.0
    worse.told_to(noise)
    assert noise.scale == pytest.approx(4.0, rel=0.2)


def test_few_sightings_and_blurred_ones_doubt_nothing():
    noise, blurred = BearingNoise(0.01, 0.02), Left(5.0)
    blurred.sightings[:, SIGMA] *= 2.0
    Left(5.0, 20).told_to(noise)
    blurred.told_to(noise)
    assert (noise.confirmed, noise.scale) == (False, 1.0)
