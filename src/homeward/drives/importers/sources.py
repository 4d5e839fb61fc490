"""Tables of formats that packages of others read: entry points of the group `SOURCES`.

The entry point is a function of the path of a file or folder. It returns the columns of each table
by name, or None for another format; names of columns may have dots, and units as in a text file.
"""

from __future__ import annotations

import csv
import re
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from homeward.errors import InputError
from homeward.plugins import FAULTS, fault, installed, load

SOURCES = "homeward.sources"


@contextmanager
def text_files(files: Sequence[Path]) -> Iterator[list[Path]]:
    """Yield the files, those of other formats as text files with one of their tables each.

    `InputError` where a source fails; later ones name the original file and the table.
    """
    with tempfile.TemporaryDirectory(prefix="homeward-") as scratch:
        found, origins = list[Path](), dict[Path, Path]()
        for number, path in enumerate(files):
            tables = _tables(path)
            folder = Path(scratch, str(number))
            for name, columns in ({} if tables is None else tables).items():
                folder.mkdir(exist_ok=True)
                _write(folder / name, columns)
                origins[folder / name] = path / name
            found += [path] if tables is None else [folder / name for name in tables]
        try:
            yield found
        except InputError as error:
            if error.file is not None:
                error.file = origins.get(error.file, error.file)
            raise


def _tables(path: Path) -> Mapping[str, Mapping[str, Sequence[Any]]] | None:
    """Return the tables of a file by the first source that reads it; None without one."""
    for name in installed(SOURCES):
        source = load(SOURCES, name, ())
        try:
            found = source(path)
            if found is None:
                continue
            sizes = [{len(cells) for cells in columns.values()} for columns in found.values()]
        except FAULTS as error:
            raise fault(f"source {name}: reading {path.name}", error) from error
        if not found or any(len(size) != 1 for size in sizes):
            raise InputError(f"source {name} returned no table, or columns of unequal length", path)
        if bad := [name for name in found if not re.fullmatch(r"\w[\w.-]*", name)]:
            raise InputError(f"source {name}: {bad[0]!r} is no name of a table", path)
        return found  # type: ignore[no-any-return]
    return None


def _write(file: Path, columns: Mapping[str, Sequence[Any]]) -> None:
    """Write a table as text, from which numbers are read back exactly."""
    with file.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(columns)
        cells = ([_plain(cell) for cell in column] for column in columns.values())
        writer.writerows(zip(*cells, strict=True))


def _plain(cell: Any) -> Any:
    """Return a cell as Python writes it exactly; empty where it is missing."""
    cell = cell.item() if hasattr(cell, "item") else cell
    return "" if cell is None or cell != cell else cell
