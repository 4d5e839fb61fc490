"""How sure a difference between two estimators is: intervals and tests, paired over the runs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from scipy.stats import bootstrap, false_discovery_control, wilcoxon

RESAMPLES = 2000
"""Of a bootstrap; its 95 % ends are off by chance by some percent of the interval's width."""
AT_ONCE = 10_000_000
"""Numbers that a bootstrap draws at once; more would not fit into memory."""
FEWEST = 3
"""Runs that an interval or a test needs: of two, neither knows anything."""


class Interval(NamedTuple):
    """A value and its 95 % interval; NaN where it is not known."""

    value: float
    low: float = np.nan
    high: float = np.nan


class Pairing(NamedTuple):
    """One estimator against another on the same runs."""

    ratio: Interval
    """Of their RMSE, over the runs in which both have a pose."""
    p: float
    """Of Wilcoxon's signed-rank test, two-sided, on the runs' logarithms: that neither is better. A
    run without a pose is worse than any with one. NaN of fewer than `FEWEST` runs, or where
    neither ever has one."""


def rmse_interval(rmse: np.ndarray) -> Interval:
    """Return the RMSE over runs, and its bootstrap interval over these.

    Parameters
    ----------
    rmse : ndarray, shape (n,)
        Of each run; NaN where it has none.
    """
    return interval(_root_mean_square, rmse[~np.isnan(rmse)])


def paired(rmse: np.ndarray, other: np.ndarray) -> Pairing:
    """Compare an estimator with another, run by run.

    Parameters
    ----------
    rmse, other : ndarray, shape (n,)
        RMSE of each run, by either; NaN where it has no pose.
    """
    both = ~np.isnan(rmse) & ~np.isnan(other)
    ratio = interval(
        lambda a, b, axis=-1: _root_mean_square(a, axis) / _root_mean_square(b, axis),
        rmse[both],
        other[both],
    )
    if rmse.size < FEWEST or np.isnan([rmse, other]).all():
        return Pairing(ratio, np.nan)
    with np.errstate(invalid="ignore", divide="ignore"):
        a, b = (np.log(np.where(np.isnan(r), np.inf, r)) for r in (rmse, other))
        by = a - b
    by[a == b] = 0.0  # neither has a pose, or both are the same
    # Wilcoxon's test takes ranks alone; so do these numbers, which are finite.
    size = np.unique(np.abs(by), return_inverse=True)[1] + (0.0 if (by == 0).any() else 1.0)
    if not size.any():
        return Pairing(ratio, 1.0)
    return Pairing(ratio, float(wilcoxon(np.sign(by) * size).pvalue))


def adjusted(p: Sequence[float]) -> np.ndarray:
    """Return p-values adjusted for their number (Benjamini and Hochberg 1995), NaN kept."""
    values = np.array(p, float)
    known = ~np.isnan(values)
    if known.any():
        values[known] = false_discovery_control(values[known])
    return values


def _root_mean_square(values: np.ndarray, axis: int = -1) -> np.ndarray:
    with np.errstate(over="ignore"):
        return np.asarray(np.sqrt(np.mean(np.square(values), axis=axis)))


def interval(statistic: Callable[..., np.ndarray], *samples: np.ndarray) -> Interval:
    """Return a statistic of paired samples and its 95 % interval by bootstrap over the pairs.

    Parameters
    ----------
    statistic : callable
        Of arrays, along `axis`.
    *samples : ndarray, shape (n,)
        Finite numbers.
    """
    number = samples[0].size
    if not number:
        return Interval(np.nan)
    value = float(statistic(*samples))
    if number < FEWEST:
        return Interval(value)
    found = bootstrap(
        samples,
        statistic,
        n_resamples=RESAMPLES,
        batch=max(1, AT_ONCE // number),
        paired=True,
        vectorized=True,
        method="percentile",
        rng=np.random.default_rng(0),
    ).confidence_interval
    return Interval(value, float(found.low), float(found.high))
