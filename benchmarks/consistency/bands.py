"""Bands of the gate: allowed differences of the figures from those of the baseline.

The baseline contains each figure of each drive, and the gate runs the same drives. A band is the
mean of the baseline over these drives, plus or minus `WIDTH` sampling spreads: the standard
deviation between drives over the root of the number of drives. Drives and noise are the same, so a
change without effect on the estimates stays in the middle of every band. A change is outside if it
moves a figure by more than a new draw of the drives could.

Shares of time, precision and recall have a lower limit, the share of wrong answers and the error
an upper one, NEES and NIS both: an estimator can be overconfident or too conservative.
"""

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path

from benchmarks.consistency.measures import FIGURES, Figures, together

BASELINE = Path(__file__).with_name("baseline.json")
THEORY = {"nees": 3.0, "nis": 1.0}  # means of a consistent estimator
FLOORS = ("pose", "sure", "precision", "recall")
CEILINGS = ("wrong", "far", "error")
WIDTH = 2.0  # half-width of a band [sampling spreads]
MIN_SPREAD = {
    "pose": 0.02,
    "sure": 0.02,
    "wrong": 0.01,
    "far": 0.01,
    "precision": 0.05,
    "recall": 0.05,
}
"""Minimum spread between drives, for a share that is the same on all drives of the baseline."""
MIN_DRIVES = 10  # minimum number of drives of a scenario for an estimate of the spread

Values = Sequence[float | None]  # one figure by drive; None if a drive does not have it
Baseline = Mapping[str, Mapping[str, Values]]  # by scenario and figure


def band(name: str, values: Values, drives: int) -> tuple[float, float]:
    """Return lower and upper limit of the mean over the first drives of the baseline.

    Infinite on a side that has no limit. NaN if the baseline has no value.
    """
    centre, _, number = together(name, values[:drives])
    spread = together(name, values)[1]
    # A single value has no spread.
    spread = max(0.0 if math.isnan(spread) else spread, MIN_SPREAD.get(name, 0.0))
    half = WIDTH * spread / math.sqrt(max(number, 1))
    if name == "error":
        return -math.inf, centre * math.exp(half)
    if name in THEORY:  # positive and skewed: the same ratio on each side
        ratio = 1.0 + half / centre
        return centre / ratio, centre * ratio
    low = -math.inf if name in CEILINGS else centre - half
    high = math.inf if name in FLOORS else centre + half
    return low, high


def failures(entries: Mapping[str, Values], runs: Sequence[Figures]) -> dict[str, str]:
    """Return the figures of some drives of a scenario outside their bands, with a description."""
    failed = {}
    for name, values in entries.items():
        expected = together(name, values[: len(runs)])[0]
        centre, _, number = together(name, [run[name] for run in runs])
        if math.isnan(expected):
            continue
        if not number:
            failed[name] = f"no value; the baseline has {expected:.3g}"
            continue
        low, high = band(name, values, len(runs))
        if not low <= centre <= high:
            limit = f"at least {low:.3g}" if centre < low else f"at most {high:.3g}"
            failed[name] = f"{centre:.3g}, must be {limit}"
    return failed


def worse(old: Baseline, results: Mapping[str, Sequence[Figures]]) -> list[str]:
    """Return the figures of new results that are worse than the bands of an old baseline.

    A NEES or NIS that left its band towards its theoretical value is an improvement.
    """
    found = []
    for scenario, runs in results.items():
        entries = old.get(scenario, {})
        for name, words in failures(entries, runs).items():
            if name in THEORY:
                before = together(name, entries[name][: len(runs)])[0] - THEORY[name]
                now = together(name, [run[name] for run in runs])[0] - THEORY[name]
                if abs(now) < abs(before):
                    continue
            found.append(f"{scenario}: {name}: {words}")
    return found


def weaknesses(entries: Mapping[str, Values]) -> dict[str, float]:
    """Return NEES and NIS of a scenario that clearly differ from their theoretical values."""
    found = {}
    for name, expected in THEORY.items():
        centre, spread, number = together(name, entries.get(name, []))
        if number >= MIN_DRIVES and abs(centre - expected) > WIDTH * spread / math.sqrt(number):
            found[name] = centre
    return found


def read(file: Path = BASELINE) -> Baseline:
    scenarios: Baseline = json.loads(file.read_text())["scenarios"]
    return scenarios


def drives(entries: Mapping[str, Values]) -> list[Figures]:
    """Return the figures of each drive of a scenario in the baseline."""
    count = len(next(iter(entries.values())))
    return [
        {name: entries[name][k] if name in entries else None for name in FIGURES}
        for k in range(count)
    ]


def measure(results: Mapping[str, Sequence[Figures]]) -> Baseline:
    """Return a baseline of some drives of each scenario, to four digits."""
    names = [name for name in FIGURES if name != "rmse"]
    every = {
        s: {name: [_short(run[name]) for run in runs] for name in names}
        for s, runs in results.items()
    }
    return {
        scenario: {n: values for n, values in entries.items() if set(values) != {None}}
        for scenario, entries in every.items()
    }


def _short(value: float | None) -> float | None:
    return None if value is None else float(f"{value:.4g}")


def write(baseline: Baseline, reason: str, file: Path = BASELINE) -> None:
    """Write a baseline and the reason for it, one line for each figure."""
    scenarios = []
    for scenario, entries in baseline.items():
        lines = [f'    "{name}": {json.dumps(values)}' for name, values in entries.items()]
        scenarios.append(f'  "{scenario}": {{\n' + ",\n".join(lines) + "\n  }")
    text = ",\n".join(scenarios)
    file.write_text(f'{{\n"reason": {json.dumps(reason)},\n"scenarios": {{\n{text}\n}}\n}}\n')
