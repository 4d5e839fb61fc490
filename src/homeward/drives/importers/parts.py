"""Tables of a drive in imported files, converted to SI units."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from homeward.drives.columns import KINDS, OPTIONAL, UNITS, Column, foreign_unit, words_in
from homeward.drives.folder import sorted_by_time
from homeward.drives.importers.pixels import PIXEL_ROLES, Pixels
from homeward.drives.importers.positions import MAX_LENGTH, POSITION_ROLES, Axes
from homeward.drives.importers.sheet import Sheet
from homeward.drives.importers.wide import long
from homeward.drives.wheels import base_of, guessed_unit
from homeward.errors import InputError
from homeward.io.table import Table
from homeward.odometry.validity import MAX_SPEED, TWIST_VALIDITY_S

UNIX_S = (1e9, 4.1e9)
"""Range of Unix time, from 2001 to 2099 [s]."""
INCOMPLETE = "incomplete rows of {}, left out"
UNSEEN = "landmarks out of view (0 or -1), or without a ray in the camera model"
AFTER = "sigma", "vy"
"""Roles whose unit, where none is given, is that of another column, which is read first."""
MIN_COMMON = 3
"""Minimum number of landmarks that home and the drive have in common for a pose."""
MAX_POSES = 2000
"""Maximum number of poses that are compared; steps between fewer poses have less noise."""
MIN_FIT = 0.7
"""Minimum fit of a path along its headings [1]; random directions have 0."""
FULL_TURN_DEG, FULL_TURN_GON = 366.0, 400.5
"""Largest bearings of one turn in degrees, with some excess, and in gon; more count the turns."""
MAX_TURNS_DEG = 3600.0
"""Largest bearings in degrees that count the turns; whole numbers do not."""
MAX_RATE = 2000.0
"""Rows a second beyond which stamps have another unit than those of the odometry."""
USUAL = 0.95
"""Share of the speeds that are no spikes."""
MAX_SIGMA = 0.2
"""Usual standard deviation of bearings without a unit beyond which it may be in degrees [rad]."""
MAX_TILT = 0.5
"""Roll and pitch without a unit beyond it may be in degrees [rad]."""


@dataclass(frozen=True)
class Imported:
    """A table of a drive in SI units."""

    kind: str
    """Odometry, bearings, home, truth, gyro or tilt."""
    table: Table
    """Its columns by role."""
    columns: Mapping[str, Column]
    """Their names and units in the file, by role."""
    is_unsure: bool = False
    """Whether poses were taken as ground truth only because there is other odometry."""
    remarks: dict[str, int] = field(default_factory=dict)
    """Numbers of corrections, by description."""

    def changed(
        self,
        values: Mapping[str, np.ndarray],
        columns: Iterable[Column] = (),
        remarks: Mapping[str, int] | None = None,
    ) -> Imported:
        """Return the table with other values by role, other columns, and further remarks."""
        return replace(
            self,
            table=replace(self.table, columns={**self.table.columns, **values}),
            columns={**self.columns, **{column.role: column for column in columns}},
            remarks={**self.remarks, **(remarks or {})},
        )

    def rows(self) -> Iterator[tuple[str, ...]]:
        """Yield file, kind, column, role, unit, source of the unit, and range of each column."""
        for role, c in self.columns.items():
            name, unit = self.table.file.name, str(c.unit)
            yield name, self.kind, c.signed_name, role, unit, c.source, self.range_of(role)

    def range_of(self, role: str) -> str:
        """Return the range of the values of a role in SI units; for names, their number."""
        column, values = self.columns[role], self.table[role]
        if column.quantity == "name":
            names = set(values.tolist()) - {""}
            return f"{len(names)} names" if names else "no ids"
        seen, digits = values[np.isfinite(values)], 12 if role == "t" else 6
        ends = f"{seen.min():.{digits}g} to {seen.max():.{digits}g}" if seen.size else ""
        per_s = "/s" * column.quantity.endswith("speed")
        is_wheel = column.quantity.startswith("wheel")
        unit = base_of(str(column.unit)) + per_s if is_wheel else column.si
        return f"{ends} {unit}" if ends else ""


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
    source: Axes | Pixels | None = None
    """Positions or pixels from which bearings are computed; None: bearings are given."""
    decision: str = ""
    """Reason for the kind of poses, as shown to the user."""

    @property
    def begins_at_origin(self) -> bool:
        """Whether the first pose is x = y = heading = 0, as in odometry."""
        table, _ = self._plain()
        return len(table) > 0 and all(abs(table[role][0]) < 1e-3 for role in ("x", "y", "heading"))

    def read(self, clock: Imported | None, angle: str | None = None) -> Imported:
        """Read the table in SI units.

        `clock` has the stamps of the odometry. `angle` is the unit of bearings where the file
        specifies none.
        """
        table, missing = (self._spread(), 0) if self.wide else self._plain()
        values, columns = dict(table.columns), dict[str, Column]()
        # A sigma has the unit of its bearing, and a sideways speed that of the forward speed.
        for role, column in sorted(self.columns.items(), key=lambda item: item[0] in AFTER):
            unit, source = "", "unchanged"
            if role == "sigma":  # the same program writes bearings and sigmas
                angle = columns["bearing"].unit
            if role == "vy" and column.unit is None:  # the same program writes both speeds
                unit, source = str(columns["v"].unit), "as v"
            elif column.quantity != "name":
                unit, source = _unit(table, column, clock, angle)
            if unit:
                values[role] = column.sign * UNITS[column.quantity][unit] * values[role]
            if self.source and role in (*POSITION_ROLES, "up", *PIXEL_ROLES):
                source = self.source.name
            is_guessed = bool(unit) and column.unit is None
            source = "specified" if column.is_specified else source
            columns[role] = replace(column, unit=unit, source=source, is_guessed=is_guessed)
        remarks = self.sheet.remarks | ({INCOMPLETE.format(self.kind): missing} if missing else {})
        ordered = replace(table, columns=values)
        if self.source:
            for role, found in self.source.measured(values).items():
                if role == "elevation":  # not shown
                    values[role] = found
                elif role in (*KINDS[self.kind], *OPTIONAL[self.kind]):
                    name = self.source.formula(columns, role)
                    unit = "m" if role == "range" else "rad"
                    values[role] = found
                    columns[role] = Column(role, name, unit, source=self.source.reason)
            is_seen = np.isfinite(values["bearing"])
            if not is_seen.any():
                raise InputError(f"all rows are of {UNSEEN}", table.file)
            if unseen := int((~is_seen).sum()):
                remarks[f"{UNSEEN}, left out"] = unseen
            ordered = ordered.rows(is_seen)
        if "t" in values:
            ordered = sorted_by_time(ordered, self.kind, remarks)
        if self.decision:
            remarks[self.decision] = len(ordered)
        is_unsure = self.kind == "truth" and bool(self.decision)
        return Imported(self.kind, ordered, columns, is_unsure, remarks)

    def _plain(self) -> tuple[Table, int]:
        """Read a table with a row for each sample; return it with the number of incomplete rows."""
        raw = self.sheet.values(self.columns)
        needed = [role for role in self.columns if role not in OPTIONAL["bearings"]]
        if "landmark" in needed and not (raw["landmark"] != "").any():  # without ids
            needed.remove("landmark")
        values = (raw[role] for role in needed)
        given = np.stack([v != "" if v.dtype == object else np.isfinite(v) for v in values])
        complete, partial = given.all(axis=0), given.any(axis=0)
        if partial.any() and not complete.any():
            raise InputError(f"no row has values for all of {', '.join(needed)}", raw.file)
        # In a file with several tables, each has its own rows.
        missing = int((partial & ~complete).sum()) if self.is_alone else 0
        return raw.rows(np.asarray(complete)), missing

    def _spread(self) -> Table:
        """Read a table with a column for each landmark."""
        t = {role: column for role, column in self.columns.items() if role == "t"}
        wide = {str(k): Column("bearing", name) for k, name in enumerate(self.wide.values())}
        return long(self.sheet.values(wide | t), list(self.wide))


def _unit(
    table: Table, column: Column, clock: Imported | None, angle: str | None
) -> tuple[str, str]:
    """Return the unit of a column and its source; `InputError` where a guess would be unsafe."""
    values = np.abs(table[column.role][np.isfinite(table[column.role])])
    largest = float(values.max(initial=0.0))
    if column.unit is not None:
        return column.unit, "named"
    if (unknown := foreign_unit(column.name, column.quantity)) is not None:
        units = ", ".join(UNITS[column.quantity])
        problem = f"{unknown!r} of {column.name!r} is no unit of {column.role}, as {units} are"
        raise column.unit_error(problem, table.file, column.si, first="convert the column, or ")
    if column.quantity == "time":
        # Two programs may write the stamps of one clock in different units.
        t = table["t"]
        middle = float(np.median(t)) if t.size else 0.0
        is_unix = {u: UNIX_S[0] <= middle * s < UNIX_S[1] for u, s in UNITS["time"].items()}
        own = next((u for u, is_it in is_unix.items() if is_it), None)
        guess = own or _clock(t)
        if own is None and clock is not None and t.size:
            usual = str(clock.columns["t"].unit)
            mine, other = (_fit(UNITS["time"][u] * t, clock.table["t"]) for u in (usual, guess))
            return (usual, "as odometry") if mine >= other else (guess, "guessed")
        return guess, "guessed"
    if column.role == "sigma" and angle:
        middle = float(np.median(values)) if values.size else 0.0
        if angle == "rad" and middle > MAX_SIGMA:
            problem = f"{column.name!r} is {middle:.3g} in the median and may be in degrees"
            raise column.unit_error(problem, table.file, "deg", "rad")
        return angle, "as bearing"
    if column.quantity in ("wheel", "wheel speed"):
        unit = guessed_unit(words_in(column.name), column.quantity, values)
        if unit is not None:
            return unit, "guessed: whole numbers" if unit == "ticks" else "guessed"
        if column.quantity == "wheel":
            problem = f"{column.name!r} may be in ticks, rad or m"
            raise column.unit_error(problem, table.file, "rad")
    if column.role == "range" and largest > MAX_LENGTH:
        return "mm", f"guessed: more than {MAX_LENGTH:g}"
    is_tilt = column.role in ("roll", "pitch")
    if is_tilt:  # one program writes both
        largest = max(float(np.nanmax(np.abs(table[role]))) for role in ("roll", "pitch"))
    if (column.role == "steering" or is_tilt) and largest > math.pi / 2:
        return "deg", "guessed: more than a quarter turn"
    if is_tilt and largest > MAX_TILT:
        problem = f"roll and pitch reach {largest:.3g} and may be in degrees"
        raise column.unit_error(problem, table.file, "deg")
    is_pose = column.role == "heading" and {"x", "y"} <= set(table.columns)
    if is_pose and largest > 1.01 * math.tau:
        # Headings that count the turns exceed a turn in radians, too.
        unit = _heading_unit(table["x"], table["y"], column.sign * table["heading"])
        if unit is not None:
            return unit, "guessed: along the path"
    is_whole = bool((values == np.round(values)).all())
    counts_turns = FULL_TURN_GON < largest < MAX_TURNS_DEG and not is_whole
    if column.role == "bearing" and largest > FULL_TURN_DEG and not counts_turns:
        problem = f"{column.name!r} reaches {largest:.6g}, too much for degrees of one turn"
        likely = ("gon",) if largest <= FULL_TURN_GON else ("mrad", "cdeg")
        raise column.unit_error(problem, table.file, *likely, "deg")
    if column.quantity in ("angle", "rate") and largest > 1.01 * math.tau:
        return column.si.replace("rad", "deg"), "guessed: more than a turn"
    if column.role == "bearing" and angle:
        if angle != "rad" and values.size >= MIN_COMMON and largest < 1.01 * math.pi:
            problem = (
                f"{column.name!r} reaches only {largest:.3g}, but other bearings are in {angle}"
            )
            raise column.unit_error(problem, table.file, "rad", angle)
        return angle, "as bearings"
    # Single spikes are left out later.
    moving = values[values > 0.0]
    if column.si == "m/s" and moving.size and np.quantile(moving, USUAL) > MAX_SPEED:
        problem = f"{column.name!r} reaches {largest:.6g}, too fast for m/s"
        raise column.unit_error(problem, table.file, "mm/s")
    return column.si, "guessed"


def _heading_unit(x: np.ndarray, y: np.ndarray, heading: np.ndarray) -> str | None:
    """Return deg or rad, in which headings of poses, shape (n,), fit the path; None if unclear.

    The fit is the length of the mean of exp(2i (direction - heading)) over the path: driving
    backwards and a constant rotation of either frame do not change it.
    """
    kept = slice(None, None, 1 + x.size // MAX_POSES)
    step = np.diff(x[kept] + 1j * y[kept])
    length = np.abs(step).sum()
    if not length > 0:
        return None
    twice = step**2 / np.where(step == 0, 1.0, np.abs(step))
    fit = {
        unit: abs((twice * np.exp(-2j * scale * heading[kept][:-1])).sum()) / length
        for unit, scale in (("deg", math.radians(1.0)), ("rad", 1.0))
    }
    best, other = sorted(fit, key=lambda unit: -fit[unit])
    return best if fit[best] > MIN_FIT and fit[other] < fit[best] - 0.2 else None


def _fit(t: np.ndarray, odometry: np.ndarray) -> tuple[bool, float]:
    """Return whether rows have a rate below `MAX_RATE`, and their share during the odometry."""
    steps = np.diff(np.unique(t))
    inside = (t >= odometry[0]) & (t <= odometry[-1])
    return steps.size == 0 or float(np.median(steps)) > 1 / MAX_RATE, float(inside.mean())


def _clock(t: np.ndarray) -> str:
    """Return the largest unit of stamps in which twists arrive at least once a second."""
    steps = np.diff(np.unique(t))
    step = float(np.median(steps)) if steps.size else 0.0
    return next(
        (unit for unit, seconds in UNITS["time"].items() if step * seconds <= TWIST_VALIDITY_S), "s"
    )
