"""`homeward import`: convert tables with any columns, or an MRCLAM folder, to a drive folder."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import typer

from homeward.cli import options as shared
from homeward.errors import InputError
from homeward.io.naming import command

MRCLAM = "mrclam"
"""First argument for a folder of the MRCLAM data set."""
OTHER_WAY = (
    "Change the sign with --columns 'omega=-COLUMN' or 'bearing=-COLUMN', or exchange the columns "
    "of the left and the right wheel."
)
EDIT = "its drive.yaml lists the settings of camera, odometry and home to edit"


def import_(
    files: Annotated[
        list[Path],
        typer.Argument(
            help="Text files with odometry, bearings, home bearings and optionally ground truth; "
            "or the word mrclam and an MRCLAM folder."
        ),
    ],
    out: Annotated[
        Path | None, typer.Option(help="The drive folder to write; without it, only --picture.")
    ] = None,
    columns: Annotated[
        list[str] | None,
        typer.Option(
            metavar="[FILE:]ROLE=COLUMN[UNIT]",
            help="Roles of columns, separated by commas; a minus before COLUMN changes the sign. "
            "Without a header, columns are 1, 2, 3. "
            "Roles: t, v, omega, vy, roll, pitch, landmark, bearing, elevation, sigma, x, y, z, "
            "heading; of positions: forward, left, right, up; of wheels: left_wheel, "
            "left_speed, left_step, right_wheel, right_speed, right_step, steering, "
            "front_left_wheel (and so on); of steps: distance, turn; "
            "of pixels: column, row, column0 to row3, fx, fy, cx, cy.",
        ),
    ] = None,
    kinds: Annotated[
        list[str] | None,
        typer.Option(
            "--as",
            metavar="FILE=KIND",
            help="Kind of a file: odometry, detections, home, truth, gyro or tilt; repeatable.",
        ),
    ] = None,
    wheels: Annotated[
        str | None,
        typer.Option(
            metavar="KEY=VALUE,KEY=VALUE",
            help="Geometry of wheels, for encoder counts, wheel speeds and steering: wheel_radius "
            "[m], track_width [m], ticks_per_turn, wheelbase [m].",
        ),
    ] = None,
    camera: Annotated[
        list[str] | None,
        typer.Option(
            metavar="[NAME=]FILE",
            help="Calibration of the camera, for pixels; of several cameras, one for each NAME in "
            "the column camera.",
        ),
    ] = None,
    tag_size: Annotated[
        float | None,
        typer.Option(min=1e-3, max=100.0, help="Side of the tags [m], for ranges from corners."),
    ] = None,
    picture: Annotated[Path, typer.Option(help="The figure of the imported data to write.")] = Path(
        "out/import.png"
    ),
    robot: Annotated[int | None, typer.Option(help="mrclam: number of the robot, 1 to 5.")] = None,
    home: Annotated[
        str | None,
        typer.Option(
            metavar=shared.HOME_FORMS,
            help="Home: a table with its bearings; or when the robot was at rest there, turned on "
            "the spot there, or had the pose that is home [s from the start]; none: a drive in a "
            "place. mrclam: X,Y,HEADING "
            "[m, m, rad] in the survey.",
        ),
    ] = None,
    home_noise_deg: Annotated[
        float, typer.Option(help="mrclam: noise of the computed home bearings [deg].")
    ] = 0.0,
    seed: Annotated[int, typer.Option(help="mrclam: random seed of that noise.")] = 0,
    json: shared.AsJson = False,
) -> None:
    """Convert CSV files with any columns, separators and units to a drive folder.

    Reports the role and the unit of each column, and draws the data, before it writes the drive.
    Angles and turn rates are positive anti-clockwise. `homeward import mrclam FOLDER --robot 3
    --home 2.0,0.0,0.3 --out DRIVE` reads a folder of the UTIAS MRCLAM data set.
    """
    from homeward.drives.opening import save_drive

    if files[0] == Path(MRCLAM) and len(files) > 1:
        if columns or kinds or wheels or camera or tag_size:
            raise InputError(
                "import mrclam takes only --robot, --home, --home-noise-deg, --seed, --out"
            )
        _mrclam(files[1:], robot, home, (home_noise_deg, seed), out, json)
        return
    if robot is not None or home_noise_deg or seed:
        raise InputError(
            "--robot, --home-noise-deg and --seed are only for: homeward import mrclam"
        )
    home_needed = home != "none"
    chosen = shared.home_choice(home if home_needed else None)
    if (table := chosen.pop("home_file", None)) is not None:
        files, kinds = [*files, Path(table)], [*(kinds or ()), f"{Path(table).name}=home"]
        home = None
    when = shared.time_at_home(chosen)
    from homeward.drives.cameras.calibration import read_calibration
    from homeward.drives.importers.reading import (
        drive_of,
        home_warnings,
        sense_warnings,
        understand,
    )
    from homeward.drives.settings import Wheels
    from homeward.io.settings import parse_settings
    from homeward.io.writing import write_whole
    from homeward.localizer.inputs.sign_check import note_of_whole
    from homeward.runs.report.canvas import png
    from homeward.runs.report.imported import draw_drive

    given = "{" + (wheels or "").replace("=", ": ") + "}"
    geometry = parse_settings(given, Wheels, Path("--wheels"))
    named = {name: file for name, _, file in (text.rpartition("=") for text in camera or ())}
    if len(named) < len(camera or ()):
        raise InputError("--camera is given twice for one camera; use --camera NAME=FILE for each")
    lenses = {name: read_calibration(Path(), file) for name, file in named.items()}
    found = understand(
        files, columns or (), kinds or (), geometry if wheels else None, lenses, tag_size
    )
    keys = ("file", "is", "column", "as", "unit", "how", "range")
    rows = [row for one in found.values() for row in one.rows()]
    if not json:
        shared.table([(*keys[:5], "", "from, to"), *rows], left=len(keys))
    with shared.progress("mapping the drive for home") as on_progress:
        name = "import" if out is None else out.name
        drive = drive_of(found, name, when, geometry, on_progress, home_needed=home_needed)
    write_whole(picture, png(draw_drive(drive)))
    senses = sense_warnings(drive, found)
    if (senses or drive.odometry.strafes) and (reversed_ := note_of_whole(drive)):
        senses = [f"{reversed_} {OTHER_WAY}" if senses else reversed_]
    remarks = [*drive.remark_lines, *senses]
    remarks += home_warnings(drive) if home_needed else []
    if out is not None:
        save_drive(drive, out, commented=True)
        following = command("run", out, *(() if home_needed else ("--place", "PLACE")))
    else:
        options: list[tuple[str, object]] = [("--columns", text) for text in columns or ()]
        options += [("--as", text) for text in kinds or ()]
        options += [("--camera", text) for text in camera or ()]
        options += [("--wheels", wheels), ("--tag-size", tag_size), ("--home", home)]
        options += [("--out", "out/drive")]
        words = (part for option in options if option[1] is not None for part in option)
        following = command("import", *files, *words)
    if json:
        columns_read = [dict(zip(keys, row, strict=True)) for row in rows]
        facts = {"columns": columns_read, "remarks": remarks, "picture": picture}
        shared.answer({**facts, "folder": out, "next": following})
        return
    shared.warn(*remarks)
    shared.say(
        f"Picture: {picture}. Check that the path has the right size and shape and that the"
        " bearings change smoothly."
    )
    _written(out, following)


def _written(out: Path | None, following: str) -> None:
    """Print where the drive is, and the next command."""
    shared.say("No drive written." if out is None else f"Drive folder: {out}; {EDIT}")
    shared.say(f"Next: {following}")


def _mrclam(
    folders: list[Path],
    robot: int | None,
    home: str | None,
    noise: tuple[float, int],
    out: Path | None,
    json: bool,
) -> None:
    """Write the drive of one robot of an MRCLAM folder."""
    from homeward.drives.importers.mrclam import read_mrclam
    from homeward.drives.opening import save_drive
    from homeward.geometry.frames import Pose

    if len(folders) != 1 or robot is None or home is None or out is None:
        raise InputError(
            "import mrclam needs one FOLDER, --robot N, --home X,Y,HEADING [m, m, rad] in the "
            "frame of its survey, and --out DRIVE"
        )
    place, (noise_deg, seed) = Pose(*shared.numbers(home, "--home", 3)), noise
    drive = read_mrclam(folders[0], robot, place, math.radians(noise_deg), seed)
    save_drive(drive, out, commented=True)
    following = command("run", out)
    if json:
        shared.answer({"remarks": drive.remark_lines, "folder": out, "next": following})
        return
    shared.warn(*drive.remark_lines)
    _written(out, following)
