"""Senses and units of imported columns, decided by the test of bearings against the odometry."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

from homeward.drives.columns import Column
from homeward.drives.drive import Drive, Odometry
from homeward.drives.importers.odometry import OPPOSITE, reversed_right
from homeward.drives.importers.parts import Imported
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
from homeward.drives.wheels import FOUR, PAIR, with_right_reversed
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


def with_senses(odometry: Odometry, found: Mapping[str, Imported]) -> dict[str, Imported]:
    """Return the tables of a drive in the sense of rotation and the units that fit its odometry.

    Specified columns stay as they are, and so do home bearings of another kind: bearings, positions
    and pixels may come from several programs.
    """
    found = dict(found)
    if "bearings" not in found or is_fixed(found["bearings"]):
        return found
    sense = _test(odometry, found["bearings"]).sense
    if sense is not None and sense.rate_factor != 1.0:
        odometry = _set_other_unit(sense, found, odometry)
        sense = _test(odometry, found["bearings"]).sense
    seen, home = found["bearings"], found.get("home")
    if sense is not Sense.REVERSED or _sided(seen):
        return found
    found["bearings"] = _reversed(seen)
    if home is not None and not is_fixed(home) and _sources(home) == _sources(seen):
        found["home"] = _reversed(home)
    return found


def _test(odometry: Odometry, seen: Imported) -> SenseTest:
    t = seen.table
    camera = t.columns.get("camera")
    return compare_senses(odometry, t["t"], t["landmark"], t["bearing"], camera)


def require_imported_senses(drive: Drive, found: Mapping[str, Imported]) -> SenseTest:
    """Test the drive of these tables; `InputError` with a remedy where it contradicts itself.

    Specified bearings are not tested.
    """
    seen, odometry = found["bearings"], found["odometry"]
    vy = odometry.columns.get("vy")
    if not (vy and vy.is_specified) and num_fixed_speeds(drive.odometry):
        fault, remedy = FIXED_SPEEDS
        advice = f"{remedy}, or use --columns 'vy=COLUMN' to import them all the same"
        raise InputError(fault, advice=advice)
    decided = UNDECIDED if is_fixed(seen) else senses_of(drive)
    if decided.sense is not Sense.RIGHT:
        _require_sides(drive, odometry)
    if not decided.is_fault:
        return decided
    sided = _sided(seen)
    if sided and decided.sense is Sense.FIXED_FRAME:
        return replace(decided, sense=None)
    if sided and decided.sense is Sense.REVERSED:
        if any(column.is_specified for column in odometry.columns.values()):
            return decided
        problem = WRONG_WAY.format(decided.intervals, sided)
        raise InputError(problem, odometry.table.file, advice=_other_way(odometry.columns))
    given = [c for role, c in seen.columns.items() if role in ("forward", *LATERAL)]
    given = [c for c in given if c.role != "bearing" or len(given) == 1]
    keep = ", ".join(f"{c.role}={c.name.partition(' ... ')[0]}" for c in given)
    fault, remedy = decided.fault
    advice = f"{remedy}, or use --columns '{keep}' to import them all the same"
    raise InputError(fault, seen.table.file, advice=advice)


def _require_sides(drive: Drive, odometry: Imported) -> None:
    """Refuse wheels of which one side counts backwards, according to the bearings."""
    columns = [c for role, c in odometry.columns.items() if role in WHEELS]
    sides = {c.role.rpartition("_")[0] for c in columns}
    names = next((n for n in (PAIR, FOUR) if sides == set(n)), None)
    words = reversed_right(columns)
    if names is None or OPPOSITE.format(words) not in drive.remarks:
        return
    wheels = drive.settings.wheels
    if any(c.is_specified for c in columns) or wheels is None or wheels.track_width is None:
        return
    other = with_right_reversed(drive.odometry, names, wheels)
    test = senses_of(replace(drive, odometry=other))
    if test.sense in (Sense.RIGHT, Sense.REVERSED):
        problem = "left and right wheels turn in opposite directions, which the bearings contradict"
        advice = (
            f"use --columns '{words}' if the right wheels count backwards, or the same for the left"
            f" ones; '{words.replace('=-', '=')}' if they are right"
        )
        raise InputError(problem, odometry.table.file, advice=advice)


def _other_way(columns: Mapping[str, Column]) -> str:
    """Return the remedy for odometry, with columns by role, that turns the wrong way."""
    pairs = [(role, role.replace("left", "right")) for role in columns if "left" in role]
    if columns.keys() >= {role for pair in pairs for role in pair} and columns.keys() & WHEELS:
        exchanged = ", ".join(
            f"{a}={columns[b].name}, {b}={columns[a].name}"
            for a, b in pairs
            if {a, b} <= columns.keys()
        )
        same = ", ".join(f"{role}={columns[role].name}" for pair in pairs for role in pair)
        return (
            f"use --columns '{exchanged}' if the left and right encoders are exchanged, or "
            f"'{same}' if they are right"
        )
    role = next((r for r in ("omega", "turn", "steering", "heading") if r in columns), "omega")
    name = columns[role].name if role in columns else "COLUMN"
    return f"change the sign with --columns '{role}=-{name}', or use '{role}={name}' if it is right"


def is_fixed(one: Imported) -> bool:
    """Whether the user specified the columns of bearings."""
    return any(one.columns[role].is_specified for role in LATERAL if role in one.columns)


def _sided(one: Imported) -> str:
    """Return the source of bearings that shows which side is left; empty for plain angles."""
    if not one.columns.keys().isdisjoint(PIXEL_ROLES):
        return "pixels"
    forward = one.columns.get("forward")
    return "positions" if forward is not None and forward.source in SIDED else ""


def _sources(one: Imported) -> set[str]:
    """Return whether bearings are computed from positions, pixels or corners."""
    return {"forward", "column", "column0"}.intersection(one.columns)


def _reversed(one: Imported) -> Imported:
    """Return a table of bearings or of home with the opposite sense of rotation."""
    lateral = [role for role in LATERAL if role in one.columns]
    columns = [replace(one.columns[role], sign=-one.columns[role].sign) for role in lateral]
    columns[0] = replace(columns[0], source=f"{columns[0].source}; {SHOWN}")
    remarks = {REMARK: len(one.table)} if one.kind == "bearings" else {}
    return one.changed({role: -one.table[role] for role in lateral}, columns, remarks)


def _set_other_unit(sense: Sense, found: dict[str, Imported], odometry: Odometry) -> Odometry:
    """Convert yaw rates, or else bearings, to another unit; return the odometry.

    Only a unit that was guessed is changed.
    """
    old, new = ("rad", "deg") if sense.rate_factor > 1.0 else ("deg", "rad")
    motion = found["odometry"]
    for role in (role for role in ROTATIONS if role in motion.columns):
        column = motion.columns[role]
        unit = str(column.unit).replace(old, new)
        if column.is_guessed and unit != column.unit:
            found["odometry"] = _scaled(motion, role, 1.0 / sense.rate_factor, unit)
            return replace(odometry, omega=odometry.omega / sense.rate_factor)
    for kind in ("bearings", "home") if new == "rad" else ():
        if kind in found and found[kind].columns["bearing"].may_be_deg:
            found[kind] = _scaled(found[kind], "bearing", math.radians(1.0), "deg")
    return odometry


def _scaled(one: Imported, role: str, factor: float, unit: str) -> Imported:
    """Return a table after a column was converted to `unit`."""
    column = one.columns[role]
    words = UNIT.format(role, unit, role, column.name.partition(" ... ")[0], column.unit)
    column = replace(column, unit=unit, source=f"guessed: {FITS}")
    return one.changed({role: factor * one.table[role]}, [column], {words: len(one.table)})
