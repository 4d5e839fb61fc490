"""What `homeward reproduce --study` leaves behind: a page, figures, and every run."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import yaml
from markupsafe import Markup

from homeward.report.below_bound import below_bound, note_below
from homeward.report.canvas import drawn
from homeward.report.layout_figures import FIGURES, ROWS, errors_of
from homeward.report.output import whole_folder
from homeward.report.template import render
from homeward.report.versions import versions
from homeward.studies.paper.layout_study import (
    CLAIMED,
    LayoutStudy,
    all_order_share,
    better_share,
    order_share,
    printed_shares,
)
from homeward.studies.paper.layouts import BOUND, MARKER, STUDIED, VARIANTS
from homeward.studies.paper.search import Best
from homeward.studies.paper.tables import TO_PAPER_UNITS, printed_order
from homeward.studies.paper.world import CaseName
from homeward.studies.study.summary import wilson

PAGE, DATA = "layouts.html", "layouts.csv"


def write_layouts(directory: Path, study: LayoutStudy) -> None:
    """Write the page, every figure as PNG, and layouts.csv with every run.

    Raises
    ------
    InputError
        When the folder holds something else, or cannot be written.
    """
    with whole_folder(directory, MARKER) as scratch:
        pictures = [
            drawn(scratch, name, caption, draw(study)) for name, (caption, draw) in FIGURES.items()
        ]
        (scratch / DATA).write_text(_every_run(study), encoding="utf-8")
        (scratch / PAGE).write_text(_page(study, pictures), encoding="utf-8")


def error_table(study: LayoutStudy) -> list[list[str]]:
    """Return medians and 90 % of every RMSE, the head first, as text."""
    head = ["case", "filter", "R [cm]", "theta [rad]", "alpha [rad]", "layouts"]
    rows = [head]
    for case in STUDIED:
        for name in ROWS:
            rmse = errors_of(study, case, name)
            low, middle, high = np.nanquantile(
                rmse, [0.05, 0.5, 0.95], axis=0, method="inverted_cdf"
            )
            cells = [
                f"{m:.3g} ({a:.2g} to {b:.2g})" for a, m, b in zip(low, middle, high, strict=True)
            ]
            rows.append([case, name, *cells, f"{len(rmse):,}"])
    return rows


def order_table(study: LayoutStudy) -> list[list[str]]:
    """Return the shares of the orders over all layouts, the head first, as text."""
    rows = [["case", "order", "R", "theta", "alpha", "all three"]]
    for case in STUDIED:
        outcome = study.main[case]
        n = outcome.rmse.shape[1]
        shares = [order_share(outcome, CLAIMED, k) for k in range(3)]
        every = all_order_share(outcome, CLAIMED)
        cells = [_share(s, n) for s in (*shares, every)]
        rows.append([case, " < ".join(CLAIMED), *cells])
        printed = [_share(s, n) for s in printed_shares(outcome, case)]
        rows.append([case, "as its table prints", *printed, ""])
        for name, other in (("PI-EKF", "EKF"), ("A-EKF (all)", "EKF"), ("A-EKF (one)", "EKF")):
            better = [_share(better_share(outcome, name, other, k), n) for k in range(3)]
            rows.append([case, f"{name} < {other}", *better, ""])
    return rows


def variant_table(study: LayoutStudy) -> list[list[str]]:
    """Return the claimed order's share and the medians of each variant, as text."""
    rows = [["variant", "case", "order holds: R, theta, alpha", "EKF", "A-EKF (all)", "PI-EKF"]]
    for name in VARIANTS:
        for case in STUDIED:
            outcome = study.varied[name, case]
            shares = [f"{100 * order_share(outcome, CLAIMED, k):.0f}" for k in range(3)]
            medians = [
                ", ".join(f"{v:.3g}" for v in np.median(outcome.of(f), axis=0) * TO_PAPER_UNITS)
                for f in ("EKF", "A-EKF (all)", "PI-EKF")
            ]
            rows.append([name, case, ", ".join(shares) + " %", *medians])
    return rows


def search_table(study: LayoutStudy) -> list[list[str]]:
    """Return the best gains of each family in each case, as text."""
    rows = [["case", "family", "Pi", "M", "errors over the EKF's", "PI-EKF", "EKF", "order holds"]]
    for best in sorted(study.search.best, key=lambda b: b.tried.case):
        t = best.tried
        Pi = ", ".join(f"{g:.2g}" for g in t.Pi) if isinstance(t.Pi, tuple) else f"{t.Pi:.2g}"
        M = "own" if t.M == "own" else "ones"
        medians = [_medians(best.pi_ekf), _medians(best.ekf)]
        rows.append([t.case, t.family, Pi, M, f"{best.cost:.3f}", *medians, _holds(best)])
    return rows


def _medians(rmse: np.ndarray) -> str:
    return ", ".join(f"{v:.3g}" for v in np.median(rmse, axis=0) * TO_PAPER_UNITS)


def _holds(best: Best) -> str:
    holds = np.mean((best.pi_ekf < best.a_ekf) & (best.a_ekf < best.ekf), axis=0)
    return ", ".join(f"{100 * share:.0f}" for share in holds) + " %"


def _share(share: float, n: int) -> str:
    low, high = wilson(round(share * n), n)
    return f"{100 * share:.1f} % ({100 * low:.1f} to {100 * high:.1f})"


def bound_ratio(study: LayoutStudy, case: CaseName, name: str) -> np.ndarray:
    """Return RMSE over all layouts of the bound, over the bound's, (3,): R, theta, alpha."""
    outcome = study.robust[case]
    bound = np.sqrt(np.mean(outcome.of(BOUND) ** 2, axis=0))
    n = outcome.rmse.shape[1]
    source = outcome if name in outcome.names else study.main[case]
    return np.asarray(np.sqrt(np.nanmean(source.of(name)[:n] ** 2, axis=0)) / bound)


def ratio_table(study: LayoutStudy) -> list[list[str]]:
    """Return RMSE over the bound for all that ran in the layouts of the bound, as text."""
    rows = [
        [case, name, *(f"{r:.2f}" for r in bound_ratio(study, case, name))]
        for case in STUDIED
        for name in ROWS[:-1]
    ]
    return [["case", "filter", "R", "theta", "alpha"], *rows]


def headline(study: LayoutStudy) -> str:
    """Say in a sentence what came out."""
    parts = []
    for case in STUDIED:
        shares = [100 * order_share(study.main[case], CLAIMED, k) for k in range(3)]
        parts.append("{:.1f}, {:.1f} and {:.1f} %".format(*shares) + f" in Case {case}")
    n = study.main["2"].rmse.shape[1]
    return (
        f"{' < '.join(CLAIMED)} holds for R, theta and alpha in {' and in '.join(parts)} of "
        f"{n:,} random layouts; by chance it would be 16.7 %"
    )


def _page(study: LayoutStudy, pictures: list[tuple[str, Markup]]) -> str:
    settings = study.settings.model_dump(mode="json")
    return render(
        "layouts.html.j2",
        headline=headline(study),
        figures=pictures,
        printed=[
            (case, [" < ".join(printed_order(case, k)) for k in range(3)]) for case in STUDIED
        ],
        tables=[
            ("Errors: median (and 5 to 95 %) over the layouts", error_table(study), 2),
            ("Errors over the Cramér-Rao bound, all layouts of the bound", ratio_table(study), 2),
            ("Who beats whom", order_table(study), 2),
            ("What it depends on: medians of R [cm], theta, alpha [rad]", variant_table(study), 2),
            ("The best Pi and M: medians of R [cm], theta, alpha [rad]", search_table(study), 4),
        ],
        below=note_below(_below(study)),
        layouts=study.settings,
        robust=study.robust["2"].rmse.shape[1],
        settings=yaml.safe_dump(settings, sort_keys=False, default_flow_style=None),
        versions=versions(),
    )


def _below(study: LayoutStudy) -> dict[str, str]:
    """Return what is to be said of each that lies below its bound."""
    found = {}
    for case in STUDIED:
        bounds = study.robust[case].of(BOUND)
        for name in ROWS[:-1]:
            source = study.robust[case] if name in study.robust[case].names else study.main[case]
            errors = source.of(name)[: len(bounds)]
            for k, quantity in enumerate(("R", "theta", "alpha")):
                words = below_bound(errors[:, k], bounds[:, k])
                found[f"{name} in Case {case}, {quantity}"] = words
    return found


def _every_run(study: LayoutStudy) -> str:
    """Return case, filter, layout and RMSE in the paper's units as CSV."""
    lines = ["case,filter,layout,R_cm,theta_rad,alpha_rad,final_distance_m"]
    for outcomes in (study.main, study.robust):
        for case, outcome in outcomes.items():
            for name in outcome.names:
                distances = outcome.final_distance[outcome.names.index(name)]
                for k, errors in enumerate(outcome.of(name) * TO_PAPER_UNITS):
                    cells = (f"{v:.6g}" if v == v else "" for v in (*errors, distances[k]))
                    lines.append(f"{case},{name},{k},{','.join(cells)}")
    return "\n".join(lines) + "\n"
