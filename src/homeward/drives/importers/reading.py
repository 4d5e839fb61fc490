"""A drive from tables that others wrote."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from homeward.drives.drive import Drive, Odometry
from homeward.drives.folder import (
    BY_SPIN,
    REPEATED_ODOMETRY,
    home_of,
    is_drive_folder,
    odometry_of,
    sightings_of,
    truth_of,
    without_repeats,
)
from homeward.drives.home.spin import with_home
from homeward.drives.importers.columns import KINDS, specified_columns
from homeward.drives.importers.parts import UNIX_S, Understood, parts_of
from homeward.drives.importers.sheet import sheet
from homeward.drives.one_clock import on_one_clock, remark_other_units
from homeward.drives.plausibility import odometry_from_poses
from homeward.drives.ros.log import is_log
from homeward.drives.settings import DriveSettings, HomeWhen
from homeward.errors import InputError
from homeward.io.naming import listing, natural
from homeward.io.settings import validated
from homeward.io.table import Table, quoted

ELSE = {
    "odometry": ", and none with odom in its name has poses",
    "home": f" without a time, and {BY_SPIN}",
}
"""What else could tell it."""
NEEDED = 3
"""Landmarks that home and the drive need in common for a pose."""
BY_POSES = "odometry rows are poses; twists are what leads from each to the next"


def understand(files: Sequence[Path], columns: Sequence[str] = ()) -> list[Understood]:
    """Find out what the columns of text files are, and read them.

    The tables may have any separator, decimal mark, header and units. `columns` are texts
    ``[FILE:]ROLE=COLUMN[UNIT]`` for what names do not say, or say wrongly. `InputError` where a
    file cannot be read, is no part of a drive, or a column may have several roles.
    """
    for path in files:
        _refuse_drives(path)
    sheets = [sheet(path) for path in files]
    told = specified_columns(columns, {one.path.name: (*one.names, *one.numbers) for one in sheets})
    parts = parts_of(sheets, told)
    found: list[Understood] = []
    clock: str | None = None
    angle: str | None = None
    # Odometry first: it comes often, so that its stamps tell their unit. Of bearings a drive has
    # more than home, so that one of them is rather beyond what an angle in rad can be.
    for kind in KINDS:
        mine = [part for part in parts if part.kind == kind]
        for extra in mine[1:]:
            way = f"; name the file, as in --columns '{extra.sheet.path.name}: t=1, ...'"
            way = way if extra.sheet.headless else ""
            raise InputError(f"a second file with {kind}; one is enough{way}", extra.sheet.path)
        for part in mine:
            part.alone = sum(other.sheet is part.sheet for other in parts) == 1
            found += part.read(clock, angle)
            clock = clock or next((u.unit for u in found if u.column.role == "t"), None)
            if kind == "bearings":
                seen = next(u for u in found if u.column.role == "bearing")
                angle = None if seen.column.unit else seen.unit
    return found


def _refuse_drives(path: Path) -> None:
    """Refuse a folder, or a log, which needs no import."""
    if is_log(path):
        ways = "`homeward run` and `homeward info` read it without an import"
        raise InputError(f"this is a ROS bag or an MCAP file: {ways}", path)
    if path.is_dir():
        is_drive = is_drive_folder(path)
        way = "this is a drive folder: use `homeward run`" if is_drive else "name the files in it"
        raise InputError(f"not a text file but a folder; {way}", path)


def drive_of(
    found: Sequence[Understood], name: str, home_spin: tuple[float, float] | None = None
) -> Drive:
    """Return the drive that tables make, its home as in `open_drive`.

    `InputError` names the missing part, or the file and row at fault.
    """
    tables = {one.kind: one.table for one in found}
    for kind in ("odometry", "bearings", "home")[: 3 if home_spin is None else 2]:
        if kind not in tables:
            needs = ", ".join(KINDS[kind]) + ELSE.get(kind, "")
            raise InputError(f"nothing tells {kind}: no file has {needs}; --columns may say so")
    start = float(np.min(tables["odometry"]["t"], initial=math.inf))
    epoch = math.floor(start) if UNIX_S[0] <= start < UNIX_S[1] else 0
    for kind, table in tables.items():
        if "t" in table.columns:
            columns = {**table.columns, "t": table["t"] - epoch}
            tables[kind] = dataclasses.replace(table, columns=columns)
    remarks = {reason: n for one in found for reason, n in one.remarks.items()}
    drive = Drive(
        name=name,
        odometry=_odometry(tables["odometry"], remarks),
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


def about_home(drive: Drive) -> list[str]:
    """Say in sentences what home and the drive have not in common, if anything."""
    seen, home = set(drive.sightings.landmark.tolist()), set(drive.home)
    both, strange = len(seen & home), len(seen - home)
    if both < NEEDED:
        here, there = (
            listing([quoted(name) for name in sorted(names, key=natural)] or ["none"], 3)
            for names in (seen, home)
        )
        return [
            f"Home saw {both} of the {len(seen)} landmarks of the drive, and a pose needs "
            f"{NEEDED}: are they called alike? The drive has {here}; home has {there}."
        ]
    how_many = f"{strange} landmark{'' if strange == 1 else 's'}"
    return [f"{how_many} that home did not see: they help the map alone."] if strange else []


def _odometry(table: Table, remarks: dict[str, int]) -> Odometry:
    """Return odometry of twists, or of poses."""
    if "v" in table.columns:
        return odometry_of(table, remarks)
    kept = without_repeats(table, remarks, REPEATED_ODOMETRY)
    poses = np.stack([kept["x"], kept["y"], kept["heading"]], axis=1)
    remarks[BY_POSES] = len(kept)
    remark_other_units(kept["t"], remarks)
    return odometry_from_poses(kept["t"], poses, remarks)
