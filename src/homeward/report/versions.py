"""Which software made a run."""

from __future__ import annotations

import platform
from importlib.metadata import PackageNotFoundError, version

_PACKAGES = (
    "homeward",
    "numpy",
    "casadi",
    "gtsam",
    "pydantic",
    "matplotlib",
    "bokeh",
    "rosbags",
)


def versions() -> dict[str, str]:
    """Return the versions of homeward, of what it computes with, and of the machine's system."""
    found = {"python": platform.python_version(), "system": platform.platform()}
    for package in _PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            continue
    return found
