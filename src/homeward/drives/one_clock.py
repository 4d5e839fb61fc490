"""Whether things that were recorded together can have been stamped by one clock."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path

from homeward.drives.drive import Drive
from homeward.errors import InputError

APART_S = 5.0
"""What begins up to so long after another thing ended may be of the same drive [s]."""
OUTSIDE = "sightings at times without odometry (are their stamps in other units?)"

OTHER_CLOCK = (
    "their stamps are of different clocks or in different units (both must be in seconds), or "
    "they were not recorded together"
)


def require_overlap(
    spans: Mapping[str, tuple[float, float]], advice: str, path: Path | None = None
) -> None:
    """Refuse things of which one begins long after another ended.

    Parameters
    ----------
    spans : mapping of str to (float, float)
        First and last time of each [s], by its name.
    advice : str
        What may be the matter, for the message.
    path : Path, optional
        Where they were read, for the message.

    Raises
    ------
    InputError
        When two of them are more than `APART_S` apart.
    """
    if not spans:
        return
    late, early = max(spans, key=lambda n: spans[n][0]), min(spans, key=lambda n: spans[n][1])
    apart = spans[late][0] - spans[early][1]
    if apart > APART_S:
        raise InputError(
            f"the first of {late} is {apart:,.1f} s after the last of {early}: {advice}", path
        )


def on_one_clock(drive: Drive, path: Path) -> Drive:
    """Return a drive of a path, with a remark where most of its bearings are beyond its odometry.

    Raises
    ------
    InputError
        When bearings and odometry do not overlap at all.
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
    outside = int(((seen < first - APART_S) | (seen > last + APART_S)).sum())
    if 2 * outside <= seen.size:
        return drive
    return dataclasses.replace(drive, remarks={**drive.remarks, OUTSIDE: outside})
