"""The tables of the leaderboard, failures first."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.consistency.scenarios import Family
from benchmarks.leaderboard.families import FIRST
from benchmarks.leaderboard.runs import LABELS, given
from benchmarks.measures import Figures
from benchmarks.monte_carlo import column
from homeward.io.naming import number, share
from homeward.lab.studies.study import statistics as stats
from homeward.lab.studies.study.summary import with_interval
from homeward.runs.report.files import markdown

MIN_POSE = 0.5  # minimum availability of a pose in a run that has not failed
MAX_WRONG = 0.5  # maximum share of the time with a pose that is beyond 4 sigma


@dataclass(frozen=True)
class Entry:
    """One estimator on some drives; arrays are (drives,), in one order."""

    name: str
    rows: Sequence[Figures]
    rmse: np.ndarray
    """Over the common times of a drive [m]; NaN if the estimator failed on it."""

    def column(self, key: str) -> np.ndarray:
        return column(self.rows, key)

    @property
    def failed(self) -> np.ndarray:
        return np.array([has_failed(row) for row in self.rows])


def has_failed(row: Figures) -> bool:
    """Return whether a run ended in an error, has too few poses, or too many wrong ones."""
    if row.get("rmse") is None or not np.isfinite(row["rmse"]):
        return True
    return bool(row["pose"] < MIN_POSE or row["beyond4"] > MAX_WRONG)


def common_rmse(rows: Sequence[Figures]) -> list[float]:
    """Return the RMSE of the runs of one drive, over the times at which all have a pose [m].

    Those that failed do not count; their RMSE is NaN. So is that of all if they have no such time.
    """
    good = [row for row in rows if not has_failed(row)]
    if not good:
        return [np.nan] * len(rows)
    times = good[0]["t"]
    for row in good[1:]:
        times = np.intersect1d(times, row["t"])
    found = []
    for row in rows:
        if has_failed(row) or not times.size:
            found.append(np.nan)
            continue
        use = np.isin(row["t"], times)
        weight = row["weight"][use]
        square = np.average(row["position"][use] ** 2, weights=weight) if weight.any() else np.nan
        found.append(float(np.sqrt(square)))
    return found


def entries(rows: Sequence[Figures], names: Sequence[str], families: Sequence[str]) -> list[Entry]:
    """Return the estimators with their rows of some families, drive by drive."""
    drives: dict[tuple[str, int], dict[str, Figures]] = {}
    for row in sorted(rows, key=lambda row: (row["number"], row["family"])):
        if row["family"] in families:
            drives.setdefault((row["family"], row["number"]), {})[row["estimator"]] = row
    by_drive = [[some[name] for name in names] for some in drives.values()]
    rmse = np.array([common_rmse(some) for some in by_drive]).reshape(-1, len(names))
    return [Entry(name, [some[k] for some in by_drive], rmse[:, k]) for k, name in enumerate(names)]


def ratio(entry: Entry, other: Entry) -> stats.Interval:
    """Return the geometric mean of the RMSE ratio over drives, with its 95 % interval.

    Families change the same simulated drives, so drives of one number are one sample of it.
    """
    numbers = np.array([row["number"] for row in entry.rows])
    logarithms = np.log(entry.rmse) - np.log(other.rmse)
    means = [
        logarithms[(numbers == n) & np.isfinite(logarithms)].mean()
        for n in np.unique(numbers[np.isfinite(logarithms)])
    ]
    return stats.interval(
        lambda values, axis=-1: np.exp(np.mean(values, axis=axis)), np.array(means)
    )


def overall(found: Sequence[Entry]) -> list[list[str]]:
    """Return the table over all families, the fewest failures first; ratios to the first named."""
    first = found[0]
    head = ["estimator", "given", "failed", "availability", "first pose [s]"]
    head += [f"RMSE ratio to {first.name}", "smaller error on", "beyond 4 sigma", "moved: exact"]
    head += ["recall", "precision", "runtime [s]"]
    rows = []
    for e in found:
        pairs = np.isfinite(e.rmse) & np.isfinite(first.rmse)
        better = (e.rmse < first.rmse)[pairs]
        cells = [
            LABELS.get(e.name, e.name),
            given(e.name),
            f"{share(float(e.failed.mean()))} of {e.failed.size}",
            share(float(np.nan_to_num(e.column("pose")).mean())),
            number(stats.known(e.column("first"), np.median)),
            "" if e is first else with_interval(ratio(e, first)),
            "" if e is first else f"{better.sum()} of {better.size}",
            share(stats.mean(e.column("beyond4"))),
            share(stats.mean(e.column("exact"))),
            share(stats.mean(e.column("recall"))),
            share(stats.mean(e.column("precision"))),
            number(stats.known(e.column("seconds"), np.median)),
        ]
        rows.append((float(e.failed.mean()), cells))
    return [head, *(cells for _, cells in sorted(rows, key=lambda pair: pair[0]))]


def by_family(
    rows: Sequence[Figures], names: Sequence[str], families: Mapping[str, Family]
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


def page(
    rows: Sequence[Figures],
    names: Sequence[str],
    families: Mapping[str, Family],
    command: str,
    origin: str,
) -> str:
    """Return the page; `origin` is commit, date and machine."""
    there = {f: family for f, family in families.items() if any(r["family"] == f for r in rows)}
    parts = [HEAD.format(command=command, first=names[0], origin=origin, number=FIRST)]
    for real, title in ((False, "Simulated drives"), (True, "Real drives")):
        kind = {f: family for f, family in there.items() if family.real is real}
        if not kind:
            continue
        found = entries(rows, names, list(kind))
        abouts = "".join(f"- **{name}**: {family.about}\n" for name, family in kind.items())
        parts += [
            f"## {title}: {len(found[0].rows)} in {len(kind)} families\n",
            markdown(overall(found)),
            FAMILIES,
            markdown(by_family(rows, names, kind)),
            abouts,
        ]
    if errors := sorted({(r["estimator"], r["error"]) for r in rows if "error" in r}):
        parts += ["## Errors\n", "".join(f"- {name}: {words}\n" for name, words in errors)]
    return "\n".join(parts)


HEAD = """# Leaderboard

Generated by `{command}`
({origin}). Every estimator runs on the same drives with its default settings.

**Drives**: the families (kinds of drives) are those on which `robust` was developed, with fresh
seeds, from {number} on, on which no choice was made. Some families change the same simulated
drives, so an interval counts the drives of one seed as one. Few drives of a family do not rank
estimators within it. Of the real drives, MRCLAM set 1 is held out; its reference is homeward's
smoother with the survey. On set 6 `robust` was developed.

- **given**: what an estimator gets next to odometry, bearings and home bearings. *start*: the true
  pose at the start, with sigmas of 5 cm and 0.05 rad. *map*: the true position of every landmark
  when home was stored. All get the camera extrinsics, if the drive specifies them.
- **failed**: share of drives that ended in an error, had a pose for less than half of the time, or
  had an error beyond 4 sigma for more than half of the time with a pose. It ranks the estimators. A
  large error with a covariance that contains it is not a failure.
- **availability**: share of the time with a pose; **first pose**: median time until it.
- **RMSE ratio to {first}**: over the common times of all estimators that did not fail on a drive;
  geometric mean over the drives on which neither failed, with its 95 % interval (bootstrap over
  seeds). **smaller error on**: number of these drives.
- **beyond 4 sigma**: share of the time with a pose; 0.03 % if consistent.
- **moved**: drives in which exactly the moved landmarks were named; recall and precision of names.
- **runtime**: median processor time per drive, on a machine with other load.

The estimators are [described below](#peers). `--estimator robust,package.module:make`
adds your own. `--keep FOLDER` keeps finished runs, so that a later command continues from them,
also with further estimators.
"""
FAMILIES = "Median RMSE [m] of the drives that did not fail; in brackets the share that failed:\n"
