"""Statistics over runs: means, quantiles, shares, intervals and paired tests."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import binomtest, bootstrap, false_discovery_control, wilcoxon

RESAMPLES = 2000
"""Number of bootstrap samples; the ends of an interval vary by some percent of its width."""
AT_ONCE = 10_000_000
"""Numbers that a bootstrap draws at once, so that they fit into memory."""
QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)
MIN_RUNS = 3
"""Minimum number of runs for an interval or a test."""


class Interval(NamedTuple):
    """A value and its 95 % interval; NaN where unknown."""

    value: float
    low: float = np.nan
    high: float = np.nan


class Pairing(NamedTuple):
    """One estimator against another on the same runs."""

    ratio: Interval
    """RMSE ratio, over the runs in which both have a pose."""
    p: float
    """p-value of the two-sided Wilcoxon signed-rank test on the logarithms of RMSE. A run without a
    pose ranks below any with one. NaN for fewer than `MIN_RUNS` runs, or if neither has a pose."""


def rmse_interval(rmse: np.ndarray) -> Interval:
    """Return the RMSE over runs (n,), NaN for unknown ones, with its bootstrap interval."""
    return interval(_root_mean_square, rmse[~np.isnan(rmse)])


def paired(rmse: np.ndarray, other: np.ndarray) -> Pairing:
    """Compare two estimators by the RMSE of each run (n,), NaN without a pose."""
    both = ~np.isnan(rmse) & ~np.isnan(other)
    ratio = interval(
        lambda a, b, axis=-1: _root_mean_square(a, axis) / _root_mean_square(b, axis),
        rmse[both],
        other[both],
    )
    if rmse.size < MIN_RUNS or np.isnan([rmse, other]).all():
        return Pairing(ratio, np.nan)
    with np.errstate(invalid="ignore", divide="ignore"):
        a, b = (np.log(np.where(np.isnan(r), np.inf, r)) for r in (rmse, other))
        difference = a - b
    difference[a == b] = 0.0  # neither has a pose, or both are the same
    # Wilcoxon's test uses only ranks; ranks of infinite differences are finite.
    ranks = np.unique(np.abs(difference), return_inverse=True)[1]
    size = ranks + (0.0 if (difference == 0).any() else 1.0)
    if not size.any():
        return Pairing(ratio, 1.0)
    return Pairing(ratio, float(wilcoxon(np.sign(difference) * size).pvalue))


def adjusted(p: Sequence[float]) -> np.ndarray:
    """Return p-values adjusted for their number (Benjamini and Hochberg 1995), NaN kept."""
    values = np.array(p, float)
    known = ~np.isnan(values)
    if known.any():
        values[known] = false_discovery_control(values[known])
    return values


def known(values: np.ndarray, statistic: Callable[[np.ndarray], Any]) -> float:
    """Return a statistic of the known values; NaN where none is known."""
    some = values[~np.isnan(values)]
    return float(statistic(some)) if some.size else np.nan


def mean(values: np.ndarray) -> float:
    """Return the mean of the known values; NaN where none is known."""
    return known(values, np.mean)


def root_mean_square(values: np.ndarray) -> float:
    """Return the root of the mean square of the known values; NaN where none is known."""
    return known(values, _root_mean_square)


def _root_mean_square(values: np.ndarray, axis: int = -1) -> np.ndarray:
    """Return the root of the mean square along an axis."""
    with np.errstate(over="ignore"):
        return np.asarray(np.sqrt(np.mean(np.square(values), axis=axis)))


def quantiles(values: np.ndarray) -> np.ndarray:
    """Return `QUANTILES` of the known values, (5,), without interpolation; NaN for no values."""
    known = values[~np.isnan(values)]
    if not known.size:
        return np.full(len(QUANTILES), np.nan)
    return np.asarray(np.quantile(known, QUANTILES, method="inverted_cdf"))


def wilson(hits: int, number: int) -> tuple[float, float]:
    """Return the 95 % interval of a share with `hits` out of `number` (Wilson 1927)."""
    if not number:
        return np.nan, np.nan
    low, high = binomtest(hits, number).proportion_ci(method="wilson")
    return float(low), float(high)


def interval(statistic: Callable[..., np.ndarray], *samples: np.ndarray) -> Interval:
    """Return a statistic of paired samples and its 95 % interval by bootstrap over the pairs.

    The statistic is of arrays along `axis`; samples (n,) are finite.
    """
    number = samples[0].size
    if not number:
        return Interval(np.nan)
    value = float(statistic(*samples))
    if number < MIN_RUNS:
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
