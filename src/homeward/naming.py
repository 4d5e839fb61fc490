"""The order in which people expect names: numbers in them by their size, so L2 before L10."""

from __future__ import annotations

import re


def natural(name: object) -> tuple[list[str | tuple[int, str]], str]:
    """Return a key that sorts names as people do; any names, and numbers of any length.

    Parameters
    ----------
    name : object
        Sorted as ``str(name)``; equal keys are equal names.
    """
    text = str(name)
    # Every other part is a number: more digits are more.
    parts: list[str | tuple[int, str]] = list(re.split(r"([0-9]+)", text))
    for at in range(1, len(parts), 2):
        digits = str(parts[at]).lstrip("0")
        parts[at] = (len(digits), digits)
    return parts, text
