"""Layout of a table in a text file: encoding, separator, header, units, cells."""

from __future__ import annotations

import codecs
import csv
import itertools
import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np

from homeward.drives.columns import Column, is_unit, value_of
from homeward.errors import InputError
from homeward.io.reading import naming, opened
from homeward.io.table import (
    Form,
    Parser,
    Table,
    array_in,
    identifiers,
    numbers_or_nan,
    quoted,
    read_csv,
    text_lines,
    with_values,
)

STAMP = ("stamp.sec", "stamp.nanosec", "frame")
XYZ, XYZW = "xyz", "xyzw"
POSE = (*(f"position.{a}" for a in XYZ), *(f"orientation.{a}" for a in XYZW))
TWIST = (*(f"linear.{a}" for a in XYZ), *(f"angular.{a}" for a in XYZ))
COVARIANCE = tuple(f"covariance.{k}" for k in range(36))
IMU = (
    *(*POSE[3:], *COVARIANCE[:9], *(f"angular_velocity.{a}" for a in XYZ), *COVARIANCE[:9]),
    *(*(f"linear_acceleration.{a}" for a in XYZ), *COVARIANCE[:9]),
)
STEERING = ("steering_angle", "steering_angle_velocity", "speed", "acceleration", "jerk")
TUM = ("t", "x", "y", "z", *(f"q{a}" for a in XYZW))
"""The columns of a TUM trajectory, as written by evo."""
ECHOED = {
    len(names): names
    for names in (
        (*STAMP, "child_frame", *POSE, *COVARIANCE, *TWIST, *COVARIANCE),  # nav_msgs/Odometry
        (*STAMP, *POSE),
        (*STAMP, *POSE, *COVARIANCE),
        (*STAMP, *TWIST),
        (*STAMP, *TWIST, *COVARIANCE),
        (*STAMP, *IMU),
        (*STAMP, *STEERING),  # ackermann_msgs/AckermannDriveStamped
    )
}
"""The columns of stamped messages in ``ros2 topic echo --csv``, by their number."""
CORNERS = tuple(f"{axis}{k}" for k in range(4) for axis in "xy")
ENDS: Mapping[int, Sequence[str]] = {2: "xy", 3: XYZ}
"""Names of the values of an array of a tag's corners, and of others by their number."""
UNIT_NORM = 0.01
"""Maximum deviation of a quaternion's norm from 1; two digits in a file cause half of it."""
JSON = (
    "write it as CSV with a row for each detection, as with pandas.json_normalize(json.load(open("
    "FILE)), 'detections', 'timestamp').to_csv('detections.csv'), or add a source "
    "(docs/do/sources.md)"
)
EXPORT, UNPACK = "export it as CSV", "unpack it"
FORMATS = (
    ((b"PK\x03\x04",), "a spreadsheet or zip archive", "export it as CSV, or unpack it"),
    ((b"\xd0\xcf\x11\xe0",), "a spreadsheet", EXPORT),
    ((b"\x1f\x8b", b"\x28\xb5\x2f\xfd", b"BZh", b"\xfd7zXZ"), "a compressed file", UNPACK),
    ((b"\x93NUMPY",), "a numpy array", "write it as CSV with numpy.savetxt"),
    (tuple(bytes([0x80, n]) for n in range(2, 6)), "a Python pickle", EXPORT),
    ((b"\x89HDF", b"MATLAB"), "a MATLAB or HDF5 file", "export it as CSV, as with writetable"),
    ((b"PAR1", b"ARROW1"), "a Parquet or Arrow file", EXPORT),
    ((b"\x89PNG", b"\xff\xd8\xff"), "an image", "use `homeward see` on a folder of images"),
    ((b"%PDF",), "a PDF", "give the table that it shows as CSV"),
    ((b"versionhttps://git-lfs",), "a pointer of Git LFS", "fetch the file with `git lfs pull`"),
    ((b"<!DOCTYPE", b"<html", b"<?xml"), "a web page or XML", "download the file itself as CSV"),
    (
        (b'{"tags":[{"ID"', b'{"field":{'),
        "a field layout of WPILib",
        "copy it to landmarks.yaml in the drive folder",
    ),
    (
        (b"header:stamp:", b"---header:stamp:"),
        "the output of `ros2 topic echo`",
        "use `ros2 topic echo --csv`, or record a bag",
    ),
    ((b'{"', b"[{", b"[["), "JSON", JSON),
)
"""First bytes, also without white space; description and advice."""


def layout(rows: Sequence[Sequence[str]]) -> tuple[str, ...] | None:
    """Return the names of the columns of a table without a header; None for an unknown layout."""
    width = len(rows[0])
    if width == len(TUM) and all(map(_is_tum, rows)):
        return TUM
    if not all(map(_is_stamped, rows)):
        return None
    return ECHOED.get(width) or _joint_states(rows)


def _is_tum(cells: Sequence[str]) -> bool:
    """Whether a row is numeric and ends in a unit quaternion."""
    try:
        numbers = [float(cell) for cell in cells]
    except ValueError:
        return False
    return len(numbers) == len(TUM) and abs(math.hypot(*numbers[4:]) - 1.0) <= UNIT_NORM


def _is_stamped(cells: Sequence[str]) -> bool:
    """Whether a row begins with seconds, nanoseconds and the name of a frame."""
    if len(cells) < min(ECHOED):
        return False
    seconds, nanoseconds, frame = (cell.strip() for cell in cells[:3])
    whole = seconds.isdecimal() and nanoseconds.isdecimal()
    return whole and int(nanoseconds) < 10**9 and not frame.replace(".", "").isdecimal()


def _joint_states(rows: Sequence[Sequence[str]]) -> tuple[str, ...] | None:
    """Return the columns of sensor_msgs/JointState: names, positions, velocities and efforts."""
    joints = list(itertools.takewhile(lambda cell: not is_number(cell, False), rows[0][3:]))
    values, rest = divmod(len(rows[0]) - 3, max(len(joints), 1))
    if rest or values not in (2, 3, 4) or any(row[3 : 3 + len(joints)] != joints for row in rows):
        return None
    kinds = ("position", "velocity", "effort")[: values - 1]
    return *STAMP, *[""] * len(joints), *(f"{joint}.{kind}" for kind in kinds for joint in joints)


EMPTY = (
    *("", "-", "--", "?", "na", "n/a", "nan", "-nan", "null", "none", "<na>", "<null>"),
    *("#n/a", "#num!", "#div/0!", "#value!", "#ref!"),
    *("nan(ind)", "-nan(ind)", "1.#qnan", "-1.#ind"),
)
"""Notations of a missing value."""
THOUSANDS = re.compile(r"-?[1-9]\d{0,2}(\.\d{3})+")
DATE = re.compile(
    r"\s*(\d{4}[-/]\d\d[-/]\d\d|\d\d[./]\d\d[./]\d{4})[ T]\d\d:\d\d|\s*\d\d:\d\d:\d\d([.,]\d+)?\s*$"
)
"""A date with a time of day, or a time of day."""
DAY = re.compile(r"(\d\d)([./])(\d\d)\2(\d{4})")
"""Day, month and year; between slashes, the month may be first."""

_WHOLE, _ID = re.compile(r"^(\d+)\.0+$"), re.compile(r"\s*\d+\s*")
MIN_IDS = 3
"""Number of landmarks that a pose needs."""


def times(
    name: str, cells: Sequence[str], rows: Sequence[int], path: Path, parse: Parser
) -> np.ndarray:
    """Parse times: numbers, which `parse` reads, or dates with a time of day as Unix time [s]."""
    if any(":" in cell for cell in cells):
        cells = [
            "" if cell.strip().lower() in EMPTY else _unix(cell, name, row, path)
            for cell, row in zip(cells, rows, strict=True)
        ]
    return parse(name, cells, rows, path)


def _texts(name: str, cells: Sequence[str], rows: Sequence[int], path: Path) -> np.ndarray:
    """Return cells as they are."""
    return np.array([cell.strip() for cell in cells], object)


def names(name: str, cells: Sequence[str], rows: Sequence[int], path: Path) -> np.ndarray:
    """Parse ids, which may be missing; 3.0 becomes 3, since programs write ids as numbers."""
    values = np.full(len(cells), "", object)
    there = [k for k, cell in enumerate(cells) if cell.strip().lower() not in EMPTY]
    plain = [_WHOLE.sub(r"\1", cells[k].strip()) for k in there]
    values[there] = identifiers(name, plain, [rows[k] for k in there], path)
    return values


def is_number(cell: str, comma: bool) -> bool:
    """Whether a cell is a number, with a decimal comma if `comma`."""
    try:
        float(cell.replace(",", ".") if comma else cell)
    except ValueError:
        return bool(DATE.match(cell))
    return True


def _number(name: str, cells: Sequence[str], rows: Sequence[int], path: Path) -> np.ndarray:
    plain = ["" if cell.strip().lower() in EMPTY else cell for cell in cells]
    return numbers_or_nan(name, plain, rows, path)


def _decimal(name: str, cells: Sequence[str], rows: Sequence[int], path: Path) -> np.ndarray:
    for cell, row in zip(cells, rows, strict=True):
        if THOUSANDS.fullmatch(cell.strip()):
            problem = f"{quoted(cell)} has a point, but other numbers have a decimal comma"
            raise InputError(problem, path, row, part=name, advice="remove thousands separators")
    plain = [c.replace(".", "").replace(",", ".") if "," in c else c for c in cells]
    return _number(name, plain, rows, path)


def _unix(cell: str, name: str, row: int, path: Path) -> str:
    """Return a date and time of day as Unix time [s]; UTC without a time zone."""
    text = cell.strip().replace(",", ".")
    if day := DAY.match(text):
        d, mark, m, year = day.groups()
        if mark == "/" and max(d, m) <= "12" and d != m:
            problem = f"{quoted(cell)} may have the day or the month first"
            raise InputError(problem, path, row, part=name, advice="write 2026-11-23")
        d, m = (m, d) if mark == "/" and m > "12" else (d, m)
        text = f"{year}-{m}-{d}{text[day.end() :]}"
    try:
        time = datetime.fromisoformat(
            f"1970-01-01 {text}" if text[2:3] == ":" else text.replace("/", "-")
        )
    except ValueError as error:
        problem = f"must be a number or a time like 2026-11-23 12:00:00.5, not {quoted(cell)}"
        raise InputError(problem, path, row, part=name) from error
    return repr((time if time.tzinfo else time.replace(tzinfo=UTC)).timestamp())


DELIMITERS = ("\t", ";", "|", ",", " ")
"""In this order: where semicolons separate fields, commas are decimal commas."""
COMMENTS = ("#", "%")
_SEPARATOR = re.compile(r"\"?sep=.\"?\s*$")
"""First line that some programs write for spreadsheets."""
MAX_COLUMNS = 10_000
"""Maximum number of columns: the widest tables have a column for each landmark."""
NUM_SAMPLED = 50
"""Number of lines from which the layout is detected."""


@dataclass(frozen=True)
class Sheet:
    """A text file with a table."""

    path: Path
    form: Form
    decimal_comma: bool
    one_row: bool
    """Whether there is a single row below the header."""
    headless: bool = False
    """Whether there is no header, so that columns have numbers."""
    lists: tuple[str, ...] = ()
    """Columns with lists of different lengths in their cells."""
    remarks: dict[str, int] = field(default_factory=dict, compare=False)
    """Numbers of rows that are left out, by description, once it is read."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the columns; without a header 1, 2, 3, ... unless the layout is known."""
        assert self.form.names is not None
        return self.form.names

    @property
    def numbers(self) -> dict[str, str]:
        """Names of the columns by number, in a file without a header."""
        return {str(k): name for k, name in enumerate(self.names, 1)} if self.headless else {}

    def values(self, columns: Mapping[str, Column]) -> Table:
        """Read columns, combined with their `more`, in their own units, by the same keys.

        A column without a name, that of landmarks without ids, is empty.
        """
        numbers = _decimal if self.decimal_comma else _number
        kinds: dict[str, Parser] = {"name": names, "time": partial(times, parse=numbers)}
        parsers: dict[str, Parser] = {
            name: kinds.get(column.quantity, numbers)
            for column in columns.values()
            for name in (column.name, *column.more)
            if name
        }
        days = [column for column in columns.values() if column.join == "day"]
        parsers |= {name: _texts for day in days for name in (day.name, *day.more)}
        raw = read_csv(self.path, parsers, form=self.form, remarks=self.remarks)
        for day in days:
            texts = [" ".join(cells) for cells in zip(raw[day.name], raw[day.more[0]], strict=True)]
            t = kinds["time"](day.signed_name, texts, raw.row.tolist(), self.path)
            raw = replace(raw, columns={**raw.columns, day.name: t})
        empty = np.full(len(raw), "", object)
        values = {key: value_of(raw, c) if c.name else empty for key, c in columns.items()}
        return replace(raw, columns=values)

    def specified(self, columns: Sequence[Column]) -> list[Column]:
        """Return the specified `columns` of this file, with the names in it."""
        own = (c for c in columns if c.file in (None, self.path.name))
        return [replace(c, name=self.numbers.get(c.name, c.name)) for c in own]


def sheet(path: Path) -> Sheet:
    """Detect the layout of a text file; `InputError` where it is empty or no table."""
    encoding = _encoding(path)
    with text_lines(path, encoding) as lines:
        first = list(itertools.islice(lines, NUM_SAMPLED))
    filled = [line for line in first if line.strip() and not _SEPARATOR.match(line)]
    before = list(itertools.takewhile(lambda line: line.lstrip().startswith(COMMENTS), filled))
    rows = filled[len(before) :]
    if not rows:
        raise InputError("empty file", path)
    delimiter, width = _delimiter(rows, path)
    if width > MAX_COLUMNS:
        raise InputError(f"{width:,} columns; at most {MAX_COLUMNS:,} are allowed", path)
    # A title may precede the table, and rows may end with a separator that the header lacks.
    rows = _without_titles(rows, delimiter, width)
    head, *body = (_fields(line, delimiter) for line in rows)
    skip = first.index(rows[0])
    numbered = any(is_number(cell, delimiter != ",") for cell in head) and not _is_header(
        head, body, delimiter != ","
    )
    # ROS and MATLAB write the header as a comment.
    comment = before[-1].strip().lstrip("".join(COMMENTS)).strip() if before else ""
    # Names may have single spaces where several spaces or tabs separate them.
    by_gaps = re.split(r"\s{2,}|\t", comment)
    above = by_gaps if len(by_gaps) == len(head) else _fields(comment, delimiter)
    if not numbered:
        names, skip = head, skip + 1
        second = [cell for cell in body[0] if cell.strip().lower() not in EMPTY] if body else []
        if second and all(map(is_unit, second)):
            units = [cell.strip("[]()<> ") if is_unit(cell) else "" for cell in body.pop(0)]
            names = [f"{n} [{unit}]" if unit else n for n, unit in zip(names, units, strict=False)]
            skip = first.index(rows[1]) + 1
    else:
        body = [head, *body]
        numbers = [str(k + 1) for k in range(len(head))]
        names = above if len(above) == len(head) else list(layout(body) or numbers)
    if not body:
        raise InputError("a header without rows", path)
    names = [*names, *[""] * (width - len(names))]
    if "" in names and all(len(row) == width and DATE.match(row[names.index("")]) for row in body):
        names[names.index("")] = "time"  # an index of times, as pandas writes it
    arrays = _arrays(body, width)
    lists = tuple(
        name
        for k, (name, size) in enumerate(zip(names, arrays, strict=False))
        if not size and any(len(array_in(row[k])) > 1 for row in body if len(row) == width)
    )
    if any(arrays):
        body = [with_values(row, arrays) for row in body]
        names = [part for name, n in zip(names, arrays, strict=True) for part in _parts(name, n)]
    cells = [cell for row in body for cell in row]
    comma = delimiter != "," and any("," in cell and is_number(cell, True) for cell in cells)
    sizes = arrays if any(arrays) else ()
    form = Form(delimiter, tuple(name.strip() for name in names), skip, encoding, sizes)
    return Sheet(path, form, comma, len(body) == 1, numbered and len(above) != len(head), lists)


def _arrays(body: Sequence[Sequence[str]], width: int) -> tuple[int, ...]:
    """Return the number of values in the cells of each column; 0 where they are no arrays."""
    rows = [row for row in body if len(row) == width]
    sizes = [
        {len(array_in(cell)) for cell in column if cell.strip().lower() not in EMPTY}
        for column in zip(*rows, strict=True)
    ]
    return tuple(max(found) if len(found) == 1 and max(found) > 1 else 0 for found in sizes)


def _parts(name: str, size: int) -> list[str]:
    """Return the names of the values of an array, before the unit; the name if it is none."""
    if not size:
        return [name]
    plain = re.split(r"\s*[\[(<]", name.strip(), maxsplit=1)[0]
    unit = name.strip().removeprefix(plain)
    is_tag = size == len(CORNERS) and "corner" in plain.lower()
    ends = CORNERS if is_tag else ENDS.get(size, range(size))
    return [f"{plain}_{end}{unit}" for end in ends]


def _encoding(path: Path) -> str:
    """Return the encoding of a file: UTF-16 with a byte order mark, else UTF-8 or Windows-1252."""
    with naming(path, "cannot be read"), opened(path) as stream:
        begin = stream.read(2**16)
    if begin.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "utf-16"
    if all(begin[:64:2]) and begin[1:2] == b"\0" and not any(begin[1:64:2]):
        return "utf-16-le"
    _refuse_other_formats(begin, path)
    try:
        codecs.getincrementaldecoder("utf-8")().decode(begin)
    except UnicodeDecodeError:
        return "cp1252"
    return "utf-8-sig"


def _refuse_other_formats(begin: bytes, path: Path) -> None:
    """Raise `InputError` with advice where a file that begins so has a format of no text table."""
    plain = b"".join(begin[:64].split())
    for starts, what, advice in FORMATS:
        if begin.startswith(starts) or plain.startswith(starts):
            raise InputError(f"{what}, not a text table", path, advice=advice)
    if b"\0" in begin.strip(b"\0"):  # a power failure leaves them at the end
        advice = "export its data as a CSV file"
        raise InputError("a binary file, not a text table", path, advice=advice)


def _delimiter(rows: Sequence[str], path: Path) -> tuple[str, int]:
    """Return the separator that gives most lines the same number of fields, and that number."""
    for delimiter in DELIMITERS:
        sizes = Counter(len(_fields(row, delimiter)) for row in rows)
        width, lines = max(sizes.items(), key=lambda item: (item[1], item[0]))
        if width > 1 and 2 * lines >= len(rows):
            return delimiter, width
    problem = "not a table: no separator gives the same number of columns in most lines"
    raise InputError(problem, path)


def _without_titles(rows: list[str], delimiter: str, width: int) -> list[str]:
    """Return the rows of the table; its header may lack the last, empty field."""
    fields = [_fields(row, delimiter) for row in rows]
    for k, (one, after) in enumerate(pairwise([*fields, []])):
        ends_empty = len(after) == width and not after[-1]
        if len(one) == width or (len(one) == width - 1 and ends_empty):
            return rows[k:]
    return rows


def _is_header(head: Sequence[str], body: Sequence[Sequence[str]], comma: bool) -> bool:
    """Whether a line has a word above a column of numbers; then its numbers are names, too."""
    for word, *cells in zip(head, *(row for row in body if len(row) == len(head)), strict=True):
        filled = [cell for cell in cells if cell.strip().lower() not in EMPTY]
        is_word = word.strip().lower() not in EMPTY and not is_number(word, comma)
        if is_word and filled and all(is_number(cell, comma) for cell in filled):
            return True
    # Ids above the bearings of one pose.
    ids = all(map(_ID.fullmatch, head)) and len(set(head)) == len(head) >= MIN_IDS
    return ids and len(body) == 1 and not any(map(_ID.fullmatch, body[0]))


def _fields(line: str, delimiter: str) -> list[str]:
    try:
        reader = csv.reader([line], delimiter=delimiter, skipinitialspace=True, strict=True)
        return next(reader, [])
    except csv.Error:  # reading the file reports the error
        return []
