"""Builds a wheel: with the C of homeward's packages compiled, where there is a compiler.

Without one, or with HOMEWARD_PURE set, the wheel is pure: what needs the C compiles it when first
asked for, or goes by NumPy. An editable install is always so. A CC that compiles for another
machine makes that one's wheel.
"""

import os
import platform
import sys
import sysconfig
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

PROGRAMS = ("vision", "lab/simulation/render/rays")
"""Packages whose folder ``native`` holds a program in C."""


class Prebuilt(BuildHookInterface):
    """Puts compiled programs beside their sources, and names the platform in the wheel's name."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Compile."""
        if version == "editable" or os.environ.get("HOMEWARD_PURE"):
            return
        source = Path(self.root, "src")
        sys.path.insert(0, str(source))
        from homeward.native.compiler import NativeError
        from homeward.native.library import PREBUILT, prebuild

        self._workshop = tempfile.TemporaryDirectory()
        compiled = {}
        try:
            for package in PROGRAMS:
                native = f"homeward/{package}/native"
                library = Path(self._workshop.name, f"{len(compiled)}.so")
                machine = prebuild(source / native, library)
                compiled[str(library)] = f"{native}/{PREBUILT}"
        except NativeError as error:
            self.app.display_warning(f"a pure wheel: {error}")
            return
        own = machine == platform.machine()
        told = sysconfig.get_platform() if own else f"linux_{machine}"
        told = told.replace("-", "_").replace(".", "_")
        build_data |= {"pure_python": False, "tag": f"py3-none-{told}"}
        build_data["force_include"] |= compiled

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        """Leave nothing behind."""
        if hasattr(self, "_workshop"):
            self._workshop.cleanup()
