"""The tables of a drive in imported files, recognised and converted to SI units."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from homeward.drives.folder import sorted_by_time
from homeward.drives.importers.columns import (
    KINDS,
    UNITS,
    Column,
    assigned,
    landmark_columns,
    landmark_in,
    long,
    matches,
    times_in,
    unit_of,
)
from homeward.drives.importers.positions import (
    POSITION_ROLES,
    Axes,
    bearings_of,
    formula,
    position_columns,
    with_axes,
)
from homeward.drives.importers.sheet import Sheet, names, number_parser, time_parser
from homeward.errors import InputError
from homeward.io.table import Parser, Table, read_csv
from homeward.odometry.limits import MAX_SPEED
from homeward.odometry.validity import TWIST_VALIDITY_S

UNIX_S = (1e9, 4.1e9)
"""Range of Unix time, from 2001 to 2099 [s]."""
RECOGNISED = {
    "odometry": "time, speed, yaw rate",
    "detections": "time, landmark id, bearing or position",
    "home bearings": "landmark id, bearing or position",
    "ground truth": "time, x, y, heading",
}
"""Descriptions of the tables of a drive and their columns; `KINDS` has the roles."""
MAX_SHOWN = 12
"""Maximum number of columns in an error message."""
TRUE_PATH = re.compile(r"truth|mocap|vicon|optitrack|(?<![a-z])gt(?![a-z])")
"""Matches the name of a file with ground-truth poses."""
INCOMPLETE = "incomplete rows of {}, left out"


@dataclass(frozen=True)
class ImportedColumn:
    """A recognised column, with its converted table."""

    kind: str
    """Odometry, bearings, home or truth."""
    table: Table
    """The whole table in SI units."""
    column: Column
    unit: str
    source: str
    """Source of the unit: specified, named, or guessed."""
    remarks: dict[str, int] = field(default_factory=dict)
    """Numbers of corrections of the table, by description."""

    @property
    def range(self) -> str:
        """Range of the values in SI units; for names, their number."""
        values = self.table[self.column.role]
        if self.column.quantity == "name":
            return f"{len(set(values.tolist()))} names"
        seen, digits = values[np.isfinite(values)], 12 if self.column.role == "t" else 6
        ends = f"{seen.min():.{digits}g} to {seen.max():.{digits}g}" if seen.size else ""
        return f"{ends} {self.column.si}" if ends else ""


@dataclass
class Part:
    """One kind of table in a file."""

    sheet: Sheet
    kind: str
    columns: dict[str, Column]
    """Columns by role."""
    wide: dict[str, str] = field(default_factory=dict)
    """Columns by landmark id, where each landmark has one."""
    is_alone: bool = True
    """Whether the file contains no other table."""
    axes: Axes | None = None
    """Axes of the positions from which bearings are computed; None: no positions."""

    def read(self, clock: str | None, angle: str | None = None) -> list[ImportedColumn]:
        """Read the table in SI units.

        `clock` and `angle` are the units of stamps and bearings where the file specifies none.
        """
        table, missing = (self._spread(), 0) if self.wide else self._plain()
        # Sigmas last: without a unit they have that of their bearings.
        self.columns = dict(sorted(self.columns.items(), key=lambda item: item[0] == "sigma"))
        values, units = dict(table.columns), dict[str, tuple[str, str]]()
        for role, column in self.columns.items():
            units[role] = "", "unchanged"
            if role == "sigma":  # the same program writes bearings and sigmas
                angle = units["bearing"][0]
            if column.quantity != "name":
                unit, _ = units[role] = _unit(table, column, clock, angle)
                values[role] = column.sign * UNITS[column.quantity][unit] * values[role]
        remarks: dict[str, int] = {}
        columns = dict(self.columns)
        if self.axes:
            for role in set(POSITION_ROLES).intersection(units):
                units[role] = units[role][0], self.axes.name
            values["bearing"] = bearings_of(values)
            columns["bearing"] = Column("bearing", formula(columns), "rad")
            units["bearing"] = "rad", self.axes.reason
        ordered = dataclasses.replace(table, columns=values)
        if "t" in values:
            ordered = sorted_by_time(ordered, self.kind, remarks)
        if missing:
            remarks[INCOMPLETE.format(self.kind)] = missing
        return [
            ImportedColumn(
                self.kind,
                ordered,
                column,
                unit,
                "specified" if column.is_specified else source,
                remarks,
            )
            for (unit, source), column in zip(units.values(), columns.values(), strict=True)
        ]

    def _plain(self) -> tuple[Table, int]:
        """Read a table with a row for each sample; return it with the number of incomplete rows."""
        raw = self._raw()
        values = {role: _value(raw, column) for role, column in self.columns.items()}
        needed = [role for role in self.columns if role != "sigma"]
        if self.axes:  # programs write zeros for landmarks out of view
            values["forward"] = np.where(np.isnan(bearings_of(values)), np.nan, values["forward"])
        given = np.stack([_has_value(values[role]) for role in needed])
        complete, partial = given.all(axis=0), given.any(axis=0)
        if partial.any() and not complete.any():
            raise InputError(f"no row has values for all of {', '.join(needed)}", raw.file)
        kept = {role: column[complete] for role, column in values.items()}
        # In a file with several tables, each has its own rows.
        missing = int((partial & ~complete).sum()) if self.is_alone else 0
        return Table(raw.file, raw.row[complete], kept), missing

    def _spread(self) -> Table:
        """Read a table with a column for each landmark."""
        raw, t = self._raw(), self.columns.get("t")
        return long(raw, self.wide, None if t is None else _value(raw, t))

    def _raw(self) -> Table:
        comma = self.sheet.decimal_comma
        kinds = {"name": names, "time": time_parser(comma)}
        parsers: dict[str, Parser] = dict.fromkeys(self.wide.values(), number_parser(comma))
        for column in self.columns.values():
            if not (self.wide and column.role in ("landmark", "bearing")):
                parser = kinds.get(column.quantity, number_parser(comma))
                parsers |= dict.fromkeys((column.name, *column.more), parser)
        return read_csv(self.sheet.path, parsers, form=self.sheet.form)


def parts_of(sheets: Sequence[Sheet], specified: Sequence[Column]) -> list[Part]:
    """Return the tables of a drive in files, at least one in each."""
    parts, others = list[Part](), list[Sheet]()
    for one in sheets:
        mine = one.specified(specified)
        kinds = _kinds_of(one, mine)
        parts += [Part(one, kind, found) for kind, found in kinds.items() if found]
        if not kinds.get("bearings") and not kinds.get("home"):
            others.append(one)
    ids = _landmark_ids(parts, others)
    for one in others:
        # The number of a column is no landmark id, although ids may be numbers.
        across = {} if one.headless else landmark_columns(one.names, ids)
        t = times_in(one.names, one.specified(specified))
        if across and (t is not None or one.one_row):
            parts.append(_wide_part(one, across, t))
        elif all(part.sheet is not one for part in parts):
            raise InputError(_not_recognised(one), one.path)
    _find_odometry(parts)
    _find_axes(parts)
    return parts


def _kinds_of(one: Sheet, mine: Sequence[Column]) -> dict[str, dict[str, Column] | None]:
    """Return the columns of each kind of table in a file, but those of wide tables."""

    def kinds(*kinds: str) -> dict[str, dict[str, Column] | None]:
        return {
            kind: assigned(KINDS[kind], one.names, mine, ("sigma",) * ("bearing" in KINDS[kind]))
            for kind in kinds
        }

    if any(c.role in POSITION_ROLES and c.name in one.names for c in mine):
        return kinds("odometry") | _positions(one, mine)
    found = kinds("odometry", "bearings")
    if found["bearings"]:
        _refuse_headings(one, found["bearings"]["bearing"], mine)
    if any(found.values()):  # poses along with twists belong to the odometry
        return found
    found = kinds("truth", "home")
    if found["home"] or (found["truth"] and not _has_landmarks(one, mine)):
        return found
    return _positions(one, mine) or found


def _refuse_headings(one: Sheet, bearing: Column, mine: Sequence[Column]) -> None:
    """Refuse a bearing such as theta along with a position: it may be the landmark's heading."""
    if bearing.is_specified or not matches(bearing.name, "heading"):
        return
    if _unambiguous_positions(one, mine):
        problem = (
            f"{bearing.name!r} may be the bearing or the heading of a landmark with a position"
        )
        roles = f"'bearing={bearing.name}', or forward and left (or right) of the position"
        raise InputError(f"{problem}; use --columns {roles}", one.path)


def _positions(one: Sheet, mine: Sequence[Column]) -> dict[str, dict[str, Column] | None]:
    """Return the columns of positions of landmarks, by kind of table."""
    for kind in ("bearings", "home"):
        if found := position_columns(kind, one.names, mine):
            return {kind: found}
    return {}


def _unambiguous_positions(
    one: Sheet, mine: Sequence[Column]
) -> dict[str, dict[str, Column] | None]:
    """Return `_positions`, but nothing where two columns match the same role."""
    try:
        return _positions(one, mine)
    except InputError:
        return {}


def _has_landmarks(one: Sheet, mine: Sequence[Column]) -> bool:
    """Whether poses are those of landmarks: several ids, each with several poses."""
    name = one.path.name.lower()
    if TRUE_PATH.search(name) or "odom" in name:
        return False
    columns = _unambiguous_positions(one, mine).get("bearings")
    if columns is None:
        return False
    ids = read_csv(one.path, {columns["landmark"].name: names}, form=one.form)
    return 1 < len(set(ids[columns["landmark"].name])) < len(ids)


def _find_axes(parts: Sequence[Part]) -> None:
    """Find the axes of positions, those of the drive before those of home."""
    axes = None
    for part in sorted(parts, key=lambda part: part.kind):
        if part.kind in ("bearings", "home") and not part.wide and "bearing" not in part.columns:
            part.columns, part.axes = with_axes(part.sheet, part.kind, part.columns, axes)
            axes = part.axes


def _not_recognised(one: Sheet) -> str:
    """Return the message for a table that is no part of a drive."""
    names, file = one.names, f"{one.path.name}: " if one.headless else ""
    *most, last = (f"{words} ({needs})" for words, needs in RECOGNISED.items())
    shown = ", ".join(map(repr, names[:MAX_SHOWN]))
    more = f", ... ({len(names):,} in all)" if len(names) > MAX_SHOWN else ""
    return (
        f"not recognised as {', '.join(most)} or {last}. Its columns are {shown}{more}: give their "
        f"roles, as in --columns '{file}t={names[0]}'"
    )


def _find_odometry(parts: Sequence[Part]) -> None:
    """Use poses as odometry where no table has twists: from a file named odom, or the only one."""
    if any(part.kind == "odometry" for part in parts):
        return
    poses = [part for part in parts if part.kind == "truth"]
    for part in poses:
        name = part.sheet.path.name.lower()
        if "odom" in name or (len(poses) == 1 and not TRUE_PATH.search(name)):
            part.kind = "odometry"


def _landmark_ids(parts: Sequence[Part], others: Sequence[Sheet]) -> set[str]:
    """Return the known landmark ids, where a table may have a column for each."""
    known: set[str] = set()
    for part in parts if others else ():
        if part.kind == "home":
            known |= set(part.read(None)[0].table["landmark"].tolist())
    for one in others:
        if one.one_row and not one.headless and times_in(one.names, ()) is None:
            known |= {landmark_in(name)[0] for name in one.names}
    return known


def _wide_part(one: Sheet, across: dict[str, str], t: Column | None) -> Part:
    first, *_, last = across.values()
    span = f"{first} ... {last}"
    columns = {"landmark": Column("landmark", span)}
    columns["bearing"] = Column("bearing", span, unit_of(list(across.values())))
    kind = "home" if t is None else "bearings"
    return Part(one, kind, columns if t is None else {"t": t, **columns}, across)


def _value(raw: Table, column: Column) -> np.ndarray:
    """Return the values of a column, combined with those in `more`, in its own unit."""
    if column.role == "t" and column.more:
        return np.asarray(raw[column.name] + 1e-9 * raw[column.more[0]])
    if column.role == "heading" and column.more:
        w, (z, x, y) = raw[column.name], (raw[name] for name in column.more)
        return np.asarray(np.arctan2(2 * (w * z + x * y), w * w + x * x - y * y - z * z))
    return raw[column.name]


def _unit(table: Table, column: Column, clock: str | None, angle: str | None) -> tuple[str, str]:
    """Return the unit of a column and its source; `InputError` where a guess would be unsafe."""
    values = np.abs(table[column.role][np.isfinite(table[column.role])])
    largest = float(values.max(initial=0.0))
    if column.unit is not None:
        return column.unit, "named"
    if column.quantity == "time":
        # Two programs may write the stamps of one clock in different units.
        own = _unix_unit(table["t"])
        return (
            (clock, "as odometry") if clock and not own else (own or _clock(table["t"]), "guessed")
        )
    if column.role == "sigma" and angle:
        return angle, "as bearing"
    if column.quantity in ("angle", "rate") and largest > 1.01 * math.tau:
        return column.si.replace("rad", "deg"), "guessed: more than a turn"
    if column.role == "bearing" and angle:
        return angle, "as bearings"
    if column.quantity == "speed" and largest > MAX_SPEED:
        raise InputError(
            f"{column.name!r} reaches {largest:.6g}, too fast for m/s; give its unit, as in "
            f"--columns '{column.role}={column.name}[mm/s]'",
            table.file,
        )
    return column.si, "guessed"


def _unix_unit(t: np.ndarray) -> str | None:
    """Return the unit in which stamps are Unix time; None if there is none."""
    middle = float(np.median(t)) if t.size else 0.0
    units = UNITS["time"].items()
    return next((u for u, s in units if UNIX_S[0] <= middle * s < UNIX_S[1]), None)


def _clock(t: np.ndarray) -> str:
    """Return the largest unit of stamps in which twists arrive at least once a second."""
    steps = np.diff(np.unique(t))
    step = float(np.median(steps)) if steps.size else 0.0
    return next(
        (unit for unit, seconds in UNITS["time"].items() if step * seconds <= TWIST_VALIDITY_S), "s"
    )


def _has_value(values: np.ndarray) -> np.ndarray:
    """Return which cells have a value, shape (n,)."""
    return np.asarray(values != "" if values.dtype == object else np.isfinite(values))
