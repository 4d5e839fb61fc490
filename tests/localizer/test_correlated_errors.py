"""Bearing errors that last: what is learnt of them, and how much sightings then count."""

import math

import numpy as np
import pytest
from wandering_drives import late_figures, with_correlated_errors

from homeward.localizer.inputs.bearing_noise import CorrelatedErrors
from homeward.localizer.localizer import Localizer
from homeward.track import run


def process(rng, share, time, gap, count, landmarks=8):
    """Return errors of unit variance, a share of which lasts, and gaps and landmarks of each."""
    kept = math.exp(-gap / time)
    slow = rng.normal(size=(count, landmarks))
    for k in range(1, count):
        slow[k] = kept * slow[k - 1] + math.sqrt(1.0 - kept**2) * slow[k]
    errors = math.sqrt(share) * slow + math.sqrt(1.0 - share) * rng.normal(size=slow.shape)
    gaps = np.full(slow.shape, gap)
    gaps[0] = np.inf
    numbers = np.broadcast_to(np.arange(landmarks), slow.shape)
    return errors.ravel(), gaps.ravel(), numbers.ravel()


@pytest.mark.parametrize(
    ("share", "time", "gap"), [(0.8, 2.0, 0.1), (0.5, 1.0, 0.2), (0.9, 5.0, 0.5)]
)
def test_what_lasts_is_learnt_by_its_share_and_its_time(share, time, gap):
    correlated = CorrelatedErrors()
    correlated.update(*process(np.random.default_rng(0), share, time, gap, 6000), 1.0)
    assert correlated.share == pytest.approx(share, abs=0.1)
    assert correlated.correlation_time == pytest.approx(time, rel=0.35)


def test_white_errors_cost_nothing():
    correlated = CorrelatedErrors()
    errors, gaps, landmarks = process(np.random.default_rng(1), 0.0, 1.0, 0.1, 3000)
    correlated.update(errors, gaps, landmarks, 1.0)
    assert correlated.excess(gaps).mean() < 0.2


def test_nothing_is_said_of_few_or_unknown_errors():
    correlated = CorrelatedErrors()
    errors, gaps, landmarks = process(np.random.default_rng(2), 0.9, 2.0, 0.2, 4)
    correlated.update(errors, gaps, landmarks, 1.0)
    errors, gaps, landmarks = process(np.random.default_rng(2), 0.9, 2.0, 0.2, 400)
    correlated.update(np.full_like(errors, np.nan), gaps, landmarks, 1.0)
    assert correlated.share == 0.0


def test_wild_errors_do_not_last():
    rng, correlated = np.random.default_rng(3), CorrelatedErrors()
    errors, gaps, landmarks = process(rng, 0.0, 1.0, 0.1, 3000)
    errors[rng.random(errors.size) < 0.02] = 500.0
    correlated.update(errors, gaps, landmarks, 1.0)
    assert correlated.share < 0.1


@pytest.mark.parametrize("gap", [0.02, 0.3, 2.0, 30.0])
def test_as_many_sightings_tell_as_much_as_the_mean_of_their_process(gap):
    """The variance of the mean of n samples of the process, exactly."""
    share, time, n = 0.7, 1.5, 20_000
    correlated = CorrelatedErrors()
    correlated.share, correlated.correlation_time = share, time
    kept = math.exp(-gap / time)
    lag = np.arange(1, n)
    exact = (1.0 + 2.0 * share * ((1.0 - lag / n) * kept**lag).sum()) / n
    counted = (1.0 + correlated.excess(np.array([gap]))[0]) / n
    assert counted == pytest.approx(exact, rel=0.01)
    assert correlated.excess(np.array([np.inf, 0.0])).tolist()[0] == 0.0
    assert np.isfinite(correlated.excess(np.array([0.0])))


def test_maps_keep_their_scale_where_errors_last():
    drive, whole = with_correlated_errors(1, 150.0)
    localizer = Localizer(drive.home, **drive.settings.robot)
    track = run(drive, localizer)
    assert any(
        n.startswith("Bearing errors of") and "correlated over" in n for n in localizer.notes
    )
    (small,) = localizer.chart.noise.correlated.notes(1e-4)
    assert not small.startswith("Bearing errors of 0 ")
    assert not small.startswith("Bearing errors of 0.0 ")
    found = late_figures(track, drive, whole)
    assert abs(found["scale"]) < 1.0  # 3.5 and more where they are counted as white
    assert found["pose"] > 0.95
    assert 0.2 < found["nees"] < 3.0
