"""Between what the figures must lie, by what they were when the baseline was made.

A figure of n runs is the mean of n numbers that differ by chance. All bands together are so wide
that chance alone fails one run of the gate in a hundred:

- NEES and NIS have two sides. Where the estimator is told all that is true, they follow chi-square
  about 3 and about 1, and a mean over a drive is worth as many independent samples as its spread
  from drive to drive says. Where the baseline itself clearly does not, or where the estimator is
  not told all, the band lies about the measured value: a known weakness that must not grow.
- Shares of time, and what was named, have a floor, the share of wrong answers and the error have a
  ceiling, all from the measured values.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from scipy.stats import gamma, norm

from benchmarks.consistency.measures import FIGURES, Figures, together
from benchmarks.consistency.scenarios import SCENARIOS

BASELINE = Path(__file__).with_name("baseline.json")
CHANCE = 0.01
"""That chance alone fails a run of the whole gate."""
THEORY = {"nees": 3.0, "nis": 1.0}
"""What they are on average when all is consistent."""
FLOORS = ("pose", "sure", "precision", "recall")
CEILINGS = ("wrong", "far", "error")
SIDES = len(SCENARIOS) * (len(FLOORS) + len(CEILINGS) + 2 * len(THEORY))
Z = float(norm.isf(CHANCE / SIDES))
"""So many standard deviations of chance are allowed to each side of each band."""
LEAST_SPREAD = {
    "pose": 0.02,
    "sure": 0.02,
    "wrong": 0.01,
    "far": 0.01,
    "precision": 0.05,
    "recall": 0.05,
}
"""A share that was the same in all runs of the baseline may yet be this much off in one."""
MARGIN = {"error": 0.05, "nees": 0.1, "nis": 0.05}
"""Relative room beyond chance, for what is no error: another order of sums, a gate's edge."""
FEWEST = 10
"""Drives of a scenario that tell how much these differ."""
DOUBTFUL = 2.0
"""So many standard deviations of chance a baseline may be off from what chi-square says."""


@dataclass(frozen=True)
class Measured:
    """A figure as it was in the baseline."""

    centre: float
    spread: float
    """Standard deviation from run to run (of an error: of its logarithm)."""
    runs: int
    by_theory: bool = False
    """Whether its band follows from chi-square alone."""

    def is_off(self, right: float, room: float = 0.0) -> bool:
        """Return whether it clearly is not `right`, by more than a relative room."""
        chance = DOUBTFUL * self.spread / math.sqrt(self.runs)
        return abs(self.centre - right) > max(chance, room * right)

    def band(self, name: str, runs: int) -> tuple[float, float]:
        """Return between what the mean of so many runs must lie; infinite where it need not."""
        spread = max(self.spread, LEAST_SPREAD.get(name, 0.0))
        off = Z * spread * math.sqrt(1.0 / runs + 1.0 / self.runs)
        room = MARGIN.get(name, 0.0)
        if name in FLOORS:
            return self.centre - off, math.inf
        if name in ("wrong", "far"):
            return -math.inf, self.centre + off
        if name == "error":
            return -math.inf, self.centre * math.exp(off) * (1.0 + room)
        if self.by_theory:
            low, high = _chi_square(THEORY[name], spread, runs)
        else:  # its centre is but the mean of the baseline's runs
            low, high = _chi_square(self.centre, spread * math.sqrt(1.0 + runs / self.runs), runs)
        return low * (1.0 - room), high * (1.0 + room)


def _chi_square(mean: float, spread: float, runs: int) -> tuple[float, float]:
    """Return between what the mean over runs of a scaled chi-square lies but for chance.

    It has the mean given, and the degrees of freedom that give one run the spread given.
    """
    shape = runs * (mean / spread) ** 2
    chance = CHANCE / SIDES
    return (
        float(gamma.ppf(chance, shape, scale=mean / shape)),
        float(gamma.isf(chance, shape, scale=mean / shape)),
    )


Baseline = Mapping[str, Mapping[str, Measured]]
"""By scenario and figure."""


def read(file: Path = BASELINE) -> Baseline:
    """Return the committed baseline."""
    plain = json.loads(file.read_text())
    return {
        scenario: {name: Measured(**entry) for name, entry in entries.items()}
        for scenario, entries in plain.items()
    }


def measure(results: Mapping[str, Sequence[Figures]]) -> Baseline:
    """Return a baseline of some runs of each scenario."""
    return {
        scenario: {
            name: entry
            for name in FIGURES
            if name != "rmse" and (entry := _measured(scenario, name, runs)) is not None
        }
        for scenario, runs in results.items()
    }


def _measured(scenario: str, name: str, runs: Sequence[Figures]) -> Measured | None:
    """Return one figure of a baseline; None where hardly a run has it."""
    centre, spread, number = together(name, [run[name] for run in runs])
    if number < 2:
        return None
    entry = Measured(float(f"{centre:.4g}"), float(f"{spread:.3g}"), number)
    if name in THEORY and SCENARIOS[scenario].exact:
        return replace(entry, by_theory=not entry.is_off(THEORY[name], MARGIN[name]))
    return entry


def write(baseline: Baseline, file: Path = BASELINE) -> None:
    """Commit a baseline: one line a figure."""
    scenarios = []
    for scenario, entries in baseline.items():
        lines = [f'    "{name}": {json.dumps(_plain(e))}' for name, e in entries.items()]
        scenarios.append(f'  "{scenario}": {{\n' + ",\n".join(lines) + "\n  }")
    file.write_text("{\n" + ",\n".join(scenarios) + "\n}\n")


def _plain(entry: Measured) -> dict[str, Any]:
    plain = {"centre": entry.centre, "spread": entry.spread, "runs": entry.runs}
    return plain | ({"by_theory": True} if entry.by_theory else {})


def failures(entries: Mapping[str, Measured], runs: Sequence[Figures]) -> dict[str, str]:
    """Return what some runs of a scenario fail, by figure, in words."""
    failed = {}
    for name, entry in entries.items():
        centre, _, number = together(name, [run[name] for run in runs])
        if not number:
            failed[name] = f"there is none; it was {entry.centre:.3g}"
            continue
        low, high = entry.band(name, number)
        if not low <= centre <= high:
            bound = f"at least {low:.3g}" if centre < low else f"at most {high:.3g}"
            failed[name] = f"{centre:.3g}, must be {bound}"
    return failed
