"""The drive folder, homeward's format of CSV files."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import TypeVar

import numpy as np

from homeward.drives.drive import Drive, HomeBearing, Odometry, Sightings, Tilt, Truth
from homeward.drives.ids import with_keys, with_names_of
from homeward.drives.landmarks import KnownLandmarks
from homeward.drives.plausibility import remark_other_units, without_implausible
from homeward.drives.ros.kinds import is_log
from homeward.drives.settings import HOME_TIMES, DriveSettings
from homeward.errors import InputError
from homeward.geometry.angles import wrap
from homeward.io.naming import listing, natural
from homeward.io.reading import is_there, require_folder
from homeward.io.settings import commented_yaml, read_settings, settings_yaml
from homeward.io.table import (
    Parser,
    Table,
    identifiers_or_empty,
    is_identifier,
    numbers,
    numbers_or_nan,
    quoted,
    read_csv,
    write_csv,
)
from homeward.io.writing import whole_folder
from homeward.odometry.validity import MAX_DELAY_S
from homeward.sighting_keys import numbered, without_number

ODOMETRY, BEARINGS, HOME = "odometry.csv", "bearings.csv", "home.csv"
SETTINGS, TRUTH, KNOWN = "drive.yaml", "truth.csv", "landmarks.yaml"
TILT = "tilt.csv"
HOME_ADVICE = f"add a table with the columns landmark, bearing ({HOME}); or use {HOME_TIMES}"
COMMENTED = (
    "# Settings of this drive. To set a key, remove the # before it. docs/look-up/files.md and\n"
    "# `homeward settings drive` describe the keys.\n"
)
"""Head of a commented drive.yaml."""
IMPORT_ADVICE = "; use homeward import to convert tables with other columns"
REQUIRED, OPTIONAL = (ODOMETRY, BEARINGS, HOME), (SETTINGS, TRUTH, KNOWN, TILT)
OPTIONAL_COLUMNS = frozenset({"sigma", "range", "range_sigma", "elevation"})
CAMERA = "camera"
_IDS = identifiers_or_empty
COLUMNS: Mapping[str, tuple[Mapping[str, Parser], Mapping[str, Parser]]] = {
    ODOMETRY: (
        {"t": numbers, "v": numbers_or_nan, "omega": numbers_or_nan},
        {"vy": numbers_or_nan},
    ),
    BEARINGS: (
        {"t": numbers, "bearing": numbers, "landmark": _IDS},
        {**dict.fromkeys(sorted(OPTIONAL_COLUMNS), numbers_or_nan), CAMERA: _IDS},
    ),
    HOME: ({"landmark": _IDS, "bearing": numbers}, {"sigma": numbers_or_nan, CAMERA: _IDS}),
    TRUTH: (dict.fromkeys(("t", "x", "y", "heading"), numbers), {}),
    TILT: (dict.fromkeys(("t", "roll", "pitch"), numbers), {}),
}
"""Required and optional columns of each file."""
SORTED = "rows of {} were out of order; sorted by time"
SIGNS_CHANGED = (
    "bearings with a sign that homeward import changed to fit the yaw rates; if these are wrong, "
    "as of wheels whose left and right are exchanged, the track is mirrored: import it again"
)
REPEATED_ODOMETRY = "odometry rows with a repeated stamp; the last counts"
REPEATED_TRUTH = "ground truth rows with a repeated stamp; the last counts"
REPEATED_TILT = "rows of roll and pitch with a repeated stamp; the last counts"
NO_ODOMETRY = (
    f"stamps of bearings without odometry ({ODOMETRY} is missing): poses use the bearings of "
    "surveyed landmarks only"
)
BAD_RANGES = "ranges that are not greater than 0, or infinite; only their bearings are used"
BEYOND_A_TURN = (
    "bearings beyond a full turn were wrapped; convert them to rad if they are in degrees"
)


def is_drive_folder(path: Path) -> bool:
    """Whether a folder contains a required file of a drive.

    The folder of a ROS 2 bag may contain a home.csv; without odometry.csv it is a bag.
    """
    if is_there(path / ODOMETRY):
        return True
    return any(is_there(path / name) for name in REQUIRED) and not is_log(path)


def has_home(folder: Path) -> bool:
    """Return whether a folder defines home without home.csv: by a survey or the time at home."""
    return _is_surveyed(folder) or read_drive_settings(folder / SETTINGS).home is not None


def _is_surveyed(folder: Path) -> bool:
    """Return whether the landmarks of a folder are surveyed in the home frame."""
    known = folder / KNOWN
    return is_there(known) and read_settings(known, KnownLandmarks).surveyed_from_home


def missing_files(folder: Path, home_needed: bool = True) -> list[str]:
    """Return the required files that a drive folder lacks.

    A survey in the home frame replaces odometry.csv and home.csv; settings with the time at home
    replace home.csv.
    """
    absent = [name for name in REQUIRED if not is_there(folder / name)]
    if HOME in absent and (not home_needed or has_home(folder)):
        absent.remove(HOME)
    if ODOMETRY in absent and _is_surveyed(folder):
        absent.remove(ODOMETRY)
    return absent


def read_folder(path: str | os.PathLike[str], *, home_needed: bool = True) -> Drive:
    """Read a drive folder; `InputError` names the file, the row and the problem.

    The folder has odometry.csv (t, v, omega[, vy]), bearings.csv (t, landmark, bearing[, sigma]
    [, range, range_sigma][, camera][, elevation]), home.csv (landmark, bearing[, sigma]
    [, camera]), drive.yaml, landmarks.yaml, truth.csv (t, x, y, heading in the home frame) and
    tilt.csv (t, roll, pitch), in s, m and rad. The last four are optional. Other files and columns
    are ignored. A survey in the home frame replaces home.csv and odometry.csv. A time at home in
    drive.yaml replaces home.csv. With `home_needed`, one of these must define home.

    Rows up to `MAX_DELAY_S` out of order are sorted by time. Bearings are wrapped, and landmark ids
    stripped of white space. The last of equal stamps counts. Remarks count these corrections, and
    report units that seem wrong.
    """
    folder = Path(path)
    require_folder(folder)
    missing = missing_files(folder, home_needed)
    if missing:
        advice = None
        if missing == [HOME]:
            from homeward.drives.home.when import with_proposal  # only a refusal needs it

            advice = with_proposal(HOME_ADVICE, read_folder(folder, home_needed=False))
        problem = f"not a complete drive folder: no {', '.join(missing)}"
        raise InputError(problem, folder, advice=advice)
    surveyed = is_there(folder / KNOWN)
    known = read_settings(folder / KNOWN, KnownLandmarks) if surveyed else KnownLandmarks()
    remarks: dict[str, int] = {}
    sightings = read_sightings(folder / BEARINGS, remarks)
    if is_there(folder / ODOMETRY):
        odometry = read_odometry(folder / ODOMETRY, remarks)
    else:
        t = np.unique(sightings.t)
        odometry = Odometry(t, np.full(t.size, np.nan), np.full(t.size, np.nan))
        remarks[NO_ODOMETRY] = t.size
    settings = read_drive_settings(folder / SETTINGS)
    together = {name for group in settings.together for name in group}
    for file, given in ((KNOWN, known.names), (SETTINGS, together)):
        if absent := sorted(given - set(sightings.landmark.tolist()), key=natural):
            names = listing([quoted(name) for name in absent], 3)
            remarks[f"landmarks of {file} without sightings in this drive: {names}"] = len(absent)
    if settings.signs_changed:
        remarks[SIGNS_CHANGED] = settings.signs_changed
    return Drive(
        name=folder.resolve().name,
        odometry=odometry,
        sightings=sightings,
        home=read_home(folder / HOME, remarks, sightings) if is_there(folder / HOME) else {},
        settings=settings,
        truth=read_samples(Truth, folder / TRUTH, remarks),
        remarks=remarks,
        known=known,
        tilt=read_samples(Tilt, folder / TILT, remarks),
    )


def write_folder(drive: Drive, path: str | os.PathLike[str], *, commented: bool = False) -> None:
    """Write a drive folder that `read_folder` reads back exactly, without name and remarks.

    With `commented`, drive.yaml also lists the other keys, commented out, for users who edit it.
    All files appear together. In an existing folder the files of a drive are replaced or, where
    this drive lacks them, deleted. `InputError` where the folder cannot be written, or the drive
    has no odometry, numbers that are not finite, or invalid ids.
    """
    folder = Path(path)
    with whole_folder(folder, owned=(*REQUIRED, *OPTIONAL)) as scratch:
        _write_files(drive, scratch, folder, commented)


def sorted_by_time(table: Table, what: str, remarks: dict[str, int]) -> Table:
    """Return a table in order of its times `t` [s]; the sort is stable.

    `remarks` counts the rows of `what` that are out of order. Rows may be up to `MAX_DELAY_S` late,
    or grouped by landmark. `InputError` for a later row: a clock was set back, or the table
    contains two drives.
    """
    t = table["t"]
    late = np.maximum.accumulate(t) - t
    if not late.any():
        return table
    if late.max() > MAX_DELAY_S and not _by_landmarks(table):
        i = int(np.argmax(late > MAX_DELAY_S))
        problem = (
            f"time runs backwards by {float(late[i]):.6g} s: {float(t[i])!r} after "
            f"{float(t[: i + 1].max())!r}, by more than {MAX_DELAY_S:g} s"
        )
        advice = "split the table where a clock was set back or another drive begins"
        raise InputError(problem, table.file, int(table.row[i]), advice=advice)
    order = np.argsort(t, kind="stable")
    remarks[SORTED.format(what)] = int((late > 0).sum())
    return table.rows(order)


def _by_landmarks(table: Table) -> bool:
    """Whether a table is grouped by landmark, each in order of time."""
    if "landmark" not in table.columns:
        return False
    ids, t = table["landmark"], table["t"]
    changes = int((ids[1:] != ids[:-1]).sum()) + 1
    return changes == len(set(ids.tolist())) and bool((np.diff(t)[ids[1:] == ids[:-1]] >= 0).all())


MIN_ROWS, MIN_STAMPS = 20, 0.1
"""Minimum share of different stamps in a table with at least this number of rows."""


def without_repeats(table: Table, remarks: dict[str, int], reason: str) -> Table:
    """Return a table with the last row of equal times `t` [s]; count the others in `remarks`.

    `InputError` where the table is empty or not in order, or most of its times are equal.
    """
    table.require_rows()
    table.require_order()
    t = table["t"]
    kept = table.rows(np.append(t[1:] != t[:-1], True)[: t.size])
    if len(table) >= MIN_ROWS and len(kept) < MIN_STAMPS * len(table):
        problem = (
            f"the {len(table):,} rows have {len(kept):,} different stamps, as if a spreadsheet had "
            "rounded them"
        )
        raise InputError(problem, table.file, advice="export all digits of the times")
    if len(kept) < len(table):
        remarks[reason] = len(table) - len(kept)
    return kept


def wrapped(table: Table, name: str, remarks: dict[str, int]) -> np.ndarray:
    """Return column `name` [rad] wrapped to (-pi, pi]; angles within stay bit-identical.

    `remarks` counts angles beyond a full turn, which may be degrees.
    """
    table.require_angle(name)
    angle = table[name]
    if beyond := int((np.abs(angle) > math.tau).sum()):
        remarks[BEYOND_A_TURN] = remarks.get(BEYOND_A_TURN, 0) + beyond
    inside = (angle > -math.pi) & (angle <= math.pi)
    # Rounding can leave a multiple of pi one bit outside.
    return np.where(inside, angle, np.clip(wrap(angle), np.nextafter(-math.pi, 0), math.pi))


def _read(file: str, path: Path, remarks: dict[str, int]) -> Table:
    """Read a table with the columns of a file of a drive folder."""
    required, optional = COLUMNS[file]
    return read_csv(path, required, optional, advice=IMPORT_ADVICE, remarks=remarks)


def read_odometry(path: Path, remarks: dict[str, int]) -> Odometry:
    """Read odometry.csv (t, v, omega[, vy]); `remarks` lists anomalies of stamps and motion.

    A row in which both v and omega are empty starts an interval of unknown motion.
    """
    table = _read(ODOMETRY, path, remarks)
    for name in sorted(table.columns.keys() - {"t"}):
        empty = np.isnan(table[name]) & ~(np.isnan(table["v"]) & np.isnan(table["omega"]))
        if empty.any():
            advice = "leave all speeds empty where the motion is unknown"
            raise InputError(
                "empty", path, int(table.row[np.argmax(empty)]), part=name, advice=advice
            )
    return odometry_of(table, remarks)


def odometry_of(table: Table, remarks: dict[str, int]) -> Odometry:
    """Return the odometry of a table with t, v, omega[, vy]; as `read_folder`."""
    table = sorted_by_time(table, "odometry", remarks)
    table = without_repeats(table, remarks, REPEATED_ODOMETRY)
    remark_other_units(table["t"], remarks)
    twist = (table[name] for name in ("v", "omega", "vy") if name in table.columns)
    return without_implausible(Odometry(table["t"], *twist), remarks)


def read_sightings(path: Path, remarks: dict[str, int]) -> Sightings:
    """Read a bearings.csv; columns, errors and remarks as `read_folder`."""
    return sightings_of(_read(BEARINGS, path, remarks), remarks)


def sightings_of(table: Table, remarks: dict[str, int]) -> Sightings:
    """Return the sightings of a table; as `read_sightings`."""
    table = sorted_by_time(table, "bearings", remarks)
    bearings = wrapped(table, "bearing", remarks)
    ranges = _ranges(table, remarks), _sigma(table, "range_sigma")
    cameras = [table[CAMERA]] if CAMERA in table.columns else []
    columns = table["t"], table["landmark"], bearings, _sigma(table), *ranges, *cameras
    sightings = Sightings(*columns)
    if "elevation" in table.columns:
        sightings = replace(sightings, elevation=table["elevation"])
    if cameras:
        number = np.unique(cameras[0].astype(str), return_inverse=True)[1]
        sightings = sightings.rows(np.lexsort((number, sightings.t)))
    return with_keys(sightings, remarks)


def read_home(
    path: Path, remarks: dict[str, int], seen: Sightings | None = None
) -> dict[str, HomeBearing]:
    """Read a home.csv (landmark, bearing[, sigma][, camera]); as `home_of`."""
    return home_of(_read(HOME, path, remarks), remarks, seen)


def home_of(
    table: Table, remarks: dict[str, int], seen: Sightings | None = None
) -> dict[str, HomeBearing]:
    """Return the home bearings of a table, with the ids and classes of the sightings `seen`."""
    if seen is not None:
        table = with_names_of(seen, table, remarks)
    keys = np.array(numbered(table["landmark"].tolist()), object)
    table = replace(table, columns={**table.columns, "landmark": keys})
    table.require_unique("landmark")
    bearings = wrapped(table, "bearing", remarks)
    cameras = table[CAMERA].tolist() if CAMERA in table.columns else [""] * len(table)
    rows = zip(bearings.tolist(), _sigma(table).tolist(), cameras, strict=True)
    return dict(zip(table["landmark"].tolist(), (HomeBearing(*row) for row in rows), strict=True))


def _sigma(table: Table, name: str = "sigma") -> np.ndarray:
    """Return an optional column of standard deviations, NaN where not given."""
    if name not in table.columns:
        return np.full(len(table), np.nan)
    sigma = table[name]
    is_valid = (sigma > 0) & np.isfinite(sigma)
    table.require(name, np.isnan(sigma) | is_valid, "must be greater than 0, not {}")
    return sigma


def _ranges(table: Table, remarks: dict[str, int]) -> np.ndarray:
    """Return the optional column range [m], NaN where not given; `remarks` counts bad ones."""
    if "range" not in table.columns:
        return np.full(len(table), np.nan)
    ranges = table["range"]
    bad = ~((ranges > 0) & np.isfinite(ranges)) & ~np.isnan(ranges)
    if bad.any():
        remarks[BAD_RANGES] = int(bad.sum())
    return np.where(bad, np.nan, ranges)


def read_drive_settings(path: Path) -> DriveSettings:
    """Read drive.yaml, which may be absent."""
    return read_settings(path, DriveSettings) if is_there(path) else DriveSettings()


Sampled = TypeVar("Sampled", Truth, Tilt)
SAMPLES = {
    Truth: ("ground truth", REPEATED_TRUTH, ("heading",)),
    Tilt: ("roll and pitch", REPEATED_TILT, ("roll", "pitch")),
}
"""For each kind of samples: its name, the remark on repeated stamps, and its angles."""


def read_samples(kind: type[Sampled], path: Path, remarks: dict[str, int]) -> Sampled | None:
    """Read truth.csv (t, x, y, heading) or tilt.csv (t, roll, pitch); None where it is absent."""
    if not is_there(path):
        return None
    return samples_of(kind, _read(TRUTH if kind is Truth else TILT, path, remarks), remarks)


def samples_of(kind: type[Sampled], table: Table, remarks: dict[str, int]) -> Sampled:
    """Return the ground truth or the tilt of a table; as `read_samples`."""
    what, repeats, angles = SAMPLES[kind]
    table = without_repeats(sorted_by_time(table, what, remarks), remarks, repeats)
    for name in angles:
        table.require_angle(name)
    return kind(*(table[column.name] for column in fields(kind)))


def _write_files(drive: Drive, scratch: Path, folder: Path, commented: bool) -> None:
    """Write all files of a drive into `scratch`; errors name files of `folder`."""
    if not drive.odometry.t.size:
        raise InputError("no rows", folder / ODOMETRY)
    may_lack = set(OPTIONAL_COLUMNS)
    if (np.isnan(drive.odometry.v) == np.isnan(drive.odometry.omega)).all():
        may_lack |= {"v", "omega", "vy"}  # unknown motion
    for name, columns in _columns(drive).items():
        cells = [
            _cells(column, values, folder / name, column in may_lack)
            for column, values in columns.items()
        ]
        write_csv(scratch / name, columns, zip(*cells, strict=True))
    for name, model in ((SETTINGS, drive.settings), (KNOWN, drive.known)):
        text = settings_yaml(model)
        if commented and name == SETTINGS:
            text = COMMENTED + commented_yaml(model)
        if text:
            (scratch / name).write_text(text, encoding="utf-8")


def _columns(drive: Drive) -> dict[str, dict[str, np.ndarray]]:
    """Return the columns of each CSV file of a drive, without optional ones that have no value."""
    home, ids = drive.home.values(), [without_number(str(i)) for i in drive.sightings.landmark]
    files = {
        ODOMETRY: dict(vars(drive.odometry)),
        BEARINGS: vars(drive.sightings) | {"landmark": np.array(ids, object)},
        HOME: {
            "landmark": np.array([*map(without_number, drive.home)], object),
            "bearing": np.array([seen.bearing for seen in home], float),
            "sigma": np.array([seen.sigma for seen in home], float),
            CAMERA: np.array([seen.camera for seen in home], object),
        },
    }
    if not drive.odometry.moves_sideways:
        del files[ODOMETRY]["vy"]
    for name, samples in ((TRUTH, drive.truth), (TILT, drive.tilt)):
        if samples is not None:
            files[name] = dict(vars(samples))
    for name, columns in files.items():
        for column in COLUMNS[name][1].keys() & columns.keys() - {"vy"}:
            values = columns[column]
            if not any(values) if column == CAMERA else np.isnan(values).all():
                del columns[column]
    return files


def _cells(column: str, values: np.ndarray, file: Path, may_lack: bool) -> list[str]:
    """Return a column as text; repr is the shortest text of a float that reads back exactly."""
    if column in ("landmark", CAMERA):
        ids = [str(value) for value in values]
        if bad := [i for i in ids if i and not is_identifier(i)]:
            problem = f"{column} {quoted(bad[0])} is not a valid id (printable, no outer spaces)"
            raise InputError(problem, file)
        return ids
    missing = np.isnan(values) if may_lack else np.zeros(values.shape, bool)
    if not (missing | np.isfinite(values)).all():
        raise InputError(f"{column} contains a number that is not finite", file)
    pairs = zip(values.tolist(), missing.tolist(), strict=True)
    return ["" if is_missing else repr(float(value)) for value, is_missing in pairs]
