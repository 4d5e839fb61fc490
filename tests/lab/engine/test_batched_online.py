"""Filters in batches over recorded drives, compared with the same filters sample by sample."""

from dataclasses import replace

import numpy as np
import pytest

from homeward.drives.drive import HomeBearing
from homeward.lab.engine.estimators.batched_online import batch_kind, run_batched
from homeward.lab.simulation.simulate import changed_scenario, load_scenario, simulate
from homeward.native.compiler import NativeError, find_compiler
from homeward.registry import make_estimator
from homeward.track import run

try:
    find_compiler()
except NativeError as error:
    pytest.skip(f"native engine: {error}", allow_module_level=True)


def driven(seed=3, **changes):
    """A short drive; grid points of the track and odometry share their stamps."""
    few = {"landmarks.count": 3, "moved.count": 1, "noise.bearing_sigma": 0.02, "seed": seed}
    few |= {"trajectory.duration": 4.0, **changes}
    return simulate(changed_scenario(load_scenario("circle"), few)).drive


def troubled():
    """Stamps off their time, a hole in the odometry, own deviations, a landmark never at home."""
    drive = driven(**{"rates.jitter": 0.004, "trajectory.duration": 6.0})
    o, s = drive.odometry, drive.sightings
    home = dict(drive.home)
    home["unseen"] = HomeBearing(1.0)
    del home[str(s.landmark[0])]
    sigma = np.where(np.arange(s.t.size) % 3, np.nan, 0.05)
    hole = (o.t > 2.0) & (o.t < 4.5)
    return replace(drive, home=home, odometry=o.rows(~hole), sightings=replace(s, sigma=sigma))


def assert_equal(track, alone, atol=1e-9):
    for name in ("t", "x", "y", "heading", "covariance"):
        expected = getattr(alone, name)
        np.testing.assert_allclose(getattr(track, name), expected, atol=atol, err_msg=name)
    np.testing.assert_array_equal(track.innovations.accepted, alone.innovations.accepted)
    order = [np.lexsort((i.landmark, i.t)) for i in (track.innovations, alone.innovations)]
    for name in ("value", "sigma"):
        a, b = (getattr(t.innovations, name)[k] for t, k in zip((track, alone), order, strict=True))
        np.testing.assert_allclose(a, b, atol=atol, err_msg=name)
    assert track.counts.used == alone.counts.used
    for mine, other in zip(track.landmarks, alone.landmarks, strict=True):
        assert (mine.landmark, mine.sightings) == (other.landmark, other.sightings)
        for name in ("home_bearing_estimated", "distance", "sigma_distance"):
            np.testing.assert_allclose(getattr(mine, name), getattr(other, name), rtol=1e-6)


@pytest.mark.parametrize("name", ["ekf", "a-ekf", "pi-ekf", "schmidt", "ukf"])
@pytest.mark.parametrize("drive", [driven(), troubled()], ids=["plain", "troubled"])
def test_a_batch_equals_sample_after_sample(name, drive):
    other = replace(drive, sightings=drive.sightings.rows(drive.sightings.t < 3.0))
    drives = [drive, other, drive]
    tracks = run_batched(drives, [make_estimator(name, d) for d in drives], "native")
    for d, track in zip(drives, tracks, strict=True):
        assert_equal(track, run(d, make_estimator(name, d)))


@pytest.mark.parametrize("others", [0, 1])
def test_a_drive_that_is_over_at_once_is_run_too(others):
    first = driven().odometry.rows(np.arange(1))
    over = replace(driven(), odometry=first, sightings=driven().sightings.rows(np.arange(0)))
    drives = [over, over, *[driven()] * others]
    tracks = run_batched(drives, [make_estimator("ekf", d) for d in drives], "native")
    assert_equal(tracks[0], run(over, make_estimator("ekf", over)))


def test_a_filter_is_the_same_in_any_company():
    drives = [driven(seed) for seed in range(5)]
    all_of_them = run_batched(drives, [make_estimator("ekf", d) for d in drives], "native")
    alone = run_batched(drives[2:3], [make_estimator("ekf", drives[2])], "native")
    np.testing.assert_array_equal(all_of_them[2].covariance, alone[0].covariance)
    np.testing.assert_array_equal(all_of_them[2].x, alone[0].x)


def test_settings_differ_from_filter_to_filter():
    drive = driven()
    each = [{"proportional": p, "integral_gain": m} for p in (0.0, 0.1) for m in (0.01, 0.5)]
    each += [{"bearing_sigma": 0.1, "gate": None, "minimum_visible": 3}]
    tracks = run_batched([drive] * 5, [make_estimator("pi-ekf", drive, t) for t in each], "native")
    for settings, track in zip(each, tracks, strict=True):
        assert_equal(track, run(drive, make_estimator("pi-ekf", drive, settings)))


def test_one_that_diverges_is_left_to_itself():
    drive = driven()
    wild = make_estimator("pi-ekf", drive, {"proportional": 1e13})
    tame = make_estimator("pi-ekf", drive)
    tracks = run_batched([drive, drive], [wild, tame], "native")
    assert tracks[0] is None
    assert_equal(tracks[1], run(drive, make_estimator("pi-ekf", drive)))


def test_what_is_not_a_filter_in_the_papers_state_runs_by_itself():
    drive = driven()
    for name in ("robust", "invariant", "particle", "adaptive"):
        assert batch_kind(make_estimator(name, drive)) is None
