"""How a text file holds a table: its separator, its header and its decimal mark."""

from __future__ import annotations

import csv
import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from homeward.drives.text.table import Form, text_lines
from homeward.errors import InputError

DELIMITERS = ("\t", ";", "|", ",", " ")
"""In this order: a decimal comma is none where semicolons part the fields as well."""
COMMENTS = ("#", "%")
LOOKED_AT = 50
"""So many lines tell the form of all."""


@dataclass(frozen=True)
class Sheet:
    """A text file with a table in it."""

    path: Path
    form: Form
    decimal_comma: bool

    @property
    def names(self) -> tuple[str, ...]:
        """Of its columns; 1, 2, 3, ... where it has no header."""
        assert self.form.names is not None
        return self.form.names


def sheet(path: Path) -> Sheet:
    """Find out the form of a text file.

    Raises
    ------
    InputError
        When it cannot be read, is empty, or nothing parts its lines into fields.
    """
    with text_lines(path) as lines:
        first = list(itertools.islice(lines, LOOKED_AT))
    told = [line for line in first if line.strip()]
    before = list(itertools.takewhile(lambda line: line.lstrip().startswith(COMMENTS), told))
    rows = told[len(before) :]
    if not rows:
        raise InputError("empty file", path)
    delimiter = next((d for d in DELIMITERS if _parts(rows, d)), None)
    if delimiter is None:
        raise InputError("no table: nothing parts its lines into one number of fields", path)
    head, *body = (_fields(line, delimiter) for line in rows)
    skip = first.index(rows[0])
    numbered = any(_is_number(cell, delimiter) for cell in head)
    # ROS and MATLAB write the header as a comment.
    above = _fields(before[-1].lstrip().lstrip("".join(COMMENTS)), delimiter) if before else []
    if not numbered:
        names, skip = head, skip + 1
        body = body or [head]
    else:
        names = above if len(above) == len(head) else [str(k + 1) for k in range(len(head))]
        body = [head, *body]
    cells = [cell for row in body for cell in row]
    decimal_comma = delimiter != "," and any("," in c and _is_number(c, ";") for c in cells)
    return Sheet(path, Form(delimiter, tuple(name.strip() for name in names), skip), decimal_comma)


def _parts(rows: Sequence[str], delimiter: str) -> bool:
    """Whether a delimiter parts most lines into as many fields as the first, two at least."""
    sizes = [len(_fields(row, delimiter)) for row in rows]
    return sizes[0] > 1 and 2 * sizes.count(sizes[0]) > len(sizes)


def _fields(line: str, delimiter: str) -> list[str]:
    try:
        reader = csv.reader([line], delimiter=delimiter, skipinitialspace=True, strict=True)
        return next(reader, [])
    except csv.Error:  # reading the file says why
        return []


def _is_number(cell: str, delimiter: str) -> bool:
    try:
        float(cell if delimiter == "," else cell.replace(",", "."))
    except ValueError:
        return False
    return True
