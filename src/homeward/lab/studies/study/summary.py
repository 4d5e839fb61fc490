"""Summary and tables of a study: per scenario and estimator, over all runs."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from homeward.io.naming import number, share
from homeward.lab.studies.study.plan import StudyPlan
from homeward.lab.studies.study.results import Results
from homeward.lab.studies.study.statistics import (
    Interval,
    adjusted,
    mean,
    paired,
    quantiles,
    rmse_interval,
    root_mean_square,
    wilson,
)

MIN_SHARE = 0.2
"""Minimum share of runs still in progress for a mean over time."""


@dataclass(frozen=True)
class Line:
    """One estimator in one scenario."""

    scenario: str
    estimator: str
    rmse: float
    """RMSE of the position over all runs [m]."""
    quantiles: np.ndarray
    """(5,), `QUANTILES` of the position RMSE of single runs [m]."""
    bound: float
    """Cramer-Rao bound on `rmse` [m]; NaN where unknown."""
    heading_rmse: float
    """[rad]"""
    nees: np.ndarray
    """(5,), `QUANTILES` of the runs' mean NEES: 3 when consistent."""
    home: float
    """Share of runs that ended at home; NaN in the open loop."""
    home_interval: tuple[float, float]
    """95 % interval of that share (Wilson)."""
    moved_right: float
    """Exact detection rate of moved landmarks; NaN if the estimator detects none."""
    no_pose: int
    """Number of runs without any pose."""
    failed: int
    """Number of runs that ended in an error."""
    runs: int
    seconds: float
    """Median runtime (processor time) of a run [s]."""

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
    arrived, known = int(np.nansum(home)), int(np.isfinite(home).sum())
    return Line(
        scenario=results.plan.cases[i].label,
        estimator=results.plan.contenders[j].label,
        rmse=root_mean_square(run["position_rmse"]),
        quantiles=quantiles(run["position_rmse"]),
        bound=root_mean_square(run["position_bound"]),
        heading_rmse=root_mean_square(run["heading_rmse"]),
        nees=quantiles(run["nees"]),
        home=arrived / known if known else np.nan,
        home_interval=wilson(arrived, known),
        moved_right=mean(run["moved_right"]),
        no_pose=int(np.sum(~failed & np.isnan(run["position_rmse"]))),
        failed=int(failed.sum()),
        runs=failed.size,
        seconds=float(quantiles(run["seconds"])[2]),
    )


def over_time(results: Results, name: str, i: int, j: int, root: bool) -> np.ndarray:
    """Return the mean, or root mean square, of a series over the runs still in progress, (times,).

    NaN where fewer than `MIN_SHARE` of the runs are in progress.
    """
    values = np.asarray(results.series[name][i, j, : results.plan.cases[i].runs], float)
    here = ~np.isnan(values)
    with warnings.catch_warnings(), np.errstate(over="ignore"):
        warnings.simplefilter("ignore", RuntimeWarning)  # at times without a run
        found = np.nanmean(values**2 if root else values, axis=0)
    enough = here.sum(axis=0) >= max(MIN_SHARE * len(values), 1)
    return np.asarray(np.where(enough, np.sqrt(found) if root else found, np.nan))


def failures(results: Results) -> dict[str, int]:
    """Return the reasons of failed runs with their numbers, most frequent first."""
    reasons, counts = np.unique(results.failure[results.failed], return_counts=True)
    order = np.argsort(-counts, kind="stable")
    return {str(reasons[k]): int(counts[k]) for k in order}


class Compared(NamedTuple):
    """A line, compared with the reference in its scenario: the first estimator of the study."""

    line: Line
    rmse: Interval
    """RMSE [m]."""
    ratio: Interval
    """RMSE ratio to the reference; see `Pairing`."""
    p: float
    """p-value, adjusted for multiple comparisons; NaN for the reference."""


def summary(results: Results) -> list[Compared]:
    """Return lines, intervals and tests of a study."""
    rmse, cases = results.run["position_rmse"], results.plan.cases
    pairs = [(i, j) for i in range(len(cases)) for j in range(len(results.plan.contenders))]
    parts = [(rmse[i, j, : cases[i].runs], rmse[i, 0, : cases[i].runs]) for i, j in pairs]
    pairings = [paired(*both) for both in parts]
    p = adjusted([np.nan if j == 0 else f.p for (_, j), f in zip(pairs, pairings, strict=True)])
    intervals, ratios = [rmse_interval(own) for own, _ in parts], [f.ratio for f in pairings]
    return list(map(Compared, lines(results), intervals, ratios, p.tolist()))


def table(plan: StudyPlan, found: Sequence[Compared]) -> list[list[str]]:
    """Return the table of the terminal and of the page as text, its head first.

    Columns without any known value are left out.
    """
    closed, first = plan.study.loop == "closed", plan.contenders[0].label
    head = ["scenario", "estimator", "failed", "no pose", "RMSE [m]", "5 to 95 % of runs"]
    head += ["RMSE / bound", f"RMSE ratio to {first}", "p", "heading [deg]", "NEES"]
    head += [*(["reached home"] if closed else []), "exact detection rate", "runtime [s]"]
    rows, before = [head], ""
    for line, rmse, ratio, p in found:
        shown = line.scenario if line.scenario != before else ""
        before = line.scenario
        rows.append(
            [
                shown,
                line.estimator,
                f"{line.failed} of {line.runs}" if line.failed else "",
                f"{line.no_pose} of {line.runs}" if line.no_pose else "",
                with_interval(rmse),
                _span(line.quantiles[0], line.quantiles[4]),
                number(line.ratio),
                "" if line.estimator == first else with_interval(ratio),
                probability(p),
                number(float(np.degrees(line.heading_rmse))),
                number(float(line.nees[2])),
                *([share(line.home)] if closed else []),
                share(line.moved_right),
                number(line.seconds),
            ]
        )
    known = [k for k in range(len(head)) if k < 2 or any(row[k] for row in rows[1:])]
    return [[row[k] for k in known] for row in rows]


EXACT = (
    *("scenario", "estimator", "runs", "failed", "no_pose", "rmse_m", "rmse_low_m", "rmse_high_m"),
    *("bound_m", "ratio", "ratio_low", "ratio_high", "p_adjusted", "heading_rmse_rad"),
    *("nees_median", "reached_home_share", "moved_right_share", "seconds_median"),
)
"""Columns of `exact_table`."""


def exact_table(found: Sequence[Compared]) -> list[list[object]]:
    """Return the table with exact numbers; ratio and p are relative to the first estimator."""
    rows: list[list[object]] = [list(EXACT)]
    for line, rmse, ratio, p in found:
        rows.append(
            [
                *(line.scenario, line.estimator, line.runs, line.failed, line.no_pose, *rmse),
                *(line.bound, *ratio, p, line.heading_rmse, float(line.nees[2])),
                *(line.home, line.moved_right, line.seconds),
            ]
        )
    return rows


def with_interval(found: Interval) -> str:
    """Return a value and its interval as text; empty where unknown."""
    if np.isnan(found.low):
        return number(found.value)
    return f"{number(found.value)} ({number(found.low)} to {number(found.high)})"


def probability(p: float) -> str:
    """Return a p-value as text; empty where unknown."""
    return "" if np.isnan(p) else "< 0.001" if p < 1e-3 else f"{p:.2g}"


def _span(low: float, high: float) -> str:
    return "" if np.isnan(low) else f"{number(low)} to {number(high)}"
