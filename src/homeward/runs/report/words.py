"""Wording of numbers and lists in sentences."""

from __future__ import annotations

import math
from collections.abc import Mapping

from homeward.drives.drive import Drive
from homeward.io.naming import listing as listing

_SMALL = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten")


def count(n: int, noun: str) -> str:
    """Return a number with its noun: "no landmarks", "one landmark", "1,204 landmarks"."""
    return f"{_SMALL[n] if n < len(_SMALL) else f'{n:,}'} {noun}{'' if n == 1 else 's'}"


def quantity(value: float, unit: str) -> str:
    """Return a quantity with two significant digits (more above 100): "0.083 m", "12 s"."""
    if not math.isfinite(value):
        return "an unknown number of " + unit
    size = abs(value)
    if size >= 10 or value == 0:
        return f"{value:,.0f} {unit}"
    # Rounding may carry: 0.0996 is 0.10.
    digits = 1 - math.floor(math.log10(float(f"{size:.1e}")))
    return f"{value:.{digits}f} {unit}"


def percent(share: float) -> str:
    """Return a share in per cent; only exactly 0 is 0 % and only exactly 1 is 100 %."""
    rounded = round(100 * share)
    if rounded == 100 and share < 1 - 1e-9:
        return "over 99 %"
    if rounded == 0 and share > 0:
        return "under 1 %"
    return f"{rounded} %"


def degrees(angle: float) -> str:
    """Return an angle [rad] in degrees, with two significant digits."""
    return quantity(math.degrees(angle), "deg").replace(" deg", "°")


def name(landmark: str, longest: int = 24) -> str:
    """Return a landmark's id, printable and shortened to `longest` characters."""
    line = "".join(c if c.isprintable() else "�" for c in landmark) or "(empty)"
    return line if len(line) <= longest else line[: longest - 1] + "…"


def describe_sightings(drive: Drive) -> str:
    """Return the numbers of sightings, landmarks, images and home bearings."""
    images, ids = drive.sightings.begins.size, set(drive.sightings.landmark.tolist())
    at_home = len(ids & set(drive.home))
    return (
        f"{drive.sightings.t.size:,} sightings of {count(len(ids), 'landmark')} in "
        f"{count(images, 'image')}; home saw {at_home:,} of these landmarks."
    )


def describe_moved(boxes: Mapping[str, bool]) -> str:
    """Return which boxes were moved since the home image, and which of these a run can detect.

    `boxes` are the moved ones; True where the home image shows the box.
    """
    if not boxes:
        return "No box was moved since the home image."
    shown = [name for name, seen in boxes.items() if seen]
    return (
        f"Moved since the home image: {listing(list(boxes))}; the home image shows "
        f"{listing(shown) if shown else 'none of them'}. A run can detect only boxes with landmarks"
        " that are seen from home and often enough during the drive."
    )
