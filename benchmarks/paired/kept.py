"""Figures of finished drives in a file, from which a command continues."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from benchmarks.paired.processes import VariantError


class Kept(dict[tuple[Any, ...], Any]):
    """Results by name, each appended to a file as a line of JSON."""

    def __init__(self, file: Path | None, key: Mapping[str, str]) -> None:
        """Read a file, which begins with `key`, the versions that it is of; None: no file."""
        super().__init__()
        self._file = file
        if file is None:
            return
        if not file.exists():
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(json.dumps(key) + "\n")
        first, *lines = file.read_text().splitlines()
        if json.loads(first) != key:
            raise VariantError(f"{file} is of other versions: {first}; delete it, or use another")
        for line in lines:
            name, result = json.loads(line)
            self[tuple(name)] = result

    def add(self, name: tuple[Any, ...], result: Any) -> None:
        """Add a result."""
        self[name] = result
        if self._file is not None:
            with self._file.open("a") as file:
                print(json.dumps([name, result]), file=file)
