"""A drive from tables of any layout."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from homeward.drives.drive import Drive, Odometry
from homeward.drives.folder import (
    HOME_ADVICE,
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
from homeward.drives.importers.parts import UNIX_S, ImportedColumn, parts_of
from homeward.drives.importers.sheet import sheet
from homeward.drives.one_clock import remark_other_units, with_clock_remarks
from homeward.drives.plausibility import odometry_from_poses
from homeward.drives.ros.log import is_log
from homeward.drives.settings import DriveSettings, HomeWhen
from homeward.errors import InputError
from homeward.io.naming import listing, natural
from homeward.io.table import Table, quoted

OTHER_SOURCES = {
    "odometry": ", and none with odom in its name has poses",
    "bearings": ", or a position instead of the bearing",
    "home": f" without a time; {HOME_ADVICE}",
}
"""Other sources of the tables of a drive."""
MIN_COMMON = 3
"""Minimum number of landmarks that home and the drive have in common for a pose."""
FROM_POSES = "odometry rows are poses; twists are computed from their differences"


def understand(files: Sequence[Path], columns: Sequence[str] = ()) -> list[ImportedColumn]:
    """Read text files, with the roles and units of their columns recognised.

    The tables may have any separator, decimal mark, header and units. `columns` are texts
    ``[FILE:]ROLE=COLUMN[UNIT]`` that specify or correct roles. `InputError` where a file cannot be
    read, contains no table of a drive, or a role is ambiguous.
    """
    for path in files:
        _refuse_drives(path)
    sheets = [sheet(path) for path in files]
    there = {one.path.name: (*one.names, *one.numbers) for one in sheets}
    parts = parts_of(sheets, specified_columns(columns, there))
    found: list[ImportedColumn] = []
    clock: str | None = None
    angle: str | None = None
    # Odometry first: from its rate, the unit of stamps can be guessed. Bearings before home: they
    # are more, so one of them probably exceeds 2 pi if they are in degrees.
    for kind in KINDS:
        mine = [part for part in parts if part.kind == kind]
        for extra in mine[1:]:
            advice = f"; give its roles, as in --columns '{extra.sheet.path.name}: t=1, ...'"
            advice = advice if extra.sheet.headless else "; leave one of them out"
            raise InputError(f"a second file with {kind}{advice}", extra.sheet.path)
        for part in mine:
            part.is_alone = sum(other.sheet is part.sheet for other in parts) == 1
            found += part.read(clock, angle)
            clock = clock or next((u.unit for u in found if u.column.role == "t"), None)
            if kind == "bearings":
                seen = next(u for u in found if u.column.role == "bearing")
                angle = None if seen.column.unit else seen.unit
    return found


def _refuse_drives(path: Path) -> None:
    """Refuse a folder, or a log, which needs no import."""
    if is_log(path):
        ways = "use it directly with `homeward run` or `homeward info`"
        raise InputError(f"a ROS bag or an MCAP file needs no import: {ways}", path)
    if path.is_dir():
        is_drive = is_drive_folder(path)
        advice = "use it directly with `homeward run`" if is_drive else "give the files in it"
        raise InputError(f"a {'drive ' * is_drive}folder, not a text file; {advice}", path)


def drive_of(found: Sequence[ImportedColumn], name: str, home: HomeWhen | None = None) -> Drive:
    """Return the drive of imported tables, with its home as in `open_drive`.

    `InputError` names the missing table, or the file and row of the problem.
    """
    tables = {one.kind: one.table for one in found}
    for kind in ("odometry", "bearings", "home")[: 3 if home is None else 2]:
        if kind not in tables:
            needs = ", ".join(KINDS[kind]) + OTHER_SOURCES.get(kind, "")
            label = kind.replace("home", "home bearings")
            raise InputError(
                f"no {label} found: no file has the columns {needs}. "
                "If the names of columns were not recognised, give their roles with --columns"
            )
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
    drive = with_clock_remarks(drive, tables["bearings"].file)
    return drive if home is None else with_home(drive, home)


def home_warnings(drive: Drive) -> list[str]:
    """Return warnings about landmarks that home and the drive do not have in common."""
    seen, home = set(drive.sightings.landmark.tolist()), set(drive.home)
    both, without_home = len(seen & home), len(seen - home)
    if both < MIN_COMMON:
        here, there = (
            listing([quoted(name) for name in sorted(names, key=natural)] or ["none"], 3)
            for names in (seen, home)
        )
        return [
            f"{both} of the {len(seen)} landmarks of the drive have a home bearing; a pose needs "
            f"{MIN_COMMON}. Check that ids are equal: the drive has {here}; home has {there}."
        ]
    plural = " has" if without_home == 1 else "s have"
    words = f"{without_home} landmark{plural} no home bearing, and can only extend the map."
    return [words] if without_home else []


def _odometry(table: Table, remarks: dict[str, int]) -> Odometry:
    """Return the odometry of a table of twists or poses."""
    if "v" in table.columns:
        return odometry_of(table, remarks)
    kept = without_repeats(table, remarks, REPEATED_ODOMETRY)
    poses = np.stack([kept["x"], kept["y"], kept["heading"]], axis=1)
    remarks[FROM_POSES] = len(kept)
    remark_other_units(kept["t"], remarks)
    return odometry_from_poses(kept["t"], poses, remarks)
