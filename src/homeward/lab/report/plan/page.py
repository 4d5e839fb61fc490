"""Summary and page of `homeward plan`, and a table of the floor."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import yaml
from markupsafe import Markup

from homeward.io.table import write_csv
from homeward.io.writing import whole_folder
from homeward.lab.planning.accuracy import Arcs
from homeward.lab.planning.analysis import PlanView
from homeward.lab.report.plan.figures import costliest, draw_accuracy, draw_begin, draw_hidden
from homeward.runs.report import words
from homeward.runs.report.canvas import drawn
from homeward.runs.report.files import number
from homeward.runs.report.template import render

RIGID = 3
"""Minimum number of common landmarks for a pose."""


def plan_summary(view: PlanView) -> str:
    """Return in sentences where homing can begin, the worst case, and what to add."""
    trouble = _trouble(view)
    if trouble:
        return " ".join([trouble, *_advice(view)])
    limits = view.plan.limits
    begin = (
        f"Homing can begin on {words.percent(float(view.begins.mean()))} of the floor: with at"
        f" least {words.count(limits.landmarks, 'landmark')} in common with home, and errors below"
        f" {words.quantity(limits.position, 'm')} and {words.degrees(limits.heading)}."
    )
    return " ".join([begin, *_worst(view), *_advice(view)])


def _trouble(view: PlanView) -> str:
    """Return why homing can begin nowhere; empty if it can."""
    seen = int(view.stored.sum())
    if not view.names:
        return "No landmarks: homing is impossible. Add landmarks to the plan."
    if not seen:
        return "No landmark is visible from home: homing is impossible. Move home or add landmarks."
    if view.begins.any():
        return ""
    observable = np.isfinite(view.position)
    text = "Homing can begin nowhere: "
    if seen < RIGID and view.plan.landmark_sigma is None:
        circle = " (with two, home may lie anywhere on a circle through them)" if seen == 2 else ""
        return text + f"home sees only {words.count(seen, 'landmark')}, and needs three{circle}."
    common = int(view.common.max())
    if common < view.plan.limits.landmarks:
        return (
            f"{text}at most {words.count(common, 'landmark')} are visible there and from home, and"
            f" the limit is {view.plan.limits.landmarks}."
        )
    if not observable.any():
        return text + "the pose is not observable anywhere."
    return (
        f"{text}the minimum errors of {words.quantity(float(view.position.min()), 'm')} and"
        f" {words.degrees(float(view.heading.min()))} exceed the limits wherever enough landmarks"
        " are in common."
    )


def _worst(view: PlanView) -> list[str]:
    """Return the effect of one or two hidden landmarks."""
    all_in_place = float(view.begins.mean())
    safe = float(view.safe.mean())
    parts = [f"With any one landmark hidden, {words.percent(safe)} remain."]
    costly = costliest(view)
    if costly:
        kept = float((view.hidden[:, costly[0]] <= 1).mean())
        parts.append(
            f"The most important landmark is {words.name(view.names[costly[0]])}: without it,"
            f" {words.percent(kept)} instead of {words.percent(all_in_place)}."
        )
    pair = worst_pairs(view, 1)
    if pair:
        i, j, share = pair[0]
        parts.append(
            f"The most important two are {words.name(view.names[i])} and"
            f" {words.name(view.names[j])}:"
            f" without both, {words.percent(share)}."
        )
    return parts


def worst_pairs(view: PlanView, most: int) -> list[tuple[int, int, float]]:
    """Return pairs of landmarks, and the share of the floor that remains without both."""
    q = len(view.names)
    pairs = [(i, j, float(view.pair_share[i, j])) for i in range(q) for j in range(i)]
    whole = float(view.begins[view.sample].mean())
    return sorted((p for p in pairs if p[2] < whole), key=lambda p: p[2])[:most]


def _advice(view: PlanView) -> list[str]:
    """Return the best places for further landmarks."""
    advice = view.advice
    if not len(advice.places):
        searched = view.plan.further and len(advice.candidates)
        return ["No further landmark at a candidate place would help."] if searched else []
    places = [f"({x:.1f}, {y:.1f})" for x, y in advice.places]
    what = "a further landmark" if len(places) == 1 else f"{len(places)} further landmarks"
    where = words.listing(places)
    return [
        f"Best {'place' if len(places) == 1 else 'places'} for {what}: {where}. Homing could then"
        f" begin on {words.percent(float(advice.share[-1]))} of the floor, and on"
        f" {words.percent(float(advice.safe[-1]))} with any one hidden (now"
        f" {words.percent(float(advice.share[0]))} and {words.percent(float(advice.safe[0]))})."
    ]


SETTINGS_FILE = "plan.yaml"
"""The plan; written last, so that it marks the folder as complete output."""
PAGE = "plan.html"
PAIRS = 8
"""Number of pairs in the table."""


def write_plan(directory: Path, view: PlanView) -> None:
    """Write plan.html, maps as PNG and SVG, floor.csv, plan.yaml; errors as `whole_folder`."""
    figures = {
        "begin": (draw_begin(view), "Where homing can begin"),
        "accuracy": (draw_accuracy(view), "Minimum errors of position and heading over the floor"),
    }
    if costliest(view):
        figures["hidden"] = (draw_hidden(view), "Cost of hiding one landmark")
    with whole_folder(directory, SETTINGS_FILE) as scratch:
        drawings = {
            key: drawn(scratch, key, label, figure, vector=True)[1]
            for key, (figure, label) in figures.items()
        }
        _write_floor(scratch / "floor.csv", view)
        (scratch / PAGE).write_text(_page(view, drawings), encoding="utf-8")
        (scratch / SETTINGS_FILE).write_text(_settings(view), encoding="utf-8")


def _page(view: PlanView, drawings: dict[str, Markup]) -> str:
    common, begins = view.common, view.begins
    q = len(view.names)
    order = sorted(range(q), key=lambda i: float((view.hidden[:, i] <= 1).mean()))
    return render(
        "plan.html.j2",
        package="homeward.lab.report",
        words=words,
        view=view,
        plan=view.plan,
        title=words.name(view.plan.name, 60),
        summary=plan_summary(view),
        figures=drawings,
        headline=[
            ("homing can begin", words.percent(float(begins.mean()))),
            ("with any one hidden", words.percent(float(view.safe.mean()))),
            ("with any two hidden", words.percent(float(view.pair_safe.mean()))),
            ("a moved one is detected", words.percent(float((begins & (common >= 4)).mean()))),
            ("and identified", words.percent(float((begins & (common >= 5)).mean()))),
        ],
        landmarks=[
            (
                view.names[i],
                bool(view.stored[i]),
                # Both from the same places, so that they are comparable.
                float((view.hidden[view.sample, i] <= 1).mean()),
                float((view.moved[:, i] <= 1).mean()),
            )
            for i in order
        ],
        pairs=[(view.names[j], view.names[i], share) for i, j, share in worst_pairs(view, PAIRS)],
        headings=len(Arcs(view.plan).headings),
        settings=_settings(view),
    )


def _settings(view: PlanView) -> str:
    tree = view.plan.model_dump(mode="json", exclude_none=True)
    return yaml.safe_dump(tree, sort_keys=False, allow_unicode=True, default_flow_style=None)


def _write_floor(file: Path, view: PlanView) -> None:
    """Write the map as CSV, empty where the pose is not observable."""
    columns = np.column_stack([view.floor.points, view.position, view.heading])
    flags = (np.where(yes, "yes", "no") for yes in (view.begins, view.safe))
    rows = zip(columns, view.common, *flags, strict=True)
    write_csv(
        file,
        ("x", "y", "position_sigma", "heading_sigma", "landmarks", "begins", "safe"),
        ([*(number(float(f"{v:.4g}")) for v in row), *words] for row, *words in rows),
    )
