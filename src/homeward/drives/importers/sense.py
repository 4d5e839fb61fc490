"""Senses and units of imported columns, decided by the test of bearings against the odometry."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence

from homeward.drives.drive import Drive, Odometry
from homeward.drives.importers.parts import ImportedColumn
from homeward.drives.importers.pixels import PIXEL_ROLES
from homeward.drives.senses import (
    FIXED_SPEEDS,
    UNDECIDED,
    Sense,
    SenseTest,
    compare_senses,
    num_fixed_speeds,
    senses_of,
)
from homeward.drives.wheels import ROLES as WHEELS
from homeward.errors import InputError

LATERAL = ("bearing", "left", "right")
"""Roles of columns whose sign depends on the sense of rotation."""
ROTATIONS = ("omega", "turn")
"""Roles of odometry whose unit may be wrong."""
SIDED = ("camera axes", "named")
"""Sources of positions of which the axes show which side is left."""
SHOWN = "sign changed to fit yaw rates"
REMARK = (
    "bearings with changed sign, because they were clockwise and the yaw rates anti-clockwise; to "
    "keep it, use --columns 'bearing=COLUMN', and if the yaw rates are wrong, 'omega=-COLUMN' or "
    "left and right wheels exchanged"
)
FITS = "fits the bearings"
UNIT = "rows with {} in {}, which fits the bearings; to keep it, use --columns '{}={}[{}]'"
NOT_DECIDED = (
    "Senses and units of bearings and yaw rates were not tested: too few intervals in which the "
    "robot turns to both sides and sees landmarks with ids. Check that both are anti-clockwise."
)
WRONG_WAY = (
    "the odometry turns the wrong way: its yaw rates and the bearings have opposite signs in {:,} "
    "intervals, and {} show which side is left"
)


def with_senses(odometry: Odometry, found: list[ImportedColumn]) -> list[ImportedColumn]:
    """Return the columns of a drive in the sense of rotation and the units that fit its odometry.

    Specified columns stay as they are, and so do home bearings of another kind: bearings, positions
    and pixels may come from several programs.
    """
    seen = [one for one in found if one.kind == "bearings"]
    if not seen or is_fixed(seen):
        return found
    sense = _test(odometry, seen[0]).sense
    if sense is None or sense is Sense.RIGHT:
        return found
    if sense.rate_factor != 1.0:
        found, odometry = _in_other_unit(sense, found, odometry)
        seen = [one for one in found if one.kind == "bearings"]
        sense = _test(odometry, seen[0]).sense
    if sense is not Sense.REVERSED or _sided(seen):
        return found
    home = [one for one in found if one.kind == "home"]
    also_home = not is_fixed(home) and _sources(home) == _sources(seen)
    kinds = ("bearings", "home") if also_home else ("bearings",)
    return [_reversed(one) if one.kind in kinds else one for one in found]


def _test(odometry: Odometry, seen: ImportedColumn) -> SenseTest:
    t = seen.table
    camera = t.columns.get("camera")
    return compare_senses(odometry, t["t"], t["landmark"], t["bearing"], camera)


def require_imported_senses(drive: Drive, found: Sequence[ImportedColumn]) -> SenseTest:
    """Test the drive of these columns; `InputError` with a remedy where it contradicts itself.

    Specified bearings are not tested.
    """
    is_specified = any(one.column.role == "vy" and one.column.is_specified for one in found)
    if not is_specified and num_fixed_speeds(drive.odometry):
        fault, remedy = FIXED_SPEEDS
        advice = f"{remedy}, or use --columns 'vy=COLUMN' to import them all the same"
        raise InputError(fault, advice=advice)
    seen = [one for one in found if one.kind == "bearings"]
    decided = UNDECIDED if is_fixed(seen) else senses_of(drive)
    if not decided.is_fault:
        return decided
    sided, odometry = _sided(seen), [one for one in found if one.kind == "odometry"]
    if sided and decided.sense is Sense.FIXED_FRAME:
        return dataclasses.replace(decided, sense=None)
    if sided and decided.sense is Sense.REVERSED:
        if any(one.column.is_specified for one in odometry):
            return decided
        advice = _other_way({one.column.role: one.column.name for one in odometry})
        problem = WRONG_WAY.format(decided.intervals, sided)
        raise InputError(problem, odometry[0].table.file, advice=advice)
    given = [u.column for u in seen if u.column.role in ("forward", *LATERAL)]
    given = [c for c in given if c.role != "bearing" or len(given) == 1]
    keep = ", ".join(f"{c.role}={c.name.partition(' ... ')[0]}" for c in given)
    fault, remedy = decided.fault
    advice = f"{remedy}, or use --columns '{keep}' to import them all the same"
    raise InputError(fault, seen[0].table.file, advice=advice)


def _other_way(columns: Mapping[str, str]) -> str:
    """Return the remedy for odometry, with columns by role, that turns the wrong way."""
    pairs = [(role, role.replace("left", "right")) for role in columns if "left" in role]
    if columns.keys() >= {role for pair in pairs for role in pair} and columns.keys() & WHEELS:
        exchanged = ", ".join(
            f"{a}={columns[b]}, {b}={columns[a]}" for a, b in pairs if {a, b} <= columns.keys()
        )
        same = ", ".join(f"{role}={columns[role]}" for pair in pairs for role in pair)
        return (
            f"use --columns '{exchanged}' if the left and right encoders are exchanged, or "
            f"'{same}' if they are right"
        )
    role = next((r for r in ("omega", "turn", "steering", "heading") if r in columns), "omega")
    name = columns.get(role, "COLUMN")
    return f"change the sign with --columns '{role}=-{name}', or use '{role}={name}' if it is right"


def is_fixed(columns: Sequence[ImportedColumn]) -> bool:
    """Whether the user specified the columns of bearings."""
    return any(one.column.role in LATERAL and one.column.is_specified for one in columns)


def _sided(columns: Sequence[ImportedColumn]) -> str:
    """Return the source of bearings that shows which side is left; empty for plain angles."""
    roles = {one.column.role for one in columns}
    if roles.intersection(PIXEL_ROLES):
        return "pixels"
    is_sided = any(one.column.role == "forward" and one.source in SIDED for one in columns)
    return "positions" if is_sided else ""


def _sources(columns: Sequence[ImportedColumn]) -> set[str]:
    """Return whether bearings are computed from positions, pixels or corners."""
    return {one.column.role for one in columns}.intersection(("forward", "column", "column0"))


def _reversed(one: ImportedColumn) -> ImportedColumn:
    """Return a column of bearings or of home with the opposite sense of rotation."""
    column, remarks, source = one.column, one.remarks, one.source
    values = {n: -v if n in LATERAL else v for n, v in one.table.columns.items()}
    if column.role in LATERAL:
        column = dataclasses.replace(column, sign=-column.sign)
    if column.role == "bearing":
        source = f"{source}; {SHOWN}"
        remarks = remarks | ({REMARK: len(one.table)} if one.kind == "bearings" else {})
    table = dataclasses.replace(one.table, columns=values)
    return dataclasses.replace(one, table=table, column=column, source=source, remarks=remarks)


def _in_other_unit(
    sense: Sense, found: list[ImportedColumn], odometry: Odometry
) -> tuple[list[ImportedColumn], Odometry]:
    """Return the columns and the odometry with yaw rates, or else bearings, in another unit.

    Only a unit that was guessed is changed.
    """
    guessed = [one for one in found if one.column.unit is None]
    old, new = ("rad", "deg") if sense.rate_factor > 1.0 else ("deg", "rad")
    for one in guessed:
        if one.kind == "odometry" and one.column.role in ROTATIONS and one.unit.startswith(old):
            unit = one.unit.replace(old, new)
            scaled = [_scaled(o, one, 1.0 / sense.rate_factor, unit) for o in found]
            twists = odometry.t, odometry.v, odometry.omega / sense.rate_factor, odometry.vy
            return scaled, Odometry(*twists)
    for one in guessed:
        if new == "rad" and one.column.role == "bearing" and one.unit == "rad":
            found = [_scaled(o, one, math.radians(1.0), "deg") for o in found]
    return found, odometry


def _scaled(one: ImportedColumn, like: ImportedColumn, factor: float, unit: str) -> ImportedColumn:
    """Return a column after that of the role and table of `like` was converted to `unit`."""
    if one.kind != like.kind:
        return one
    role, name = like.column.role, like.column.name
    columns = {**one.table.columns, role: factor * one.table[role]}
    one = dataclasses.replace(one, table=dataclasses.replace(one.table, columns=columns))
    if one.column.role != role:
        return one
    words = UNIT.format(role, unit, role, name.partition(" ... ")[0], like.unit)
    remarks = one.remarks | {words: len(one.table)}
    return dataclasses.replace(one, unit=unit, source=f"guessed: {FITS}", remarks=remarks)
