"""The compiled core: loops in C++, built when the package is installed.

Without it, or with HOMEWARD_PURE set, NumPy computes the same. Callers read `core.compiled` at each
call, so that a test can replace it.
"""

from __future__ import annotations

import os
from importlib import import_module
from types import ModuleType

INTERFACE = 5
"""Version of the signatures of the module's functions; cpp/module.cpp has the same number."""
PURE = "HOMEWARD_PURE"
"""Environment variable that excludes the compiled core, from an installation or at run time."""


def _load() -> tuple[ModuleType | None, str]:
    if os.environ.get(PURE):
        return None, f"{PURE} is set"
    try:
        module = import_module("homeward._core")
    except ModuleNotFoundError:
        return None, "no compiled core in this installation"
    except ImportError as error:  # of another Python or machine
        return None, f"the compiled core cannot be loaded: {error}"
    if getattr(module, "INTERFACE", 0) != INTERFACE:
        return None, "the compiled core is of another version, install homeward again"
    return module, ""


compiled: ModuleType | None
"""The module ``homeward._core``, or None."""
missing: str
"""Reason why `compiled` is None, in a few words; otherwise empty."""
compiled, missing = _load()


def description() -> str:
    """Return which of the two is used, in a few words."""
    return "compiled core" if compiled is not None else f"NumPy only: {missing}"
