"""An exported filter as the folder of a library, as Arduino and PlatformIO lay one out."""

from __future__ import annotations

from importlib.metadata import version

from homeward.engine.export.source import filled, sources
from homeward.errors import InputError
from homeward.filters.settings import FilterSettings

MARKER = "library.properties"
"""The file that tells an earlier export."""
MOST_LANDMARKS = 32
"""What has been seen is a word of so many bits."""
_FILES = {
    "examples/cortex_m4f/main.c": "main.c",
    "examples/cortex_m4f/startup.c": "startup.c",
    "examples/cortex_m4f/mps2_an386.ld": "mps2_an386.ld",
    "examples/homing/homing.ino": "homing.ino",
    "library.json": "library.json",
    MARKER: MARKER,
}


def project(q: int, settings: FilterSettings, single: bool) -> dict[str, str]:
    """Return all files of an exported EKF of q landmarks, by their place in the folder.

    Its defaults are the settings; numbers are floats (`single`) or doubles.

    Raises
    ------
    InputError
        For a number of landmarks that it cannot have.
    """
    if not 1 <= q <= MOST_LANDMARKS:
        raise InputError(f"an exported filter has 1 to {MOST_LANDMARKS} landmarks, not {q}")
    values = {"version": version("homeward"), "landmarks": q}
    texts = {f"src/{k}": text for k, text in sources(q, settings, single).items()}
    return texts | {place: filled(name, values) for place, name in _FILES.items()}
