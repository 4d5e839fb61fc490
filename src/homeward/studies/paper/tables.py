"""The paper's two tables of RMSE, with ours beside them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from homeward.studies.paper.cases import Reproduction
from homeward.studies.paper.world import CaseName

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
"""RMSE of R [cm], theta, alpha [rad], as the paper prints them."""


@dataclass(frozen=True)
class Row:
    """One filter in one case; errors are R [cm], theta, alpha [rad]."""

    case: CaseName
    filter: str
    printed: tuple[float, float, float] | None
    """What the paper prints, where it does."""
    shown: np.ndarray
    """(3,), RMSE of the run drawn in the figures."""
    median: np.ndarray
    """(3,), over all runs."""
    low: np.ndarray
    """(3,), 5 % of runs are better than this."""
    high: np.ndarray
    """(3,), 5 % are worse."""
    home_share: float
    """Share of runs that ended truly within twice the stop radius of home."""
    home_distance_median: float
    """Median of the true distance from home at the end [m]."""


def rows(result: Reproduction) -> list[Row]:
    """Return a row for each case and filter."""
    table = []
    for case, by_filter in result.rmse.items():
        for name, rmse in by_filter.items():
            scaled = rmse * TO_PAPER_UNITS
            low, median, high = _quantiles(scaled)
            distance = result.final_distance[case][name]
            within = distance < 2 * result.settings.assumed.stop_radius
            table.append(
                Row(
                    case=case,
                    filter=name,
                    printed=PRINTED.get(case, {}).get(name.split(" ")[0]),
                    shown=scaled[0],
                    median=median,
                    low=low,
                    high=high,
                    home_share=float(np.mean(within)),
                    home_distance_median=float(np.median(distance)),
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


def ordering_share(result: Reproduction, case: CaseName, column: int) -> float:
    """Return the share of runs whose errors are in the printed order in one column.

    A-EKF stands for the one with all parameters.

    Parameters
    ----------
    result : Reproduction
        Of all runs.
    case : one of the cases
        The paper prints Cases 2 and 4.
    column : int
        0: R, 1: theta, 2: alpha.
    """
    rmse = result.rmse[case]
    ours = {"A-EKF": "A-EKF (all)"}
    least, middle, most = (
        rmse[ours.get(name, name)][:, column] for name in printed_order(case, column)
    )
    return float(np.mean((least < middle) & (middle < most)))
