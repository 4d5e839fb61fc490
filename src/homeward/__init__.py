"""Where is the robot, relative to a place it has seen before? From bearings alone."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from homeward.drives.drive import Drive
    from homeward.drives.opening import open_drive
    from homeward.errors import HomewardError, InputError
    from homeward.estimator import Estimate, Estimator, Status
    from homeward.frames import Polar, Pose
    from homeward.registry import make_estimator
    from homeward.scoring import score
    from homeward.track import Track, run

    __version__: str

_HOMES = {
    "Drive": "drives.drive",
    "Estimate": "estimator",
    "Estimator": "estimator",
    "HomewardError": "errors",
    "InputError": "errors",
    "Polar": "frames",
    "Pose": "frames",
    "Status": "estimator",
    "Track": "track",
    "make_estimator": "registry",
    "open_drive": "drives.opening",
    "run": "track",
    "score": "scoring",
}

__all__ = [
    "Drive",
    "Estimate",
    "Estimator",
    "HomewardError",
    "InputError",
    "Polar",
    "Pose",
    "Status",
    "Track",
    "__version__",
    "make_estimator",
    "open_drive",
    "run",
    "score",
]


def __dir__() -> list[str]:
    return __all__


def __getattr__(name: str) -> Any:
    # Imported when first asked for: `import homeward` alone stays quick.
    if name == "__version__":
        return import_module("importlib.metadata").version("homeward")
    if name not in _HOMES:
        raise AttributeError(f"module 'homeward' has no attribute {name!r}")
    return getattr(import_module(f"homeward.{_HOMES[name]}"), name)
