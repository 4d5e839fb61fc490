"""Whether things that were recorded together can have been stamped by one clock, in seconds."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from homeward.drives.drive import Drive, is_slow
from homeward.errors import InputError
from homeward.odometry.validity import TWIST_VALIDITY_S, twist_validity

MAX_CLOCK_OFFSET_S = 5.0
"""What begins up to so long after another thing ended may be of the same drive [s]."""
OUTSIDE = "sightings at times without odometry (are their stamps in other units?)"

SLOW, MIN_TWISTS = 2.0 * TWIST_VALIDITY_S, 10
"""Twists that come so rarely in the median [s] lead nowhere, since each holds half as long at most;
of fewer of them nobody says how often they come."""
UNITS = {1e3: "milliseconds", 1e6: "microseconds", 1e9: "nanoseconds"}
"""Of stamps, how many are a second: odometry that is worth it comes more than once in one."""
TOO_RARE = (
    "odometry rows, {:,.1f} s apart in the median, where each holds {:g} s at most "
    "(are their stamps in {}?)"
)

ODOMETRY_ROWS = "odometry rows"
SLOW_ODOMETRY = (
    ODOMETRY_ROWS + ", {:.1f} s apart in the median: each twist is assumed to hold until the next, "
    "at most {:g} s, and poses are less certain; record odometry at 2 Hz or more"
)
SLOW_TRUTH = (
    "rows of ground truth, {:.1f} s apart in the median, too far to interpolate: errors are "
    "computed at their own times only"
)

ON_TIME = "sightings were stamped {:g} s late, as bearings_late says: taken back by that"

OTHER_CLOCK = (
    "their stamps are of different clocks or in different units (both must be in seconds), or "
    "they were not recorded together"
)


def require_overlap(
    spans: Mapping[str, tuple[float, float]], advice: str, path: Path | None = None
) -> None:
    """Raise InputError when a span begins over `MAX_CLOCK_OFFSET_S` after another one ended.

    `spans` are first and last time of each [s], by name; the message ends with `advice`.
    """
    if not spans:
        return
    late, early = max(spans, key=lambda n: spans[n][0]), min(spans, key=lambda n: spans[n][1])
    apart = spans[late][0] - spans[early][1]
    if apart > MAX_CLOCK_OFFSET_S:
        raise InputError(
            f"the first of {late} is {apart:,.1f} s after the last of {early}: {advice}", path
        )


def remark_other_units(t: np.ndarray, remarks: dict[str, int]) -> None:
    """Remark odometry whose stamps `t`, (n,), seem to be in a smaller unit than seconds."""
    if t.size < MIN_TWISTS or (step := float(np.median(np.diff(t)))) <= SLOW:
        return
    unit = next((name for a_second, name in UNITS.items() if step <= a_second), "other units")
    remarks[TOO_RARE.format(step, twist_validity(np.diff(t).tolist()), unit)] = t.size


def without_bearing_delay(drive: Drive) -> Drive:
    """Return a drive whose bearings have the times at which they were taken, by its settings."""
    late = drive.settings.bearings_late
    if late is None:
        return drive
    settings = drive.settings.model_copy(update={"bearings_late": None})
    remarks = {**drive.remarks, ON_TIME.format(late): drive.sightings.t.size}
    return dataclasses.replace(
        drive.with_earlier_sightings(late), settings=settings, remarks=remarks
    )


def _remark_slow(drive: Drive) -> dict[str, int]:
    """Return remarks on odometry and ground truth that come slowly."""
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


def on_one_clock(drive: Drive, path: Path) -> Drive:
    """Return a drive with remarks on stamps that are rare, or beyond its odometry.

    `InputError` where bearings and odometry do not overlap at all.
    """
    odometry, seen = drive.odometry.t, drive.sightings.t
    if not (odometry.size and seen.size):
        return drive
    first, last = float(odometry[0]), float(odometry[-1])
    require_overlap(
        {"the odometry": (first, last), "the bearings": (float(seen[0]), float(seen[-1]))},
        OTHER_CLOCK,
        path,
    )
    drive = dataclasses.replace(drive, remarks={**drive.remarks, **_remark_slow(drive)})
    outside = int(((seen < first - MAX_CLOCK_OFFSET_S) | (seen > last + MAX_CLOCK_OFFSET_S)).sum())
    if 2 * outside <= seen.size:
        return drive
    return dataclasses.replace(drive, remarks={**drive.remarks, OUTSIDE: outside})
