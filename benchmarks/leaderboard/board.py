"""The tables of the leaderboard, failures first."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.leaderboard.families import HELD_OUT, Family
from benchmarks.leaderboard.runs import LABELS, Row, given
from benchmarks.monte_carlo import column
from homeward.io.naming import number, share
from homeward.lab.studies.study import statistics as stats
from homeward.lab.studies.study.summary import probability, with_interval
from homeward.runs.report.files import markdown

MIN_POSE = 0.5  # minimum availability of a pose in a run that has not failed
MAX_WRONG = 0.5  # maximum share of the time with a pose that is beyond 4 sigma


@dataclass(frozen=True)
class Entry:
    """One estimator on all drives of some families; arrays are (drives,), in one order."""

    name: str
    rows: Sequence[Row]

    def column(self, key: str) -> np.ndarray:
        return column(self.rows, key)

    @property
    def failed(self) -> np.ndarray:
        pose, wrong = self.column("pose"), self.column("wrong")
        good = (pose >= MIN_POSE) & (wrong <= MAX_WRONG) & np.isfinite(self.column("rmse"))
        return np.asarray(~good)

    @property
    def rmse(self) -> np.ndarray:
        """RMSE of each drive [m]; NaN if it failed."""
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
    head = ["estimator", "given", "failed", "availability", "beyond 4 sigma"]
    head += [f"RMSE ratio to {first.name}", "p", "RMSE / bound", "NEES"]
    head += ["exact detection rate", "runtime [s]"]
    p = stats.adjusted(
        [np.nan if e is first else stats.paired(e.rmse, first.rmse).p for e in found]
    )
    rows = [
        [
            LABELS.get(e.name, e.name),
            given(e.name),
            f"{share(float(e.failed.mean()))} of {e.failed.size}",
            share(float(np.nan_to_num(e.column("pose")).mean())),
            share(stats.mean(e.column("wrong"))),
            "" if e is first else with_interval(ratio(e.rmse, first.rmse)),
            probability(value),
            number(stats.geometric_mean(e.column("to_bound"))),
            number(stats.known(e.column("nees"), np.median)),
            share(stats.mean(e.column("named"))),
            number(stats.known(e.column("seconds"), np.median)),
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
    table = [["family", *(LABELS.get(name, name) for name in names)]]
    for family in families:
        cells = []
        for entry in entries(rows, names, [family]):
            rmse = number(stats.known(entry.rmse, np.median))
            failed = share(float(entry.failed.mean())) if entry.failed.any() else ""
            cells.append(f"{rmse} ({failed})" if rmse and failed else rmse or failed)
        table.append([family, *cells])
    return table


def ratio(rmse: np.ndarray, other: np.ndarray) -> stats.Interval:
    """Return the geometric mean over common drives of the ratio of two RMSEs."""
    logarithms = np.log(rmse) - np.log(other)
    logarithms = logarithms[np.isfinite(logarithms)]
    return stats.interval(lambda values, axis=-1: np.exp(np.mean(values, axis=axis)), logarithms)


def page(
    rows: Sequence[Row],
    names: Sequence[str],
    families: Mapping[str, Family],
    command: str,
    development: bool = False,
) -> str:
    there = {f: family for f, family in families.items() if any(r["family"] == f for r in rows)}
    title, drives = DRIVES[development]
    parts = [HEAD.format(command=command, first=names[0], title=title, drives=drives)]
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


DRIVES = {
    False: (
        "Leaderboard",
        f"""**Drives:** held out. No choice was made on their seeds, from {HELD_OUT} on.
The families (kinds of drives) are those on which the localiser was developed; the [development
drives](../appendix/leaderboard-development.md), with other seeds and the real drives of MRCLAM
set 6, have a page of their own. Some families change the same simulated drives (room, table, site,
mount-given, mount-unknown, odometry-unknown, slipping, lagging; soon, soon-lagging), so drives are
not independent: intervals are too narrow and p-values too small. Few drives of a family do not
rank estimators within the family. Held-out real drives: [MRCLAM set
1](../understand/peers.md#held-out-real-drives), without ground truth.""",
    ),
    True: (
        "Leaderboard: development drives",
        """**Drives:** those on which models and constants of `robust` were chosen: the first seeds
of each family, and MRCLAM set 6. The [leaderboard](../understand/leaderboard.md) uses held-out
drives.""",
    ),
}
HEAD = """# {title}

Generated by `{command}`. Every estimator runs on the same drives with its
default settings.

{drives}

- **given**: what an estimator gets next to odometry, bearings and home bearings. *start*: the true
  pose at the start, with sigmas of 5 cm and 0.05 rad. *map*: the true position of every landmark
  when home was stored. All get the camera extrinsics, if the drive specifies them.
- **failed**: share of drives that ended in an error, had a pose for less than half of the time, or
  had an error beyond 4 sigma for more than half of the time with a pose. It ranks the estimators. A
  large error with a covariance that contains it is not a failure.
- **availability**: share of the time with a pose; errors are of that time. **beyond 4 sigma**:
  share of that time with an error beyond 4 sigma; 0.03 % if consistent.
- **RMSE ratio to {first}**: geometric mean over the drives on which neither failed, with its 95 %
  interval (bootstrap over drives). **p**: Wilcoxon's signed-rank test over all drives, a failure
  being worse than any RMSE, adjusted for the number of estimators (Benjamini and Hochberg).
- **RMSE / bound**: ratio to the posterior Cramer-Rao bound where it is known, failures included.
  The bound has no map and no start.
- **NEES** of (x, y, heading), median over the drives: 3 if consistent. **exact detection rate**:
  share of drives in which exactly the moved landmarks were reported. **runtime**: median processor
  time per drive, on a machine with other load.

[Peers](../understand/peers.md) describes the estimators. `--estimator robust,package.module:make`
adds your own. `--keep FOLDER` keeps finished runs, so that a later command continues from them,
also with further estimators.
"""
FAMILIES = "Median RMSE [m] of the drives that did not fail; in brackets the share that failed:\n"
