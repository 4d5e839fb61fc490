"""Which software made a run, and with which settings."""

from __future__ import annotations

import platform
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import yaml

_PACKAGES = (
    *("homeward", "numpy", "scipy", "casadi", "opencv-python-headless", "pydantic"),
    *("matplotlib", "bokeh", "rosbags"),
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


def with_versions(settings: Mapping[str, Any]) -> str:
    """Return plain data as YAML, and under ``versions`` those of everything."""
    tree = {**settings, "versions": versions()}
    return yaml.safe_dump(tree, sort_keys=False, allow_unicode=True)


def write_settings(file: Path, settings: Mapping[str, Any]) -> None:
    """Write `with_versions` of settings."""
    file.write_text(with_versions(settings), encoding="utf-8")
