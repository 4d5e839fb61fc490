"""Tests of the clocks and units of stamps that were recorded together."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from homeward.drives.drive import Drive, is_slow
from homeward.errors import InputError
from homeward.odometry.validity import TWIST_VALIDITY_S, twist_validity

MAX_CLOCK_OFFSET_S = 5.0
"""Maximum gap between two recordings of one drive [s]."""
OUTSIDE = "sightings at times without odometry; check the clock and unit of their stamps"
MAX_INTERVAL_S, MIN_TWISTS = 2.0 * TWIST_VALIDITY_S, 10
"""Maximum median interval of usable odometry [s]: a twist is valid for about half of it. With fewer
than this number of twists the interval is not tested."""
DAY_S = 86400.0
MAX_JUMP_S = 7 * DAY_S
"""Maximum gap of odometry [s]; at a longer one, the clock was set."""
UNITS = {1e3: "milliseconds", 1e6: "microseconds", 1e9: "nanoseconds"}
"""Units of stamps by their number in a second."""
TOO_RARE = (
    "odometry rows with a median interval of {:,.1f} s, of which each is valid for at most {:g} s; "
    "convert the stamps to seconds if they are in {}"
)
ODOMETRY_ROWS = "odometry rows"
SLOW_ODOMETRY = (
    ODOMETRY_ROWS + " with a median interval of {:.1f} s: each is used until the next, for at most "
    "{:g} s, and poses are less certain; record odometry at 2 Hz or more"
)
SLOW_TRUTH = (
    "rows of ground truth with a median interval of {:.1f} s, too long to interpolate: errors are "
    "computed at these times only"
)
OTHER_CLOCK = "use stamps of one clock in seconds, and files that were recorded together"


def require_overlap(
    spans: Mapping[str, tuple[float, float]], advice: str, path: Path | None = None
) -> None:
    """Raise InputError when a span begins over `MAX_CLOCK_OFFSET_S` after another one ends.

    `spans` are the first and last times [s] by name; the message ends with `advice`.
    """
    if not spans:
        return
    late, early = max(spans, key=lambda n: spans[n][0]), min(spans, key=lambda n: spans[n][1])
    apart = spans[late][0] - spans[early][1]
    if apart > MAX_CLOCK_OFFSET_S:
        problem = f"the first of {late} is {apart:,.1f} s after the last of {early}"
        raise InputError(problem, path, advice=advice)


def _require_steady(t: np.ndarray, path: Path) -> None:
    """Raise InputError where the clock of odometry stamps `t`, (n,), was set meanwhile."""
    steps = np.diff(t)
    if steps.size < MIN_TWISTS:
        return
    k, usual = int(steps.argmax()), float(np.median(steps))
    jump = float(steps[k])
    if jump <= max(MAX_JUMP_S, 1e3 * usual):  # all stamps may be in another unit
        return
    raise InputError(
        "the clock was set during the recording: stamps jump from "
        f"{float(t[k])!r} to {float(t[k + 1])!r} s, by {jump / DAY_S:,.0f} days",
        path,
        advice=f"leave out the {k + 1:,} odometry rows before the jump, and the sightings",
    )


def remark_other_units(t: np.ndarray, remarks: dict[str, int]) -> None:
    """Add a remark where odometry stamps `t`, (n,), seem to be in a smaller unit than seconds."""
    if t.size < MIN_TWISTS or (step := float(np.median(np.diff(t)))) <= MAX_INTERVAL_S:
        return
    unit = next((name for a_second, name in UNITS.items() if step <= a_second), "other units")
    remarks[TOO_RARE.format(step, twist_validity(np.diff(t).tolist()), unit)] = t.size


def _slow_remarks(drive: Drive) -> dict[str, int]:
    """Return remarks on slow odometry and ground truth."""
    remarks, t = {}, drive.odometry.t
    step = float(np.median(np.diff(t))) if t.size >= MIN_TWISTS else 0.0
    if step > TWIST_VALIDITY_S and not any(
        words.startswith(ODOMETRY_ROWS) for words in drive.remarks
    ):
        remarks[SLOW_ODOMETRY.format(step, twist_validity(np.diff(t).tolist()))] = t.size
    if drive.truth is not None and is_slow(drive.truth.t):
        step = float(np.median(np.diff(drive.truth.t)))
        remarks[SLOW_TRUTH.format(step)] = drive.truth.t.size
    return remarks


def with_clock_remarks(drive: Drive, path: Path) -> Drive:
    """Return a drive with remarks on slow odometry and on sightings outside its time.

    `InputError` where bearings and odometry do not overlap.
    """
    odometry, seen = drive.odometry.t, drive.sightings.t
    if not (odometry.size and seen.size):
        return drive
    first, last = float(odometry[0]), float(odometry[-1])
    _require_steady(odometry, path)
    require_overlap(
        {"the odometry": (first, last), "the bearings": (float(seen[0]), float(seen[-1]))},
        OTHER_CLOCK,
        path,
    )
    drive = dataclasses.replace(drive, remarks={**drive.remarks, **_slow_remarks(drive)})
    outside = int(((seen < first - MAX_CLOCK_OFFSET_S) | (seen > last + MAX_CLOCK_OFFSET_S)).sum())
    if 2 * outside <= seen.size:
        return drive
    return dataclasses.replace(drive, remarks={**drive.remarks, OUTSIDE: outside})
