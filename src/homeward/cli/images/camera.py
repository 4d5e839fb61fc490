"""`homeward camera calibrate`: pictures of a board in, a camera model out."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, cast

import typer

from homeward.cli.options import AsJson, progress
from homeward.cli.terminal import answer, say
from homeward.errors import InputError

if TYPE_CHECKING:
    from homeward.vision.calibrating import Model

camera = typer.Typer(no_args_is_help=True, rich_markup_mode=None)


@camera.callback()
def about() -> None:
    """Calibrate a camera."""


@camera.command()
def calibrate(
    pictures: Annotated[list[Path], typer.Argument(help="Picture files, or a folder of them.")],
    out: Annotated[Path, typer.Option(help="The folder to write.")],
    board: Annotated[str, typer.Option(help="Squares of the chessboard: COLUMNSxROWS.")],
    charuco: Annotated[
        str | None, typer.Option(help="Family of the tags in its white squares, such as 4x4_50.")
    ] = None,
    marker: Annotated[float, typer.Option(help="Side of such a tag over its square's.")] = 0.75,
    model: Annotated[
        str, typer.Option(help="plumb_bob, rational_polynomial or equidistant (fisheye).")
    ] = "plumb_bob",
    json: AsJson = False,
) -> None:
    """Calibrate a camera by pictures of a chessboard or a ChArUco board.

    The folder gets camera.yaml, as ROS writes it, and residuals.png, a picture of how far the model
    is off where. 15 pictures or more are good, with the board near and tilted, and in all corners
    of the image.
    """
    from homeward.drives.cameras.lens import COEFFICIENTS, SAME
    from homeward.drives.images import KINDS
    from homeward.report.images.calibration import (
        CAMERA,
        describe_calibration,
        write_calibration,
    )
    from homeward.report.output import check_output
    from homeward.vision.calibrating import Board
    from homeward.vision.calibrating import calibrate as fitted

    squares = re.fullmatch(r"(\d{1,2})x(\d{1,2})", board)
    if squares is None or min(map(int, squares.groups())) < 3:
        raise InputError(f"--board must be COLUMNSxROWS of 3 squares or more, not {board!r}")
    if not 0.1 < marker < 1.0:
        raise InputError(f"--marker must be between 0.1 and 1, not {marker:g}")
    lens = SAME.get(model, model)
    if lens not in COEFFICIENTS:
        raise InputError(f"--model must be one of {', '.join(COEFFICIENTS)}, not {model!r}")
    check_output(out, CAMERA)
    files = [
        file
        for place in pictures
        for file in (sorted(place.iterdir()) if place.is_dir() else [place])
        if not place.is_dir() or file.suffix.lower() in KINDS
    ]
    columns, rows = map(int, squares.groups())
    with progress("looking for the board"):
        found = fitted(files, Board((columns, rows), charuco, marker), cast("Model", lens))
    write_calibration(found, out)
    if json:
        residuals = {"rms_px": found.rms, "used": found.used, "unused": found.unused}
        files_ = {"camera": out / CAMERA, "lens": found.lens.model_dump()}
        answer({"summary": describe_calibration(found), **residuals, **files_})
        return
    say(describe_calibration(found))
    say(f"Camera: {out / CAMERA}")
