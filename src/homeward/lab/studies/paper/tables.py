"""The paper's tables of RMSE, ours beside them, and what is counted over layouts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from homeward.lab.studies.paper.layouts import Outcome
from homeward.lab.studies.paper.reproduction import Reproduction
from homeward.lab.studies.paper.world import CaseName

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
"""RMSE of R [cm], theta, alpha [rad], as the paper prints them; Table 3 twice, since its caption
says closed loop, which is Case 1, and its text open loop, which is Case 4."""


def printed_of(case: CaseName, name: str) -> tuple[float, float, float] | None:
    """Return what the paper prints of one of `FILTERS` in a case, where it does."""
    return PRINTED.get(case, {}).get(name.split(" ")[0])


@dataclass(frozen=True)
class Row:
    """One filter in one case; errors are R [cm], theta, alpha [rad]."""

    case: CaseName
    filter: str
    printed: tuple[float, float, float] | None
    """What the paper prints, where it does."""
    median: np.ndarray
    """(3,), over all runs."""
    low: np.ndarray
    """(3,), 5 % of runs are better than this."""
    high: np.ndarray
    """(3,), 5 % are worse."""
    theta_far: float
    """Median RMSE of theta over the samples farther than 20 cm from home [rad]."""
    home_share: float
    """Share of runs that ended truly within twice the stop radius of home."""


def rows(result: Reproduction) -> list[Row]:
    """Return a row for each case and filter."""
    table = []
    for case, outcome in result.outcomes.items():
        for k, name in enumerate(outcome.names):
            low, median, high = _quantiles(outcome.of(name) * TO_PAPER_UNITS)
            distance = outcome.final_distance[k]
            within = distance < 2 * result.settings.assumed.stop_radius
            table.append(
                Row(
                    case=case,
                    filter=name,
                    printed=printed_of(case, name),
                    median=median,
                    low=low,
                    high=high,
                    theta_far=float(np.nanmedian(outcome.theta_far[k])),
                    home_share=float(np.mean(within)),
                )
            )
    return table


def _quantiles(values: np.ndarray) -> np.ndarray:
    """Return the 5, 50 and 95 % quantiles over axis 0; infinite where runs diverged."""
    with np.errstate(invalid="ignore"):
        found = np.quantile(values, [0.05, 0.5, 0.95], axis=0)
    # Between two infinite runs NumPy makes a NaN.
    return np.where(np.isnan(found), np.inf, found)


def printed_order(case: CaseName, column: int) -> tuple[str, ...]:
    """Return the paper's three filters, least printed error first, in one column of a case.

    They are not in the same order everywhere: PI-EKF, A-EKF, EKF in R and theta of Case 2 alone.
    """
    return tuple(sorted(PRINTED[case], key=lambda name: PRINTED[case][name][column]))


def order_share(outcome: Outcome, order: tuple[str, ...], a_ekf: str) -> np.ndarray:
    """Return the shares of layouts in which errors have an order: R, theta, alpha, and all three.

    The order is three of the paper's names, least error first; `a_ekf` is which of `FILTERS` stands
    for the A-EKF, of which the paper has one.
    """
    ours = {"A-EKF": a_ekf}
    least, middle, most = (outcome.of(ours.get(name, name)) for name in order)
    holds = (least < middle) & (middle < most)
    return np.append(holds.mean(axis=0), holds.all(axis=1).mean())


def printed_order_shares(outcome: Outcome, case: CaseName, a_ekf: str) -> list[float]:
    """Return the share with the order that the table prints, for R, theta and alpha."""
    return [float(order_share(outcome, printed_order(case, k), a_ekf)[k]) for k in range(3)]


def better_shares(outcome: Outcome, name: str, other: str) -> np.ndarray:
    """Return the shares of layouts in which one errs less than another: R, theta, alpha."""
    return np.asarray(np.mean(outcome.of(name) < outcome.of(other), axis=0))


def beats_printed(outcome: Outcome, case: CaseName, name: str) -> float:
    """Return the share of layouts with errors below the printed ones in all three."""
    below = outcome.of(name) * TO_PAPER_UNITS < np.array(printed_of(case, name))
    return float(below.all(axis=1).mean())
