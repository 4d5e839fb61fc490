"""Figures, page and table of `homeward study layouts`."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator

from homeward.io.table import write_csv
from homeward.io.writing import whole_folder
from homeward.lab.report.paper.claims import (
    claims,
    conclusions,
    deciding_table,
    reading_words,
    start_words,
)
from homeward.lab.report.paper.page import COLOURS, PAPER, QUANTITIES
from homeward.lab.report.study.page import below_bound, note_below
from homeward.lab.studies.blocks.store import MARKER
from homeward.lab.studies.paper.cases import DEAD_RECKONING, FILTERS, PI_HT
from homeward.lab.studies.paper.layouts import (
    BOUND,
    ROBUST,
    STUDIED,
    Reading,
    Start,
)
from homeward.lab.studies.paper.reproduction import (
    TO_PAPER_UNITS,
    LayoutStudy,
    beats_printed,
    better_shares,
    order_share,
    printed_of,
    printed_order,
    printed_order_shares,
)
from homeward.lab.studies.paper.world import CaseName
from homeward.lab.studies.study.statistics import quantiles, wilson
from homeward.runs.report import html
from homeward.runs.report.canvas import (
    drawn,
    legend_below,
    log_axis,
    quantile_bar,
    styled_figure,
    uncrowd,
)
from homeward.runs.report.palette import GREEN, INK, MUTED, SKY
from homeward.runs.report.words import percent

ROWS = (*FILTERS, ROBUST, BOUND)
TITLES = {
    "1": "Case 1: closed loop, no fault",
    "2": "Case 2: closed loop, landmarks moved",
    "4": "Case 4: open loop, a circle, no fault",
}
ACROSS = ("initial_error", "meaning_of_Q", "disturbance")
"""Fields of a reading in the rows of the grid's figure."""
RIVALS = ("A-EKF (one)", "PI-EKF", PI_HT, DEAD_RECKONING)
"""Filters of the grid's figure."""


def errors_of(study: LayoutStudy, case: CaseName, name: str, start: Start) -> np.ndarray:
    """Return the RMSE of a filter, the robust localiser or the bound in the paper's units."""
    outcome = study.outcome(case, study.reading(case, initial_error=start), name)
    return np.asarray(outcome.of(name) * TO_PAPER_UNITS)


def draw_distributions(study: LayoutStudy) -> Figure:
    """Draw the distribution of every RMSE from each start, with the printed values."""
    with styled_figure(9.0) as figure:
        panels = figure.subplots(len(STUDIED), 3, sharey=True, sharex="col")
        for row, case in zip(panels, STUDIED, strict=True):
            for k, axes in enumerate(row):
                for place, name in enumerate(ROWS):
                    for j, start in enumerate((study.starts[0], study.starts[-1])):
                        rmse = errors_of(study, case, name, start)[:, k]
                        colour = COLOURS.get(name, SKY if name == ROBUST else GREEN)
                        values = quantiles(rmse)
                        shown = np.where(np.isfinite(values), values, 1e6)
                        quantile_bar(axes, place + 0.3 * j, shown, colour, hollow=j > 0)
                    printed = printed_of(case, name)
                    if printed is not None:
                        axes.plot(printed[k], place, "x", ms=7, mew=1.6, color=GREEN, zorder=5)
                log_axis(axes, LogLocator(numticks=8))
                axes.grid(False, axis="y")
            row[0].set_yticks(range(len(ROWS)), ROWS)
            row[0].set_ylim(len(ROWS) - 0.2, -0.6)
            row[0].set_title(TITLES[case], loc="left", fontsize=9)
        for axes, quantity in zip(panels[-1], QUANTITIES, strict=True):
            axes.set_xlabel(f"RMSE of {quantity}")
        last = start_words(study.reading("2", initial_error=study.starts[-1]))
        exact = "exact start: median, middle half"
        dot: dict[str, Any] = {"color": MUTED, "marker": "o", "ms": 5}
        entries = [
            Line2D([], [], lw=4, label=exact, **dot),
            Line2D([], [], mfc="white", lw=1.2, label=last, **dot),
            Line2D([], [], color=GREEN, marker="x", ms=7, mew=1.6, ls="none", label="printed"),
        ]
        legend_below(figure, entries)
        uncrowd(figure)
    return figure


def draw_grid(study: LayoutStudy) -> Figure:
    """Draw the share of layouts with smaller errors than the EKF, under all readings.

    A cell has the smallest of the three shares of R, theta and alpha.
    """
    values = product(*(study.settings.axis(k) for k in ACROSS))
    rows = [dict(zip(ACROSS, row, strict=True)) for row in values]
    columns = _columns(study)
    with styled_figure(1.4 + 0.2 * len(rows) * len(RIVALS)) as figure:
        panels = figure.subplots(len(RIVALS), 1, sharex=True)
        for axes, name in zip(panels, RIVALS, strict=True):
            outcomes = ([study.grid[c, r._replace(**row)] for c, r in columns] for row in rows)
            shares = np.array(
                [[better_shares(o, name, "EKF").min() for o in line] for line in outcomes]
            )
            axes.imshow(100 * shares, cmap="RdBu", vmin=0, vmax=100, aspect="auto")
            for (i, j), share in np.ndenumerate(shares):
                ink = "white" if abs(share - 0.5) > 0.35 else INK
                words = f"{100 * share:.0f}"
                axes.text(j, i, words, ha="center", va="center", fontsize=7, color=ink)
            axes.set_yticks(range(len(rows)), [_row_words(row) for row in rows], fontsize=7)
            title = f"{name} < EKF: smallest of the shares of R, theta and alpha [% of layouts]"
            axes.set_title(title, loc="left", fontsize=9)
            axes.grid(False)
        below = [_column_words(c, r) for c, r in columns]
        panels[-1].set_xticks(range(len(below)), below, fontsize=7, rotation=90)
    return figure


def _columns(study: LayoutStudy) -> list[tuple[CaseName, Reading]]:
    """Return the columns: case, stop radius and faults."""
    first = {case: study.reading(case) for case in STUDIED}
    return [
        (case, r)
        for case in STUDIED
        for r in study.settings.readings(case)
        if all(getattr(r, k) == getattr(first[case], k) for k in ACROSS)
    ]


def _row_words(row: dict[str, Any]) -> str:
    start, Q, noise = row.values()
    words = ["exact" if not any(start) else "{:g} m, {:g} rad".format(*start)]
    return ", ".join([*words, "2 x 2" if Q == "input" else "n x n", *["twist noise"] * any(noise)])


def _column_words(case: CaseName, reading: Reading) -> str:
    lines = [f"Case {case}"]
    lines += [] if case == "4" else [f"{100 * reading.stop_radius:g} cm"]
    lines += [f"{reading.faults} wrong"] if case == "2" else []
    lines += [f"{reading.circle_turn_rate:g} rad/s"] if case == "4" else []
    return ", ".join(lines)


FIGURES: dict[str, tuple[str, Callable[[LayoutStudy], Figure]]] = {
    "distributions": ("RMSE over the layouts, with the printed values", draw_distributions),
    "grid": (
        "Share of layouts with smaller errors than the EKF (smallest of R, theta and alpha)",
        draw_grid,
    ),
}
"""File name to caption and figure, in the order of the page."""


CLAIMED = ("PI-EKF", "A-EKF", "EKF")
"""Order of errors that the paper claims, from small to large."""
TEXTS = html.texts("homeward.lab.report")["layouts"]
PAGE, DATA = "layouts.html", "layouts.csv"


def write_layouts(directory: Path, study: LayoutStudy) -> None:
    """Write the page, PNGs, and layouts.csv with every run; errors as `whole_folder`."""
    with whole_folder(directory, MARKER) as scratch:
        pictures = [
            drawn(scratch, name, caption, draw(study), vector="pdf")
            for name, (caption, draw) in FIGURES.items()
        ]
        write_csv(scratch / DATA, RUNS, _every_run(study))
        (scratch / PAGE).write_text(_page(study, pictures), encoding="utf-8")


def error_table(study: LayoutStudy) -> list[list[str]]:
    """Return median and 90 % range of every RMSE from each start as text, with a head."""
    head = ["case", "filter", "start", "R [cm]", "theta [rad]", "alpha [rad]"]
    rows = [[*head, "theta, R > 20 cm", "below all printed", "reached home", "layouts"]]
    for case, name, start in product(STUDIED, ROWS, study.starts):
        rmse = errors_of(study, case, name, start)
        low, middle, high = np.nanquantile(rmse, [0.05, 0.5, 0.95], axis=0, method="inverted_cdf")
        cells = [f"{m:.3g} ({a:.2g} to {b:.2g})" for a, m, b in zip(low, middle, high, strict=True)]
        reading = study.reading(case, initial_error=start)
        outcome = study.outcome(case, reading, name)
        k = outcome.names.index(name)
        far = f"{np.nanmedian(outcome.theta_far[k]):.3g}"
        printed = printed_of(case, name)
        beats = f"{100 * beats_printed(outcome, case, name):.1f} %" if printed else ""
        home = np.mean(outcome.final_distance[k] < 2 * reading.stop_radius)
        came = "" if case == "4" or name == BOUND else percent(float(home))
        words = start_words(reading)
        rows.append([case, name, words, *cells, far, beats, came, f"{len(rmse):,}"])
    return rows


def order_table(study: LayoutStudy) -> list[list[str]]:
    """Return the shares of layouts with each order of errors, with a head."""
    rows = [["case", "order", "start", "R", "theta", "alpha", "all three"]]
    for case, start in product(STUDIED, study.starts):
        reading = study.reading(case, initial_error=start)
        outcome, words = study.grid[case, reading], start_words(reading)
        n = outcome.rmse.shape[1]
        for a_ekf in ("A-EKF (one)", "A-EKF (all)"):
            order = " < ".join(a_ekf if name == "A-EKF" else name for name in CLAIMED)
            shares = [_share(float(s), n) for s in order_share(outcome, CLAIMED, a_ekf)]
            rows.append([case, order, words, *shares])
            printed = [_share(s, n) for s in printed_order_shares(outcome, case, a_ekf)]
            rows.append([case, f"as printed, {a_ekf}", words, *printed, ""])
        for name in FILTERS[1:]:
            better = [_share(float(s), n) for s in better_shares(outcome, name, "EKF")]
            rows.append([case, f"{name} < EKF", words, *better, ""])
    return rows


def grid_table(study: LayoutStudy) -> list[list[str]]:
    """Return medians under all readings, and shares of layouts better than the EKF, as text."""
    better = [f"{name} < EKF [%]" for name in FILTERS[1:]]
    printed = [f"{name} below printed [%]" for name in FILTERS[:-1]]
    rows = [["case", "reading", *FILTERS, *better, *printed]]
    for (case, reading), outcome in study.grid.items():
        cells = [_medians(outcome.of(name)) for name in FILTERS]
        wins = [
            ", ".join(f"{100 * s:.0f}" for s in better_shares(outcome, name, "EKF"))
            for name in FILTERS[1:]
        ]
        beats = [f"{100 * beats_printed(outcome, case, name):.1f}" for name in FILTERS[:-1]]
        rows.append([case, reading_words(reading, case), *cells, *wins, *beats])
    return rows


def variant_table(study: LayoutStudy) -> list[list[str]]:
    """Return medians of each variant, and shares of layouts better than the EKF, as text."""
    rows = [["variant", "case", "start", *FILTERS, "PI-EKF < EKF [%]", f"{PI_HT} < EKF [%]"]]
    for (name, case, start), outcome in study.varied.items():
        wins = [
            ", ".join(f"{100 * s:.0f}" for s in better_shares(outcome, pi, "EKF"))
            for pi in ("PI-EKF", PI_HT)
        ]
        words = start_words(study.reading(case, initial_error=start))
        rows.append([name, case, words, *(_medians(outcome.of(f)) for f in FILTERS), *wins])
    return rows


def claim_table(study: LayoutStudy) -> list[list[str]]:
    """Return the paper's claims with decisions as text, with a head."""
    return [["claim", "reading", "decision", "figure", "command"], *map(list, claims(study))]


def _medians(rmse: np.ndarray) -> str:
    return ", ".join(f"{v:.3g}" for v in np.median(rmse, axis=0) * TO_PAPER_UNITS)


def _share(share: float, n: int) -> str:
    low, high = wilson(round(share * n), n)
    return f"{100 * share:.1f} % ({100 * low:.1f} to {100 * high:.1f})"


def bound_ratio(study: LayoutStudy, case: CaseName, reading: Reading, name: str) -> np.ndarray:
    """Return the ratio of RMSE to the bound over the layouts of the bound, (3,)."""
    bounds = study.bounds[case, reading].of(BOUND)
    errors = study.outcome(case, reading, name).of(name)[: len(bounds)]
    bound = np.sqrt(np.mean(bounds**2, axis=0))
    return np.asarray(np.sqrt(np.nanmean(errors**2, axis=0)) / bound)


def ratio_table(study: LayoutStudy) -> list[list[str]]:
    """Return the bound and RMSE ratios to it, under all readings that differ in it, as text.

    Where start and motion are exact the bound is zero, and there is no ratio.
    """
    rows = [["case", "reading", "bound: R [cm], theta, alpha [rad]", *ROWS[:-1]]]
    for (case, reading), outcome in study.bounds.items():
        bound = np.sqrt(np.mean(outcome.of(BOUND) ** 2, axis=0)) * TO_PAPER_UNITS
        exact = not any((*reading.initial_error, *reading.disturbance))
        ratios = [
            "" if exact else ", ".join(f"{r:.2f}" for r in bound_ratio(study, case, reading, name))
            for name in ROWS[:-1]
        ]
        cells = [", ".join(f"{v:.2g}" for v in bound), *ratios]
        rows.append([case, reading_words(reading, case), *cells])
    return rows


def headline(study: LayoutStudy) -> str:
    """Return the conclusions as one text."""
    return " ".join(conclusions(study.grid, study.settings.paper.printed.M))


def _page(study: LayoutStudy, pictures: Sequence[tuple[str, str]]) -> str:
    settings, tree = study.settings, study.settings.model_dump(mode="json")
    tables = {
        "Claims of the paper, tested": ("sssss", claim_table(study)),
        "Which open quantity decides: readings in which it holds": (
            "s" * 10,
            deciding_table(study),
        ),
        "RMSE: median (5 to 95 %) over the layouts": ("sssrrrrrrr", error_table(study)),
        "Cramér-Rao bound, and ratios to it": ("ss" + "r" * len(ROWS), ratio_table(study)),
        "Shares of layouts by order of errors": ("sssrrrr", order_table(study)),
        "All readings: medians of R [cm], theta, alpha [rad]": ("ss" + "r" * 16, grid_table(study)),
        "Variants: medians of R [cm], theta, alpha [rad]": ("sss" + "r" * 8, variant_table(study)),
    }
    slow = min(settings.robust, settings.layouts)
    body = [
        html.figures(pictures),
        html.note(TEXTS["compared"].format(slow, settings.varied)),
        html.note(note_below(_below(study))),
        *(html.section(name, html.table(*t, whole=True)) for name, t in tables.items()),
        html.note(TEXTS["shares"]),
        html.settings(
            "Every setting", yaml.safe_dump(tree, sort_keys=False, default_flow_style=None)
        ),
    ]
    orders = []
    for case in STUDIED:
        R, theta, alpha = (" < ".join(printed_order(case, k)) for k in range(3))
        orders.append(f"Case {case} {R} for R, {theta} for theta and {alpha} for alpha")
    head = html.header(
        f"{PAPER} over many layouts and readings",
        *map(html.summary, conclusions(study.grid, settings.paper.printed.M)),
        html.note(TEXTS["introduction"].format(settings.layouts, "; ".join(orders))),
        html.contents(body),
    )
    return html.page("The paper's cases over many layouts and readings", head, *body)


def _below(study: LayoutStudy) -> dict[str, str]:
    """Return a note for each filter below its bound."""
    found = {}
    for (case, reading), outcome in study.bounds.items():
        bounds = outcome.of(BOUND)
        for name in ROWS[:-1]:
            errors = study.outcome(case, reading, name).of(name)[: len(bounds)]
            for k, quantity in enumerate(("R", "theta", "alpha")):
                words = below_bound(errors[:, k], bounds[:, k])
                found[f"{name} in Case {case}, {quantity}, {reading_words(reading, case)}"] = words
    return found


RUNS = ("case", "start", "filter", "layout", "R_cm", "theta_rad", "alpha_rad", "final_distance_m")


def _every_run(study: LayoutStudy) -> Iterator[list[object]]:
    """Yield `RUNS` of each run: RMSE in the paper's units, empty where unknown."""
    for case, start, outcomes in product(STUDIED, study.starts, (study.grid, study.bounds)):
        reading = study.reading(case, initial_error=start)
        outcome, words = outcomes[case, reading], " ".join(f"{v:g}" for v in start)
        for j, name in enumerate(outcome.names):
            for k, errors in enumerate(outcome.of(name) * TO_PAPER_UNITS):
                values = (*errors, outcome.final_distance[j, k])
                yield [case, words, name, k, *(f"{v:.6g}" if v == v else "" for v in values)]
