"""The tables of a study: failures first, each estimator beside the one that is named first."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from homeward.studies.study.results import Results
from homeward.studies.study.statistics import Interval, Pairing, adjusted, paired, rmse_interval
from homeward.studies.study.summary import Line, lines, number, share


@dataclass(frozen=True)
class Summary:
    """What a study says, estimator by estimator, each beside the one that it names first."""

    closed: bool
    """Whether each steered its own drives."""
    first: str
    """The estimator that the others are compared with."""
    lines: list[Line]
    rmse: list[Interval]
    """Of each line [m]."""
    pairings: list[Pairing]
    """Of each line with that of the first in its scenario."""
    p: np.ndarray
    """Of each line, adjusted for the number of all comparisons; NaN of the first itself."""


def summary(results: Results) -> Summary:
    """Return lines, intervals and tests of a study."""
    rmse, cases = results.run["position_rmse"], results.plan.cases
    pairs = [(i, j) for i in range(len(cases)) for j in range(len(results.plan.contenders))]
    parts = [(rmse[i, j, : cases[i].runs], rmse[i, 0, : cases[i].runs]) for i, j in pairs]
    pairings = [paired(*both) for both in parts]
    p = [np.nan if j == 0 else found.p for (_, j), found in zip(pairs, pairings, strict=True)]
    return Summary(
        results.plan.study.loop == "closed",
        results.plan.contenders[0].label,
        lines(results),
        [rmse_interval(own) for own, _ in parts],
        pairings,
        adjusted(p),
    )


def table(found: Summary) -> list[list[str]]:
    """Return the table of the terminal and of the page, its head first, as text.

    Failures are told first. A column in which nothing is known is left out.
    """
    head = ["scenario", "estimator", "failed", "no pose", "RMSE [m]", "5 to 95 % of runs"]
    head += ["RMSE / bound", f"x {found.first}", "p", "heading [deg]", "NEES"]
    head += [*(["reached home"] if found.closed else []), "moved right", "time of a run [s]"]
    rows, before = [head], ""
    for line, rmse, pair, p in zip(found.lines, found.rmse, found.pairings, found.p, strict=True):
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
                "" if line.estimator == found.first else with_interval(pair.ratio),
                probability(p),
                number(float(np.degrees(line.heading_rmse))),
                number(float(line.nees[2])),
                *([share(line.home)] if found.closed else []),
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


def exact_table(found: Summary) -> list[list[object]]:
    """Return the same to the last bit, units in the head; ratio and p are against the first."""
    rows: list[list[object]] = [list(EXACT)]
    for line, rmse, pair, p in zip(found.lines, found.rmse, found.pairings, found.p, strict=True):
        rows.append(
            [
                *(line.scenario, line.estimator, line.runs, line.failed, line.no_pose, *rmse),
                *(line.bound, *pair.ratio, float(p), line.heading_rmse, float(line.nees[2])),
                *(line.home, line.moved_right, line.seconds),
            ]
        )
    return rows


def with_interval(found: Interval) -> str:
    """Return a value and its interval; empty where it is not known."""
    if np.isnan(found.low):
        return number(found.value)
    return f"{number(found.value)} ({number(found.low)} to {number(found.high)})"


def probability(p: float) -> str:
    """Return a p-value; empty where it is not known."""
    return "" if np.isnan(p) else "< 0.001" if p < 1e-3 else f"{p:.2g}"


def _span(low: float, high: float) -> str:
    return "" if np.isnan(low) else f"{number(low)} to {number(high)}"
