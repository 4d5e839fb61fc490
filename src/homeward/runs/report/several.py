"""What several estimators over one drive leave behind: a page, tables, and a folder of each run."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from homeward.io.naming import number, share
from homeward.io.writing import whole_folder
from homeward.runs.report.canvas import drawn, legend_below, new_figure, plain, style, uncrowd
from homeward.runs.report.files import write_tables
from homeward.runs.report.folder import write_run
from homeward.runs.report.palette import CONTENDER_COLOURS, INK, MUTED
from homeward.runs.report.template import render
from homeward.runs.report.words import count, name
from homeward.runs.scoring import errors
from homeward.runs.single_run import Outcome

PAGE = "estimators.html"
"""Written last: a folder that holds it is whole output of ours."""
LEAST_M = 1e-3
"""Smaller errors are drawn as this: a start that is told has none."""
HEAD = ["estimator", "no pose", "beyond 3 sigma", "RMSE [m]", "median [m]", "worst [m]"]
HEAD += ["heading [deg]", "NEES", "update [ms]", "named as moved"]


def write_several(directory: Path, outcomes: Sequence[Outcome]) -> None:
    """Write a page, tables, figures, a run folder of each that ended; errors as `whole_folder`."""
    drive = outcomes[0].drive
    ended = [o for o in outcomes if o.track is not None and o.track.t.size]
    with whole_folder(directory, PAGE) as scratch:
        figures = []
        if ended:
            figures = [
                drawn(scratch, "paths", "Where each says the robot was", draw_paths(ended)),
                drawn(scratch, "errors", "How far off each is over time", draw_errors(ended)),
            ]
        for outcome in ended:
            assert outcome.track is not None
            settings = outcome.run.model_dump(mode="json")
            write_run(scratch / folder_name(outcome), outcome.drive, outcome.track, settings)
        write_tables(scratch, table(outcomes), exact_table(outcomes))
        html = render(
            "several.html.j2",
            title=f"{count(len(outcomes), 'estimator')} on {name(drive.name, 60)}",
            head=HEAD,
            rows=list(zip(outcomes, table(outcomes)[1:], strict=True)),
            folder=folder_name,
            figures=figures,
            has_truth=drive.truth is not None,
        )
        (scratch / PAGE).write_text(html, encoding="utf-8")


def folder_name(outcome: Outcome) -> str:
    """Return the folder of a run, after its estimator."""
    return "".join(c if c.isalnum() or c in "-_." else "_" for c in outcome.run.estimator)


def table(outcomes: Sequence[Outcome]) -> list[list[str]]:
    """Return the table of the terminal and of the page, its head first, failures told first."""
    rows = [(o, _numbers(o)) for o in outcomes]
    words = [[*map(share, numbers[:2]), *map(number, numbers[2:])] for _, numbers in rows]
    return [
        HEAD,
        *([o.run.estimator, *w, _named(o)] for (o, _), w in zip(rows, words, strict=True)),
    ]


def exact_table(outcomes: Sequence[Outcome]) -> list[list[object]]:
    """Return the same to the last bit, with the reasons of failures."""
    rows = ([o.run.estimator, *_numbers(o), _named(o), o.failure] for o in outcomes)
    return [[*HEAD, "failure"], *rows]


def _numbers(outcome: Outcome) -> list[float]:
    """Return the figures of one row, NaN where they are not known."""
    metrics = outcome.metrics
    if metrics is None:
        return [1.0] + [math.nan] * 7
    errors_of = [math.nan] * 6
    if (a := metrics.accuracy) is not None:
        p, heading = a.position, math.degrees(a.heading.rmse)
        beyond = 1.0 - a.position_inside_sigma_shares[2]
        errors_of = [beyond, p.rmse, p.median, p.max, heading, a.nees_mean]
    update = metrics.update_median_s
    return [
        1.0 - (metrics.pose_share or 0.0),
        *errors_of,
        math.nan if update is None else 1e3 * update,
    ]


def _named(outcome: Outcome) -> str:
    """Return which landmarks are said to have moved; nothing where the estimator names none."""
    known = [] if outcome.track is None else outcome.track.landmarks
    if all(m.moved is None for m in known):
        return ""
    return " ".join(name(m.landmark) for m in known if m.moved) or "none"


def draw_paths(outcomes: Sequence[Outcome]) -> Figure:
    """Draw the path of each, and the true one; what is far from all others is cut off."""
    truth = outcomes[0].drive.truth
    tracks = [o.track for o in outcomes if o.track is not None]
    with style("paths"):
        figure = new_figure(5.4)
        axes = figure.add_subplot()
        if truth is not None:
            axes.plot(truth.x, truth.y, color=MUTED, lw=2.4)
            axes.set(xlim=_span(truth.x), ylim=_span(truth.y))
        for j, track in enumerate(tracks):
            axes.plot(track.x, track.y, color=_colour(j), lw=0.9)
        axes.plot(0.0, 0.0, marker="*", ms=11, color=INK, ls="none")
        axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
        _legend(figure, outcomes, "truth" if truth is not None else "")
        uncrowd(figure)
    return figure


def draw_errors(outcomes: Sequence[Outcome]) -> Figure:
    """Draw the position error over time; without truth, what each claims it to be."""
    with style("errors"):
        figure = new_figure(3.2)
        axes = figure.add_subplot()
        for j, outcome in enumerate(outcomes):
            track, truth = outcome.track, outcome.drive.truth
            assert track is not None
            if truth is not None:
                judged = errors(track, truth)
                times, size = judged.t, judged.position
            else:
                times, size = track.t, np.hypot(track.sigmas[:, 0], track.sigmas[:, 1])
            axes.plot(times - track.t[0], np.maximum(size, LEAST_M), color=_colour(j), lw=0.9)
        told = outcomes[0].drive.truth is not None
        label = "position error [m]" if told else "claimed sigma [m]"
        axes.set(yscale="log", xlabel="time [s]", ylabel=label)
        _legend(figure, outcomes, "")
        uncrowd(figure)
    return figure


def _legend(figure: Figure, outcomes: Sequence[Outcome], truth: str) -> None:
    entries = [Line2D([], [], color=MUTED, lw=2.4, label=truth)] if truth else []
    entries += [
        Line2D([], [], color=_colour(j), label=plain(o.run.estimator))
        for j, o in enumerate(outcomes)
    ]
    legend_below(figure, entries)


def _colour(j: int) -> str:
    return CONTENDER_COLOURS[j % len(CONTENDER_COLOURS)]


def _span(values: np.ndarray) -> tuple[float, float]:
    """Return what an axis shows: all of the truth and home, with half as much room around."""
    low, high = min(float(values.min()), 0.0), max(float(values.max()), 0.0)
    room = 0.25 * max(high - low, 1.0)
    return low - room, high + room
