"""Sentences and page of `homeward plan`, its maps, and a table of the floor."""

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
"""Landmarks in common without which home cannot be fixed."""


def plan_summary(view: PlanView) -> str:
    """Say from where homing can begin, what the worst case is, and what would help."""
    trouble = _trouble(view)
    if trouble:
        return " ".join([trouble, *_advice(view)])
    limits = view.plan.limits
    begin = (
        f"Homing can begin from {words.percent(float(view.begins.mean()))} of the floor: there"
        f" {words.count(limits.landmarks, 'landmark')} at least are seen that home sees too, and"
        f" at best the position is known to {words.quantity(limits.position, 'm')}, the heading"
        f" to {words.degrees(limits.heading)}."
    )
    return " ".join([begin, *_worst(view), *_advice(view)])


def _trouble(view: PlanView) -> str:
    """Say why homing can begin nowhere, when that is so."""
    seen = int(view.stored.sum())
    if not view.names:
        return "There is no landmark: nothing can be told anywhere."
    if not seen:
        return "Home sees no landmark: nothing can be told anywhere."
    if view.begins.any():
        return ""
    told = np.isfinite(view.position)
    text = "Homing can begin nowhere: "
    if seen < RIGID and view.plan.landmark_sigma is None:
        circle = " (with two, home may lie anywhere on a circle through them)" if seen == 2 else ""
        return text + f"home sees only {words.count(seen, 'landmark')}, and it takes three{circle}."
    most = int(view.common.max())
    if most < view.plan.limits.landmarks:
        return (
            f"{text}{words.count(most, 'landmark')} at most are seen both there and from home, and"
            f" the limit asks for {view.plan.limits.landmarks}."
        )
    if not told.any():
        return text + "the pose is not told anywhere."
    return (
        f"{text}the position is known to {words.quantity(float(view.position.min()), 'm')} and the"
        f" heading to {words.degrees(float(view.heading.min()))} at the very best, which is beyond"
        " the limits wherever enough landmarks are in common."
    )


def _worst(view: PlanView) -> list[str]:
    """Say what hiding one landmark, or two, does."""
    all_in_place = float(view.begins.mean())
    safe = float(view.safe.mean())
    parts = [f"Whichever one landmark is hidden, {words.percent(safe)} remain."]
    costly = costliest(view)
    if costly:
        kept = float((view.hidden[:, costly[0]] <= 1).mean())
        parts.append(
            f"The worst to lose is {words.name(view.names[costly[0]])}: without it,"
            f" {words.percent(kept)} instead of {words.percent(all_in_place)}."
        )
    pair = worst_pairs(view, 1)
    if pair:
        i, j, share = pair[0]
        parts.append(
            f"The worst two are {words.name(view.names[i])} and {words.name(view.names[j])}:"
            f" without both, {words.percent(share)}."
        )
    return parts


def worst_pairs(view: PlanView, most: int) -> list[tuple[int, int, float]]:
    """Return pairs of landmarks, and the share of the floor that is left without both."""
    q = len(view.names)
    pairs = [(i, j, float(view.pair_share[i, j])) for i in range(q) for j in range(i)]
    whole = float(view.begins[view.sample].mean())
    return sorted((p for p in pairs if p[2] < whole), key=lambda p: p[2])[:most]


def _advice(view: PlanView) -> list[str]:
    """Say where further landmarks would help."""
    advice = view.advice
    if not len(advice.places):
        asked = view.plan.further and len(advice.candidates)
        return ["No further landmark among the candidate places would help."] if asked else []
    places = [f"({x:.1f}, {y:.1f})" for x, y in advice.places]
    what = "a further landmark" if len(places) == 1 else f"{len(places)} further landmarks"
    where = words.listing(places)
    return [
        f"The best {'place' if len(places) == 1 else 'places'} found for {what}: {where}; from"
        f" {words.percent(float(advice.share[-1]))} of the floor homing could then begin, from"
        f" {words.percent(float(advice.safe[-1]))} whichever one is hidden (now"
        f" {words.percent(float(advice.share[0]))} and {words.percent(float(advice.safe[0]))})."
    ]


SETTINGS_FILE = "plan.yaml"
"""Written last: a folder that holds it is whole output of ours; it repeats the plan."""
PAGE = "plan.html"
PAIRS = 8
"""So many pairs stand in the table."""


def write_plan(directory: Path, view: PlanView) -> None:
    """Write plan.html, maps as PNG and SVG, floor.csv, plan.yaml; errors as `whole_folder`."""
    figures = {
        "begin": (draw_begin(view), "From where homing can begin"),
        "accuracy": (draw_accuracy(view), "Least error of position and heading over the floor"),
    }
    if costliest(view):
        figures["hidden"] = (draw_hidden(view), "What hiding one landmark costs")
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
            ("a moved one is noticed", words.percent(float((begins & (common >= 4)).mean()))),
            ("and named", words.percent(float((begins & (common >= 5)).mean()))),
        ],
        landmarks=[
            (
                view.names[i],
                bool(view.stored[i]),
                # Both of the same places, lest chance puts them in the wrong order.
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
    """Write the map as CSV: empty where the pose is not told."""
    columns = np.column_stack([view.floor.points, view.position, view.heading])
    told = (np.where(yes, "yes", "no") for yes in (view.begins, view.safe))
    rows = zip(columns, view.common, *told, strict=True)
    write_csv(
        file,
        ("x", "y", "position_sigma", "heading_sigma", "landmarks", "begins", "safe"),
        ([*(number(float(f"{v:.4g}")) for v in row), *words] for row, *words in rows),
    )
