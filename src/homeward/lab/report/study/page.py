"""Figures and page of `homeward study`, and notes on estimators below their bound."""

from __future__ import annotations

import math
import re
import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator
from matplotlib.transforms import blended_transform_factory

from homeward.io.writing import whole_folder
from homeward.lab.report.study.maps import draw_maps, grids
from homeward.lab.studies.blocks.store import MARKER
from homeward.lab.studies.study.results import Results, write_netcdf
from homeward.lab.studies.study.summary import (
    Line,
    exact_table,
    failures,
    lines,
    over_time,
    summary,
    table,
)
from homeward.runs.report import html
from homeward.runs.report.canvas import (
    drawn,
    legend_below,
    log_axis,
    plain,
    quantile_bar,
    styled_figure,
    uncrowd,
)
from homeward.runs.report.files import write_tables
from homeward.runs.report.palette import CONTENDER_COLOURS, INK, MUTED, RULE
from homeward.runs.report.words import count, listing

MARK = "†"
"""Mark of estimators below their bound."""
MAX_NAMED = 6
"""Maximum number of such estimators in a note."""
SIGNIFICANT, MIN_RUNS = 3.0, 10
"""Number of standard errors for significance (99.9 %), and of runs to estimate them."""


def below_bound(errors: np.ndarray, bounds: np.ndarray) -> str:
    """Describe an RMSE below its bound, with its significance; empty if it is not below.

    `errors` are the RMSE of each run, `bounds` their bounds, (runs,); NaN where unknown.
    """
    known = np.isfinite(errors) & np.isfinite(bounds)
    excess = (errors**2 - bounds**2)[known]
    if not excess.size or excess.mean() >= 0.0:
        return ""
    share = np.sqrt(np.mean(errors[known] ** 2) / np.mean(bounds[known] ** 2))
    error = excess.std() / np.sqrt(excess.size)
    significant = excess.size >= MIN_RUNS and -excess.mean() > SIGNIFICANT * error
    return f"{100 * share:.1f} % of it, {'significant' if significant else 'not significant'}"


def note_below(found: Mapping[str, str]) -> str:
    """Return the note on estimators that `below_bound` found, by name; empty without any."""
    below = [f"{name} ({words})" for name, words in found.items() if words]
    if not below:
        return ""
    return (
        f"{MARK} RMSE below its bound: {listing(below, MAX_NAMED)}. The bound is for the mean over"
        " all drives and for unbiased estimators. A small number of runs, or a bias towards prior"
        " assumptions, can give a smaller RMSE."
    )


OVERVIEW, OVER_TIME = "overview", "rmse_over_time"
"""Names of figures that only some studies have."""
MAX_ROWS = 80
"""Maximum number of rows of the overview."""
MAX_CONTENDERS = 24
"""Maximum number of estimators in the overview; more are only in maps and in the table."""
MAX_PANELS = 8
"""Maximum number of scenarios over time."""
LINE = 34
"""Characters of a label in one line."""
BELOW = "RMSE below its bound"
CONSISTENT = 3.0
"""Mean NEES of (x, y, heading) of a consistent estimator."""


def figures(results: Results) -> Iterator[tuple[str, str, Figure]]:
    """Yield file name, caption and figure of all figures."""
    for grid in grids(results):
        yield f"map_{grid.name}", grid.caption, draw_maps(results, grid)
    if len(results.plan.contenders) <= MAX_CONTENDERS:
        words = "Errors, successful homing and consistency (NEES) over all runs"
        yield OVERVIEW, words, draw_overview(results)
    if len(results.plan.contenders) <= len(CONTENDER_COLOURS):
        words = "RMSE of the position over time, and the Cramér-Rao bound"
        yield OVER_TIME, words, draw_rmse(results)
        words = "Consistency over time: mean NEES of (x, y, heading), 3 when consistent"
        yield "nees_over_time", words, draw_nees(results)


def below(results: Results) -> dict[str, str]:
    """Return a note for each "estimator in scenario" below its bound, else an empty text."""
    run, plan = results.run, results.plan
    return {
        f"{contender.label} in {case.label}": below_bound(
            run["position_rmse"][i, j], run["position_bound"][i, j]
        )
        for i, case in enumerate(plan.cases)
        for j, contender in enumerate(plan.contenders)
    }


def draw_overview(results: Results) -> Figure:
    """Draw a row for each scenario and estimator: errors, successful homing, NEES."""
    rows = lines(results)[:MAX_ROWS]
    closed = results.plan.study.loop == "closed"
    colours = {
        c.label: CONTENDER_COLOURS[j % len(CONTENDER_COLOURS)]
        for j, c in enumerate(results.plan.contenders)
    }
    places = _places(rows)
    found = below(results)
    beneath = [bool(found[f"{line.estimator} in {line.scenario}"]) for line in rows]
    names = [
        _wrapped(f"{line.estimator} {MARK if b else ''}")
        for line, b in zip(rows, beneath, strict=True)
    ]
    height = 0.06 + 0.155 * max(name.count("\n") + 1 for name in names)
    with styled_figure(1.1 + height * (places[-1] + 1)) as figure:
        panels = figure.subplots(
            1, 3 if closed else 2, sharey=True, width_ratios=[5, 2, 3] if closed else [5, 3]
        )
        for place, line in zip(places, rows, strict=True):
            colour = colours[line.estimator]
            for axes, values in ((panels[0], line.quantiles), (panels[-1], line.nees)):
                if np.isfinite(values[0]):
                    quantile_bar(axes, place, values, colour)
            if np.isfinite(line.bound):
                panels[0].plot(line.bound, place, "|", color=INK, ms=9, mew=1.4)
            if closed:
                low, high = 100 * np.array(line.home_interval)
                panels[1].plot((low, high), (place, place), color=colour, lw=1.6)
                panels[1].plot(100 * line.home, place, "o", ms=4.5, mew=0, color=colour)
        for axes, words in ((panels[0], "position RMSE of a run [m]"), (panels[-1], "mean NEES")):
            axes.set(xscale="log", xlabel=words)
            log_axis(axes, _ticks(axes))
        panels[-1].axvline(CONSISTENT, color=INK, lw=0.9, zorder=0)
        if closed:
            panels[1].set(xlim=(-4, 104), xlabel="reached home [%]")
        panels[0].set_yticks(places, names)
        panels[0].set_ylim(places[-1] + 0.7, places[0] - 1.3)
        for axes in panels:
            axes.grid(False, axis="y")
        _name_scenarios(panels[0], rows, places)
        entries = [
            Line2D([], [], color=MUTED, marker="o", ms=5, lw=0, label="median"),
            Line2D([], [], color=MUTED, lw=4, label="half of the runs"),
            Line2D([], [], color=MUTED, lw=1.2, label="90 %"),
            Line2D([], [], color=INK, marker="|", ms=9, mew=1.4, ls="none", label="bound"),
        ]
        if any(beneath):
            mark = f"${MARK}$"
            entries.append(Line2D([], [], color=INK, marker=mark, ls="none", label=BELOW))
        legend_below(figure, entries, len(entries))
        uncrowd(figure)
    return figure


def _wrapped(label: str) -> str:
    """Return a label in lines of limited length."""
    return textwrap.fill(plain(label), LINE)


def _ticks(axes: Axes) -> LogLocator:
    """Return ticks at 1, 2 and 5 for a short axis, else at powers of ten."""
    low, high = axes.get_xlim()
    return LogLocator(subs=(1.0, 2.0, 5.0) if high / low < 50 else (1.0,), numticks=7)


def _places(rows: list[Line]) -> list[float]:
    """Return the position of each row, with room for a heading before each scenario."""
    new = [False, *(a.scenario != b.scenario for a, b in pairwise(rows))]
    places: list[float] = (np.arange(len(rows)) + 1.4 * np.cumsum(new)).tolist()
    return places


def _name_scenarios(axes: Axes, rows: list[Line], places: list[float]) -> None:
    across = blended_transform_factory(axes.transAxes, axes.transData)
    before = None
    for line, place in zip(rows, places, strict=True):
        if line.scenario != before:
            where: dict[str, Any] = {"transform": across, "va": "center"}
            axes.text(0.02, place - 0.75, plain(line.scenario), weight="bold", **where)
            before = line.scenario


def draw_rmse(results: Results) -> Figure:
    """Draw the RMSE of the position over time in each scenario, with the bound."""

    def draw(axes: Axes, i: int) -> None:
        times = results.plan.times
        for j in range(len(results.plan.contenders)):
            rmse = over_time(results, "position_error", i, j, root=True)
            axes.plot(times, rmse, color=CONTENDER_COLOURS[j])
            bound = over_time(results, "position_bound_over_time", i, j, root=True)
            axes.plot(times, bound, color=CONTENDER_COLOURS[j], lw=0.9, ls=(0, (4, 3)))
        axes.set(yscale="log", ylabel="RMSE [m]")

    return _panels(results, draw, [Line2D([], [], color=MUTED, lw=0.9, ls="--", label="bound")])


def draw_nees(results: Results) -> Figure:
    """Draw the mean NEES over time in each scenario, with its expected range."""

    def draw(axes: Axes, i: int) -> None:
        for j in range(len(results.plan.contenders)):
            nees = over_time(results, "nees_over_time", i, j, root=False)
            axes.plot(results.plan.times, nees, color=CONTENDER_COLOURS[j])
        # Mean of N draws from chi-square(3), which has variance 6.
        half = 1.96 * math.sqrt(6.0 / results.plan.cases[i].runs)
        axes.axhspan(max(CONSISTENT - half, 0.1), CONSISTENT + half, color=RULE, lw=0, zorder=0)
        axes.axhline(CONSISTENT, color=INK, lw=0.8, zorder=0)
        axes.set(yscale="log", ylabel="mean NEES")

    return _panels(results, draw, [Line2D([], [], color=RULE, lw=6, label="95 % if consistent")])


def _panels(results: Results, draw: Callable[[Axes, int], None], entries: list[Line2D]) -> Figure:
    """Draw a panel for each scenario, and one legend for all."""
    cases = results.plan.cases[:MAX_PANELS]
    columns = min(len(cases), 2)
    rows = -(-len(cases) // columns)
    with styled_figure(0.9 + 2.3 * rows) as figure:
        panels = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
        for i, case in enumerate(cases):
            axes = panels.flat[i]
            draw(axes, i)
            axes.set_title(_wrapped(case.label), loc="left", fontsize=9)
            axes.label_outer()
        for axes in panels.flat[len(cases) :]:
            axes.remove()
        for axes in panels.flat[max(len(cases) - columns, 0) : len(cases)]:  # the lowest ones
            axes.tick_params(labelbottom=True)
            axes.set_xlabel("time [s]")
        handles = [
            Line2D([], [], color=CONTENDER_COLOURS[j], label=_wrapped(contender.label))
            for j, contender in enumerate(results.plan.contenders)
        ]
        legend_below(figure, [*handles, *entries])
        uncrowd(figure)
    return figure


TEXTS = html.texts("homeward.lab.report")["study"]
PAGE, DATA = "study.html", "results.nc"


def write_study(directory: Path, results: Results) -> list[list[str]]:
    """Write the page, its table, figures as PNG, and results as netCDF, completely or not at all.

    Return the table; errors as `whole_folder`.
    """
    with whole_folder(directory, MARKER) as scratch:
        pictures = [
            (name, *drawn(scratch, re.sub(r"[^\w-]", "_", name), caption, figure, vector="pdf"))
            for name, caption, figure in figures(results)
        ]
        write_netcdf(results, scratch / DATA)
        found = summary(results)
        rows = table(results.plan, found)
        write_tables(scratch, rows, exact_table(found), left=2)
        (scratch / PAGE).write_text(_page(results, rows, pictures), encoding="utf-8")
    return rows


def headline(results: Results) -> str:
    """Return one sentence on the runs of a study."""
    plan, study = results.plan, results.plan.study
    loop = "steered by the estimator" if study.loop == "closed" else "steered by the true pose"
    failed = int(results.failed.sum())
    outcome = f"{failed:,} of {results.number:,} runs failed" if failed else "no run failed"
    fixed = any(case.runs < study.runs for case in plan.cases)
    return (
        f"{count(len(plan.contenders), 'estimator')} in {count(len(plan.cases), 'scenario')},"
        f" {count(study.runs, 'run')} each{' (1 where nothing is random)' if fixed else ''},"
        f" {loop}: {outcome}"
    )


def _page(results: Results, rows: list[list[str]], pictures: Sequence[tuple[str, str, str]]) -> str:
    plan = results.plan
    names = [name for name, _, _ in pictures]
    cut = []
    if OVER_TIME in names and len(plan.cases) > MAX_PANELS:
        cut.append(f"figures over time have the first {MAX_PANELS} scenarios")
    if OVERVIEW in names and len(plan.cases) * len(plan.contenders) > MAX_ROWS:
        cut.append(f"the overview has the first {MAX_ROWS} rows of the table")
    home = TEXTS["home"].format(plan.study.home_radius) if plan.study.loop == "closed" else ""
    columns = TEXTS["columns"].format(first=plan.contenders[0].label)
    reasons = [f"{number}: {reason}" for reason, number in failures(results).items()]
    settings = plan.study.model_dump(mode="json", exclude_none=True)
    return html.page(
        plan.study.name,
        html.header(plan.study.name, html.summary(f"{headline(results)}.")),
        html.figures((caption, drawing) for _, caption, drawing in pictures),
        html.note(TEXTS["over_time"] if OVER_TIME in names else ""),
        html.note(f"Shortened: {listing(cut)}." if cut else ""),
        html.note(note_below(below(results))),
        html.section(
            "Results by scenario and estimator",
            html.table("ss" + "r" * (len(rows[0]) - 2), rows),
            html.note(columns, home, TEXTS["rates"]),
        ),
        html.section(
            "Failed runs", html.bullets(reasons), html.note(TEXTS["failed"] if reasons else "")
        ),
        html.settings(
            "The study as YAML, which repeats it exactly",
            yaml.safe_dump(settings, sort_keys=False, default_flow_style=None),
        ),
    )
