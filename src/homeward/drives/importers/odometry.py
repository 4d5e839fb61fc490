"""Odometry of an imported table: twists, wheels, steering, steps, or poses."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from homeward.drives.columns import Column
from homeward.drives.drive import Odometry
from homeward.drives.folder import REPEATED_ODOMETRY, sorted_by_time, without_repeats
from homeward.drives.importers.parts import Imported
from homeward.drives.measure import motion, with_yaw_rate
from homeward.drives.plausibility import remark_other_units
from homeward.drives.settings import Wheels
from homeward.drives.wheels import (
    FOUR,
    MODULES,
    OMNI,
    PAIR,
    accumulates,
    base_of,
    missing_geometry,
    of_wheels,
    wheel_speeds,
)
from homeward.drives.wheels import ROLES as WHEELS
from homeward.errors import InputError
from homeward.io.table import Table
from homeward.odometry.validity import MAX_SPEED

FROM_POSES = "odometry rows are poses; twists are computed from their differences"
OPPOSITE = (
    "odometry rows with left and right wheels that turn in opposite directions; if those of one "
    "side count backwards, use --columns '{}', or the same for the left"
)
SIZES = {"wheel_radius": 0.033, "track_width": 0.16, "ticks_per_turn": 4096, "wheelbase": 0.33}
EXAMPLE = SIZES | {"omni_radius": 0.2, "modules": "'[[.3,.3],[.3,-.3],[-.3,.3],[-.3,-.3]]'"}
"""Values shown in error messages."""


def imported_odometry(one: Imported, wheels: Wheels, remarks: dict[str, int]) -> Odometry:
    """Return the odometry of an imported table.

    `InputError` where the geometry of the wheels is missing or given without a need, or the unit of
    the wheels is ambiguous or too large.
    """
    by_role, table = one.columns, one.table
    if wheels != Wheels() and not by_role.keys() & {*WHEELS, *MODULES, "steering"}:
        problem = "not needed: the odometry does not come from wheels"
        advice = "leave it out, or give columns, as in --columns 'left_wheel=A, right_wheel=B'"
        raise InputError(problem, table.file, part="--wheels", advice=advice)
    table = sorted_by_time(table, "odometry", remarks)
    for role in [role for role in table.columns if role.endswith("_step")] + ["distance", "turn"]:
        if role in table.columns:  # repeated times must lose no step
            summed = {**table.columns, role: np.cumsum(table[role])}
            table = Table(table.file, table.row, summed)
    table = without_repeats(table, remarks, REPEATED_ODOMETRY)
    t = table["t"]
    remark_other_units(t, remarks)
    if "heading" in by_role:
        remarks[FROM_POSES] = len(table)
    if "steering" in by_role:
        _require(wheels.missing("m", steers=True), by_role.values(), table)
    if MODULES[0] in by_role:
        _require(["modules"] * (len(wheels.modules) != 4), by_role.values(), table)
    if not by_role.keys() & set(WHEELS):
        return motion(table.columns, wheels, remarks)
    odometry = _of_wheels(by_role, table, wheels, remarks)
    if "omega" not in by_role:
        return odometry
    gyro = by_role["omega"]
    return with_yaw_rate(odometry, t, table["omega"], repr(gyro.name), remarks, gyro.may_be_deg)


def _of_wheels(
    by_role: Mapping[str, Column], table: Table, wheels: Wheels, remarks: dict[str, int]
) -> Odometry:
    """Return the odometry of left and right wheels, of a mecanum drive, or of omni wheels."""
    by_wheel = {role.rpartition("_")[0]: one for role, one in by_role.items() if role in WHEELS}
    on_circle = tuple(wheel for wheel in OMNI if wheel in by_wheel)
    names = on_circle or (FOUR if FOUR[0] in by_wheel else PAIR)
    columns = [by_wheel[name] for name in names]
    left, right = columns[:2]
    role, name, unit = left.role.rpartition("_")[2], left.name, base_of(str(left.unit))
    in_rad = "rad/s" if role == "speed" else "rad"
    for other in columns[1:]:
        if base_of(str(other.unit)) != unit:
            problem = f"{name!r} is in {left.unit}, {other.name!r} in {other.unit}"
            raise left.unit_error(problem, table.file, in_rad)
    if role == "speed" and left.is_guessed and unit == "m" and wheels.wheel_radius:
        problem = f"{name!r} may be in m/s, or in rad/s as wheel_radius is given"
        raise left.unit_error(problem, table.file, in_rad)
    _require(missing_geometry(wheels, names, unit), columns, table)
    t, values = table["t"], np.stack([table[one.role] for one in columns], axis=1)
    speeds = wheel_speeds(t, values, wheels, unit, remarks, are_positions=role != "speed")
    moved = speeds[:-1] * np.diff(t)[:, None]
    if role == "wheel" and not left.is_specified and not any(map(accumulates, moved.T)):
        steps, positions = (
            ", ".join(f"{w}_{what}={c.name}" for w, c in zip(names, columns, strict=True))
            for what in ("step", "wheel")
        )
        problem = f"{name!r} and {right.name!r} do not accumulate"
        advice = f"use --columns '{steps}' for steps from row to row, otherwise '{positions}'"
        raise InputError(problem, table.file, advice=advice)
    if opposite := _opposite_rows(speeds, names):
        remarks[OPPOSITE.format(reversed_right(columns))] = opposite
    odometry = of_wheels(t, speeds, names, wheels, remarks)
    if (usual := float(np.nanquantile(np.abs(odometry.v), 0.95))) > MAX_SPEED:
        problem = f"the wheels reach {usual:.3g} m/s; check --wheels"
        raise left.unit_error(problem, table.file, in_rad)
    return odometry


def _opposite_rows(speeds: np.ndarray, names: Sequence[str]) -> int:
    """Return the rows whose left and right wheels have opposite signs; 0 where most have not.

    `speeds` are (n, k); the wheels of a side count with their mean, since they differ in sideways
    motion.
    """
    if names[0] in OMNI:
        return 0
    left, right = (speeds[:, [side in name for name in names]].mean(axis=1) for side in PAIR)
    opposite = int((left * right < 0.0).sum())
    return opposite if 2 * opposite > np.count_nonzero((left != 0.0) | (right != 0.0)) else 0


def reversed_right(columns: Iterable[Column]) -> str:
    """Return the roles of the right wheels with the opposite sign, as for --columns."""
    return ", ".join(f"{c.role}=-{c.name}" for c in columns if "right" in c.role)


def _require(missing: Sequence[str], columns: Iterable[Column], table: Table) -> None:
    """Refuse wheels without their geometry."""
    if missing:
        names = " and ".join(f"{c.name!r} [{c.unit}]" for c in columns)
        example = ",".join(f"{key}={EXAMPLE[key]}" for key in missing)
        problem = f"odometry from {names} requires {', '.join(missing)} (SI units)"
        raise InputError(problem, table.file, advice=f"give them, as in --wheels {example}")
