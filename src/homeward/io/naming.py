"""Natural order of names, lists in words, short numbers, and commands to type."""

from __future__ import annotations

import math
import os
import re
import shlex
import shutil
import sys
from collections.abc import Sequence

from homeward.errors import as_typed


def natural(name: object) -> tuple[list[str | tuple[int, str]], str]:
    """Return a sort key in natural order, L2 before L10; only equal names have equal keys."""
    text = str(name)
    # Every second part is a number: the one with more digits is larger.
    parts: list[str | tuple[int, str]] = list(re.split(r"([0-9]+)", text))
    for at in range(1, len(parts), 2):
        digits = str(parts[at]).lstrip("0")
        parts[at] = (len(digits), digits)
    return parts, text


def listing(items: Sequence[str], longest: int = 8) -> str:
    """Return "A, B and C"; when there are more than `longest`, "A, B, C and 12 more"."""
    shown = list(items[:longest])
    if len(items) > longest:
        return ", ".join(shown) + f" and {len(items) - longest:,} more"
    return shown[0] if len(shown) == 1 else ", ".join(shown[:-1]) + f" and {shown[-1]}"


def number(value: float) -> str:
    """Return a number with three digits; empty for NaN."""
    if math.isnan(value):
        return ""
    return f"{value:.3g}" if value < 1e4 else f"{value:.0e}".replace("e+0", "e")


def share(value: float) -> str:
    """Return a share in per cent; empty for NaN."""
    return "" if math.isnan(value) else f"{100 * value:.0f} %"


def command(*words: object) -> str:
    """Return a homeward command to type, with its arguments quoted for a shell.

    A program that is not on the PATH, as that of `make demo`, is named as it was called.
    """
    called = sys.argv[0] if os.path.basename(sys.argv[0]) == "homeward" else "homeward"
    program = "homeward" if shutil.which("homeward") else as_typed(called)
    return shlex.join([program, *(as_typed(str(word)) for word in words)])
