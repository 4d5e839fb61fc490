"""`homeward import`: a drive from CSV files of any columns, separators and units."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from homeward.cli.options import AsJson, HomeSpin, spin_span
from homeward.cli.terminal import answer, say, table, warn


def import_(
    files: Annotated[
        list[Path],
        typer.Argument(help="Text files with odometry, bearings, home's bearings, perhaps truth."),
    ],
    out: Annotated[
        Path | None,
        typer.Option(help="The drive folder to write; without it, --picture alone."),
    ] = None,
    columns: Annotated[
        list[str] | None,
        typer.Option(
            metavar="[FILE:]ROLE=COLUMN[UNIT]",
            help="What a column is, several with commas; a minus before COLUMN turns the sign. "
            "Without a header, columns are 1, 2, 3. "
            "Roles: t, v, omega, landmark, bearing, sigma, x, y, heading.",
        ),
    ] = None,
    home_spin: HomeSpin = None,
    picture: Annotated[Path, typer.Option(help="Where to draw what was understood.")] = Path(
        "out/import.png"
    ),
    json: AsJson = False,
) -> None:
    """Turn CSV files of any columns, separators and units into a drive folder.

    Says what each column was taken for, and draws it, before anything is written. Angles and turn
    rates run anti-clockwise.
    """
    from homeward.drives.foreign.reading import about_home, drive_of, understand
    from homeward.drives.saving import save_drive
    from homeward.drives.text.files import naming
    from homeward.report.canvas import png
    from homeward.report.imported import glance

    found = understand(files, columns or ())
    keys = ("file", "is", "column", "as", "unit", "how", "range")
    rows = [
        (u.table.file.name, u.kind, u.column.name, u.column.role, u.unit, u.how, u.range)
        for u in found
    ]
    if not json:
        table([(*keys[:5], "", "from, to"), *rows], left=len(keys))
    drive = drive_of(found, "import" if out is None else out.name, spin_span(home_spin))
    with naming(picture, "cannot be written"):
        picture.parent.mkdir(parents=True, exist_ok=True)
        picture.write_bytes(png(glance(drive)))
    remarks = [*drive.remark_lines, *about_home(drive)]
    if json:
        if out is not None:
            save_drive(drive, out)
        told = [dict(zip(keys, row, strict=True)) for row in rows]
        answer({"columns": told, "remarks": remarks, "picture": picture, "folder": out})
        return
    for remark in remarks:
        warn(remark)
    say(f"Picture: {picture}. Has the path the right size and shape, do bearings run smoothly?")
    if out is None:
        say("Nothing else was written; --out FOLDER writes the drive.")
        return
    save_drive(drive, out)
    say(f"Drive folder: {out}")
