"""The tables of the leaderboard, failures first."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.leaderboard.families import Family
from benchmarks.leaderboard.runs import Row
from benchmarks.monte_carlo import column
from homeward.io.naming import number, share
from homeward.lab.studies.study.statistics import (
    Interval,
    adjusted,
    geometric_mean,
    interval,
    known,
    mean,
    paired,
)
from homeward.lab.studies.study.summary import probability, with_interval
from homeward.runs.report.files import markdown

LEAST_POSE = 0.5
"""A run with a pose for less of the time has failed."""
MOST_WRONG = 0.5
"""A run that is beyond 4 sigma for more of the time with a pose has failed."""


@dataclass(frozen=True)
class Entry:
    """One estimator on all drives of some families; arrays are (drives,), in one order."""

    name: str
    rows: Sequence[Row]

    def column(self, key: str) -> np.ndarray:
        """Return a figure of each drive, NaN where there is none."""
        return column(self.rows, key)

    @property
    def failed(self) -> np.ndarray:
        """Which drives it failed on."""
        pose, wrong = self.column("pose"), self.column("wrong")
        good = (pose >= LEAST_POSE) & (wrong <= MOST_WRONG) & np.isfinite(self.column("rmse"))
        return np.asarray(~good)

    @property
    def rmse(self) -> np.ndarray:
        """RMSE of each drive [m]; NaN where it failed."""
        return np.where(self.failed, np.nan, self.column("rmse"))


def entries(rows: Sequence[Row], names: Sequence[str], families: Sequence[str]) -> list[Entry]:
    """Return the estimators with their rows of some families, drive by drive."""
    ordered = sorted(rows, key=lambda row: (row["family"], row["number"]))
    return [
        Entry(name, [r for r in ordered if r["estimator"] == name and r["family"] in families])
        for name in names
    ]


def overall(found: Sequence[Entry]) -> list[list[str]]:
    """Return the table over all families, the fewest failures first; ratios to the first named."""
    first = found[0]
    head = ["estimator", "failed", "without a pose", "beyond 4 sigma", f"RMSE / {first.name}", "p"]
    head += ["RMSE / bound", "NEES", "moved named", "s a drive"]
    p = adjusted([np.nan if e is first else paired(e.rmse, first.rmse).p for e in found])
    rows = [
        [
            e.name,
            f"{share(float(e.failed.mean()))} of {e.failed.size}",
            share(1.0 - float(np.nan_to_num(e.column("pose")).mean())),
            share(mean(e.column("wrong"))),
            "" if e is first else with_interval(ratio(e.rmse, first.rmse)),
            probability(value),
            number(geometric_mean(e.column("to_bound"))),
            number(known(e.column("nees"), np.median)),
            share(mean(e.column("named"))),
            number(known(e.column("seconds"), np.median)),
        ]
        for e, value in zip(found, p, strict=True)
    ]
    ranked = sorted(zip(found, rows, strict=True), key=lambda pair: _rank(pair[0], first))
    return [head, *(row for _, row in ranked)]


def _rank(entry: Entry, first: Entry) -> tuple[float, float]:
    value = ratio(entry.rmse, first.rmse).value
    return float(entry.failed.mean()), np.inf if np.isnan(value) else value


def by_family(
    rows: Sequence[Row], names: Sequence[str], families: Mapping[str, Family]
) -> list[list[str]]:
    """Return the median RMSE [m] of each estimator in each family, and the share that failed."""
    table = [["family", *names]]
    for family in families:
        cells = []
        for entry in entries(rows, names, [family]):
            told = number(known(entry.rmse, np.median))
            failed = share(float(entry.failed.mean())) if entry.failed.any() else ""
            cells.append(f"{told} ({failed})" if told and failed else told or failed)
        table.append([family, *cells])
    return table


def ratio(rmse: np.ndarray, other: np.ndarray) -> Interval:
    """Return how many times as large an RMSE is in the geometric mean over the drives of both."""
    logarithms = np.log(rmse) - np.log(other)
    logarithms = logarithms[np.isfinite(logarithms)]
    return interval(lambda values, axis=-1: np.exp(np.mean(values, axis=axis)), logarithms)


def page(
    rows: Sequence[Row], names: Sequence[str], families: Mapping[str, Family], command: str
) -> str:
    """Return docs/understand/leaderboard.md."""
    there = {f: family for f, family in families.items() if any(r["family"] == f for r in rows)}
    parts = [HEAD.format(command=command, first=names[0])]
    for real, title in ((False, "Simulated drives"), (True, "Real drives")):
        kind = {f: family for f, family in there.items() if family.real is real}
        if not kind:
            continue
        found = entries(rows, names, list(kind))
        drives = len({(r["family"], r["number"]) for r in found[0].rows})
        abouts = "".join(f"- **{name}**: {family.about}\n" for name, family in kind.items())
        parts += [
            f"## {title}: {drives} in {len(kind)} families\n",
            markdown(overall(found)),
            FAMILIES,
            markdown(by_family(rows, names, kind)),
            abouts,
        ]
    if errors := sorted({(r["estimator"], r["error"]) for r in rows if "error" in r}):
        parts += ["## Errors\n", "".join(f"- {name}: {words}\n" for name, words in errors)]
    return "\n".join(parts)


HEAD = """# Leaderboard

Made by `{command}`; the tables below are what it wrote. Every estimator
runs over the same drives, each with its default settings.

- **failed**, told first, and by which estimators are ranked: the share of drives that ended in an
  error, had a pose for less than half of the time, or were farther off than 4 of their own sigmas
  for more than half of the time with a pose.
- **without a pose**, **beyond 4 sigma**: shares of the time, and of the time with a pose; by chance
  0.03 % would be beyond.
- **RMSE / {first}**: how many times as far off, in the geometric mean over the drives on which
  neither failed, with its 95 % interval (bootstrap over drives); **p**: Wilcoxon's signed-rank test
  over all drives, a failure being worse than any RMSE, adjusted for the number of estimators
  (Benjamini and Hochberg).
- **RMSE / bound**: over the posterior Cramer-Rao bound, where it is known, failures too.
- **NEES** of (x, y, heading), median over the drives: 3 when consistent. **moved named**: share of
  drives in which exactly the landmarks that moved were named. **s a drive**: processor time, the
  median.

`robust` finds home by itself. What needs a start prior is told the true start (with sigmas of 5 cm
and 0.05 rad), since no drive here has a prior: a kind start, from which odometry alone
(`dead_reckoning:make`, the [template](../do/estimators.md)) goes far on drives of a minute or two.
`--estimator robust,package.module:make` adds an estimator of your own; `--keep FOLDER` keeps
finished runs, and a later command continues from them, also with further estimators.
"""
FAMILIES = "Median RMSE [m] over the drives that did not fail; in brackets the share that did:\n"
