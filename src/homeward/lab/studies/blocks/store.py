"""Store of finished blocks in a folder; each is written completely or not at all.

MARKER           the settings; marks the folder as output of homeward
blocks/          manifest.json (the settings, whose digest is the key of the study)
                 and NAME.npz, one for each finished block
"""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from homeward.errors import InputError
from homeward.io.models import Strict
from homeward.io.reading import is_there, naming, opened, read_small
from homeward.io.writing import whole_file, write_whole

Arrays = dict[str, np.ndarray]
"""Results of a block: names to arrays, text as ``str`` arrays."""

MARKER = "study.yaml"
"""Settings of a study; a folder with this file is output of homeward."""
MAX_MANIFEST = 2**26
"""[byte]; settings as JSON are a few times as long as in YAML."""
_KEY = "__study__"


class BlockStore:
    """Finished blocks of one study in one folder, which is created if necessary.

    `settings` are all settings that determine the results, as plain JSON values; they are written
    as YAML to the file `marker`. Raises `InputError` when the folder cannot be written, contains
    something else, or blocks of other settings or of another version of homeward.
    """

    def __init__(self, folder: Path, settings: Mapping[str, Any], marker: str) -> None:
        self.folder = folder
        tree = {"homeward": our_version(), **settings}
        text = json.dumps(tree, sort_keys=True)
        self.key = hashlib.sha256(text.encode()).hexdigest()
        self._blocks = folder / "blocks"
        with naming(folder, "cannot be written"):
            self._claim(tree, marker)

    def __contains__(self, name: str) -> bool:
        """Whether a block is finished and readable."""
        return self._read(name) is not None

    def save(self, name: str, arrays: Arrays) -> None:
        """Store a finished block atomically."""
        path = self._path(name)
        with naming(path, "cannot be written"), whole_file(path) as scratch:
            # mypy: the mapping could contain allow_pickle, which is another argument.
            np.savez_compressed(scratch, **{_KEY: np.array(self.key), **arrays})  # type: ignore[arg-type]

    def load(self, name: str) -> Arrays:
        """Return a finished block; `InputError` when there is none."""
        arrays = self._read(name)
        if arrays is None:
            raise InputError("missing or damaged; run the study again", self._path(name))
        return arrays

    def _path(self, name: str) -> Path:
        return self._blocks / f"{name}.npz"

    def _read(self, name: str) -> Arrays | None:
        """Return a block, or None when it is missing, damaged, or of another study."""
        try:
            # Opened here: NumPy would leave a damaged file open.
            with opened(self._path(name)) as stream, np.load(stream) as file:
                arrays = {k: file[k] for k in file.files}
        except Exception:  # zip, zlib and NumPy raise many types for damaged files
            return None
        key = arrays.pop(_KEY, None)
        return arrays if key is not None and str(key) == self.key else None

    def _claim(self, tree: dict[str, Any], marker: str) -> None:
        """Create the folder, or check that its blocks are of this study."""
        manifest = self._blocks / "manifest.json"
        if is_there(manifest):
            self._refuse_change(manifest, tree)
            return
        new = not is_there(self.folder)
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            # First, so that an interrupted folder is recognised as output of homeward.
            text = yaml.safe_dump(tree, sort_keys=False, default_flow_style=None)
            write_whole(self.folder / marker, text.encode())
            self._blocks.mkdir(exist_ok=True)
            write_whole(manifest, json.dumps(tree, indent=1).encode())
        except BaseException:
            if new:  # a full disk leaves nothing behind
                shutil.rmtree(self.folder, ignore_errors=True)
            raise

    def _refuse_change(self, manifest: Path, tree: dict[str, Any]) -> None:
        try:
            before = json.loads(read_small(manifest, MAX_MANIFEST, "a manifest"))
        except (ValueError, RecursionError):
            raise InputError("damaged; choose another output folder", manifest) from None
        change = _first_change(before, json.loads(json.dumps(tree)))
        if change is not None:
            raise InputError(
                f"contains blocks of another study ({change}); choose another output folder, or "
                "delete this one",
                self.folder,
            )


def store_of(settings: Strict, folder: Path) -> BlockStore:
    """Return the store of a study in a folder, new or resumed; errors as `BlockStore`."""
    tree = settings.model_dump(mode="json", exclude_none=True)
    return BlockStore(folder, tree, MARKER)


def our_version() -> str:
    """Return the installed version of homeward."""
    try:
        return version("homeward")
    except PackageNotFoundError:
        return "not installed"


def _first_change(before: Any, now: Any, key: str = "") -> str | None:
    """Describe the first difference between two trees of plain values; None without one."""
    if before == now:
        return None
    if isinstance(before, dict) and isinstance(now, dict):
        for k in [*before, *(k for k in now if k not in before)]:
            here = f"{key}.{k}" if key else str(k)
            if k not in now:
                return f"{here} is gone"
            if k not in before:
                return f"{here} is new"
            if (change := _first_change(before[k], now[k], here)) is not None:
                return change
    if isinstance(before, list) and isinstance(now, list) and len(before) == len(now):
        for i, (a, b) in enumerate(zip(before, now, strict=True)):
            if (change := _first_change(a, b, f"{key}.{i}")) is not None:
                return change
    return f"{key} was {_short(before)}, is {_short(now)}"


def _short(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= 40 else text[:39] + "…"
