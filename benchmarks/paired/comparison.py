"""The table of a paired comparison: effects, intervals, and decisions on non-inferiority.

The effect of a figure in a family is the mean over its drives of the difference between both
variants; of logarithms where the figure is a ratio. Its 95 % interval is Student's. A figure is
*no worse* if a one-sided t-test rejects that it is worse by the margin or more, and *worse* if one
rejects that it is the same or better, and it is not shown to be within the margin. Both tests are
adjusted for all rows of a table by Holm's method, so that one wrong decision in a table has a
probability of at most 5 %. Rows in which all drives have the same values are not tested.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import t as student

from benchmarks.paired.drives import Case

MARGIN = 0.03
LEVEL = 0.05
MIN_PAIRS = 3  # minimum number of drives for a test
FIRST_S = 1.0  # added to the time of the first pose, whose ratio is compared [s]
SAME, NO_WORSE, WORSE, OPEN = "same", "no worse (3 %)", "worse", "not decidable"
ALL = "all"  # the family of all drives of a benchmark
Values = Mapping[str, float | None]  # figures of one drive


@dataclass(frozen=True)
class Figure:
    """How a figure is compared."""

    about: str
    kind: str  # "ratio", "share" (larger is better), "excess" (smaller is better) or "nees"
    margin: float = MARGIN


FIGURES = {
    "rmse": Figure("RMSE of the position", "ratio"),
    "final": Figure("error of the last position", "ratio"),
    "pose": Figure("availability: share of the time with a pose", "share"),
    "sure": Figure("share of the time localised or coasting", "share"),
    "first": Figure("time of the first pose, plus 1 s", "ratio"),
    "nees": Figure("distance of NEES from 3, as a ratio", "nees"),
    "beyond3": Figure("share of the time with a pose beyond 3 sigma", "excess", 0.1 * MARGIN),
    "beyond4": Figure("share of the time with a pose beyond 4 sigma", "excess", 0.1 * MARGIN),
    "wrong": Figure("share localised or coasting, and beyond 4 sigma", "excess", 0.1 * MARGIN),
    "precision": Figure("share of the landmarks reported as moved that did", "share"),
    "recall": Figure("share of the moved landmarks that are reported", "share"),
    "exact": Figure("drives in which exactly the moved landmarks are reported", "share"),
    "ms": Figure("processor time of a frame, median", "ratio"),
    "ms99": Figure("processor time of a frame, 99 %", "ratio"),
    "ms_all": Figure("processor time of the run, per frame", "ratio"),
}
"""Of shares beyond some sigmas, the margin is a tenth: a consistent estimator has 0.03 % beyond 4
sigma."""
TIMES = ("ms", "ms99", "ms_all")
"""Compared over all drives of a benchmark together, as they vary with the load of the machine."""


@dataclass(frozen=True, eq=False)
class Row:
    """One figure in one family; `worse_by` (n,) is positive where the new variant is worse."""

    benchmark: str
    family: str
    figure: str
    worse_by: np.ndarray
    lost: int  # drives on which only the old variant has the figure

    @property
    def is_same(self) -> bool:
        return not self.worse_by.any() and not self.lost

    def p(self, limit: float, above: bool) -> float:
        """Return the p-value of H0: the mean effect is not above (below) a limit."""
        n = self.worse_by.size
        if n < MIN_PAIRS:
            return 1.0
        off = (self.worse_by.mean() - limit) * (1 if above else -1)
        error = self.worse_by.std(ddof=1) / math.sqrt(n)
        return float(student.sf(off / error, n - 1)) if error > 0 else float(off <= 0.0)

    def effect(self) -> tuple[float, float, float]:
        """Return the effect as printed, and its 95 % interval: a ratio, or new minus old."""
        d, n = self.worse_by, self.worse_by.size
        error = d.std(ddof=1) / math.sqrt(n) if n >= MIN_PAIRS else math.nan
        half = float(student.ppf(0.975, max(n - 1, 1))) * error
        ends = [float(d.mean()), float(d.mean() - half), float(d.mean() + half)]
        match FIGURES[self.figure].kind:
            case "ratio" | "nees":
                ends = [math.exp(e) for e in ends]
            case "share":
                ends = [-ends[0], -ends[2], -ends[1]]
        return ends[0], ends[1], ends[2]


def difference(figure: str, new: float, old: float) -> float:
    """Return by how much a new value is worse than an old one."""
    match FIGURES[figure].kind:
        case "share":
            return old - new
        case "excess":
            return new - old
        case "nees":
            return abs(math.log(max(new, 1e-9) / 3.0)) - abs(math.log(max(old, 1e-9) / 3.0))
    more = FIRST_S if figure == "first" else 1e-9
    return math.log(new + more) - math.log(old + more)


def rows(pairs: Mapping[Case, tuple[Values, Values]], figures: Iterable[str]) -> list[Row]:
    """Return the rows of a table; a pair is the new and the old figures of a drive."""
    families = {(case.benchmark, case.family) for case in pairs}
    names = {b for b, _ in families if sum(other == b for other, _ in families) > 1}
    found = []
    for benchmark, family in [*sorted(families), *((b, ALL) for b in sorted(names))]:
        some = [
            pair
            for case, pair in pairs.items()
            if case.benchmark == benchmark and family in (case.family, ALL)
        ]
        for figure in figures:
            if figure in TIMES and family != ALL and benchmark in names:
                continue
            both = [(new.get(figure), old.get(figure)) for new, old in some]
            worse_by = [difference(figure, a, b) for a, b in both if None not in (a, b)]  # type: ignore[arg-type]
            lost = sum(a is None and b is not None for a, b in both)
            if worse_by or lost:
                found.append(Row(benchmark, family, figure, np.array(worse_by), lost))
    return found


def decisions(found: Sequence[Row]) -> list[str]:
    """Return the decision on each row."""
    tested = [k for k, row in enumerate(found) if not row.is_same]
    margins = [_margin(found[k]) for k in tested]
    within = holm([found[k].p(m, above=False) for k, m in zip(tested, margins, strict=True)])
    worse = holm([found[k].p(0.0, above=True) for k in tested])
    decided = [SAME] * len(found)
    for k, p_within, p_worse in zip(tested, within, worse, strict=True):
        good, bad = p_within < LEVEL and not found[k].lost, p_worse < LEVEL
        decided[k] = NO_WORSE if good else WORSE if bad else OPEN
    return decided


def is_beyond_margin(row: Row) -> bool:
    """Return whether a figure is worse by more than its margin, chance or not."""
    return bool(row.worse_by.size) and float(row.worse_by.mean()) > _margin(row)


def _margin(row: Row) -> float:
    margin = FIGURES[row.figure].margin
    return math.log1p(margin) if _is_log(row) else margin


def _is_log(row: Row) -> bool:
    return FIGURES[row.figure].kind in ("ratio", "nees")


def holm(p: Sequence[float]) -> np.ndarray:
    """Return p-values adjusted by Holm's method."""
    values = np.array(p, float)
    order = np.argsort(values)
    steps = values[order] * np.arange(values.size, 0, -1)
    adjusted = np.empty(values.size)
    adjusted[order] = np.minimum(np.maximum.accumulate(steps), 1.0)
    return adjusted


def table(found: Sequence[Row], decided: Sequence[str]) -> str:
    """Return the table as text; rows with the same values on all drives are only counted."""
    lines = [f"{'':34}{'figure':10}{'drives':>6}{'effect':>9}  {'95 % interval':20} decision"]
    for row, decision in zip(found, decided, strict=True):
        if decision == SAME:
            continue
        lost = f", {row.lost} drives without a value" if row.lost else ""
        effect = low = high = math.nan
        if row.worse_by.size:
            effect, low, high = row.effect()
        sign = "" if _is_log(row) else "+"
        numbers = f"{effect:{sign}9.4f}  {f'{low:{sign}.4f} to {high:{sign}.4f}':20}"
        name = f"{row.benchmark} {row.family}"[:33]
        lines.append(f"{name:34}{row.figure:10}{row.worse_by.size:6}{numbers} {decision}{lost}")
    counts = {d: list(decided).count(d) for d in (SAME, NO_WORSE, WORSE, OPEN)}
    return "\n".join([*lines, ", ".join(f"{d}: {n}" for d, n in counts.items() if n)])
