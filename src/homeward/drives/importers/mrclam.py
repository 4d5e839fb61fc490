"""Reader of UTIAS MRCLAM folders; other robots are ignored.

Format and source: Leung, Halpern, Barfoot and Liu, "The UTIAS multi-robot cooperative localization
and mapping dataset", IJRR 2011. The dataset has no home bearings, so the user chooses a home, and
its bearings are computed from the surveyed landmarks.
"""

from __future__ import annotations

import math
import os
from dataclasses import replace
from pathlib import Path

import numpy as np

from homeward.drives.drive import Drive, HomeBearing, Sightings, Truth
from homeward.drives.folder import odometry_of, samples_of, sightings_of, sorted_by_time
from homeward.drives.plausibility import with_clock_remarks
from homeward.drives.settings import DriveSettings, Sensor
from homeward.errors import InputError
from homeward.geometry.frames import Pose, bearing
from homeward.io.naming import command
from homeward.io.reading import is_there, require_folder
from homeward.io.table import Table, read_columns

BARCODES = "Barcodes.dat"
OTHER_ROBOTS = "sightings of other robots"
UNKNOWN_BARCODES = "sightings of unknown barcodes"


def is_mrclam(path: Path) -> bool:
    """Whether a folder is an MRCLAM folder."""
    return is_there(path / BARCODES)


def read_mrclam(
    path: str | os.PathLike[str], robot: int, home: Pose, home_noise: float = 0.0, seed: int = 0
) -> Drive:
    """Read the drive of one robot of an MRCLAM folder; `InputError` names the file and the row.

    The folder has Barcodes.dat, Landmark_Groundtruth.dat and, for robot N, RobotN_Odometry.dat,
    RobotN_Measurement.dat and optionally RobotN_Groundtruth.dat. Landmark ids are the subjects'
    numbers; ground truth is in the home frame. Remarks count ignored sightings.

    `home` is x [m], y [m] and heading [rad] in the frame of the survey. Its bearings have normal
    noise with a standard deviation of `home_noise` [rad] from a `seed`.
    """
    folder = Path(path)
    if not all(math.isfinite(value) for value in home):
        raise InputError("home must be three finite numbers: x [m], y [m], heading [rad]")
    if not (math.isfinite(home_noise) and home_noise >= 0):
        raise InputError(f"home noise must be finite and not negative, not {home_noise}")
    if seed < 0:
        raise InputError(f"seed must not be negative, not {seed}")
    require_folder(folder)
    if not is_there(folder / f"Robot{robot}_Odometry.dat"):
        advice = f"choose one of: {robots_in(folder)}"
        raise InputError(f"no robot {robot} in it", folder, advice=advice)
    survey, numbers = _by_subject(
        folder / "Landmark_Groundtruth.dat", ("subject", "x", "y", "x_sigma", "y_sigma")
    )
    places = zip(survey["x"].tolist(), survey["y"].tolist(), strict=True)
    landmarks = dict(sorted(zip(numbers, places, strict=True)))
    barcodes, owners = _by_subject(folder / BARCODES, ("subject", "barcode"))
    barcodes.require_unique("barcode")
    subjects = dict(zip(_whole(barcodes, "barcode"), owners, strict=True))
    truth, remarks = folder / f"Robot{robot}_Groundtruth.dat", dict[str, int]()
    drive = Drive(
        name=f"{folder.resolve().name}-robot{robot}",
        odometry=odometry_of(
            read_columns(folder / f"Robot{robot}_Odometry.dat", ("t", "v", "omega"), remarks),
            remarks,
        ),
        sightings=_read_sightings(
            folder / f"Robot{robot}_Measurement.dat", subjects, set(landmarks), remarks
        ),
        home=_home_bearings(landmarks, home, home_noise, seed),
        settings=DriveSettings(sensor=Sensor(x=0.0, y=0.0, yaw=0.0)),
        truth=_read_truth(truth, home, remarks) if is_there(truth) else None,
        remarks=remarks,
    )
    return with_clock_remarks(drive, folder)


def mrclam_command(folder: Path) -> str:
    """Return the command that imports the first robot of an MRCLAM folder."""
    robot = robots_in(folder).partition(",")[0]
    options = "--robot", robot, "--home", "0,0,0", "--out", f"out/robot{robot}"
    return command("import", "mrclam", folder, *options)


def robots_in(folder: Path) -> str:
    """Return the numbers of the robots in an MRCLAM folder, separated by commas."""
    names = (file.name for file in folder.glob("Robot*_Odometry.dat"))
    robots = sorted(name.removeprefix("Robot").removesuffix("_Odometry.dat") for name in names)
    return ", ".join(robots) or "none"


def _by_subject(path: Path, names: tuple[str, ...]) -> tuple[Table, list[int]]:
    """Return a table with a row for each subject, and the subjects."""
    table = read_columns(path, names)
    table.require_rows()
    table.require_unique("subject")
    return table, _whole(table, "subject")


def _read_sightings(
    path: Path, subjects: dict[int, int], landmarks: set[int], remarks: dict[str, int]
) -> Sightings:
    """Read the sightings of landmarks; all other subjects are robots."""
    table = read_columns(path, ("t", "barcode", "range", "bearing"), remarks)
    table = sorted_by_time(table, "bearings", remarks)
    seen = [subjects.get(barcode) for barcode in _whole(table, "barcode")]
    of_landmark = np.array([subject in landmarks for subject in seen], bool)
    unknown = seen.count(None)
    robots = len(seen) - unknown - int(of_landmark.sum())
    remarks |= {r: n for r, n in ((OTHER_ROBOTS, robots), (UNKNOWN_BARCODES, unknown)) if n}
    ids = {"landmark": np.array([str(subject) for subject in seen], object)}
    table = replace(table, columns={**table.columns, **ids})
    return sightings_of(table.rows(of_landmark), remarks)


def _home_bearings(
    landmarks: dict[int, tuple[float, float]], home: Pose, sigma: float, seed: int
) -> dict[str, HomeBearing]:
    """Return the bearings at `home`, with noise drawn in landmark order."""
    x, y = np.array(list(landmarks.values())).T
    noise = np.random.default_rng(seed).normal(0.0, sigma, x.size)
    # Adding the noise to the heading keeps the sum wrapped.
    seen = bearing(Pose(home.x, home.y, home.heading - noise), x, y).tolist()
    known = sigma if sigma > 0 else math.nan
    return {str(i): HomeBearing(b, known) for i, b in zip(landmarks, seen, strict=True)}


def _read_truth(path: Path, home: Pose, remarks: dict[str, int]) -> Truth:
    table = read_columns(path, ("t", "x", "y", "heading"), remarks)
    return samples_of(Truth, table, remarks).seen_from(home)


def _whole(table: Table, name: str) -> list[int]:
    """Return column `name`, which must contain whole numbers."""
    values = table[name]
    table.require(
        name, (values % 1 == 0) & (np.abs(values) < 2**53), "must be a whole number, not {}"
    )
    return [int(value) for value in values.tolist()]
