"""Tables in text files, read in bounded memory; errors name file and row.

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
from functools import partial
from pathlib import Path
from typing import IO, TextIO, TypeAlias

import numpy as np

from homeward.errors import InputError
from homeward.io.reading import naming, opened

CHUNK = 1024
"""Number of rows kept as text at once; more would slow down garbage collection."""
MAX_ANGLE = 1e6
"""Maximum angle [rad]; wrapping a larger one would lose all precision."""
MAX_LINE = 2**20
"""Maximum length of a line [characters]."""
_FORMULA = re.compile(r"'*[=+\-@\t\r\n\uff1d\uff0b\uff0d\uff20]")
"""Begin of a text that a spreadsheet may execute as a formula, after any number of apostrophes."""
_VALUE = re.compile(r"[^\s,;\[\]()]+")
"""A value in an array."""
_UNDECODABLE = re.compile("[\udc80-\udcff]")

Parser = Callable[[str, Sequence[str], Sequence[int], Path], np.ndarray]
"""Converts (column name, cells, their rows, file) to an array, or raises InputError."""


@dataclass(frozen=True)
class Table:
    """Columns of a file, each an array of shape (n,)."""

    file: Path
    row: np.ndarray
    """Line number of each entry, shape (n,)."""
    columns: Mapping[str, np.ndarray]

    def __getitem__(self, name: str) -> np.ndarray:
        return self.columns[name]

    def __len__(self) -> int:
        return self.row.size

    def require(
        self, name: str, is_good: np.ndarray, problem: str, advice: str | None = None
    ) -> None:
        """Raise InputError for the first entry of column `name` where `is_good`, (n,), is False.

        `problem` has the value as ``{}``.
        """
        if not is_good.all():
            i = int(np.argmin(is_good))
            problem, row = problem.format(quoted(str(self[name][i]))), int(self.row[i])
            raise InputError(problem, self.file, row, part=name, advice=advice)

    def require_angle(self, name: str) -> None:
        """Raise InputError where column `name` exceeds `MAX_ANGLE`."""
        self.require(
            name,
            np.abs(self[name]) <= MAX_ANGLE,
            f"must be an angle in rad, of at most {MAX_ANGLE:g}, not {{}}",
        )

    def require_rows(self) -> None:
        """Raise InputError for an empty table."""
        if not len(self):
            raise InputError("no rows", self.file)

    def require_unique(self, name: str) -> None:
        """Raise InputError where column `name` repeats an earlier entry."""
        values = self[name].tolist()
        first = dict(zip(reversed(values), reversed(range(len(values))), strict=True))
        fresh = np.array([first[value] == i for i, value in enumerate(values)], bool)
        self.require(name, fresh, "{} already has a row", "keep one of them")

    def require_order(self) -> None:
        """Raise InputError where `t` decreases."""
        t = self["t"]
        late = np.flatnonzero(t[1:] < t[:-1])
        if late.size:
            i = int(late[0]) + 1
            problem = f"time runs backwards: {float(t[i])!r} after {float(t[i - 1])!r}"
            raise InputError(problem, self.file, int(self.row[i]))

    def rows(self, use: np.ndarray) -> Table:
        """Return some rows: a mask (n,), or their numbers."""
        return Table(self.file, self.row[use], {n: c[use] for n, c in self.columns.items()})


@dataclass(frozen=True)
class Form:
    """Layout of a table in a text file; the default is plain CSV."""

    delimiter: str = ","
    names: tuple[str, ...] | None = None
    """Names of the columns; None: the first line has them."""
    skip: int = 0
    """Number of lines before the table."""
    encoding: str = "utf-8-sig"
    arrays: tuple[int, ...] = ()
    """Number of values in each cell of a line that is an array; 0: a plain cell. Each value has its
    own name. Empty: no cell is an array."""


PLAIN = Form()
CUT_OFF = "last row of {}, which is cut off and left out"
HEADER_AGAIN = "repeated header lines of {}, left out"
_PARTIAL = re.compile(r"[+-]?\.?|.*\d[eE][+-]?")
"""A number without its end, as far as that shows."""


Records: TypeAlias = list[tuple[int, list[str]]]
"""Rows and their fields."""


class _Lines:
    """Lines of a file that may be cut off, or joined from several that have a header each."""

    def __init__(
        self, lines: Iterable[str], num_header: int, remarks: dict[str, int] | None
    ) -> None:
        self.is_cut = False
        """Whether the last line that was read has no line end; False without `remarks`."""
        self.remarks = remarks
        self.repeats = 0
        self.lines = iter(lines) if remarks is None else self._without_headers(lines, num_header)

    def __iter__(self) -> Iterator[str]:
        return self.lines

    def _without_headers(self, lines: Iterable[str], num_header: int) -> Iterator[str]:
        """Yield the lines, with a blank one for each that repeats one of the header."""
        header, has_rows = set[str](), False
        for k, line in enumerate(lines):
            text = line.rstrip("\r\n")
            self.is_cut = text == line
            is_repeat = has_rows and text in header
            self.repeats += is_repeat
            yield "\n" if is_repeat else line
            if k < num_header and any(map(str.isalpha, text)):
                header.add(text)
            has_rows |= k >= num_header

    def whole(self, records: Records, width: int, path: Path) -> Records:
        """Return the records read last, without one that the end of the file cuts off."""
        if self.remarks is not None and self.repeats:
            self.remarks[HEADER_AGAIN.format(path.name)] = self.repeats
        if self.remarks is None or not self.is_cut or not records:
            return records
        *before, (_, last) = records
        is_partial = len(last) < width or (
            len(last) == width
            and bool(_PARTIAL.fullmatch(last[-1].strip()))
            and all(fields[-1].strip() != last[-1].strip() for _, fields in before)
        )
        if is_partial:
            self.remarks[CUT_OFF.format(path.name)] = 1
        return before if is_partial else records


def read_csv(
    path: Path,
    required: Mapping[str, Parser],
    optional: Mapping[str, Parser] | None = None,
    form: Form = PLAIN,
    advice: str = "",
    remarks: dict[str, int] | None = None,
) -> Table:
    """Read the named columns of a CSV file with a header, in any order.

    Other columns, blank lines, a byte order mark and any line ending are accepted. A missing
    optional column is not in the table. `form` specifies other layouts; `advice` ends the error of
    a missing column. With `remarks`, which count them, a last row that is cut off and header lines
    that come again are left out.
    """
    with text_lines(path, form.encoding) as plain:
        lines = _Lines(plain, form.skip if form.names else 1, remarks)
        list(itertools.islice(lines, form.skip))
        records = _csv_records(lines, path, form)
        row, header = (form.skip, form.names) if form.names else next(records, (1, None))
        if header is None:
            raise InputError("empty file", path)
        wanted = {**required, **(optional or {})}
        names = [name.strip() for name in header]
        if missing := [name for name in required if name not in names]:
            found = _shown(",".join(names), path)
            what = f"no column {', '.join(missing)} in the header{found}{advice}"
            raise InputError(what, path, row)
        indices = _column_indices(names, wanted, path, row)
        parsers = {name: (i, wanted[name]) for name, i in indices.items()}
        return _collect(records, len(header), parsers, path, lines)


def read_columns(path: Path, names: Sequence[str], remarks: dict[str, int] | None = None) -> Table:
    """Read a file of numbers separated by white space; ``#`` begins a comment line.

    It has no header; its columns are called `names`, in order; `remarks` as of `read_csv`.
    """
    with text_lines(path) as plain:
        lines = _Lines(plain, 0, remarks)
        records = (
            (row, line.split())
            for row, line in enumerate(lines, start=1)
            if line.strip() and not line.lstrip().startswith("#")
        )
        parsers = {name: (i, numbers) for i, name in enumerate(names)}
        return _collect(records, len(names), parsers, path, lines)


def write_csv(path: Path, header: Iterable[object], rows: Iterable[Iterable[object]]) -> None:
    """Write a CSV file according to RFC 4180, but with LF as line ending.

    A text that a spreadsheet could execute as a formula (``=``, ``+``, ``-``, ``@`` first, and not
    a number) gets an apostrophe in front, which `identifiers` removes.
    """
    with path.open("w", encoding="utf-8", newline="") as out:
        writer = csv.writer(_PlainEnds(out))
        writer.writerow(map(_inert, header))
        writer.writerows(map(_inert, row) for row in rows)


def _inert(cell: object) -> object:
    """Return a cell that a spreadsheet shows as it is."""
    if isinstance(cell, str) and _FORMULA.match(cell) and not _is_number(cell):
        return f"'{cell}"
    return cell


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return "_" not in cell


class _PlainEnds:
    """Replaces the line ending of each row; with LF set in csv itself, it would not quote CR."""

    def __init__(self, out: TextIO) -> None:
        self.out = out

    def write(self, row: str) -> int:
        """Write one row."""
        return self.out.write(row.removesuffix("\r\n") + "\n")


def numbers(name: str, cells: Sequence[str], rows: Sequence[int], path: Path) -> np.ndarray:
    """Parse finite numbers."""
    try:
        values = np.fromiter(map(float, cells), float, len(cells))
        if np.isfinite(values).all() and "_" not in "".join(cells):
            return values
    except ValueError:
        pass
    i = [_is_number(cell) and math.isfinite(float(cell)) for cell in cells].index(False)
    shown = _shown(cells[i], path)
    problem = "must be a finite number" + f", not{shown}" * bool(shown)
    raise InputError(problem if cells[i].strip() else "empty", path, rows[i], part=name)


def with_default(parse: Parser, default: float | str) -> Parser:
    """Return a parser that gives `default` for an empty cell."""

    def parse_given(name: str, cells: Sequence[str], rows: Sequence[int], path: Path) -> np.ndarray:
        given = [i for i, cell in enumerate(cells) if cell.strip()]
        values = np.full(len(cells), default, object if default == "" else float)
        values[given] = parse(name, [cells[i] for i in given], [rows[i] for i in given], path)
        return values

    return parse_given


numbers_or_nan = with_default(numbers, math.nan)


def identifiers(
    name: str, cells: Sequence[str], rows: Sequence[int], path: Path, may_be_empty: bool = False
) -> np.ndarray:
    """Parse ids: any printable text, without the white space around it.

    An apostrophe in front of ``=``, ``+``, ``-`` or ``@`` is removed; see `write_csv`.
    """
    clean = {cell: sys.intern(_original(cell.strip())) for cell in set(cells)}
    for cell, text in clean.items():
        if not is_identifier(text) and (text or not may_be_empty):
            problem = f"unprintable characters in{_shown(text, path)}" if text else "empty"
            raise InputError(problem, path, rows[cells.index(cell)], part=name)
    # Objects, not fixed-width text: one long id would widen every row.
    return np.array([clean[cell] for cell in cells], object)


def _original(text: str) -> str:
    """Return an id without the apostrophe that `write_csv` puts in front of a formula."""
    return text[1:] if text.startswith("'") and _FORMULA.match(text) else text


identifiers_or_empty = partial(identifiers, may_be_empty=True)


def is_identifier(text: str) -> bool:
    """Whether `text` is a valid id in a file: printable, without white space around it."""
    return bool(text) and text.isprintable() and text == text.strip()


def _shown(text: str, path: Path) -> str:
    """Return text of a file, quoted; empty for a link, whose target may be private."""
    return "" if path.is_symlink() else f" {quoted(text)}"


def quoted(text: str) -> str:
    """Quote and shorten untrusted text for a message."""
    return repr(text if len(text) <= 40 else text[:40] + "...")


@contextmanager
def text_lines(path: Path, encoding: str = "utf-8-sig") -> Iterator[Iterator[str]]:
    """Open a text file and iterate over its lines; an OSError becomes an InputError."""
    # Invalid UTF-8 becomes surrogates, so that the error can name the line.
    damaged = "replace" if encoding.startswith("utf-16") else "surrogateescape"
    options = {"encoding": encoding, "errors": damaged, "newline": ""}
    with naming(path, "cannot be read"), opened(path, "r", **options) as stream:
        yield _checked(stream, path)


def _checked(stream: IO[str], path: Path) -> Iterator[str]:
    """Yield the lines of a file; `InputError` for one that is too long or not UTF-8.

    Without null characters at their ends, which a power failure leaves.
    """
    for row in itertools.count(1):
        if not (read := stream.readline(MAX_LINE)):
            return
        if len(read) == MAX_LINE:
            raise InputError(f"a line of {MAX_LINE:,} characters or more", path, row)
        if not (line := read.strip("\0")):
            continue
        if not line.isascii() and _UNDECODABLE.search(line):
            raise InputError("not UTF-8 text", path, row)
        yield line


def _csv_records(lines: _Lines, path: Path, form: Form) -> Iterator[tuple[int, list[str]]]:
    """Yield (row, fields) of each line that is not blank."""
    reader = csv.reader(lines, delimiter=form.delimiter, skipinitialspace=True, strict=True)
    row = form.skip + 1
    try:
        for fields in reader:
            if len(fields) > 1 or (fields and fields[0].strip()):
                yield row, with_values(fields, form.arrays) if form.arrays else fields
            row = form.skip + reader.line_num + 1
    except csv.Error as error:
        is_open = str(error) == "unexpected end of data"
        if is_open and lines.is_cut and row == form.skip + reader.line_num:
            yield row, []
            return
        raise InputError(f"not CSV: {error}", path, row) from error


def array_in(cell: str) -> list[str]:
    """Return the values of an array in a cell, as ``[[1. 2. 3.]]``; empty for another cell."""
    return _VALUE.findall(cell) if cell.lstrip().startswith(("[", "(")) else []


def with_values(fields: list[str], arrays: Sequence[int]) -> list[str]:
    """Return the fields of a line, with those that are arrays of a known size as their values."""
    if len(fields) != len(arrays):
        return fields
    values = list[str]()
    for cell, size in zip(fields, arrays, strict=True):
        found = array_in(cell)
        values += [cell] * max(size, 1) if size == 0 or len(found) != size else found
    return values


def _column_indices(
    header: list[str], wanted: Mapping[str, Parser], path: Path, row: int
) -> dict[str, int]:
    """Return the indices of the wanted columns in the header."""
    indices: dict[str, list[int]] = {}
    for index, name in enumerate(header):
        indices.setdefault(name, []).append(index)
    for name in wanted:
        if len(indices.get(name, ())) > 1:
            raise InputError(f"the header has column {name} twice", path, row, advice="rename one")
    return {name: indices[name][0] for name in wanted if name in indices}


def _collect(
    records: Iterator[tuple[int, list[str]]],
    width: int,
    parsers: Mapping[str, tuple[int, Parser]],
    path: Path,
    lines: _Lines,
) -> Table:
    """Parse the records in chunks, so that only the numbers of a long file stay in memory."""
    parts: dict[str, list[np.ndarray]] = {
        name: [parse(name, (), (), path)] for name, (_, parse) in parsers.items()
    }
    all_rows = [np.empty(0, int)]
    while chunk := lines.whole(list(itertools.islice(records, CHUNK)), width, path):
        rows = [row for row, _ in chunk]
        for row, fields in chunk:
            if len(fields) != width:
                many = "s" * (len(fields) != 1)
                problem = f"{len(fields)} field{many}, but the header has {width}"
                raise InputError(problem, path, row, advice="remove or complete the row")
        cells = list(zip(*(fields for _, fields in chunk), strict=True))
        for name, (index, parse) in parsers.items():
            parts[name].append(parse(name, cells[index], rows, path))
        all_rows.append(np.array(rows))
    return Table(path, np.concatenate(all_rows), {n: np.concatenate(p) for n, p in parts.items()})
