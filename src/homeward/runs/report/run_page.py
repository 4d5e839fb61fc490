"""report.html: the self-contained page of a run."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from bokeh.models import UIElement
from markupsafe import Markup

from homeward.drives.drive import Drive
from homeward.estimator import LandmarkEstimate, Status
from homeward.io.naming import natural
from homeward.runs.report import html, words
from homeward.runs.report.files import TEMPLATES, with_versions
from homeward.runs.report.palette import STATUS_COLOURS
from homeward.runs.report.plots.look import embedded, script
from homeward.runs.report.plots.map import map_aspect, map_plot, undrawn
from homeward.runs.report.plots.moments import moments
from homeward.runs.report.plots.time import consistency_plots, error_plots, sigma_plots, time_range
from homeward.runs.report.plots.timeline import MAX_ROWS, timeline
from homeward.runs.report.summary import caution, sentence
from homeward.runs.scoring import ELLIPSE_SHARES, Metrics
from homeward.track import Track

TEXTS = html.texts("homeward.runs.report")["run"]
NO_SCRIPT = Markup("<noscript>{}</noscript>").format(html.note(TEXTS["no_script"]))
PLAYER = Markup(
    '<div class="player">\n<button id="play" aria-label="Play">▶</button>\n'
    '<input id="moment" type="range" min="0" max="{}" value="{}" aria-label="Moment of the drive">'
    '\n<output id="clock" for="moment"></output>\n</div>\n<p class="note" id="state"></p>'
)
KEY = Markup('<div class="key">\n{}\n</div>')
TOP = Markup('<div class="top">\n{}\n{}\n{}\n</div>')
LEGEND = Markup('<div class="legend">\n{}\n{}\n</div>')
DOT, RAY = Markup('<i style="background:{}"></i>'), Markup('<b class="ray" style="color:{}"></b>')


def write_page(
    file: Path, drive: Drive, track: Track, metrics: Metrics, settings: Mapping[str, Any]
) -> None:
    """Write the page of a run; `settings` contains every setting used, as plain data."""
    plots = _plots(drive, track)
    seen = moments(drive, track) if plots else {}
    figures = {name: html.plot(name) for name in plots}
    title = words.name(drive.name, 60)
    text = html.page(
        title,
        TOP.format(
            html.header(f"{title}, estimator {track.estimator}", *_head(track, metrics)),
            *(_map(drive, track, seen) if plots else (html.EMPTY, html.EMPTY)),
        ),
        _errors(figures, metrics),
        _landmarks(track),
        _consistency(figures.get("consistency", html.EMPTY), metrics),
        _sightings(figures.get("timeline", html.EMPTY), drive, metrics),
        html.section("Notes", html.bullets(track.notes)),
        _stages(track, metrics),
        _glossary(),
        html.section(
            "Run time, settings, versions",
            html.paragraph(_timing(metrics)),
            html.details("run.yaml: repeats this run", with_versions(settings)),
        ),
        data=embedded(plots, moments=seen),
        scripts=[script(), TEMPLATES.joinpath("run.js").read_text("utf-8")] if plots else (),
    )
    file.write_text(text, encoding="utf-8")


def _plots(drive: Drive, track: Track) -> dict[str, UIElement]:
    """Return the plots for which the run has data, by name."""
    if not track.t.size:
        return {}
    span = time_range(track)
    plots: dict[str, UIElement] = {"map": map_plot(track, drive.truth)}
    if drive.truth is not None and track.has_pose.any():
        plots["errors"] = error_plots(track, drive.truth, span)
    elif track.has_pose.any():
        plots["sigmas"] = sigma_plots(track, span)
    if drive.sightings.t.size:
        plots["timeline"] = timeline(track, drive.sightings, span)
    if track.innovations.t.size:
        plots["consistency"] = consistency_plots(track, span)
    return plots


def _head(track: Track, metrics: Metrics) -> list[Markup]:
    """Return the result in words, and the share of each status as a bar with its key."""
    # No line break between a number and its unit.
    result = re.sub(r"(?<=\d) (?=\w)", "\u00a0", sentence(track, metrics))
    parts = [html.summary(result), html.paragraph(caution(metrics)), NO_SCRIPT]
    shares = metrics.status_shares
    if not shares:
        return parts
    bar = Markup('<span style="width:{:.3f}%;background:{}"></span>')
    bars = Markup("\n").join(bar.format(100 * v, STATUS_COLOURS[s]) for s, v in shares.items())
    word = Markup('<a href="#word-{0}" title="{1}">{2}{0}</a>')
    key = (
        word.format(s.value, html.GLOSSARY[s.value], DOT.format(STATUS_COLOURS[s])) for s in shares
    )
    bars = Markup('<div class="bar" aria-hidden="true">\n{}\n</div>').format(bars)
    return [*parts, bars, KEY.format(Markup("\n").join(key))]


def _map(drive: Drive, track: Track, seen: Mapping[str, Any]) -> tuple[Markup, Markup]:
    """Return the map with its slider, and the legend."""
    aspect = f"aspect-ratio: {map_aspect(track, drive.truth):.3f}"
    player = PLAYER.format(len(seen["t"]) - 1, seen["opening"])
    colours = seen["colours"]
    signs = {
        "robot": Markup('<i class="kite"></i>'),
        "ground truth": Markup('<b class="line"></b>') if drive.truth else html.EMPTY,
        "landmark in place": DOT.format(colours["moved"][0]),
        "moved": Markup('<i class="moved"></i>'),
        "not tested": DOT.format(colours["untested"]),
        "bearing used": RAY.format(colours["moved"][0]),
        "rejected": RAY.format(colours["moved"][-1]),
    }
    key = (Markup("<span>{}{}</span>").format(sign, text) for text, sign in signs.items() if sign)
    missing = [words.name(i) for i in undrawn(track, drive.truth)]
    text = html.note(
        TEXTS["map"],
        TEXTS["arrows"] if any(m.moved for m in track.landmarks) else "",
        TEXTS["slider"],
        TEXTS["undrawn"].format(words.listing(missing, 20)) if missing else "",
    )
    legend = LEGEND.format(KEY.format(Markup("\n").join(key)), text)
    return html.section("Map", html.plot("map", aspect), player, kind="map"), legend


def _errors(figures: Mapping[str, Markup], metrics: Metrics) -> Markup:
    """Return the section of errors, or without ground truth that of standard deviations."""
    if "sigmas" in figures:
        return html.section("Uncertainty (sigma)", figures["sigmas"], html.note(TEXTS["sigmas"]))
    if "errors" not in figures:
        return html.EMPTY
    parts = [figures["errors"], html.note(TEXTS["errors"])]
    if (a := metrics.accuracy) is not None:
        errors = {
            "position": a.position,
            "position after rigid alignment (ATE)": a.aligned,
            "heading alpha": a.heading,
            "distance from home R": a.R,
            "direction from home theta": a.theta,
            "translation in 1 s (RPE)": a.rpe_1s,
        }
        rows = [["Error", "RMSE", "median", "95 %", "max"]]
        for label, e in errors.items():
            is_angle = label in ("heading alpha", "direction from home theta")
            if e is not None:
                values = (e.rmse, e.median, e.p95, e.max)
                rows.append([label, *(_size(v, is_angle) for v in values)])
        over = html.note(TEXTS["scored"].format(words.quantity(a.scored_s, "s")))
        parts += [html.table("lrrrr", rows), over]
    return html.section("Errors (RMSE, ATE, RPE)", *parts)


def _size(error: float, is_angle: bool) -> str:
    return words.degrees(error) if is_angle else words.quantity(error, "m")


def _landmarks(track: Track) -> Markup:
    """Return the table of landmarks, moved ones first."""
    if not track.landmarks:
        return html.EMPTY
    landmarks = sorted(track.landmarks, key=lambda m: (not m.moved, natural(m.landmark)))
    head = ["Landmark", "Result", "probability of move", "home bearing", "bearing now"]
    rows = [[*head, "distance [m]", "sigma [m]", "sightings"]]
    for m in landmarks:
        chance = m.moved_probability
        rows.append(
            [
                words.name(m.landmark, 60),
                _fate(m, track),
                "" if math.isnan(chance) else words.percent(chance),
                *map(_degrees, (m.home_bearing_stored, m.home_bearing_estimated)),
                *map(_metres, (m.distance, m.sigma_distance)),
                f"{m.sightings:,}",
            ]
        )
    moved = [k for k, m in enumerate(landmarks) if m.moved]
    text = html.note("Bearings and distances are from home. Empty: not estimated.")
    return html.section("Moved landmarks", html.table("wlrrrrrr", rows, moved), text)


def _fate(m: LandmarkEstimate, track: Track) -> str:
    """Return whether a landmark moved."""
    if math.isfinite(m.moved_at):
        return f"moved at {words.quantity(m.moved_at - track.t[0], 's') if track.t.size else ''}"
    if m.exchanged_with:
        return f"exchanged with {words.name(m.exchanged_with, 60)}"
    return {True: "moved", False: "in place", None: "not tested"}[m.moved]


def _degrees(angle: float) -> str:
    return "" if math.isnan(angle) else f"{math.degrees(angle):.1f}°"


def _metres(value: float) -> str:
    return "" if math.isnan(value) else f"{value:.2f}" if value < 100 else f"{value:.0f}"


def _consistency(plots: Markup, metrics: Metrics) -> Markup:
    """Return the section of NEES and NIS, found and expected."""
    rows = [["", "value", "expected"]]
    if (a := metrics.accuracy) is not None:
        rows.append(["mean NEES of (x, y, heading)", f"{a.nees_mean:.2f}", "3"])
        inside = words.percent(a.nees_inside_95_share)
        rows.append(["time with NEES inside its 95 % region", inside, "95 %"])
        shares = zip(a.position_inside_sigma_shares, ELLIPSE_SHARES, strict=True)
        for k, (found, expected) in enumerate(shares, start=1):
            name = f"time inside the {k}-sigma ellipse"
            rows.append([name, words.percent(found), f"{100 * expected:.0f} %"])
        inside = words.percent(a.inside_protection_level_share)
        rows.append(["time inside the protection level", inside, "99.9 %"])
    if metrics.innovation_inside_95_share is not None:
        share = words.percent(metrics.innovation_inside_95_share)
        rows.append(["sightings inside their 95 % interval", share, "95 %"])
    if metrics.innovation_nis_mean is not None:
        rows.append(["mean NIS of the sightings used", f"{metrics.innovation_nis_mean:.2f}", "1"])
    text = html.note(TEXTS["consistency"] if plots else "")
    return html.section("Consistency (NEES, NIS)", plots, text, html.table("lrr", rows))


def _sightings(timeline: Markup, drive: Drive, metrics: Metrics) -> Markup:
    """Return the section of sightings used and rejected."""
    text = unlisted = ""
    if timeline:
        text = TEXTS["timeline"]
        missing = np.unique(drive.sightings.landmark).size - MAX_ROWS
        if missing > 0:
            number = words.count(missing, "landmark").capitalize()
            unlisted = f"{number} with fewer sightings not drawn."
    rejected = ((why.words, number) for why, number in metrics.rejected.items())
    left_out = [[reason, f"{n:,}"] for reason, n in (*drive.remarks.items(), *rejected)]
    used = f"{words.count(metrics.sightings_used, 'sighting').capitalize()} used."
    return html.section(
        "Sightings, used and rejected",
        *(timeline, html.note(text), html.note(unlisted)),
        html.paragraph(used if left_out else f"{used} None rejected."),
        html.table("lr", [["Rejected, corrected or doubtful", "number"], *left_out]),
    )


def _stages(track: Track, metrics: Metrics) -> Markup:
    """Return the first time, share of the time and first reason of each status."""
    first = sorted((track.status.index(s), s.value, s) for s in Status if s in track.status)
    rows = [["status", "first at", "share of time", "first reason"]]
    for row, word, status in first:
        at = words.quantity(float(track.t[row] - track.t[0]), "s")
        share = words.percent(metrics.status_shares.get(status, 0.0))
        rows.append([word, at, share, track.reason[row]])
    return html.section("Availability by status", html.table("lrrw", rows))


def _glossary() -> Markup:
    entry = Markup('<dt id="word-{}">{}</dt><dd>{}</dd>')
    entries = (
        entry.format(word.replace(" ", "-").lower(), word, html.GLOSSARY[word])
        for word in sorted(html.GLOSSARY, key=str.lower)
    )
    listed = words.listing(sorted(html.GLOSSARY, key=str.lower), 99)
    body = Markup("<dl>{}</dl>").format(html.EMPTY.join(entries))
    return html.section("Glossary", html.details(listed, body))


def _timing(metrics: Metrics) -> str:
    """Return the run time of the estimator in one sentence."""
    text = f"Run time {words.quantity(metrics.run_s, 's')}"
    if metrics.update_median_s is None or metrics.update_p99_s is None:
        return text + "."
    median, p99 = (1e3 * s for s in (metrics.update_median_s, metrics.update_p99_s))
    return (
        f"{text}; per update with bearings: median {words.quantity(median, 'ms')}, 99 % quantile "
        f"{words.quantity(p99, 'ms')}."
    )
