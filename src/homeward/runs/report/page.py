"""report.html: the self-contained page of a run."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from bokeh.models import UIElement

from homeward.drives.drive import Drive
from homeward.estimator import Status
from homeward.io.naming import natural
from homeward.runs.report import words
from homeward.runs.report.files import with_versions
from homeward.runs.report.palette import STATUS_COLOURS
from homeward.runs.report.plots.look import embedded, script
from homeward.runs.report.plots.map import map_aspect, map_plot, undrawn
from homeward.runs.report.plots.moments import moments
from homeward.runs.report.plots.time import consistency_plots, error_plots, sigma_plots, time_range
from homeward.runs.report.plots.timeline import MAX_ROWS, timeline
from homeward.runs.report.summary import caution, sentence
from homeward.runs.report.template import GLOSSARY, render
from homeward.runs.scoring import ELLIPSE_SHARES, Accuracy, Metrics, Statistics
from homeward.track import Track


def write_page(
    file: Path, drive: Drive, track: Track, metrics: Metrics, settings: Mapping[str, Any]
) -> None:
    """Write the page of a run; `settings` contains every setting used, as plain data."""
    plots = _plots(drive, track)
    html = render(
        "report.html.j2",
        words=words,
        glossary=GLOSSARY,
        colours=STATUS_COLOURS,
        drive=drive,
        track=track,
        metrics=metrics,
        # No line break between a number and its unit.
        sentence=re.sub(r"(?<=\d) (?=\w)", "\u00a0", sentence(track, metrics)),
        caution=caution(metrics),
        plots=plots,
        embedded=embedded(plots),
        script=script(),
        aspect=map_aspect(track, drive.truth),
        moments=moments(drive, track) if track.t.size else None,
        undrawn=[words.name(i) for i in undrawn(track, drive.truth)],
        error_rows=_error_rows(metrics.accuracy),
        landmarks=sorted(track.landmarks, key=lambda m: (not m.moved, natural(m.landmark))),
        consistency=_consistency(metrics),
        unlisted=max(0, np.unique(drive.sightings.landmark).size - MAX_ROWS),
        left_out=[*drive.remarks.items(), *((why.words, n) for why, n in metrics.rejected.items())],
        stages=_stages(track, metrics),
        timing=_timing(metrics),
        settings=with_versions(settings),
    )
    file.write_text(html, encoding="utf-8")


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


def _error_rows(accuracy: Accuracy | None) -> list[tuple[str, Statistics, bool]]:
    """Return label, statistics and whether it is an angle, for each row of the table of errors."""
    if accuracy is None:
        return []
    rpe = [("translation in 1 s (RPE)", accuracy.rpe_1s, False)] if accuracy.rpe_1s else []
    return [
        ("position", accuracy.position, False),
        ("position after rigid alignment (ATE)", accuracy.aligned, False),
        ("heading alpha", accuracy.heading, True),
        ("distance from home R", accuracy.R, False),
        ("direction from home theta", accuracy.theta, True),
        *rpe,
    ]


def _consistency(metrics: Metrics) -> list[tuple[str, str, str]]:
    """Return label, value and expected value, for each row of the table of consistency."""
    rows: list[tuple[str, str, str]] = []
    if metrics.accuracy is not None:
        a = metrics.accuracy
        rows.append(("mean NEES of (x, y, heading)", f"{a.nees_mean:.2f}", "3"))
        rows.append(
            ("time with NEES inside its 95 % region", words.percent(a.nees_inside_95_share), "95 %")
        )
        shares = zip(a.position_inside_sigma_shares, ELLIPSE_SHARES, strict=True)
        for k, (found, expected) in enumerate(shares, start=1):
            name = f"time inside the {k}-sigma ellipse"
            rows.append((name, words.percent(found), f"{100 * expected:.0f} %"))
        name = "time inside the protection level"
        rows.append((name, words.percent(a.inside_protection_level_share), "99.9 %"))
    if metrics.innovation_inside_95_share is not None:
        share = words.percent(metrics.innovation_inside_95_share)
        rows.append(("sightings inside their 95 % interval", share, "95 %"))
    if metrics.innovation_nis_mean is not None:
        rows.append(("mean NIS of the sightings used", f"{metrics.innovation_nis_mean:.2f}", "1"))
    return rows


def _stages(track: Track, metrics: Metrics) -> list[tuple[float, str, float, str]]:
    """Return the first time [s], name, share of the time and first reason of each status."""
    first = [(track.status.index(s), s) for s in Status if s in track.status]
    shares = metrics.status_shares
    return [
        (float(track.t[row] - track.t[0]), s.value, shares.get(s, 0.0), track.reason[row])
        for row, s in sorted(first, key=lambda f: f[0])
    ]


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
