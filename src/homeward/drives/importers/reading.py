"""A drive from tables of any layout, of text files or of formats that packages of others read.

Such a package has an entry point of the group `SOURCES`: a function of the path of a file or
folder. It returns the columns of each table by name, or None for another format; names of columns
may have dots, and units as in a text file.
"""

from __future__ import annotations

import dataclasses
import math
import re
import tempfile
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

from homeward.drives.columns import KINDS, specified_columns
from homeward.drives.drive import Drive, Odometry, Tilt, Truth
from homeward.drives.folder import (
    HOME_ADVICE,
    REPEATED_ODOMETRY,
    home_of,
    samples_of,
    sightings_of,
    without_repeats,
)
from homeward.drives.home.when import with_home
from homeward.drives.ids import with_names_of
from homeward.drives.importers.mrclam import is_mrclam
from homeward.drives.importers.odometry import imported_odometry
from homeward.drives.importers.parts import MIN_COMMON, UNIX_S, Imported, Part
from homeward.drives.importers.pixels import Calibrations, Pixels
from homeward.drives.importers.recognition import parts_of
from homeward.drives.importers.sense import (
    FITS,
    NOT_DECIDED,
    REMARK,
    require_imported_senses,
    with_senses,
)
from homeward.drives.importers.sheet import sheet
from homeward.drives.measure import with_yaw_rate
from homeward.drives.opening import DRIVE_FOLDER, kind_of, tables_in
from homeward.drives.opening import KINDS as KINDS_OF_DRIVES
from homeward.drives.plausibility import with_clock_remarks
from homeward.drives.ros.kinds import is_log
from homeward.drives.ros.log import Log
from homeward.drives.settings import DriveSettings, HomeWhen, Wheels
from homeward.errors import InputError
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose, between
from homeward.io.naming import command, listing, natural
from homeward.io.table import Table, quoted, write_csv
from homeward.odometry.history import dead_reckoning
from homeward.plugins import FAULTS, fault, installed, load
from homeward.sighting_keys import is_unlabelled

SOURCES = "homeward.sources"


@contextmanager
def text_files(files: Sequence[Path]) -> Iterator[list[Path]]:
    """Yield the files, those of other formats as text files with one of their tables each.

    `InputError` where a source fails; later ones name the original file and the table.
    """
    with tempfile.TemporaryDirectory(prefix="homeward-") as scratch:
        found, origins = list[Path](), dict[Path, Path]()
        for number, path in enumerate(files):
            tables = _tables(path)
            folder = Path(scratch, str(number))
            for name, columns in ({} if tables is None else tables).items():
                folder.mkdir(exist_ok=True)
                cells = ([_plain(cell) for cell in column] for column in columns.values())
                write_csv(folder / name, columns, zip(*cells, strict=True))
                origins[folder / name] = path / name
            found += [path] if tables is None else [folder / name for name in tables]
        try:
            yield found
        except InputError as error:
            if error.file is not None:
                error.file = origins.get(error.file, error.file)
            raise


def _tables(path: Path) -> Mapping[str, Mapping[str, Sequence[Any]]] | None:
    """Return the tables of a file by the first source that reads it; None without one."""
    for name in installed(SOURCES):
        source = load(SOURCES, name, ())
        try:
            found = source(path)
            if found is None:
                continue
            sizes = [{len(cells) for cells in columns.values()} for columns in found.values()]
        except FAULTS as error:
            raise fault(f"source {name}: reading {path.name}", error) from error
        if not found or any(len(size) != 1 for size in sizes):
            raise InputError(f"source {name} returned no table, or columns of unequal length", path)
        if bad := [name for name in found if not re.fullmatch(r"\w[\w.-]*", name)]:
            raise InputError(f"source {name}: {bad[0]!r} is no name of a table", path)
        return found  # type: ignore[no-any-return]
    return None


def _plain(cell: Any) -> Any:
    """Return a cell as Python writes it exactly; empty where it is missing."""
    cell = cell.item() if hasattr(cell, "item") else cell
    return "" if cell is None or cell != cell else cell


OTHER_SOURCES = {
    "odometry": ", and none with odom in its name has poses",
    "bearings": ", or a position or pixels instead of the bearing",
    "home": " without a time",
}
"""Other sources of the tables of a drive."""
AVERAGED = "rows of home bearings, averaged for each landmark"
MAX_HOME_SPREAD = 0.1
"""Maximum deviation from their mean of the home bearings of a landmark [rad]."""
MAX_DRIFT = 0.003
"""Maximum deviation of poses from dead reckoning that are no ground truth, over its length [1]."""
EQUAL_POSES = (
    "poses of {0} not used: they are within {1:.3g} m of the dead reckoning of the odometry; if "
    "they are ground truth, use --as {0}=truth"
)
AS = {"detections": "bearings"} | {kind: kind for kind in KINDS}
"""The kinds of tables by their names in the option --as."""


def understand(
    files: Sequence[Path],
    columns: Sequence[str] = (),
    kinds: Sequence[str] = (),
    wheels: Wheels | None = None,
    cameras: Calibrations | None = None,
    tag_size: float | None = None,
) -> dict[str, Imported]:
    """Read text files, with the roles and units of their columns recognised, by kind of table.

    The tables may have any separator, decimal mark, header and units; files of other formats are
    read by installed sources. `columns` are texts ``[FILE:]ROLE=COLUMN[UNIT]`` that specify or
    correct roles, `kinds` texts ``FILE=KIND`` with a key of `AS`. `wheels`, their geometry, prefers
    wheels to poses in one file; `cameras` are those of pixels, `tag_size` that of tags with corners
    [m]. Bearings get the sense of rotation of the odometry. `InputError` where a file cannot be
    read, contains no table of a drive, or a role is ambiguous.
    """
    with text_files(files) as texts:
        for path in texts:
            _refuse_drives(path)
        sheets = [sheet(path) for path in texts]
        there = {one.path.name: (*one.names, *one.numbers) for one in sheets}
        specified = specified_columns(columns, there)
        parts = parts_of(sheets, specified, _kinds(kinds, there), wheels is not None, cameras)
        if tag_size is not None:
            _set_tag_size(parts, tag_size)
        found = _read(parts)
        with suppress(InputError):  # `drive_of` raises it after the columns are shown
            found = with_senses(_odometry(found, wheels, {}), found)
        return found


def _read(parts: Sequence[Part]) -> dict[str, Imported]:
    """Read the tables by kind."""
    found: dict[str, Imported] = {}
    # Odometry first: from its rate, the unit of stamps can be guessed. Bearings before home: they
    # are more, so one of them probably exceeds 2 pi if they are in degrees.
    for kind in KINDS:
        mine = [part for part in parts if part.kind == kind]
        for extra in mine[1:]:
            advice = f"give its roles, as in --columns '{extra.sheet.path.name}: t=1, ...'"
            if not extra.sheet.headless:
                name = extra.sheet.path.name
                advice = f"leave one out, or use --as {name}=KIND for another kind, such as home"
            raise InputError(f"a second file with {kind}", extra.sheet.path, advice=advice)
        for part in mine:
            others = [p for p in parts if p.sheet is part.sheet and p.kind != "tilt"]
            part.is_alone = len(others) == 1
            timed = (one for one in found.values() if "t" in one.columns and len(one.table))
            seen = found["bearings"].columns["bearing"] if "bearings" in found else None
            angle = seen.unit if seen is not None and seen.is_guessed else None
            found[kind] = part.read(next(timed, None), angle)
    return found


def _set_tag_size(parts: Sequence[Part], tag_size: float) -> None:
    """Give the corners of tags their size [m]; `InputError` where there are none."""
    is_used = False
    for part in parts:
        if isinstance(part.source, Pixels) and "row0" in part.columns:
            part.source = dataclasses.replace(part.source, tag_size=tag_size)
            is_used = True
    if not is_used:
        raise InputError("not used: no table has the corners of tags", part="--tag-size")


def _refuse_drives(path: Path) -> None:
    """Refuse a folder, or a log, which needs no import, with the command to use instead."""
    if is_log(path):
        ways = f"`homeward run {path}`, or `homeward convert {path} my_drive` for a drive folder"
        raise InputError(f"a log ({Log(path).kind}) needs no import", path, advice=f"use {ways}")
    if not path.is_dir():
        return
    if not any(recognises(path) for recognises in (*KINDS_OF_DRIVES.values(), is_mrclam)):
        files: Sequence[object] = tables_in(path) or ["FILE", "..."]
        way = command("import", *files, "--out", f"out/{path.resolve().name}")
        raise InputError("a folder, not a text file", path, advice=f"give the files in it: `{way}`")
    kind = kind_of(path)
    way = command("run" if kind == DRIVE_FOLDER else "info", path)
    raise InputError(f"a {kind.partition(' (')[0]} needs no import", path, advice=f"use `{way}`")


def drive_of(
    found: Mapping[str, Imported],
    name: str,
    home: HomeWhen | None = None,
    wheels: Wheels | None = None,
    on_progress: Callable[[float], None] | None = None,
    *,
    home_needed: bool = True,
) -> Drive:
    """Return the drive of imported tables, with its home as in `open_drive`.

    `wheels` is their geometry, where the odometry comes from wheels. `InputError` names the missing
    table, or the file and row of the problem.
    """
    for kind in ("odometry", "bearings", "home")[: 3 if home is None and home_needed else 2]:
        if kind not in found:
            needs = ", ".join(KINDS[kind]) + OTHER_SOURCES[kind]
            label = kind.replace("home", "home bearings")
            advice = "give roles with --columns if the names of columns were not recognised"
            if kind == "home":
                advice += f", {HOME_ADVICE}"
            raise InputError(f"no {label} found: no file has the columns {needs}", advice=advice)
    found = dict(found)
    if "tilt" not in found:  # without use
        table = found["bearings"].table
        columns = {name: values for name, values in table.columns.items() if name != "elevation"}
        table = dataclasses.replace(table, columns=columns)
        found["bearings"] = dataclasses.replace(found["bearings"], table=table)
    start = float(np.min(found["odometry"].table["t"], initial=math.inf))
    epoch = math.floor(start) if UNIX_S[0] <= start < UNIX_S[1] else 0
    for kind, one in found.items():
        if "t" in one.table.columns:
            found[kind] = one.changed({"t": one.table["t"] - epoch})
    tables = {kind: one.table for kind, one in found.items()}
    remarks = {reason: n for one in found.values() for reason, n in one.remarks.items()}
    odometry = _odometry(found, wheels, remarks)
    given: dict[str, Any] = {"epoch": epoch} if epoch else {}
    if wheels not in (None, Wheels()):
        turned_by_gyro = "gyro" in tables or "omega" in tables["odometry"].columns
        given["wheels"] = wheels.without_turns if turned_by_gyro else wheels
    if REMARK in remarks:
        given["signs_changed"] = remarks[REMARK]
    seen = sightings_of(tables["bearings"], remarks)
    at_home = with_names_of(seen, tables["home"], remarks) if "home" in tables else None
    drive = Drive(
        name=name,
        odometry=odometry,
        sightings=seen,
        home=home_of(_averaged(at_home, remarks), remarks) if at_home is not None else {},
        settings=DriveSettings(**given),
        truth=samples_of(Truth, tables["truth"], remarks) if "truth" in tables else None,
        tilt=samples_of(Tilt, tables["tilt"], remarks) if "tilt" in tables else None,
        remarks=remarks,
    )
    if "truth" in found and found["truth"].is_unsure:
        drive = _without_dead_reckoning(drive, tables["truth"].file)
    drive = with_clock_remarks(drive, tables["bearings"].file)
    require_imported_senses(drive, found)
    return drive if home is None else with_home(drive, home, on_progress)


def _averaged(home: Table, remarks: dict[str, int]) -> Table:
    """Return home bearings with one row for each landmark, the mean of its rows if they agree."""
    ids, first, index = np.unique(
        home["landmark"].astype(str), return_index=True, return_inverse=True
    )
    total = np.zeros(ids.size, complex)
    np.add.at(total, index, np.exp(1j * home["bearing"]))
    error = np.abs(wrap(home["bearing"] - np.angle(total)[index]))
    is_plain = ids.size == len(home) or any(map(is_unlabelled, ids.tolist()))
    if is_plain or not error.max() <= MAX_HOME_SPREAD:
        return home
    remarks[AVERAGED] = len(home)
    columns = {name: values[first] for name, values in home.columns.items()}
    return Table(home.file, home.row[first], columns | {"bearing": np.angle(total)})


def sense_warnings(drive: Drive, found: Mapping[str, Imported]) -> list[str]:
    """Return a warning where the senses and units of bearings could not be tested."""
    columns = (column for one in found.values() for column in one.columns.values())
    is_tested = any(column.source.endswith(FITS) for column in columns)  # in its former unit
    decided = require_imported_senses(drive, found).sense
    return [] if is_tested or decided is not None else [NOT_DECIDED]


def home_warnings(drive: Drive) -> list[str]:
    """Return warnings about landmarks that home and the drive do not have in common."""
    seen, home = set(drive.sightings.landmark.tolist()), set(drive.home)
    both, without_home = len(seen & home), sum(not is_unlabelled(name) for name in seen - home)
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


def _odometry(
    found: Mapping[str, Imported], wheels: Wheels | None, remarks: dict[str, int]
) -> Odometry:
    """Return the odometry of imported tables, with the yaw rate of a gyroscope if any."""
    if "odometry" not in found:
        raise InputError("no odometry")
    odometry = imported_odometry(found["odometry"], wheels or Wheels(), remarks)
    if "gyro" in found:
        gyro = without_repeats(found["gyro"].table, remarks, REPEATED_ODOMETRY)
        may_be_deg = found["gyro"].columns["omega"].may_be_deg
        yaw_rate = gyro["t"], gyro["omega"], gyro.file.name
        odometry = with_yaw_rate(odometry, *yaw_rate, remarks, may_be_deg)
    return odometry


def _kinds(texts: Sequence[str], there: Collection[str]) -> dict[str, str]:
    """Return the kinds by file name of ``FILE=KIND`` texts."""
    found = {}
    for text in texts:
        file, _, kind = text.rpartition("=")
        name = Path(file.strip()).name
        if kind.strip() not in AS or name not in there:
            problem = f"no file {name!r}" if kind.strip() in AS else "must be FILE=KIND"
            advice = f"use one of the files, and one of {', '.join(AS)}"
            raise InputError(problem, part=f"--as {text}", advice=advice)
        found[name] = AS[kind.strip()]
    return found


def _without_dead_reckoning(drive: Drive, path: Path) -> Drive:
    """Return a drive without ground truth if its poses equal the dead reckoning of the odometry.

    `InputError` where `path`, the file of the poses, is named odometry, but they differ.
    """
    assert drive.truth is not None
    t, odometry, file = drive.truth.t, drive.odometry, path.name
    during = (t >= odometry.t[0]) & (t <= odometry.t[-1])
    poses = np.stack([drive.truth.x, drive.truth.y, drive.truth.heading])[:, during]
    if poses.shape[1] < 2:
        return drive
    reckoned = np.stack(dead_reckoning(odometry, t[during]))
    there, here = (between(Pose(*p[:, :1]), Pose(*p)) for p in (poses, reckoned))
    length = np.hypot(np.diff(here.x), np.diff(here.y)).sum()
    drift = float(np.hypot(there.x - here.x, there.y - here.y).max())
    if drift > MAX_DRIFT * length:
        if "odom" in file.lower():
            raise InputError(
                f"poses that deviate by up to {drift:.3g} m from the other odometry",
                path,
                advice=f"leave one of the files out, or use --as {file}=truth if the "
                "poses are ground truth",
            )
        return drive
    remarks = {EQUAL_POSES.format(file, drift): t.size} | {
        reason: number for reason, number in drive.remarks.items() if f"--as {file}=" not in reason
    }
    return dataclasses.replace(drive, truth=None, remarks=remarks)
