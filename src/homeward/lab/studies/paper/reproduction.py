"""`homeward study paper` and `layouts`, and the paper's tables of RMSE."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from homeward.io.settings import validated
from homeward.lab.studies.blocks.finish import StudyBlocks
from homeward.lab.studies.paper.cases import DEAD_RECKONING, FILTERS, Run, draw, run_filter
from homeward.lab.studies.paper.layouts import (
    LayoutSettings,
    Outcome,
    Question,
    Reading,
    Start,
    bound_questions,
    compute,
    grid_questions,
    varied_questions,
)
from homeward.lab.studies.paper.settings import PaperSettings
from homeward.lab.studies.paper.world import CASES, CaseName, PaperWorld


@dataclass(frozen=True)
class Shown:
    """The run of a case in its figures."""

    number: int
    """Number of the layout, from 0 on."""
    percentile: dict[str, float]
    """By filter with bearings: share of runs with a smaller error of R [%]."""
    world: PaperWorld
    runs: dict[str, Run]
    """By filter."""


@dataclass(frozen=True)
class Reproduction:
    """Results of all cases, filters and runs."""

    settings: PaperSettings
    outcomes: dict[CaseName, Outcome]
    shown: dict[CaseName, Shown]


def reproduce(settings: PaperSettings, work: StudyBlocks) -> Reproduction:
    """Run the paper's Cases 1 to 4 with its filters over random layouts."""
    questions = {case: Question(settings, case, FILTERS, settings.runs) for case in CASES}
    imaged = settings.measurements == "images"
    outcomes = compute(work.part(0.0, 0.8) if imaged else work, questions)
    shown = {str(case): (case, settings, outcomes[case]) for case in CASES}
    if imaged:
        drawn = work.part(0.8, 1.0).compute(_shown, shown)
    else:
        drawn = {case: _shown(argument) for case, argument in shown.items()}
    return Reproduction(settings, outcomes, {case: drawn[case] for case in CASES})


def _shown(argument: tuple[CaseName, PaperSettings, Outcome]) -> Shown:
    """Rerun the layout whose errors of R are nearest to the median for all filters with bearings.

    From an exact start dead reckoning has the same error in all layouts, and no median run.
    """
    case, settings, outcome = argument
    names = FILTERS[: FILTERS.index(DEAD_RECKONING)]
    errors = np.array([outcome.of(name)[:, 0] for name in names])
    rank = errors.argsort(axis=1, kind="stable").argsort(axis=1, kind="stable")
    percentile = 100 * (rank + 0.5) / rank.shape[1]
    number = int(np.argmin(np.abs(percentile - 50).max(axis=0)))
    world = draw(case, settings, number)
    runs = {name: run_filter(name, case, world, settings) for name in FILTERS}
    named = dict(zip(names, percentile[:, number].tolist(), strict=True))
    return Shown(number, named, world, runs)


@dataclass(frozen=True)
class LayoutStudy:
    """Results of `homeward study layouts`."""

    settings: LayoutSettings
    grid: dict[tuple[CaseName, Reading], Outcome]
    """The paper's filters and dead reckoning under all readings."""
    bounds: dict[tuple[CaseName, Reading], Outcome]
    """The robust localiser and the bound, under the readings that differ in the bound."""
    varied: dict[tuple[str, CaseName, Start], Outcome]
    """By variant, case and start."""

    def outcome(self, case: CaseName, reading: Reading, name: str) -> Outcome:
        """Return the outcome of a filter, the robust localiser or the bound under a reading."""
        return (self.grid if name in FILTERS else self.bounds)[case, reading]

    def reading(self, case: CaseName, **change: Any) -> Reading:
        """Return the first reading of a case with changes."""
        return self.settings.readings(case)[0]._replace(**change)

    @property
    def starts(self) -> tuple[Start, ...]:
        """All starts; the first is that of the settings."""
        return self.settings.axis("initial_error")


def layout_settings(
    values: Mapping[str, Any], layouts: int | None = None, seed: int | None = None
) -> LayoutSettings:
    """Return settings from keys of `PaperSettings` and `LayoutSettings`.

    Raises `InputError` for an unknown key, or a value out of range.
    """
    own = {k: v for k, v in values.items() if k in LayoutSettings.model_fields and k != "paper"}
    paper = {k: v for k, v in values.items() if k not in own}
    if seed is not None:
        paper["seed"] = seed
    if layouts is not None:
        own["layouts"] = layouts
    return validated(LayoutSettings, {**own, "paper": validated(PaperSettings, paper)})


def study_layouts(settings: LayoutSettings, work: StudyBlocks) -> LayoutStudy:
    """Compute the missing blocks, and return all results."""
    grid = compute(work.part(0.0, 0.5), grid_questions(settings))
    bounds = compute(work.part(0.5, 0.7), bound_questions(settings))
    varied = compute(work.part(0.7, 1.0), varied_questions(settings))
    return LayoutStudy(settings, grid, bounds, varied)


TO_PAPER_UNITS = np.array([100.0, 1.0, 1.0])
"""From m, rad, rad to cm, rad, rad."""

PRINTED: dict[CaseName, dict[str, tuple[float, float, float]]] = {
    "2": {
        "EKF": (1.9091, 0.3840, 0.0589),
        "A-EKF": (1.8076, 0.2324, 0.0616),
        "PI-EKF": (0.3778, 0.0285, 0.0271),
    },
    "4": {
        "EKF": (0.4172, 0.0174, 0.0431),
        "A-EKF": (0.5624, 0.0457, 0.0509),
        "PI-EKF": (0.2739, 0.0307, 0.0386),
    },
}
PRINTED["1"] = PRINTED["4"]
"""RMSE of R [cm], theta, alpha [rad] as printed; Table 3 twice, since its caption has closed loop
(Case 1), and its text open loop (Case 4)."""


def printed_of(case: CaseName, name: str) -> tuple[float, float, float] | None:
    """Return the printed errors of one of `FILTERS` in a case, if there are any."""
    return PRINTED.get(case, {}).get(name.split(" ")[0])


@dataclass(frozen=True)
class Row:
    """One filter in one case; errors are R [cm], theta, alpha [rad]."""

    case: CaseName
    filter: str
    printed: tuple[float, float, float] | None
    """Printed errors, if there are any."""
    median: np.ndarray
    """(3,), over all runs."""
    low: np.ndarray
    """(3,), 5 % quantile."""
    high: np.ndarray
    """(3,), 95 % quantile."""
    theta_far: float
    """Median RMSE of theta over the samples farther than 20 cm from home [rad]."""
    home_share: float
    """Share of runs whose true end is within twice the stop radius of home."""


def rows(result: Reproduction) -> list[Row]:
    """Return a row for each case and filter."""
    table = []
    for case, outcome in result.outcomes.items():
        for k, name in enumerate(outcome.names):
            low, median, high = _quantiles(outcome.of(name) * TO_PAPER_UNITS)
            distance = outcome.final_distance[k]
            home = float(np.mean(distance < 2 * result.settings.assumed.stop_radius))
            far = float(np.nanmedian(outcome.theta_far[k]))
            table.append(Row(case, name, printed_of(case, name), median, low, high, far, home))
    return table


def _quantiles(values: np.ndarray) -> np.ndarray:
    """Return the 5, 50 and 95 % quantiles over axis 0; infinite where runs diverged."""
    with np.errstate(invalid="ignore"):
        found = np.quantile(values, [0.05, 0.5, 0.95], axis=0)
    # NumPy interpolates between two infinite runs to NaN.
    return np.where(np.isnan(found), np.inf, found)


def printed_order(case: CaseName, column: int) -> tuple[str, ...]:
    """Return the paper's three filters by increasing printed error, in one column of a case.

    The order differs: PI-EKF, A-EKF, EKF only in R and theta of Case 2.
    """
    return tuple(sorted(PRINTED[case], key=lambda name: PRINTED[case][name][column]))


def order_share(outcome: Outcome, order: tuple[str, ...], a_ekf: str) -> np.ndarray:
    """Return the shares of layouts with an order of errors: in R, theta, alpha, and all three.

    The order has three of the paper's names by increasing error; `a_ekf` is the one of `FILTERS`
    that represents the paper's A-EKF.
    """
    ours = {"A-EKF": a_ekf}
    low, middle, high = (outcome.of(ours.get(name, name)) for name in order)
    holds = (low < middle) & (middle < high)
    return np.append(holds.mean(axis=0), holds.all(axis=1).mean())


def printed_order_shares(outcome: Outcome, case: CaseName, a_ekf: str) -> list[float]:
    """Return the shares of layouts with the printed order, in R, theta and alpha."""
    return [float(order_share(outcome, printed_order(case, k), a_ekf)[k]) for k in range(3)]


def better_shares(outcome: Outcome, name: str, other: str) -> np.ndarray:
    """Return the shares of layouts with smaller errors than another filter: R, theta, alpha."""
    return np.asarray(np.mean(outcome.of(name) < outcome.of(other), axis=0))


def beats_printed(outcome: Outcome, case: CaseName, name: str) -> float:
    """Return the share of layouts with errors below the printed ones in all three."""
    below = outcome.of(name) * TO_PAPER_UNITS < np.array(printed_of(case, name))
    return float(below.all(axis=1).mean())
