"""Calibration from boards that a known lens drew."""

import json

import cv2
import numpy as np
import pytest
from cli.commands import call, done, refused
from vision.drawn import picture, placed

from homeward.drives.cameras.calibration import read_calibration
from homeward.drives.cameras.lens import Lens
from homeward.errors import InputError
from homeward.vision.calibrating import Board, calibrate
from homeward.vision.tags.detector import family_of

SHAPE = (300, 400)
SIZE = {"width": 400, "height": 300}
PINHOLE = Lens(fx=330, fy=332, cx=204, cy=147, distortion=(-0.2, 0.05, 0, 0, 0), **SIZE)
FISHEYE = Lens(
    fx=190, fy=190, cx=197, cy=152, model="fisheye", distortion=(-0.01, 0.005, 0, 0), **SIZE
)
CHARUCO = Board((7, 5), "4x4_50")


def sheet(board):
    if board.family is None:
        squares = np.indices(board.squares[::-1]).sum(axis=0) % 2 * 255
        plain = np.kron(squares, np.ones((40, 40))).astype(np.uint8)
    else:
        family = family_of(board.family)
        made = cv2.aruco.CharucoBoard(board.squares, 1.0, board.marker, family)
        plain = made.generateImage((280, 200), marginSize=0, borderBits=1)
    return np.pad(plain, 20, constant_values=255)


def boards(folder, lens, board, many=10):
    rng = np.random.default_rng(1)
    flat = sheet(board)
    files = []
    for k in range(many):
        away = rng.uniform(0.55, 0.8) * (0.7 if lens is FISHEYE else 1.0)
        middle = [away, *(rng.uniform(-0.28, 0.28, 2) * away * [1.0, 0.7])]
        size = 0.5 * np.array([1.0, flat.shape[0] / flat.shape[1]])
        turns = rng.uniform(-0.6, 0.6, 3) * [1, 1, 0.4]
        image = picture(lens, SHAPE, flat, *placed(middle, size, *turns), seed=k, paper=90)
        files.append(folder / f"{k:02d}.png")
        cv2.imwrite(str(files[-1]), image)
    return files


@pytest.mark.parametrize(
    ("lens", "board"),
    [(PINHOLE, Board((8, 6))), (PINHOLE, CHARUCO), (FISHEYE, CHARUCO)],
    ids=["chessboard", "charuco", "fisheye"],
)
def test_a_lens_is_found_again(tmp_path, lens, board):
    found = calibrate(boards(tmp_path, lens, board), board, lens.model)
    assert found.rms < 0.2
    assert len(found.used) >= 8
    # What counts are directions, but for a common turn: that of the mount takes it up.
    x, y = found.points.T
    off = np.subtract(found.lens.directions(x, y), lens.directions(x, y))
    off -= off.mean(axis=1, keepdims=True)
    assert np.sqrt(np.mean(off**2)) < np.radians(0.15)
    assert (found.lens.cx, found.lens.cy) == pytest.approx((lens.cx, lens.cy), abs=3.0)


def test_by_command(tmp_path):
    (tmp_path / "boards").mkdir()
    boards(tmp_path / "boards", PINHOLE, CHARUCO, 8)
    asked = ["camera", "calibrate", str(tmp_path / "boards"), "--board", "7x5"]
    asked += ["--charuco", "4x4_50", "--out", str(tmp_path / "camera"), "--json"]
    told = json.loads(done(call(*asked)).stdout)
    assert "plumb_bob from" in told["summary"]
    assert told["rms_px"] < 1
    assert len(told["used"]) == 8
    lens = read_calibration(tmp_path / "camera", "camera.yaml")
    assert lens.fx == pytest.approx(330, abs=3)
    assert (tmp_path / "camera" / "residuals.png").stat().st_size > 5000


def test_what_cannot_be_calibrated(tmp_path):
    for k in range(3):
        cv2.imwrite(str(tmp_path / f"{k}.png"), np.full(SHAPE, 90, np.uint8))
    files = sorted(tmp_path.glob("*.png"))
    with pytest.raises(InputError, match="found in 0 of 3 pictures; 6 are needed"):
        calibrate(files, Board((8, 6)), "plumb_bob")
    cv2.imwrite(str(tmp_path / "9.png"), np.full((90, 90), 90, np.uint8))
    with pytest.raises(InputError, match="not 400x300 pixels"):
        calibrate([*files, tmp_path / "9.png"], Board((8, 6)), "plumb_bob")


@pytest.mark.parametrize(
    "wrong",
    [["--board", "7"], ["--board", "1x5"], ["--model", "mei"], ["--charuco", "nine"]],
)
def test_words_that_are_none(tmp_path, wrong):
    asked = ["camera", "calibrate", str(tmp_path), "--out", str(tmp_path / "out"), "--board", "7x5"]
    made = call(*asked, *wrong)
    refused(made)
