"""What `homeward study paper` leaves behind: figures, and a page beside the paper's tables."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import yaml
from markupsafe import Markup

from homeward.io.table import write_csv
from homeward.lab.report.paper.claims import median, triple, verdict
from homeward.lab.report.paper.figures import QUANTITIES, figures_of
from homeward.lab.studies.paper.cases import DEAD_RECKONING
from homeward.lab.studies.paper.layouts import Reading
from homeward.lab.studies.paper.reproduction import Reproduction
from homeward.lab.studies.paper.tables import PRINTED, TO_PAPER_UNITS, better_shares, rows
from homeward.lab.studies.paper.world import CaseName, fault_count
from homeward.runs.report.canvas import drawn
from homeward.runs.report.output import whole_folder
from homeward.runs.report.template import render
from homeward.runs.report.versions import write_settings
from homeward.runs.report.words import count, listing

SETTINGS_FILE = "reproduce.yaml"
"""Tells that the folder is ours; it holds the settings once all is written."""
PAGE = "paper.html"


def write_reproduction(directory: Path, result: Reproduction) -> None:
    """Write the page, PNGs, rmse.csv with every run, reproduce.yaml; errors as `whole_folder`."""
    with whole_folder(directory, SETTINGS_FILE) as scratch:
        figures = [
            drawn(scratch, name, caption, draw())
            for name, (caption, draw) in figures_of(result).items()
        ]
        write_csv(scratch / "rmse.csv", RUNS, _every_run(result))
        (scratch / PAGE).write_text(_page(result, figures), encoding="utf-8")
        write_settings(scratch / SETTINGS_FILE, result.settings.model_dump(mode="json"))


def _page(result: Reproduction, figures: list[tuple[str, Markup]]) -> str:
    table, settings = rows(result), result.settings
    return render(
        "paper.html.j2",
        figures=figures,
        verdict=sentences(result),
        printed_rows=[row for row in table if row.case in PRINTED],
        other_rows=[row for row in table if row.case not in PRINTED],
        found=found(result),
        faults=fault_rows(result),
        quantities=QUANTITIES,
        printed=settings.printed,
        assumed=settings.assumed,
        images=None if settings.measurements == "model" else settings.images,
        runs=settings.runs,
        seed=settings.seed,
        settings=yaml.safe_dump(settings.model_dump(mode="json"), sort_keys=False),
    )


def sentences(result: Reproduction) -> list[str]:
    """Say in three sentences what came out, under the one reading of the settings."""
    assumed = result.settings.assumed
    reading = Reading(*(getattr(assumed, field) for field in Reading._fields))
    readings = {(case, reading): outcome for case, outcome in result.outcomes.items()}
    return verdict(readings, result.settings.printed.M)


def fault_rows(result: Reproduction) -> list[tuple[CaseName, int, str]]:
    """Return the moved landmarks that each case asks for, and how many its runs have."""
    table = []
    for case, outcome in result.outcomes.items():
        numbers, runs = np.unique(outcome.moved, return_counts=True)
        told = [f"{n} in {count(k, 'run')}" for n, k in zip(numbers, runs.tolist(), strict=True)]
        table.append((case, fault_count(case, result.settings), listing(told)))
    return table


def found(result: Reproduction) -> list[str]:
    """Say what was found wrong in the paper, as it bears on these settings and results."""
    printed, assumed = result.settings.printed, result.settings.assumed
    q = printed.landmarks
    rank = min(2 * q, q + 3)
    words = [
        "“At least two landmarks” is not enough. With two, the printed observability matrix has"
        " four rows that are not zero, so that rank 5 is impossible by counting; the rank is"
        f" min(2q, q + 3), which for the q = {q} of these settings is {rank} of {q + 3}"
        + (": home is not determined." if rank < q + 3 else "."),
        "The printed J_i is right; K_i, P_i and the second term of Q_i (the derivatives of the"
        " bearing rate by theta, alpha and beta_i) have the wrong sign. The filters here use exact"
        " derivatives of the model, so nothing depends on it.",
        f"Q is printed {q + 3} x {q + 3} (n x n) but used with two inputs; here it is "
        + ("2 x 2." if assumed.meaning_of_Q == "input" else "n x n, of the states."),
        "Table 3's caption says closed loop, its text open loop; its figures stand beside Case 1"
        " and Case 4.",
    ]
    if not any((*assumed.initial_error, *assumed.disturbance)):
        own = median(result.outcomes["2"], DEAD_RECKONING)[0]
        words.append(
            "The start is exact and the robot moves as commanded, so that dead reckoning alone is"
            f" off by {own:.2g} cm (Case 2, median of R) and no filter can do better; what is"
            " compared is how little each is misled by its bearings."
        )
    if isinstance(printed.M, float) and isinstance(printed.Pi, float) and printed.Pi * printed.M:
        shares = {
            case: better_shares(result.outcomes[case], "PI-EKF", "EKF") for case in ("2", "4")
        }
        told = [f"{triple(shares[case])} of Case {case}" for case in shares]
        words.append(
            f"With M = {printed.M:g} in every entry the PI-EKF adds"
            f" {printed.Pi * printed.M:g} times the sum of all innovations to every state. It errs"
            f" less than the EKF (R, theta, alpha) in {' and '.join(told)}."
        )
    if assumed.single_fault:
        words.append(
            "“A 30 % error in beta*_1” is no error where beta*_1 is near zero; here it is "
            f"{assumed.single_fault:g} rad."
        )
    return words


RUNS = ("case", "filter", "run", "moved", "R_cm", "theta_rad", "alpha_rad", "final_distance_m")


def _every_run(result: Reproduction) -> Iterator[list[object]]:
    """Yield `RUNS` of each: errors are RMSE in the paper's units."""
    for case, outcome in result.outcomes.items():
        for j, name in enumerate(outcome.names):
            for k, errors in enumerate(outcome.of(name) * TO_PAPER_UNITS):
                values = (*errors, outcome.final_distance[j, k])
                yield [case, name, k, outcome.moved[k], *(f"{v:.6g}" for v in values)]
