"""Calibration of a camera from pictures of a board, by OpenCV."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from homeward.drives.cameras.calibration import ros_values
from homeward.drives.cameras.lens import Lens
from homeward.drives.text.settings import validated
from homeward.errors import InputError
from homeward.vision.cameras.image_files import read_grey
from homeward.vision.opencv import opencv
from homeward.vision.tags.detector import family_of

FEWEST = 6
"""Pictures of the board: four tell a lens at all."""
FEWEST_CORNERS = 8
"""Of a board that is partly seen."""
Model = Literal["plumb_bob", "rational_polynomial", "equidistant"]


@dataclass(frozen=True)
class Board:
    """A chessboard; with a family of tags in its white squares, a ChArUco board."""

    squares: tuple[int, int]
    """Columns and rows."""
    family: str | None = None
    marker: float = 0.75
    """Side of a tag over that of its square."""

    def finder(self) -> Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]:
        """Return what finds inner corners in a grey picture.

        It returns places (n, 2) on the board, in squares, and columns and rows (n, 2) [px]; n is 0
        where there is no board.
        """
        cv2, (columns, rows) = opencv(), self.squares
        if self.family is None:
            size = columns - 1, rows - 1
            grid = np.stack(np.meshgrid(*map(np.arange, size)), axis=-1).reshape(-1, 2)

            def chessboard(grey: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
                found, corners = cv2.findChessboardCornersSB(
                    grey, size, flags=cv2.CALIB_CB_ACCURACY
                )
                if not found:
                    return grid[:0], np.empty((0, 2))
                return grid, np.reshape(corners, (-1, 2))

            return chessboard
        board = cv2.aruco.CharucoBoard(self.squares, 1.0, self.marker, family_of(self.family))
        places, detector = board.getChessboardCorners()[:, :2], cv2.aruco.CharucoDetector(board)

        def charuco(grey: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            corners, numbers, _, _ = detector.detectBoard(grey)
            if numbers is None or len(numbers) < FEWEST_CORNERS:
                return places[:0], np.empty((0, 2))
            return places[np.ravel(numbers)], np.reshape(corners, (-1, 2))

        return charuco


@dataclass(frozen=True)
class Calibration:
    """A camera, and how well it explains its pictures."""

    lens: Lens
    points: np.ndarray
    """(n, 2), corners of the board in all pictures [px]."""
    residuals: np.ndarray
    """(n, 2), seen minus drawn by the model [px]."""
    used: tuple[str, ...]
    """Names of the pictures that show the board."""
    unused: tuple[str, ...]

    @property
    def rms(self) -> float:
        """Of the residuals' lengths [px]."""
        return float(np.sqrt(np.mean(np.sum(self.residuals**2, axis=1))))


def calibrate(files: list[Path], board: Board, model: Model) -> Calibration:
    """Calibrate a camera.

    Parameters
    ----------
    files : list of Path
        Pictures of the board, of one size: near and tilted, and in the image's corners, too.
    board : Board
        What they show.
    model : str
        Of the lens.

    Raises
    ------
    InputError
        When a picture cannot be read or has another size, too few show the board, or no lens
        explains them.
    """
    find, seen = board.finder(), dict[str, tuple[np.ndarray, np.ndarray]]()
    shapes: dict[tuple[int, int], Path] = {}
    for file in files:
        grey = read_grey(file)
        shapes.setdefault((grey.shape[0], grey.shape[1]), file)
        if len(shapes) > 1:
            (height, width), *_ = shapes
            raise InputError(f"not {width}x{height} pixels, as the pictures before it", file)
        places, corners = find(grey)
        if len(places):
            seen[file.name] = np.pad(places, ((0, 0), (0, 1))).astype(np.float32), corners
    if len(seen) < FEWEST:
        many = f"{len(seen)} of {len(files)} pictures"
        raise InputError(f"the board is found in {many}; {FEWEST} are needed")
    (height, width), *_ = shapes
    try:
        k, d, drawn = _fit(list(seen.values()), (width, height), model)
    except opencv().error as error:
        reason = " ".join(str(error.err).split())
        raise InputError(f"no {model} lens explains these pictures: {reason}") from None
    told = ros_values(k.ravel().tolist(), d.ravel().tolist(), model)
    lens = validated(Lens, {**told, "width": width, "height": height})
    points = np.concatenate([corners for _, corners in seen.values()]).astype(float)
    unused = tuple(file.name for file in files if file.name not in seen)
    return Calibration(lens, points, points - np.concatenate(drawn), tuple(seen), unused)


def _fit(
    seen: list[tuple[np.ndarray, np.ndarray]], size: tuple[int, int], model: Model
) -> tuple[np.ndarray, np.ndarray, list[np.ndarray]]:
    """Return K, the coefficients, and where the model draws the corners of each picture."""
    cv2 = opencv()
    # In a row, as the fisheye wants them and the pinhole takes them, too.
    places = [at[None] for at, _ in seen]
    corners = [np.asarray(px, np.float32)[None] for _, px in seen]
    first: Any = np.array([[size[0], 0, size[0] / 2], [0, size[0], size[1] / 2], [0, 0, 1.0]])
    draw = cv2.projectPoints
    if model == "equidistant":
        draw, flags = cv2.fisheye.projectPoints, cv2.CALIB_RECOMPUTE_EXTRINSIC | cv2.CALIB_FIX_SKEW
        _, k, d, turns, ways = cv2.fisheye.calibrate(
            places, corners, size, first, np.zeros((4, 1)), flags=flags
        )
    else:
        flags = cv2.CALIB_RATIONAL_MODEL if model == "rational_polynomial" else 0
        _, k, d, turns, ways = cv2.calibrateCamera(
            places, corners, size, first, np.zeros(5), flags=flags
        )
        d = d.ravel()[: 8 if flags else 5]
    drawn = [
        draw(at, turn, way, k, d)[0].reshape(-1, 2)
        for at, turn, way in zip(places, turns, ways, strict=True)
    ]
    return k, d, drawn
