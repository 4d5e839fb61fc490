"""Figures and page of `homeward study paper`."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Arc

from homeward.geometry.angles import wrap
from homeward.io.table import write_csv
from homeward.io.writing import whole_folder
from homeward.lab.report.paper.claims import conclusions, median, triple
from homeward.lab.studies.paper.cases import DEAD_RECKONING, FILTERS
from homeward.lab.studies.paper.layouts import Reading
from homeward.lab.studies.paper.reproduction import (
    PRINTED,
    TO_PAPER_UNITS,
    Reproduction,
    Row,
    better_shares,
    rows,
)
from homeward.lab.studies.paper.settings import PaperSettings
from homeward.lab.studies.paper.world import CaseName, PaperWorld, fault_count
from homeward.runs.report import html
from homeward.runs.report.canvas import WIDTH_IN, bare, drawn, style, styled_figure
from homeward.runs.report.files import write_settings, write_tables
from homeward.runs.report.palette import BLUE, GREEN, HOUSE, INK, MUTED, ORANGE, SKY, VERMILLION
from homeward.runs.report.words import count, listing

COLOURS = dict(zip(FILTERS, (INK, ORANGE, VERMILLION, BLUE, SKY, MUTED), strict=True))
QUANTITIES = ("R [cm]", "theta [rad]", "alpha [rad]")
PAPER = "“State Estimation for Vision-based Localization under Uncertain Conditions”"
TEXTS = html.texts("homeward.lab.report")


def draw_geometry(*_: object) -> Figure:
    """Draw home, robot and one landmark, with the angles and distances of the model."""
    robot, mark, heading = np.array([2.2, 1.0]), np.array([1.3, 3.0]), 0.35
    with styled_figure(4.6) as figure:
        axes = figure.add_subplot(aspect="equal")
        axes.set_axis_off()
        for tip in ((3.6, 0.0), (0.0, 3.4)):
            axes.annotate("", tip, (0, 0), arrowprops={"arrowstyle": "->", "color": MUTED})
        ahead = 2.2 + 1.3 * np.cos(heading), 1.0 + 1.3 * np.sin(heading)
        axes.annotate("", ahead, (2.2, 1.0), arrowprops={"arrowstyle": "-|>", "color": INK})
        axes.plot(*zip(robot, (3.3, 1.0), strict=True), color=MUTED, lw=0.7, ls=":")
        for a, b, label, colour in (
            ((0, 0), robot, "$R$", BLUE),
            ((0, 0), mark, "$D^*_i$", GREEN),
            (robot, mark, "$d_i$", VERMILLION),
        ):
            axes.plot(*zip(a, b, strict=True), color=colour, lw=1.4)
            middle = (np.array(a) + b) / 2
            at = float(middle[0]), float(middle[1])
            axes.annotate(label, at, xytext=(5, 5), textcoords="offset points", color=colour)
        to_mark = float(np.arctan2(*(mark - robot)[::-1]))
        theta = float(np.arctan2(robot[1], robot[0]))
        _arc(axes, (0, 0), 1.0, 0.0, theta, r"$\theta$", BLUE)
        _arc(axes, (0, 0), 0.6, 0.0, float(np.arctan2(mark[1], mark[0])), r"$\beta^*_i$", GREEN)
        _arc(axes, robot, 0.8, 0.0, heading, r"$\alpha$", INK)
        _arc(axes, robot, 0.55, heading, to_mark, r"$\beta_i$", VERMILLION)
        axes.plot(0, 0, marker=HOUSE, ms=13, color=INK, mec="white")
        axes.plot(*robot, "o", ms=9, color=BLUE)
        axes.plot(*mark, "*", ms=14, color=GREEN)
        for words, x, y in (("home O", 0, 0), ("robot P", *robot), ("landmark i", *mark)):
            axes.annotate(words, (x, y), xytext=(-6, -16), textcoords="offset points", ha="center")
        axes.set(xlim=(-0.6, 3.9), ylim=(-0.5, 3.5))
    return figure


def _arc(
    axes: Axes,
    centre: tuple[float, float] | np.ndarray,
    radius: float,
    start: float,
    end: float,
    label: str,
    colour: str,
) -> None:
    """Draw an angle [rad] with its symbol."""
    x, y = float(centre[0]), float(centre[1])
    arc = Arc((x, y), 2 * radius, 2 * radius, theta1=np.degrees(start), theta2=np.degrees(end))
    arc.set_color(colour)
    axes.add_patch(arc)
    middle, reach = (start + end) / 2, radius + 0.14
    where = x + reach * np.cos(middle), y + reach * np.sin(middle)
    axes.text(*where, label, color=colour, ha="center", va="center")


def draw_errors(result: Reproduction, case: CaseName, *names: str) -> Figure:
    """Draw the estimation errors of filters over time in the median run of a case."""
    runs = [(name, result.shown[case].runs[name]) for name in names]
    figure = _draw_panels([(r.t, r.errors, name, COLOURS[name], 1.2) for name, r in runs])
    with style():
        for axes in figure.axes:
            axes.axhline(0, color=MUTED, lw=0.6)
            axes.set_ylabel(f"error of {axes.get_ylabel()}")
    return figure


def _draw_panels(lines: list[tuple[np.ndarray, np.ndarray, str, str, float]]) -> Figure:
    """Draw lines over time: t [s], R, theta and alpha (k, 3), label, colour and width."""
    with styled_figure(5.4) as figure:
        panels = figure.subplots(3, 1, sharex=True)
        for k, (axes, quantity) in enumerate(zip(panels, QUANTITIES, strict=True)):
            for t, values, label, colour, width in lines:
                axes.plot(t, values[:, k] * TO_PAPER_UNITS[k], color=colour, lw=width, label=label)
            axes.set_ylabel(quantity)
        panels[-1].set_xlabel("time [s]")
        figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=3)
    return figure


def draw_path(result: Reproduction, case: CaseName, name: str) -> Figure:
    """Draw the true path home and the path estimated by one filter."""
    run, world = result.shown[case].runs[name], result.shown[case].world
    with styled_figure(5.6) as figure:
        axes = figure.add_subplot(aspect="equal")
        _draw_landmarks(axes, world)
        axes.plot(*run.pose[:, :2].T, color=INK, lw=1.0, label="ground truth")
        R, theta = run.state[:, 0], run.state[:, 1]
        axes.plot(R * np.cos(theta), R * np.sin(theta), color=COLOURS[name], label=name)
        x, y, heading = run.pose[0]
        ahead = x + 0.15 * np.cos(heading), y + 0.15 * np.sin(heading)
        arrow = {"arrowstyle": "-|>", "color": INK, "shrinkA": 3}
        axes.annotate("", ahead, (x, y), arrowprops=arrow)
        axes.plot(x, y, "o", mfc="white", mec=INK, label="start, with heading")
        axes.plot(0, 0, marker=HOUSE, ms=11, color=INK, mec="white", ls="none", label="home")
        axes.set(xlabel="x [m]", ylabel="y [m]")
        figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=5)
    return figure


def _draw_landmarks(axes: Axes, world: PaperWorld) -> None:
    """Draw landmarks, and the stored directions of the wrong ones."""
    wrong = world.faults != 0
    axes.plot(*world.landmarks[~wrong].T, "*", ms=9, color=GREEN, ls="none", label="landmark")
    if wrong.any():
        axes.plot(*world.landmarks[wrong].T, "*", ms=9, color=VERMILLION, ls="none", label="moved")
    far = np.hypot(*world.landmarks.T)
    for i in np.flatnonzero(wrong):
        old = far[i] * np.array([np.cos(world.stored[i]), np.sin(world.stored[i])])
        axes.plot(*zip((0, 0), old, strict=True), color=VERMILLION, lw=0.8, ls="--")


def draw_parameter(result: Reproduction, case: CaseName, name: str) -> Figure:
    """Draw the estimates of wrong home bearings over time, with 3 sigma.

    If none was wrong, all estimated ones are drawn.
    """
    run, world = result.shown[case].runs[name], result.shown[case].world
    n = run.state.shape[1] - len(run.estimated)
    wrong = [k for k, i in enumerate(run.estimated) if world.faults[i]]
    wrong = wrong or list(range(len(run.estimated)))
    with styled_figure(1.4 + 1.5 * len(wrong)) as figure:
        panels = figure.subplots(len(wrong), 1, sharex=True, squeeze=False)[:, 0]
        for axes, k in zip(panels, wrong, strict=True):
            i = run.estimated[k]
            truth = world.true_home_bearings[i]
            error = wrap(run.state[:, n + k] - truth)
            band = 3 * np.sqrt(np.maximum(run.variance[:, n + k], 0))
            axes.fill_between(run.t, error - band, error + band, color=COLOURS[name], alpha=0.12)
            axes.plot(run.t, error, color=COLOURS[name], label=f"{name}, with 3 sigma")
            axes.axhline(0.0, color=INK, lw=0.8, label="ground truth")
            axes.axhline(world.faults[i], color=MUTED, ls="--", label="stored at home")
            # The band is wide at first, and must be inside the axes in the second half.
            wide = float(np.median(band[len(band) // 2 :] + np.abs(error[len(band) // 2 :])))
            reach = max(1.6 * abs(world.faults[i]) or 0.5, 1.2 * wide)
            axes.set(ylim=(-reach, reach), ylabel=rf"error of $\beta^*_{i + 1}$ [rad]")
        panels[-1].set_xlabel("time [s]")
        figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=3)
    return figure


def draw_pose(result: Reproduction, case: CaseName, name: str) -> Figure:
    """Draw the true pose over time and the estimate of one filter."""
    run = result.shown[case].runs[name]
    truth = run.state[:, :3] - run.errors
    truth[:, 1:] = np.unwrap(truth[:, 1:], axis=0)
    return _draw_panels(
        [(run.t, truth, "ground truth", INK, 1.0), (run.t, run.state, name, COLOURS[name], 1.2)]
    )


def draw_panorama(result: Reproduction, case: CaseName) -> Figure:
    """Draw the home image of a case with its features and landmarks."""
    world = result.shown[case].world
    assert world.sight is not None
    image, home = world.sight.home_image, world.sight.home
    height, width = image.shape
    with styled_figure(0.4 + WIDTH_IN * height / width) as figure:
        axes = figure.add_subplot()
        axes.imshow(image, cmap="gray", vmin=0, vmax=255, aspect="auto", gid="photograph")
        axes.plot(home.column, home.row, ".", ms=2, color=SKY, label="features")
        for moved, colour, words in ((False, GREEN, "landmarks"), (True, VERMILLION, "moved")):
            rows = world.sight.landmarks[world.moved == moved]
            if not rows.size:  # no legend entry without marks
                continue
            (marks,) = axes.plot(home.column[rows], home.row[rows], "o", color=colour, label=words)
            marks.set(markersize=9, markerfacecolor="none", markeredgewidth=1.6)
        bare(axes)
        axes.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5))
        axes.set_xticks(
            (np.array([4, 3, 2, 1, 0]) * width / 4 - 0.5).clip(0),
            ["-180°", "-90°", "0°", "90°", "180°"],
        )
        axes.set_xlabel("bearing from the camera's axis at home")
        figure.legend(loc="outside upper center", ncols=3)
    return figure


class Drawing(NamedTuple):
    """A figure of a reproduction."""

    caption: str
    draw: Callable[..., Figure]
    """Function of a reproduction, a case, and the filters."""
    case: CaseName = "2"
    filters: tuple[str, ...] = ()
    """Filters whose run is drawn over time."""


FIGURES: dict[str, Drawing] = {
    "geometry": Drawing("Geometry of the problem: home, robot, one landmark", draw_geometry),
    "errors_case_1": Drawing(
        "Case 1, homing with exact landmark information: estimation errors",
        *(draw_errors, "1", FILTERS),
    ),
    "errors_case_2": Drawing(
        "Case 2, homing with moved landmarks and a varying visible set: estimation errors",
        *(draw_errors, "2", FILTERS),
    ),
    "path_case_3": Drawing(
        "Case 3: path home of the A-EKF with one wrong home bearing",
        *(draw_path, "3 (one fault)", ("A-EKF (one)",)),
    ),
    "parameter_case_3": Drawing(
        "Case 3: the wrong home bearing, estimated by the A-EKF",
        *(draw_parameter, "3 (one fault)", ("A-EKF (one)",)),
    ),
    "parameters_case_3": Drawing(
        "Case 3, several wrong home bearings, all home bearings as parameters",
        *(draw_parameter, "3 (several)", ("A-EKF (all)",)),
    ),
    "pose_pi_ekf_case_4": Drawing(
        "Case 4, PI-EKF in absence of faults: the pose against time", draw_pose, "4", ("PI-EKF",)
    ),
    "errors_case_4": Drawing(
        "Case 4, open loop on a circle: estimation errors", draw_errors, "4", FILTERS
    ),
}
"""By file name, in the order of the page."""
PANORAMA = Drawing("Case 2: the panorama stored at home, with extracted features", draw_panorama)


def figures_of(result: Reproduction) -> dict[str, tuple[str, Callable[[], Figure]]]:
    """Return all figures of a reproduction with captions, including the panorama with images.

    The caption of a figure over time has the run and the percentile of each filter.
    """
    imaged = result.settings.measurements == "images"
    figures: dict[str, tuple[str, Callable[[], Figure]]] = {}
    for name, d in (FIGURES | ({"panorama_case_2": PANORAMA} if imaged else {})).items():
        caption = d.caption
        if d.filters:
            shown = result.shown[d.case]
            ranked = [name for name in d.filters if name in shown.percentile]
            where = listing([f"{name} {shown.percentile[name]:.0f}" for name in ranked])
            caption += f" (run {shown.number}; percentile of its error of R: {where})"
        figures[name] = caption, partial(d.draw, result, d.case, *d.filters)
    return figures


SETTINGS_FILE = "reproduce.yaml"
"""Settings; marks the folder as output of homeward."""
PAGE = "paper.html"


def write_reproduction(directory: Path, result: Reproduction) -> None:
    """Write the page, figures as PNG and PDF, the tables, rmse.csv with every run, reproduce.yaml.

    Errors are those of `whole_folder`.
    """
    with whole_folder(directory, SETTINGS_FILE) as scratch:
        figures = [
            drawn(scratch, name, caption, draw(), vector="pdf")
            for name, (caption, draw) in figures_of(result).items()
        ]
        write_csv(scratch / "rmse.csv", RUNS, _every_run(result))
        write_tables(scratch, *_tables(result), left=2)
        (scratch / PAGE).write_text(_page(result, figures), encoding="utf-8")
        write_settings(scratch / SETTINGS_FILE, result.settings.model_dump(mode="json"))


def _page(result: Reproduction, figures: Sequence[tuple[str, str]]) -> str:
    settings, texts = result.settings, TEXTS["paper"]
    layouts = f"{settings.runs} random layout{'s' if settings.runs > 1 else ''}"
    imaged = settings.measurements == "images"
    printed_rows = [row for row in rows(result) if row.case in PRINTED]
    other_rows = [row for row in rows(result) if row.case not in PRINTED]
    head = ["Case", "Filter", "", *QUANTITIES, "theta, R > 20 cm"]
    head.append(f"home within {200 * settings.assumed.stop_radius:.3g} cm")
    printed, others = (
        html.table("sssrrrrr", [head, *_rows(some)], whole=True)
        for some in (printed_rows, other_rows)
    )
    faults = [["Case", "requested moved landmarks", "obtained"], *fault_rows(result)]
    tree = settings.model_dump(mode="json")
    body = [
        html.section("Printed and reproduced RMSE", printed, html.note(texts["compared"])),
        html.section("The cases without a printed table", others),
        html.figures(figures),
        html.note(texts["shown"].format(settings.seed), "" if imaged else texts["panorama"]),
        html.section("Assumptions", html.bullets(assumptions(settings))),
        html.section("Requested and obtained faults", html.table("srs", faults)),
        html.section("Errata of the paper", html.bullets(errata(result))),
        html.settings(
            "All settings (change with homeward study paper --set KEY=VALUE)",
            yaml.safe_dump(tree, sort_keys=False),
        ),
    ]
    source = "rendered panoramas" if imaged else "an ODE"
    head_of_page = html.header(
        f"{PAPER}, Cases 1 to 4, by measurements from {source}",
        html.bullets(sentences(result), "summary"),
        html.note(texts["introduction"].format(layouts, settings.printed.landmarks)),
        html.contents(body),
    )
    return html.page("The paper's cases, reproduced", head_of_page, *body)


def _rows(table: Sequence[Row]) -> Iterator[list[str]]:
    """Yield the printed errors of each filter, ours, and their range."""
    for row in table:
        name = [row.case, row.filter]
        if row.printed:
            yield [*name, "printed", *(f"{v:.4f}" for v in row.printed), "", ""]
            name = ["", ""]
        ours, far = (f"{v:.4f}" for v in row.median), f"{row.theta_far:.4f}"
        home = "" if row.case == "4" else f"{100 * row.home_share:.0f} %"
        yield [*name, "ours, median", *ours, far, home]
        ranges = zip(row.low, row.high, strict=True)
        spans = (f"{low:.3g} to {high:.3g}" for low, high in ranges)
        yield ["", "", "5 to 95 %", *spans, "", ""]


def assumptions(settings: PaperSettings) -> list[Markup]:
    """Return what these settings assume where the paper prints nothing, or two things."""
    a, images = settings.assumed, settings.images
    imaged = settings.measurements == "images"
    is_variance = a.meaning_of_R == "variance"
    values: dict[str, Any] = {
        "a": a,
        "printed": settings.printed,
        "images": images,
        "height": images.width // 4,
        "several_faults": ", ".join(map(str, a.several_faults)),
        "meaning_of_Q": (
            "(v [cm/s], omega [rad/s])" if a.meaning_of_Q == "input" else "the n states"
        ),
        "meaning_of_R": "variance [rad²]" if is_variance else "standard deviation [rad]",
        "reduced": 100 * a.guard**2 / (a.stop_radius**2 + a.guard**2),
        "bearings": "Without images, measurements" if imaged else "Measurements",
    }
    texts = TEXTS["assumptions"].items()
    return [text.format(**values) for name, text in texts if imaged or name != "images"]


def _tables(result: Reproduction) -> tuple[list[list[str]], list[list[object]]]:
    """Return the table of errors, with four digits and exact: ours, and the printed ones."""
    head = ["case", "filter", *QUANTITIES, *(f"printed {quantity}" for quantity in QUANTITIES)]
    exact = [
        [r.case, r.filter, *r.median.tolist(), *(r.printed or [None] * 3)] for r in rows(result)
    ]
    shown = [
        ["" if v is None else v if isinstance(v, str) else f"{v:.4f}" for v in r] for r in exact
    ]
    return [head, *shown], [list[object](head), *exact]


def sentences(result: Reproduction) -> list[str]:
    """Return the conclusions under the reading of the settings."""
    assumed = result.settings.assumed
    reading = Reading(*(getattr(assumed, field) for field in Reading._fields))
    readings = {(case, reading): outcome for case, outcome in result.outcomes.items()}
    return conclusions(readings, result.settings.printed.M)


def fault_rows(result: Reproduction) -> list[tuple[CaseName, int, str]]:
    """Return the requested and the obtained numbers of moved landmarks of each case."""
    table = []
    for case, outcome in result.outcomes.items():
        numbers, runs = np.unique(outcome.moved, return_counts=True)
        found = [f"{n} in {count(k, 'run')}" for n, k in zip(numbers, runs.tolist(), strict=True)]
        table.append((case, fault_count(case, result.settings), listing(found)))
    return table


def errata(result: Reproduction) -> list[Markup]:
    """Return errors and ambiguities in the paper that affect these settings and results."""
    printed, assumed, outcomes = result.settings.printed, result.settings.assumed, result.outcomes
    q, M, Pi = printed.landmarks, printed.M, printed.Pi
    rank = min(2 * q, q + 3)
    values: dict[str, Any] = {"q": q, "n": q + 3, "rank": rank, "fault": assumed.single_fault}
    values["home"] = ": home is not determined" if rank < q + 3 else ""
    values["Q"] = "2 x 2" if assumed.meaning_of_Q == "input" else "n x n, of the states"
    others = set() if assumed.single_fault else {"fault"}
    if any((*assumed.initial_error, *assumed.disturbance)):
        others.add("exact")
    else:
        values["alone"] = median(outcomes["2"], DEAD_RECKONING)[0]
    if isinstance(M, float) and isinstance(Pi, float) and Pi * M:
        shares = [triple(better_shares(outcomes[c], "PI-EKF", "EKF")) for c in ("2", "4")]
        values |= {"M": M, "times": Pi * M, "shares": shares}
    else:
        others.add("ones")
    return [t.format(**values) for name, t in TEXTS["errata"].items() if name not in others]


RUNS = ("case", "filter", "run", "moved", "R_cm", "theta_rad", "alpha_rad", "final_distance_m")


def _every_run(result: Reproduction) -> Iterator[list[object]]:
    """Yield `RUNS` of each run: RMSE in the paper's units."""
    for case, outcome in result.outcomes.items():
        for j, name in enumerate(outcome.names):
            for k, errors in enumerate(outcome.of(name) * TO_PAPER_UNITS):
                values = (*errors, outcome.final_distance[j, k])
                yield [case, name, k, outcome.moved[k], *(f"{v:.6g}" for v in values)]
