"""Tables in text files, read in bounded memory; whatever is wrong is named by file and row.

Rows are line numbers counted from 1, the header included.
"""

from __future__ import annotations

import csv
import itertools
import math
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, TextIO

import numpy as np

from homeward.errors import InputError
from homeward.io.reading import naming, opened

CHUNK = 1024
"""How many rows are held as text at once; few, so that collecting their garbage stays cheap."""
LARGEST_ANGLE = 1e6
"""Beyond this [rad] an angle can no longer be wrapped with any meaning."""

LONGEST_LINE = 2**20
"""Characters; a row that is as long holds no table."""
_UNDECODABLE = re.compile("[\udc80-\udcff]")

Parser = Callable[[str, Sequence[str], Sequence[int], Path], np.ndarray]
"""Turns (column name, cells, their rows, file) into an array, or raises InputError."""


@dataclass(frozen=True)
class Table:
    """The wanted columns of a file, each an array of shape (n,)."""

    file: Path
    row: np.ndarray
    """Line number of each entry, shape (n,)."""
    columns: Mapping[str, np.ndarray]

    def __getitem__(self, name: str) -> np.ndarray:
        return self.columns[name]

    def __len__(self) -> int:
        return self.row.size

    def require(self, name: str, good: np.ndarray, complaint: str) -> None:
        """Raise InputError for the first entry of column `name` where `good`, (n,), is False."""
        if not good.all():
            i = int(np.argmin(good))
            value = quoted(str(self[name][i]))
            raise InputError(f"{name} is {value}, {complaint}", self.file, int(self.row[i]))

    def require_angle(self, name: str) -> None:
        """Raise InputError where column `name` cannot be an angle [rad]."""
        self.require(name, np.abs(self[name]) <= LARGEST_ANGLE, "too large for an angle in rad")

    def require_rows(self) -> None:
        """Raise InputError when there are none."""
        if not len(self):
            raise InputError("no rows", self.file)

    def require_unique(self, name: str) -> None:
        """Raise InputError where column `name` repeats an earlier entry."""
        values = self[name].tolist()
        first = dict(zip(reversed(values), reversed(range(len(values))), strict=True))
        fresh = np.array([first[value] == i for i, value in enumerate(values)], bool)
        self.require(name, fresh, "which has a row already")

    def require_order(self) -> None:
        """Raise InputError where `t` decreases."""
        t = self["t"]
        late = np.flatnonzero(t[1:] < t[:-1])
        if late.size:
            i = int(late[0]) + 1
            raise InputError(
                f"time runs backwards: {float(t[i])!r} after {float(t[i - 1])!r}",
                self.file,
                int(self.row[i]),
            )

    def last_of_equal_stamps(self) -> Table:
        """Keep only the last of the entries that share a `t`."""
        t = self["t"]
        return self.rows(np.append(t[1:] != t[:-1], True)[: t.size])

    def rows(self, use: np.ndarray) -> Table:
        """Return some rows: a mask (n,), or their numbers."""
        return Table(self.file, self.row[use], {n: c[use] for n, c in self.columns.items()})


@dataclass(frozen=True)
class Form:
    """How a text file holds a table, where that is not as `read_csv` has it."""

    delimiter: str = ","
    names: tuple[str, ...] | None = None
    """Of its columns, where its first line does not tell."""
    skip: int = 0
    """Lines before the first that counts."""
    encoding: str = "utf-8-sig"


PLAIN = Form()


def read_csv(
    path: Path,
    required: Mapping[str, Parser],
    optional: Mapping[str, Parser] | None = None,
    form: Form = PLAIN,
) -> Table:
    """Read the named columns of a CSV file with a header, in whatever order they stand.

    Other columns, blank lines, a byte order mark and any line ending are accepted; an optional
    column that the file lacks is not in the table. `form` specifies other layouts.
    """
    with text_lines(path, form.encoding) as lines:
        list(itertools.islice(lines, form.skip))
        records = _csv_records(lines, path, form)
        row, header = (0, form.names) if form.names else next(records, (1, None))
        if header is None:
            raise InputError("empty file", path)
        wanted = {**required, **(optional or {})}
        places = _places([name.strip() for name in header], required, wanted, path, row)
        return _collect(records, len(header), {n: (i, wanted[n]) for n, i in places.items()}, path)


def read_columns(path: Path, names: Sequence[str]) -> Table:
    """Read a headerless file of numbers parted by white space; ``#`` begins a comment line.

    Its columns are called `names`, in their order.
    """
    with text_lines(path) as lines:
        records = (
            (row, line.split())
            for row, line in enumerate(lines, start=1)
            if line.strip() and not line.lstrip().startswith("#")
        )
        return _collect(
            records, len(names), {name: (i, numbers) for i, name in enumerate(names)}, path
        )


def write_csv(path: Path, header: Iterable[object], rows: Iterable[Iterable[object]]) -> None:
    """Write a CSV file as RFC 4180 has it, but with plain line ends."""
    with path.open("w", encoding="utf-8", newline="") as out:
        writer = csv.writer(_PlainEnds(out))
        writer.writerow(header)
        writer.writerows(rows)


class _PlainEnds:
    """Turns the line end of each row; with its own, csv quotes a carriage return in a name."""

    def __init__(self, out: TextIO) -> None:
        self.out = out

    def write(self, row: str) -> int:
        """Take one whole row."""
        return self.out.write(row.removesuffix("\r\n") + "\n")


def numbers(name: str, cells: Sequence[str], rows: Sequence[int], path: Path) -> np.ndarray:
    """Parse finite numbers."""
    try:
        values = np.fromiter(map(float, cells), float, len(cells))
        if np.isfinite(values).all() and "_" not in "".join(cells):
            return values
    except ValueError:
        pass
    i = next(i for i, cell in enumerate(cells) if not _is_finite_number(cell))
    told = _shown(cells[i], path)
    trouble = f"is{told}, not a finite number" if told else "is not a finite number"
    trouble = trouble if cells[i].strip() else "is empty"
    raise InputError(f"{name} {trouble}", path, rows[i])


def or_nothing(parse: Parser, nothing: float | str) -> Parser:
    """Return a parser that gives `nothing` for an empty cell."""

    def parse_given(name: str, cells: Sequence[str], rows: Sequence[int], path: Path) -> np.ndarray:
        given = [i for i, cell in enumerate(cells) if cell.strip()]
        values = np.full(len(cells), nothing, object if nothing == "" else float)
        values[given] = parse(name, [cells[i] for i in given], [rows[i] for i in given], path)
        return values

    return parse_given


numbers_or_nothing = or_nothing(numbers, math.nan)


def identifiers(name: str, cells: Sequence[str], rows: Sequence[int], path: Path) -> np.ndarray:
    """Parse ids: any printable text, without the white space around it."""
    clean = {cell: sys.intern(cell.strip()) for cell in set(cells)}
    for cell, text in clean.items():
        if not is_identifier(text):
            trouble = f"is{_shown(text, path)}, with unprintable characters" if text else "is empty"
            raise InputError(f"{name} {trouble}", path, rows[cells.index(cell)])
    # Objects, not fixed-width text: one long id must not widen every row.
    return np.array([clean[cell] for cell in cells], object)


def is_identifier(text: str) -> bool:
    """Whether `text` can stand as an id in a file: printable, no white space around it."""
    return bool(text) and text.isprintable() and text == text.strip()


def _shown(text: str, path: Path) -> str:
    """Return text of a file, quoted; nothing of a link: its target may be private here."""
    return "" if path.is_symlink() else f" {quoted(text)}"


def quoted(text: str) -> str:
    """Quote hostile text for a message of one line."""
    return repr(text if len(text) <= 40 else text[:40] + "...")


def _is_finite_number(cell: str) -> bool:
    try:
        return math.isfinite(float(cell)) and "_" not in cell
    except ValueError:
        return False


@contextmanager
def text_lines(path: Path, encoding: str = "utf-8-sig") -> Iterator[Iterator[str]]:
    """Open a text file to walk its lines; whatever the system says becomes an InputError."""
    # What is no UTF-8 becomes surrogates, so that the line at fault is known.
    damaged = "replace" if encoding == "utf-16" else "surrogateescape"
    options = {"encoding": encoding, "errors": damaged, "newline": ""}
    with naming(path, "cannot be read"), opened(path, "r", **options) as stream:
        yield _checked(stream, path)


def _checked(stream: IO[str], path: Path) -> Iterator[str]:
    """Yield the lines of a file, none of which may be endless or other than UTF-8."""
    for row in itertools.count(1):
        line = stream.readline(LONGEST_LINE)
        if len(line) == LONGEST_LINE:
            raise InputError(f"a line of {LONGEST_LINE:,} characters or more", path, row)
        if not line.isascii() and _UNDECODABLE.search(line):
            raise InputError("not UTF-8 text", path, row)
        if not line:
            return
        yield line


def _csv_records(lines: Iterator[str], path: Path, form: Form) -> Iterator[tuple[int, list[str]]]:
    """Yield (row, fields) of every line that is not blank."""
    reader = csv.reader(lines, delimiter=form.delimiter, skipinitialspace=True, strict=True)
    row = form.skip + 1
    try:
        for fields in reader:
            if len(fields) > 1 or (fields and fields[0].strip()):
                yield row, fields
            row = form.skip + reader.line_num + 1
    except csv.Error as error:
        raise InputError(f"not CSV: {error}", path, row) from error


def _places(
    header: list[str],
    required: Mapping[str, Parser],
    wanted: Mapping[str, Parser],
    path: Path,
    row: int,
) -> dict[str, int]:
    """Find the wanted columns in the header."""
    places: dict[str, list[int]] = {}
    for place, name in enumerate(header):
        places.setdefault(name, []).append(place)
    missing = [name for name in required if name not in places]
    if missing:
        found = _shown(",".join(header), path)
        raise InputError(f"no column {', '.join(missing)} in the header{found}", path, row)
    for name in wanted:
        if len(places.get(name, ())) > 1:
            raise InputError(f"column {name} stands twice in the header", path, row)
    return {name: places[name][0] for name in wanted if name in places}


def _collect(
    records: Iterator[tuple[int, list[str]]],
    width: int,
    parsers: Mapping[str, tuple[int, Parser]],
    path: Path,
) -> Table:
    """Parse the records chunk by chunk, so that only numbers of a long file stay in memory."""
    parts: dict[str, list[np.ndarray]] = {
        name: [parse(name, (), (), path)] for name, (_, parse) in parsers.items()
    }
    all_rows = [np.empty(0, int)]
    while chunk := list(itertools.islice(records, CHUNK)):
        rows = [row for row, _ in chunk]
        for row, fields in chunk:
            if len(fields) != width:
                raise InputError(f"{len(fields)} fields where {width} are due", path, row)
        cells = list(zip(*(fields for _, fields in chunk), strict=True))
        for name, (place, parse) in parsers.items():
            parts[name].append(parse(name, cells[place], rows, path))
        all_rows.append(np.array(rows))
    return Table(path, np.concatenate(all_rows), {n: np.concatenate(p) for n, p in parts.items()})
