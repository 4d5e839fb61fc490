"""Fixed-lag smoothing: estimates come in time, each once, and better than the causal ones."""

import dataclasses

import numpy as np
from rig import ring
from test_smoothing import deviations, recorded

from homeward.localizer.fixed_lag import FixedLag, smooth_with_lag
from homeward.localizer.localizer import Localizer
from homeward.track import run


def test_each_estimate_is_smoothed_once_and_at_most_the_lag_late():
    drive = recorded(ring(8), {}, seconds=25)
    alone = run(drive, Localizer(drive.home, **drive.settings.robot))
    localizer = Localizer(drive.home, **drive.settings.robot)
    late, given, found = FixedLag(localizer, 3.0), [], []

    def keep(estimate):
        given.append(estimate)
        due = late.add(estimate)
        found.extend(due)
        assert estimate.t - given[len(found)].t < 3.0
        assert all(estimate.t - each.t >= 2.4 for each in due)

    causal = run(drive, localizer, on_estimate=keep)
    found += late.finish()
    assert [each.t for each in found] == causal.t.tolist()
    assert np.array_equal(causal.x, alone.x, equal_nan=True)  # the localiser is not disturbed
    assert np.array_equal(causal.covariance, alone.covariance, equal_nan=True)
    assert late.add(given[5]) == []  # an old estimate


def test_a_late_pose_is_better_than_the_causal_one_also_across_a_slip():
    drive = recorded(ring(10), {}, seconds=50)
    o, seen, begin = drive.odometry, drive.sightings, drive.odometry.t[0] + 20.0
    slips = (o.t >= begin) & (o.t < begin + 1.0)
    dark = (seen.t >= begin) & (seen.t < begin + 1.5)
    drive = dataclasses.replace(
        drive,
        odometry=dataclasses.replace(o, omega=o.omega + 0.6 * slips),
        sightings=seen.rows((np.abs(seen.bearing) < 1.3) & ~dark),
    )
    causal = run(drive, Localizer(drive.home, **drive.settings.robot))
    late = smooth_with_lag(drive, 5.0)
    assert deviations(causal, drive.truth).max() > 5.0
    assert deviations(late, drive.truth).max() < 4.0
    assert late.has_pose[causal.has_pose].mean() > 0.97
    both = causal.has_pose & late.has_pose & (causal.t <= drive.truth.t[-1])
    there = drive.truth.at(causal.t[both])
    off = [np.hypot(t.x[both] - there.x, t.y[both] - there.y) for t in (causal, late)]
    assert np.square(off[1]).mean() < np.square(off[0]).mean()
