"""A study in numbers: per scenario and estimator, over its runs."""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np
from scipy.stats import binomtest

from homeward.studies.study.results import Results

QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)
FEWEST_SHARE = 0.2
"""Over time, means are told while at least this share of the runs goes on."""


@dataclass(frozen=True)
class Line:
    """One estimator in one scenario."""

    scenario: str
    estimator: str
    rmse: float
    """Of the position, over all runs [m]."""
    quantiles: np.ndarray
    """(5,), `QUANTILES` of the runs' RMSE of the position [m]."""
    bound: float
    """Cramer-Rao bound on `rmse` [m]; NaN where it is not known."""
    heading_rmse: float
    """[rad]"""
    nees: np.ndarray
    """(5,), `QUANTILES` of the runs' mean NEES: 3 when consistent."""
    home: float
    """Share of runs that ended at home; NaN in the open loop."""
    home_interval: tuple[float, float]
    """95 % interval of that share (Wilson)."""
    moved_right: float
    """Share of runs in which exactly the moved landmarks were named; NaN if it names none."""
    no_pose: int
    """Runs that never had a pose."""
    failed: int
    """Runs that ended in an error."""
    runs: int
    seconds: float
    """Processor time of a run, median [s]."""

    @property
    def ratio(self) -> float:
        """RMSE over bound."""
        return self.rmse / self.bound


def lines(results: Results) -> list[Line]:
    """Return a line for each scenario and estimator, in order."""
    return [
        _line(results, i, j)
        for i in range(len(results.plan.cases))
        for j in range(len(results.plan.contenders))
    ]


def _line(results: Results, i: int, j: int) -> Line:
    runs = results.plan.cases[i].runs
    run = {name: values[i, j, :runs] for name, values in results.run.items()}
    failed = results.failed[i, j, :runs]
    home = run["reached_home"]
    arrived, judged = int(np.nansum(home)), int(np.isfinite(home).sum())
    return Line(
        scenario=results.plan.cases[i].label,
        estimator=results.plan.contenders[j].label,
        rmse=root_mean_square(run["position_rmse"]),
        quantiles=quantiles(run["position_rmse"]),
        bound=root_mean_square(run["position_bound"]),
        heading_rmse=root_mean_square(run["heading_rmse"]),
        nees=quantiles(run["nees"]),
        home=arrived / judged if judged else np.nan,
        home_interval=wilson(arrived, judged),
        moved_right=mean(run["moved_right"]),
        no_pose=int(np.sum(~failed & np.isnan(run["position_rmse"]))),
        failed=int(failed.sum()),
        runs=failed.size,
        seconds=float(quantiles(run["seconds"])[2]),
    )


def mean(values: np.ndarray) -> float:
    """Return the mean of what is known; NaN where nothing is."""
    known = values[~np.isnan(values)]
    return float(known.mean()) if known.size else np.nan


def root_mean_square(values: np.ndarray) -> float:
    """Return the root of the mean square of what is known; NaN where nothing is."""
    return float(np.sqrt(mean(np.square(values))))


def quantiles(values: np.ndarray) -> np.ndarray:
    """Return `QUANTILES` of what is known, (5,): values that occur; NaN where nothing is known."""
    known = values[~np.isnan(values)]
    if not known.size:
        return np.full(len(QUANTILES), np.nan)
    return np.asarray(np.quantile(known, QUANTILES, method="inverted_cdf"))


def wilson(hits: int, number: int) -> tuple[float, float]:
    """Return the 95 % interval of a share of which `hits` in `number` were seen (Wilson 1927)."""
    if not number:
        return np.nan, np.nan
    low, high = binomtest(hits, number).proportion_ci(method="wilson")
    return float(low), float(high)


def over_time(results: Results, name: str, i: int, j: int, root: bool) -> np.ndarray:
    """Return the mean of a series over the runs that go on, (times,), or the root mean square.

    NaN where fewer than `FEWEST_SHARE` of the runs go on.
    """
    values = np.asarray(results.series[name][i, j, : results.plan.cases[i].runs], float)
    here = ~np.isnan(values)
    with warnings.catch_warnings(), np.errstate(over="ignore"):
        warnings.simplefilter("ignore", RuntimeWarning)  # of times without a run
        found = np.nanmean(values**2 if root else values, axis=0)
    enough = here.sum(axis=0) >= max(FEWEST_SHARE * len(values), 1)
    return np.asarray(np.where(enough, np.sqrt(found) if root else found, np.nan))


def number(value: float) -> str:
    """Return a number with three digits; empty where it is not known."""
    if np.isnan(value):
        return ""
    return f"{value:.3g}" if value < 1e4 else f"{value:.0e}".replace("e+0", "e")


def share(value: float) -> str:
    """Return a share in per cent; empty where it is not known."""
    return "" if np.isnan(value) else f"{100 * value:.0f} %"


def failures(results: Results) -> dict[str, int]:
    """Return each reason for which runs failed, with their number, the most frequent first."""
    reasons, counts = np.unique(results.failure[results.failed], return_counts=True)
    order = np.argsort(-counts, kind="stable")
    return {str(reasons[k]): int(counts[k]) for k in order}
