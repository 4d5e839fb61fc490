"""Scores against cases that can be worked out by hand."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

from homeward.drives.drive import Truth
from homeward.drives.opening import open_drive
from homeward.errors import InputError
from homeward.estimator import Counts, Status
from homeward.localizer.smoothing import smooth
from homeward.reasons import Rejection
from homeward.registry import make_estimator
from homeward.runs.scoring import (
    CHI_SQUARE_1_95,
    CHI_SQUARE_3_95,
    ELLIPSE_SHARES,
    errors,
    normalised_squared,
    score,
    statistics,
)
from homeward.track import Innovations, Track, run


def track(t, x=0.0, y=0.0, heading=0.0, sigma=0.1, status=None, **other):
    """Make a track whose columns may be numbers or arrays; NaN is no pose."""
    t = np.asarray(t, float)
    n = t.size
    x, y, heading = (np.broadcast_to(np.asarray(a, float), n).copy() for a in (x, y, heading))
    none = np.empty(0)
    innovations = Innovations(none, none.astype(str), none, none, none.astype(bool))
    covariance = np.tile(sigma**2 * np.eye(3), (n, 1, 1))
    covariance[np.isnan(x)] = np.nan
    fields = {
        "estimator": "made up",
        "t": t,
        "x": x,
        "y": y,
        "heading": heading,
        "covariance": covariance,
        "status": status or [Status.LOCALISED if p else Status.WAITING for p in np.isfinite(x)],
        "reason": ["because"] * n,
        "innovations": innovations,
        "update_seconds": none,
        "run_seconds": 1.5,
        "landmarks": [],
        "counts": Counts(),
        "notes": (),
    }
    return Track(**(fields | other))


def still(t, x=0.0, y=0.0, heading=0.0):
    """Return ground truth of a robot at rest."""
    t = np.asarray(t, float)
    return Truth(t, np.full(t.size, x), np.full(t.size, y), np.full(t.size, heading))


def steps(end, dt=0.1):
    return np.arange(round(end / dt) + 1) * dt


def test_a_constant_offset_is_every_statistic():
    a = score(track(steps(10), x=1.3, y=0.4), still(steps(10), x=1.0)).accuracy
    assert a.scored_s == pytest.approx(10.0)
    for value in (a.position.rmse, a.position.median, a.position.p95, a.position.max):
        assert value == pytest.approx(0.5)
    assert a.R.rmse == pytest.approx(math.hypot(1.3, 0.4) - 1.0)
    assert a.theta.max == pytest.approx(math.atan2(0.4, 1.3))
    assert a.heading.max == 0.0
    # (0.3^2 + 0.4^2) / 0.1^2
    assert a.nees_mean == pytest.approx(25.0)
    assert a.nees_inside_95_share == 0.0
    assert a.position_inside_sigma_shares == (0.0, 0.0, 0.0)


def test_metrics_are_printed_as_a_short_table():
    there = track(steps(10), x=0.3)
    said = str(score(there, still(steps(10)))).splitlines()
    assert "position error  0.300 m RMSE, 0.300 m maximum" in said
    assert "with a pose     100 %, first after 0.0 s (also unverified)" in said
    assert len(said) <= 7
    assert "error" not in str(score(there, None))


def test_rows_weigh_until_the_next_row():
    # Off by 1 m for 1 s, by 3 m for 0.5 s; the last row lasts no time.
    a = score(track([0.0, 1.0, 1.5], x=[1.0, 3.0, 99.0]), still(steps(2))).accuracy
    assert a.scored_s == pytest.approx(1.5)
    assert a.position.rmse == pytest.approx(math.sqrt((1 * 1.0 + 9 * 0.5) / 1.5))
    assert a.position.median == 1.0
    assert a.position.p95 == 3.0
    assert a.position.max == 3.0


def test_gaps_and_ends_of_truth_are_not_scored():
    # Truth from 1 to 2 s and from 4 to 5 s; in between and outside the track is far off.
    truth = still(np.concatenate([1 + steps(1), 4 + steps(1)]))
    t = np.array([0.0, 0.5, 1.0, 1.9, 2.4, 3.0, 4.0, 4.9, 5.5, 6.0])
    x = np.array([9.0, 9.0, 0.2, 0.4, 9.0, 9.0, 0.2, 0.4, 9.0, 9.0])
    a = score(track(t, x=x), truth).accuracy
    assert a.scored_s == pytest.approx(2.0)
    assert a.position.max == pytest.approx(0.4)
    expected = math.sqrt((2 * 0.9 * 0.2**2 + 2 * 0.1 * 0.4**2) / 2)
    assert a.position.rmse == pytest.approx(expected)


def test_slow_truth_is_scored_at_its_own_stamps():
    t = np.arange(0.0, 10.05, 0.1)
    x = np.where(np.abs(t - np.round(t)) < 0.01, 0.2, 9.0)
    a = score(track(t, x=x), still(np.arange(11.0))).accuracy
    assert a.position.rmse == pytest.approx(0.2)
    assert a.scored_s == pytest.approx(11.0)


def test_half_a_second_is_no_gap():
    a = score(track(steps(4), x=1.0), still(steps(4, 0.5))).accuracy
    assert a.scored_s == pytest.approx(4.0)


def test_headings_are_compared_around_pi():
    scored = errors(track(steps(1), heading=-3.1), still(steps(1), heading=3.1))
    np.testing.assert_allclose(scored.heading, 2 * math.pi - 6.2)


def test_theta_is_compared_around_pi():
    scored = errors(track(steps(1), x=-1.0, y=-0.1), still(steps(1), x=-1.0, y=0.1))
    np.testing.assert_allclose(scored.theta, 2 * math.atan(0.1))


def test_truth_is_interpolated():
    truth = Truth(np.array([0.0, 0.4]), np.array([0.0, 4.0]), np.zeros(2), np.array([3.0, -3.0]))
    scored = errors(track([0.1, 0.2], x=[1.0, 2.5], heading=math.pi), truth)
    np.testing.assert_allclose(scored.position, [0.0, 0.5], atol=1e-12)
    np.testing.assert_allclose(scored.heading[1], 0.0, atol=1e-12)


def test_rows_without_a_pose_are_not_scored_but_cost_share():
    x = np.where(steps(10) < 2.45, np.nan, 0.0)
    metrics = score(track(steps(10), x=x), still(steps(10)))
    assert metrics.accuracy.scored_s == pytest.approx(7.5)
    assert metrics.pose_share == pytest.approx(0.75)
    assert metrics.first_pose_after_s == pytest.approx(2.5)
    assert metrics.status_shares == pytest.approx({Status.WAITING: 0.25, Status.LOCALISED: 0.75})


def test_nees_of_correlated_covariance():
    covariance = np.array([[[2.0, 1.0, 0.0], [1.0, 2.0, 0.0], [0.0, 0.0, 4.0]]])
    e = np.array([[1.0, 1.0, 2.0]])
    # Along (1, 1) the variance is 3, the error sqrt(2).
    np.testing.assert_allclose(normalised_squared(e, covariance), 2 / 3 + 1)


def test_a_covariance_that_is_none_counts_as_never_inside():
    bad = np.stack([np.zeros((3, 3)), np.diag([1.0, 1.0, -1.0])])
    assert np.isinf(normalised_squared(np.zeros((2, 3)), bad)).all()
    metrics = score(track(steps(1), sigma=0.0), still(steps(1)))
    assert metrics.accuracy.nees_inside_95_share == 0.0
    assert "nees_mean" not in metrics.as_dict()
    json.dumps(metrics.as_dict(), allow_nan=False)


def test_consistent_errors_score_as_consistent():
    rng = np.random.default_rng(5)
    n = 20001
    e = 0.1 * rng.normal(size=(n, 3))
    t = 0.1 * np.arange(n)
    a = score(track(t, x=5 + e[:, 0], y=e[:, 1], heading=e[:, 2]), still(t, x=5)).accuracy
    assert a.nees_mean == pytest.approx(3.0, abs=0.06)
    assert a.nees_inside_95_share == pytest.approx(0.95, abs=0.006)
    assert a.position_inside_sigma_shares == pytest.approx(ELLIPSE_SHARES, abs=0.012)


def test_named_quantiles_are_right():
    root = math.sqrt(CHI_SQUARE_3_95 / 2)
    below = math.erf(root) - 2 / math.sqrt(math.pi) * root * math.exp(-(root**2))
    assert below == pytest.approx(0.95, abs=1e-12)
    assert math.erf(math.sqrt(CHI_SQUARE_1_95 / 2)) == pytest.approx(0.95, abs=1e-12)
    assert pytest.approx([1 - math.exp(-(k**2) / 2) for k in (1, 2, 3)]) == ELLIPSE_SHARES


def test_weighted_quantiles():
    s = statistics(np.array([-4.0, 1.0, 2.0, 3.0]), np.array([0.04, 0.5, 0.4, 0.06]))
    assert (s.median, s.p95, s.max) == (1.0, 3.0, 4.0)
    # A row of no weight is no worst case.
    assert statistics(np.array([1.0, 50.0]), np.array([1.0, 0.0])).max == 1.0


def test_without_truth_the_rest_is_there():
    innovations = Innovations(
        t=np.array([0.0, 0.1, 0.2, 0.3]),
        landmark=np.array(["a"] * 4),
        value=np.array([0.1, -0.3, 0.1, 0.9]),
        sigma=np.full(4, 0.1),
        accepted=np.array([True, True, True, False]),
    )
    counts = Counts(used=3)
    counts.reject(Rejection.OUTSIDE_GATE)
    other = {
        "innovations": innovations,
        "counts": counts,
        "update_seconds": np.array([0.001, 0.002, 0.009]),
    }
    plain = score(track(steps(1), **other), None).as_dict()
    assert plain["innovation_nis_mean"] == pytest.approx((1 + 9 + 1) / 3)
    assert plain["innovation_inside_95_share"] == pytest.approx(0.5)
    assert plain["update_median_s"] == 0.002
    assert plain["run_s"] == 1.5
    assert plain["sightings_used"] == 3
    assert plain["rejected"] == {"bearing is outside the gate": 1}
    assert not any(key.startswith(("position", "nees", "scored")) for key in plain)


@pytest.mark.parametrize("truth", [still([]), still([0.5]), still([50.0, 50.1])])
def test_truth_that_judges_nothing_gives_no_accuracy(truth):
    assert score(track(steps(1)), truth).accuracy is None


@pytest.mark.parametrize("t", [[], [3.0]])
def test_tracks_that_last_no_time(t):
    metrics = score(track(t), still(steps(10)))
    assert metrics.accuracy is None
    assert metrics.pose_share is None
    assert metrics.duration_s == 0.0
    json.dumps(metrics.as_dict(), allow_nan=False)


def test_keys_name_their_units():
    plain = score(track(steps(1), x=1.0), still(steps(1))).as_dict()
    assert {"position_rmse_m", "R_p95_m", "theta_max_rad", "heading_median_rad"} <= set(plain)
    assert plain["localised_share"] == 1.0


def test_what_is_no_track_and_no_truth_is_refused_with_what_to_give():
    drive = open_drive("sample")
    with pytest.raises(InputError, match="not a str; run gives one"):
        score("track", None)
    with pytest.raises(InputError, match=r"a Truth is needed, not a ndarray; give drive\.truth"):
        score(track([0.0, 1.0]), np.zeros((3, 4)))
    with pytest.raises(InputError, match=r"make one with make_estimator\('robust', drive\)"):
        run(drive, "robust")
    with pytest.raises(InputError, match=r"a Drive is needed, not a .*; read one"):
        run(Path("sample"), None)
    with pytest.raises(InputError, match="a Drive is needed, not a str; read one"):
        make_estimator("robust", "sample")
    with pytest.raises(InputError, match="give the drive, not its track"):
        smooth("track")
