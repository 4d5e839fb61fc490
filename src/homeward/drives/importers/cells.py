"""What stands in the cells of tables that others wrote: numbers, times, names, or nothing."""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from homeward.errors import InputError
from homeward.io.table import Parser, identifiers, numbers_or_nothing, quoted

NOTHING = ("", "-", "--", "nan", "na", "n/a", "#n/a", "null", "none", "?")
"""What people write where there is no value."""
THOUSANDS = re.compile(r"-?[1-9]\d{0,2}(\.\d{3})+")
DATE = re.compile(r"\s*\d{4}-\d\d-\d\d[ T]\d\d:\d\d")

_WHOLE = re.compile(r"^(\d+)\.0+$")


def number_parser(decimal_comma: bool) -> Parser:
    """Return what parses numbers, of which some may be missing (NaN)."""
    return _decimal if decimal_comma else _number


def time_parser(decimal_comma: bool) -> Parser:
    """Return what parses times: numbers, or dates with a time of day as Unix time [s]."""

    def parse(name: str, cells: Sequence[str], rows: Sequence[int], path: Path) -> np.ndarray:
        if any(":" in cell for cell in cells):
            cells = [
                "" if cell.strip().lower() in NOTHING else _unix(cell, name, row, path)
                for cell, row in zip(cells, rows, strict=True)
            ]
        return number_parser(decimal_comma)(name, cells, rows, path)

    return parse


def names(name: str, cells: Sequence[str], rows: Sequence[int], path: Path) -> np.ndarray:
    """Parse ids, of which some may be missing; 3.0 is 3, which a table of numbers made of it."""
    values = np.full(len(cells), "", object)
    there = [k for k, cell in enumerate(cells) if cell.strip().lower() not in NOTHING]
    plain = [_WHOLE.sub(r"\1", cells[k].strip()) for k in there]
    values[there] = identifiers(name, plain, [rows[k] for k in there], path)
    return values


def is_number(cell: str, comma: bool) -> bool:
    """Whether a cell is a number, perhaps with a decimal comma."""
    try:
        float(cell.replace(",", ".") if comma else cell)
    except ValueError:
        return bool(DATE.match(cell))
    return True


def _number(name: str, cells: Sequence[str], rows: Sequence[int], path: Path) -> np.ndarray:
    plain = ["" if cell.strip().lower() in NOTHING else cell for cell in cells]
    return numbers_or_nothing(name, plain, rows, path)


def _decimal(name: str, cells: Sequence[str], rows: Sequence[int], path: Path) -> np.ndarray:
    for cell, row in zip(cells, rows, strict=True):
        if THOUSANDS.fullmatch(cell.strip()):
            trouble = "with a point, where others have a decimal comma: is it one, or of thousands?"
            raise InputError(f"{name} is {quoted(cell)}, {trouble}", path, row)
    plain = [c.replace(".", "").replace(",", ".") if "," in c else c for c in cells]
    return _number(name, plain, rows, path)


def _unix(cell: str, name: str, row: int, path: Path) -> str:
    """Return a date and time of day as Unix time [s]; of no zone it is UTC."""
    try:
        told = datetime.fromisoformat(cell.strip().replace(",", "."))
    except ValueError as error:
        trouble = "neither a number nor a time like 2026-11-23 12:00:00.5"
        raise InputError(f"{name} is {quoted(cell)}, {trouble}", path, row) from error
    return repr((told if told.tzinfo else told.replace(tzinfo=UTC)).timestamp())
