"""The tables of a drive in imported files, recognised and converted to SI units."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np

from homeward.drives.cameras.lens import Lens
from homeward.drives.folder import sorted_by_time
from homeward.drives.importers.columns import (
    KINDS,
    ODOMETRY,
    OPTIONAL,
    UNITS,
    Column,
    assigned,
    landmark_columns,
    landmark_in,
    long,
    matches,
    times_in,
    unit_of,
    words_in,
)
from homeward.drives.importers.heading_unit import heading_unit
from homeward.drives.importers.pixels import (
    PIXEL_ROLES,
    Pixels,
    has_intrinsics,
    pixel_columns,
    with_pixels,
)
from homeward.drives.importers.positions import (
    MAX_LENGTH,
    POSITION_ROLES,
    Axes,
    position_columns,
    with_axes,
)
from homeward.drives.importers.sheet import Sheet, names, number_parser, time_parser
from homeward.drives.importers.wheel_columns import SIDES, base_of, guessed_unit
from homeward.errors import InputError
from homeward.io.table import Parser, Table, read_csv
from homeward.odometry.limits import MAX_SPEED
from homeward.odometry.validity import TWIST_VALIDITY_S

Found: TypeAlias = "dict[str, Column] | None"
"""The columns of a table by role; None where there is none."""
POSITIONED = ("bearings", "home")
"""Kinds of tables that may have positions of landmarks instead of bearings."""
SIDE_NAMES = [(name,) for name in SIDES]
UNIX_S = (1e9, 4.1e9)
"""Range of Unix time, from 2001 to 2099 [s]."""
RECOGNISED = {
    "odometry": "time, speed, yaw rate; or wheels",
    "detections": "time, landmark id, bearing, position or pixels",
    "home bearings": "landmark id, bearing, position or pixels",
    "ground truth": "time, x, y, heading",
}
"""Descriptions of the tables of a drive and their columns; `KINDS` has the roles."""
MAX_SHOWN = 12
"""Maximum number of columns in an error message."""
TRUE_PATH = re.compile(r"truth|mocap|vicon|optitrack|(?<![a-z])gt(?![a-z])")
"""Matches the name of a file with ground-truth poses."""
AS_TRUTH = (
    "poses of {0} used as ground truth, because there is other odometry; if they are odometry, use "
    "--as {0}=odometry"
)
AS_ODOMETRY = (
    "poses of {0} used as odometry; if they are ground truth, use --as {0}=truth and add odometry"
)
INCOMPLETE = "incomplete rows of {}, left out"
UNSEEN = "landmarks out of view (0 or -1), or without a ray in the camera model"


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
    is_unsure: bool = False
    """Whether poses were taken as ground truth only because there is other odometry."""
    remarks: dict[str, int] = field(default_factory=dict)
    """Numbers of corrections of the table, by description."""

    @property
    def may_be_deg(self) -> bool:
        """Whether an angle or a rate was taken as rad although its unit is unknown."""
        return self.column.unit is None and self.unit.startswith("rad")

    @property
    def range(self) -> str:
        """Range of the values in SI units; for names, their number."""
        values = self.table[self.column.role]
        if self.column.quantity == "name":
            return f"{len(set(values.tolist()))} names"
        seen, digits = values[np.isfinite(values)], 12 if self.column.role == "t" else 6
        ends = f"{seen.min():.{digits}g} to {seen.max():.{digits}g}" if seen.size else ""
        is_wheel = self.column.quantity.startswith("wheel")
        per_s = "/s" * self.column.quantity.endswith("speed")
        unit = base_of(self.unit) + per_s if is_wheel else self.column.si
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
        remarks = {INCOMPLETE.format(self.kind): missing} if missing else {}
        columns = dict(self.columns)
        ordered = dataclasses.replace(table, columns=values)
        if self.source:
            for role in {*POSITION_ROLES, *PIXEL_ROLES}.intersection(units):
                units[role] = units[role][0], self.source.name
            for role, found in self.source.measured(values).items():
                if role in (*KINDS[self.kind], *OPTIONAL[self.kind]):
                    unit = "m" if role == "range" else "rad"
                    columns[role] = Column(role, self.source.formula(columns, role), unit)
                    values[role], units[role] = found, (unit, self.source.reason)
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
        return [
            ImportedColumn(
                self.kind,
                ordered,
                column,
                unit,
                "specified" if column.is_specified else source,
                self.kind == "truth" and bool(self.decision),
                remarks,
            )
            for (unit, source), column in zip(units.values(), columns.values(), strict=True)
        ]

    def _plain(self) -> tuple[Table, int]:
        """Read a table with a row for each sample; return it with the number of incomplete rows."""
        raw = self.raw()
        values = {role: _value(raw, column) for role, column in self.columns.items()}
        needed = [role for role in self.columns if role not in OPTIONAL["bearings"]]
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
        raw, t = self.raw(), self.columns.get("t")
        return long(raw, self.wide, None if t is None else _value(raw, t))

    def raw(self) -> Table:
        """Read the columns in their own units."""
        comma = self.sheet.decimal_comma
        kinds = {"name": names, "time": time_parser(comma)}
        parsers: dict[str, Parser] = dict.fromkeys(self.wide.values(), number_parser(comma))
        for column in self.columns.values():
            if not (self.wide and column.role in ("landmark", "bearing")):
                parser = kinds.get(column.quantity, number_parser(comma))
                parsers |= dict.fromkeys((column.name, *column.more), parser)
        return read_csv(self.sheet.path, parsers, form=self.sheet.form)


def parts_of(
    sheets: Sequence[Sheet],
    specified: Sequence[Column],
    kinds: Mapping[str, str] | None = None,
    has_wheels: bool = False,
    camera: Lens | None = None,
) -> list[Part]:
    """Return the tables of a drive in files, at least one in each.

    `kinds` are specified kinds by file name; `has_wheels` prefers wheels to poses in one file;
    `camera` is that of pixels.
    """
    parts, others = list[Part](), list[Sheet]()
    for one in sheets:
        kind = (kinds or {}).get(one.path.name)
        found = _kinds_of(one, one.specified(specified), kind, has_wheels, camera)
        parts += [Part(one, kind, columns) for kind, columns in found.items() if columns]
        if not found.get("bearings") and not found.get("home"):
            others.append(one)
    ids = _landmark_ids(parts, others)
    for one in others:
        kind, mine = (kinds or {}).get(one.path.name), one.specified(specified)
        # The number of a column is no landmark id, although ids may be numbers.
        used = {c.name for part in parts if part.sheet is one for c in part.columns.values()}
        free = [name for name in one.names if name not in used]
        across = {} if one.headless else landmark_columns(free, ids)
        t = times_in(one.names, mine)
        if across and (t is not None or one.one_row) and kind in (None, _wide_kind(t)):
            parts.append(_wide_part(one, across, t))
        elif all(part.sheet is not one for part in parts):
            gyro = assigned(KINDS["gyro"], one.names, mine) if kind is None else None
            if gyro is None:
                raise InputError(_not_recognised(one, kind), one.path)
            parts.append(Part(one, "gyro", gyro))
    _find_odometry(parts, kinds or {})
    _find_sources(parts, camera)
    return parts


def _kinds_of(
    one: Sheet, mine: Sequence[Column], kind: str | None, has_wheels: bool, camera: Lens | None
) -> dict[str, Found]:
    """Return the columns of each kind of table in a file, but those of wide tables."""

    def columns_of(kind: str) -> Found:
        return assigned(KINDS[kind], one.names, mine, OPTIONAL.get(kind, ()))

    poses = _unambiguous(lambda: columns_of("truth"))
    odometry = _odometry_columns(one, mine, has_wheels or not poses)
    if kind == "odometry":
        return {kind: odometry or columns_of("truth")}
    if kind is not None:
        placed = kind in POSITIONED and (
            pixel_columns(one, kind, mine, camera) or position_columns(kind, one.names, mine)
        )
        return {kind: columns_of(kind) or placed or None}
    roles = {column.role for column in mine if column.name in one.names}
    if roles.intersection(POSITION_ROLES):
        return {"odometry": odometry} | _positions(one, mine)
    name = one.path.name.lower()
    is_of_robot = TRUE_PATH.search(name) or "odom" in name
    pixels = {} if is_of_robot else _pixels(one, mine, camera)
    if has_intrinsics(pixels, camera):
        given = _unambiguous(lambda: columns_of("bearings") or columns_of("home"))
        if given is None or roles.intersection(PIXEL_ROLES):
            return {"odometry": odometry} | pixels
        _refuse_headings(one, given["bearing"], "column and row of the pixel")
    if poses:  # the heading of the robot is no bearing
        others = [name for name in one.names if name != poses["heading"].name]
        seen = assigned(KINDS["bearings"], others, mine, OPTIONAL["bearings"])
        if seen and _belong_to_robot(one, poses, seen["landmark"]):
            return {"odometry": odometry, "bearings": seen, "truth": None if odometry else poses}
    bearings = columns_of("bearings")
    if bearings:
        if _unambiguous(lambda: _positions(one, mine).get("bearings")):
            _refuse_headings(
                one, bearings["bearing"], "forward and left (or right) of the position"
            )
        return {"odometry": odometry, "bearings": bearings}
    if odometry:  # poses along with twists belong to the odometry
        seen = _unambiguous(lambda: position_columns("bearings", one.names, mine))
        of_robot = seen and poses and seen.get("x") == poses["x"]
        is_seen = seen and not of_robot and _has_landmarks(one, seen["landmark"])
        return {"odometry": odometry, "bearings": seen if is_seen else None}
    home, poses = columns_of("home"), columns_of("truth")
    if home or (poses and is_of_robot):
        return {"truth": poses, "home": home}
    seen = _unambiguous(lambda: position_columns("bearings", one.names, mine))
    if poses and not (seen and _has_landmarks(one, seen["landmark"])):
        return {"truth": poses}
    return pixels if pixels and not seen else _positions(one, mine)


def _odometry_columns(one: Sheet, mine: Sequence[Column], has_wheels: bool) -> Found:
    """Return the columns of odometry in the preferred form that a file has, except poses."""
    roles = {column.role for column in mine if column.name in one.names}
    forms = sorted(ODOMETRY, key=lambda form: -len(roles.intersection(form)))
    # Along with landmarks, left and right are those of a box in an image.
    is_seen = any(matches(name, "landmark") for name in one.names)
    usable = [n for n in one.names if not (is_seen and words_in(n) in SIDE_NAMES)]
    for form in forms:
        is_wanted = has_wheels or "omega" in form or len(roles.intersection(form)) > 1
        if is_wanted and (found := assigned(form, usable, mine, ODOMETRY[form])):
            return found
    return None


def _belong_to_robot(one: Sheet, poses: dict[str, Column], landmark: Column) -> bool:
    """Whether poses along with sightings are those of the robot: the same for all at one time."""
    raw = Part(one, "truth", {**poses, "landmark": landmark}).raw()
    rows = np.isfinite(raw[poses["x"].name]) & (raw[landmark.name] != "")
    by_time: dict[float, set[tuple[float, float]]] = {}
    columns = (_value(raw, poses[role])[rows].tolist() for role in "txy")
    for stamp, x, y in zip(*columns, strict=True):
        by_time.setdefault(stamp, set()).add((x, y))
    is_repeated = not rows.any() or len(by_time) < rows.sum()
    return is_repeated and all(len(places) == 1 for places in by_time.values())


def _refuse_headings(one: Sheet, bearing: Column, others: str) -> None:
    """Refuse a bearing such as theta along with `others`: it may be the landmark's heading."""
    if not bearing.is_specified and matches(bearing.name, "heading"):
        problem = f"{bearing.name!r} may be the bearing or the heading of a landmark"
        roles = f"'bearing={bearing.name}', or the roles {others}"
        raise InputError(f"{problem}; use --columns {roles}", one.path)


def _pixels(one: Sheet, mine: Sequence[Column], camera: Lens | None) -> dict[str, Found]:
    """Return the columns of landmarks in pixels, by kind of table."""
    for kind in POSITIONED:
        try:
            if found := pixel_columns(one, kind, mine, camera):
                return {kind: found}
        except InputError:  # without a camera, two columns u need not be pixels
            if camera is not None:
                raise
    return {}


def _positions(one: Sheet, mine: Sequence[Column]) -> dict[str, Found]:
    """Return the columns of positions of landmarks, by kind of table."""
    for kind in POSITIONED:
        if found := position_columns(kind, one.names, mine):
            return {kind: found}
    return {}


def _unambiguous(columns: Callable[[], Found]) -> Found:
    """Return the columns of a table; None where two columns match the same role."""
    try:
        return columns()
    except InputError:
        return None


def _has_landmarks(one: Sheet, landmark: Column) -> bool:
    """Whether a column has several ids in several rows each, so that positions are landmarks'."""
    ids = read_csv(one.path, {landmark.name: names}, form=one.form)[landmark.name]
    seen = [name for name in ids.tolist() if name]
    return 1 < len(set(seen)) < len(seen)


def _find_sources(parts: Sequence[Part], camera: Lens | None) -> None:
    """Find the camera of pixels, and the axes of positions, of the drive before those of home."""
    axes = None
    for part in sorted(parts, key=lambda part: part.kind):
        if part.kind not in POSITIONED or part.wide or "bearing" in part.columns:
            continue
        if not part.columns.keys().isdisjoint(PIXEL_ROLES):
            part.columns, part.source = with_pixels(part.sheet, part.columns, camera)
        else:
            part.columns, axes = with_axes(part.sheet, part.kind, part.columns, axes)
            part.source = axes
    if camera is not None and not any(isinstance(part.source, Pixels) for part in parts):
        raise InputError(
            "--camera is not used: no table has pixels instead of bearings; give their columns, as "
            "in --columns 'column=u, row=v'"
        )


def _not_recognised(one: Sheet, kind: str | None) -> str:
    """Return the message for a table that is no part of a drive, or not of the specified kind."""
    if kind is not None:
        words = ", ".join(map(repr, one.names[:MAX_SHOWN]))
        return f"--as {one.path.name}={kind}: its columns {words} have no {', '.join(KINDS[kind])}"
    names, file = one.names, f"{one.path.name}: " if one.headless else ""
    *most, last = (f"{words} ({needs})" for words, needs in RECOGNISED.items())
    shown = ", ".join(map(repr, names[:MAX_SHOWN]))
    more = f", ... ({len(names):,} in all)" if len(names) > MAX_SHOWN else ""
    return (
        f"not recognised as {', '.join(most)} or {last}. Its columns are {shown}{more}: give their "
        f"roles, as in --columns '{file}t={names[0]}'"
    )


def _find_odometry(parts: Sequence[Part], kinds: Mapping[str, str]) -> None:
    """Decide whether poses are odometry or ground truth, except in files of a specified kind."""
    poses = [p for p in parts if p.kind == "truth" and p.sheet.path.name not in kinds]
    named = [part for part in poses if "odom" in part.sheet.path.name.lower()]
    unknown = [p for p in poses if not TRUE_PATH.search(p.sheet.path.name.lower())]
    if any(part.kind == "odometry" for part in parts):
        for part in unknown:
            part.decision = AS_TRUTH.format(part.sheet.path.name)
        return
    candidates = named or unknown
    if len(candidates) > 1 and not named:
        candidates = [part for part in candidates if part.begins_at_origin]
    if len(unknown) > 1 and len(candidates) != 1:
        files = " and ".join(part.sheet.path.name for part in unknown)
        raise InputError(
            f"{files} have poses, and either may be the odometry: use --as FILE=odometry for one, "
            "and --as FILE=truth for ground truth"
        )
    for part in unknown:
        part.kind = "odometry" if part in candidates else "truth"
        if part not in named:
            name = part.sheet.path.name
            part.decision = (AS_ODOMETRY if part in candidates else AS_TRUTH).format(name)


def _landmark_ids(parts: Sequence[Part], others: Sequence[Sheet]) -> set[str]:
    """Return the known landmark ids, where a table may have a column for each."""
    if not others:
        return set()
    known, seen = set[str](), set[str]()
    for part in parts:
        if part.kind in ("home", "bearings"):
            name, one = part.columns["landmark"].name, part.sheet
            ids = set(read_csv(one.path, {name: names}, form=one.form)[name].tolist()) - {""}
            seen |= ids
            known |= ids if part.kind == "home" else set()
    rows = {one: times_in(one.names, ()) is None and one.one_row for one in others}
    across = {one: {landmark_in(name)[0] for name in one.names} for one in others}
    seen |= set().union(*(across[one] for one in others if not rows[one]))
    for one in others:  # a row of home bearings has landmarks that the drive saw
        if rows[one] and not one.headless and len(across[one] & seen) > 1:
            known |= across[one]
    return known


def _wide_kind(t: Column | None) -> str:
    return "home" if t is None else "bearings"


def _wide_part(one: Sheet, across: dict[str, str], t: Column | None) -> Part:
    first, *_, last = across.values()
    span = f"{first} ... {last}"
    columns = {"landmark": Column("landmark", span)}
    columns["bearing"] = Column("bearing", span, unit_of(list(across.values())))
    return Part(one, _wide_kind(t), columns if t is None else {"t": t, **columns}, across)


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
    if column.quantity in ("wheel", "wheel speed"):
        unit = guessed_unit(words_in(column.name), column.quantity, values)
        if unit is not None:
            return unit, "guessed: whole numbers" if unit == "ticks" else "guessed"
        if column.quantity == "wheel":
            raise InputError(
                f"{column.name!r} may be in ticks, rad or m; give its unit, as in --columns "
                f"'{column.role}={column.name}[rad]'",
                table.file,
            )
    if column.role == "range" and largest > MAX_LENGTH:
        return "mm", f"guessed: more than {MAX_LENGTH:g}"
    if column.role == "steering" and largest > math.pi / 2:
        return "deg", "guessed: more than a quarter turn"
    is_pose = column.role == "heading" and {"x", "y"} <= set(table.columns)
    if is_pose and largest > 1.01 * math.tau:
        # Headings that count the turns exceed a turn in radians, too.
        unit = heading_unit(table["x"], table["y"], column.sign * table["heading"])
        if unit is not None:
            return unit, "guessed: along the path"
    if column.quantity in ("angle", "rate") and largest > 1.01 * math.tau:
        return column.si.replace("rad", "deg"), "guessed: more than a turn"
    if column.role == "bearing" and angle:
        return angle, "as bearings"
    if column.si == "m/s" and largest > MAX_SPEED:
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
