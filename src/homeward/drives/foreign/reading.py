"""A drive from tables that others wrote, and what was understood of them."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from homeward.drives.drive import Drive, DriveSettings, HomeWhen
from homeward.drives.folder import home_of, odometry_of, sightings_of, truth_of
from homeward.drives.foreign.columns import KINDS, UNITS, Column, assigned, told_columns
from homeward.drives.foreign.sheet import Sheet, sheet
from homeward.drives.home.choosing import with_home
from homeward.drives.one_clock import on_one_clock
from homeward.drives.text.settings import validated
from homeward.drives.text.table import Parser, Table, identifiers, numbers_or_nothing, read_csv
from homeward.errors import InputError
from homeward.estimator import HOLD_S

FASTEST = 10.0
"""No robot of ours drives so fast [m/s]; a number above it is of another unit."""
UNIX_S = (1e9, 4.1e9)
"""Clocks that count from 1970 are between these, from 2001 to 2099 [s]."""


@dataclass(frozen=True)
class Understood:
    """What a column was taken for."""

    kind: str
    """Odometry, bearings, home or truth."""
    table: Table
    """Of its file, in SI units."""
    column: Column
    unit: str
    how: str
    """Whether that was told, named, or guessed."""

    @property
    def range(self) -> str:
        """From where to where it goes, in SI units; for names, how many."""
        values = self.table[self.column.role]
        if self.column.quantity == "name":
            return f"{len(set(values.tolist()))} names"
        seen = values[np.isfinite(values)]
        return f"{seen.min():.6g} to {seen.max():.6g} {self.column.si}" if seen.size else ""


def understand(files: Sequence[Path], columns: Sequence[str] = ()) -> list[Understood]:
    """Find out what the columns of text files are, and read them.

    Parameters
    ----------
    files : sequence of path
        Tables with whatever separator, decimal mark, header and units.
    columns : sequence of str
        ``ROLE=COLUMN[UNIT]``, of what names do not say, or say wrongly.

    Raises
    ------
    InputError
        When a file cannot be read, is no part of a drive, or a column may be several things.
    """
    sheets = [sheet(path) for path in files]
    told = told_columns(columns, {name for one in sheets for name in one.names})
    parts = {(one.path, kind): found for one in sheets for kind, found in _kinds(one, told)}
    found: list[Understood] = []
    clock: str | None = None
    # Odometry first: it comes often, so that its stamps tell their unit.
    for kind in KINDS:
        mine = [one for one in sheets if (one.path, kind) in parts]
        for extra in mine[1:]:
            raise InputError(f"a second file with {kind}; one is enough", extra.path)
        for one in mine:
            alone = sum(path == one.path for path, _ in parts) == 1
            found += _read(one, kind, parts[one.path, kind], clock, alone)
            clock = clock or next((u.unit for u in found if u.column.role == "t"), None)
    return found


def drive_of(
    found: Sequence[Understood], name: str, home_spin: tuple[float, float] | None = None
) -> Drive:
    """Return the drive that tables make, its home as in `open_drive`.

    Raises
    ------
    InputError
        When a part is missing, or what a drive cannot be; it names file and row.
    """
    tables = {one.kind: one.table for one in found}
    for kind in ("odometry", "bearings", "home")[: 3 if home_spin is None else 2]:
        if kind not in tables:
            needs = ", ".join(KINDS[kind])
            raise InputError(f"nothing tells {kind}: no file has {needs}; --columns may say so")
    start = float(np.min(tables["odometry"]["t"], initial=math.inf))
    epoch = math.floor(start) if UNIX_S[0] <= start < UNIX_S[1] else 0
    for kind, table in tables.items():
        if "t" in table.columns:
            columns = {**table.columns, "t": table["t"] - epoch}
            tables[kind] = dataclasses.replace(table, columns=columns)
    remarks: dict[str, int] = {}
    drive = Drive(
        name=name,
        odometry=odometry_of(tables["odometry"], remarks),
        sightings=sightings_of(tables["bearings"], remarks),
        home=home_of(tables["home"], remarks) if "home" in tables else {},
        settings=DriveSettings(epoch=epoch) if epoch else DriveSettings(),
        truth=truth_of(tables["truth"], remarks) if "truth" in tables else None,
        remarks=remarks,
    )
    drive = on_one_clock(drive, tables["bearings"].file)
    if home_spin is None:
        return drive
    return with_home(drive, validated(HomeWhen, {"spin": home_spin}))


def _kinds(one: Sheet, told: Sequence[Column]) -> list[tuple[str, dict[str, Column]]]:
    """Return what a file holds of a drive, with its columns by role: at least one kind."""
    parts = {kind: assigned(kind, one.names, told) for kind in ("odometry", "bearings")}
    if not any(parts.values()):  # poses beside twists are the odometry's own
        parts = {kind: assigned(kind, one.names, told) for kind in ("truth", "home")}
    if made := [(kind, found) for kind, found in parts.items() if found]:
        return made
    needs = "; ".join(", ".join(roles) for roles in KINDS.values())
    raise InputError(
        f"its columns {', '.join(map(repr, one.names[:12]))} are none of: {needs}. "
        f"Say which is which, as in --columns 't={one.names[0]}'",
        one.path,
    )


def _read(
    one: Sheet, kind: str, parts: dict[str, Column], clock: str | None, alone: bool
) -> list[Understood]:
    """Read one kind of table of a file, in SI units.

    Where it is not `alone` in its file, rows that have not all of it are of the other kind.
    """
    number = _decimal if one.decimal_comma else _number
    parsers: dict[str, Parser] = {
        c.name: _names if c.quantity == "name" else number for c in parts.values()
    }
    raw = read_csv(one.path, parsers, form=one.form)
    given = np.stack([_given(raw[parts[role].name]) for role in KINDS[kind]])
    kept = given.any(axis=0) if alone else given.all(axis=0)
    values = {role: raw[column.name][kept] for role, column in parts.items()}
    table = Table(one.path, raw.row[kept], values)
    for role in KINDS[kind]:
        table.require(role, _given(table[role]), "not a value")
    found = []
    for role, column in parts.items():
        unit, how = "", "as it is"
        if column.quantity != "name":
            unit, how = _unit(table, column, clock)
            values[role] = column.sign * UNITS[column.quantity][unit] * values[role]
        found.append(Understood(kind, table, column, unit, "told" if column.told else how))
    return found


def _unit(table: Table, column: Column, clock: str | None) -> tuple[str, str]:
    """Return the unit of a column, and how it is known, unless a wrong guess would never show."""
    values = np.abs(table[column.role][np.isfinite(table[column.role])])
    most = float(values.max(initial=0.0))
    if column.unit is not None:
        return column.unit, "named"
    if column.quantity == "time":
        return (clock, "as odometry") if clock else (_clock(table["t"]), "guessed")
    if column.quantity in ("angle", "rate") and most > 1.01 * math.tau:
        return column.si.replace("rad", "deg"), "guessed: more than a turn"
    if column.quantity == "speed" and most > FASTEST:
        raise InputError(
            f"{column.name!r} reaches {most:.6g}, too fast for m/s; say its unit, as in "
            f"--columns '{column.role}={column.name}[mm/s]'",
            table.file,
        )
    return column.si, "guessed"


def _clock(t: np.ndarray) -> str:
    """Return the unit of stamps: Unix time tells it, or that twists come each second."""
    units, middle = UNITS["time"], float(np.median(t)) if t.size else 0.0
    for unit, seconds in units.items():
        if UNIX_S[0] <= middle * seconds < UNIX_S[1]:
            return unit
    steps = np.diff(np.unique(t))
    step = float(np.median(steps)) if steps.size else 0.0
    return next((unit for unit, seconds in units.items() if step * seconds <= HOLD_S), "s")


def _given(values: np.ndarray) -> np.ndarray:
    """Return which cells hold something, shape (n,)."""
    return np.asarray(values != "" if values.dtype == object else np.isfinite(values))


def _number(name: str, cells: Sequence[str], *place: Any) -> np.ndarray:
    plain = ["" if cell.strip().lower() in ("nan", "na", "null") else cell for cell in cells]
    return numbers_or_nothing(name, plain, *place)


def _decimal(name: str, cells: Sequence[str], *place: Any) -> np.ndarray:
    return _number(name, [cell.replace(",", ".") for cell in cells], *place)


def _names(name: str, cells: Sequence[str], rows: Sequence[int], path: Path) -> np.ndarray:
    """Parse ids, of which some may be missing."""
    values = np.full(len(cells), "", object)
    there = [k for k, cell in enumerate(cells) if cell.strip()]
    values[there] = identifiers(name, [cells[k] for k in there], [rows[k] for k in there], path)
    return values
