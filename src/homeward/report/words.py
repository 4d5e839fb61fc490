"""Numbers and lists as they are written in a sentence."""

from __future__ import annotations

import math

from homeward.naming import listing as listing

_SMALL = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten")


def count(n: int, noun: str) -> str:
    """Return a number of things: "no landmarks", "one landmark", "1,204 landmarks"."""
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
    """Return a share in per cent; only nothing is 0 % and only all of it is 100 %."""
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
    """Return a landmark's id fit for a line of text: printable, and not too long."""
    line = "".join(c if c.isprintable() else "�" for c in landmark) or "(empty)"
    return line if len(line) <= longest else line[: longest - 1] + "…"
