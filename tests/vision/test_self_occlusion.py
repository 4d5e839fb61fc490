"""What turns with the camera is detected where a mask is missing, and nowhere else."""

# ruff: noqa: E402 (nothing is imported where OpenCV is missing)
from functools import cache

import numpy as np
import pytest
from cli.commands import call

cv2 = pytest.importorskip("cv2")

from test_mask import CAMERA, HEIGHT, HORIZON, PAINTED, WIDTH, on_robot
from vision_scene import look as draw
from vision_scene import make_room, write_pictures

from homeward.vision import Mask, extract
from homeward.vision.checks import SelfOcclusionDetector

STEP = 0.2
"""What the robot turns by from frame to frame [rad]."""
MASK = Mask.of(PAINTED)


@cache
def frame(k, seed=7, steps=1.0):
    """Return frame k of a robot that drives an arc."""
    return draw(make_room(seed), 3.0 + 0.05 * k, 3.0, 0.4 + STEP * steps * k, seed=k)


def detected(frames, headings, mask=None):
    along = SelfOcclusionDetector()
    for image, heading in zip(frames, headings, strict=True):
        along.see(extract(image, CAMERA, mask), heading)
    return along.found


HEADINGS = [STEP * k for k in range(12)]


def test_a_deck_is_detected_with_its_elevation():
    found = detected([on_robot(frame(k)) for k in range(12)], HEADINGS)
    assert found.matches > 50
    top = np.degrees((HEIGHT / 2 - HORIZON) * 2 * np.pi / WIDTH)  # the mast is higher
    assert np.degrees(found.lowest) < top - 10
    assert np.degrees(found.lowest) > -45
    assert "mask" in found.words


def test_with_its_mask_nothing_is_detected():
    assert detected([on_robot(frame(k)) for k in range(12)], HEADINGS, MASK) is None


@pytest.mark.parametrize("seed", range(3))
def test_a_clean_room_is_not_suspected(seed):
    assert detected([frame(k, seed) for k in range(12)], HEADINGS) is None


def test_a_robot_that_does_not_turn_is_not_suspected():
    """Its wheels slip, or its gyroscope drifts: then it is odometry that is wrong."""
    assert detected([frame(0)] * 12, HEADINGS) is None
    assert detected([frame(k, steps=0.0) for k in range(12)], HEADINGS) is None


def test_without_a_turn_nothing_is_known():
    frames = [on_robot(frame(k, steps=0.0)) for k in range(12)]
    assert detected(frames, [0.01 * k for k in range(12)]) is None


@pytest.fixture
def folder(tmp_path):
    """A drive with the robot's own texture in its pictures."""
    path = tmp_path / "drive"
    path.mkdir()
    cv2.imwrite(str(path / "home.png"), on_robot(draw(make_room(7), 3.0, 3.0, 0.4, seed=99)))
    cv2.imwrite(str(path / "mask.png"), PAINTED)
    write_pictures(path, [on_robot(frame(k)) for k in range(10)], 1.0)
    twists = [f"{0.5 * k},0.05,{STEP}" for k in range(20)]
    (path / "odometry.csv").write_text("\n".join(["t,v,omega", *twists]) + "\n")
    return path


def words(*arguments):
    result = call(*arguments)
    assert result.exit_code in (0, 1), result.output
    return " ".join(result.output.split())


def test_a_missing_mask_is_said_on_the_terminal(folder, tmp_path):
    for command in ("see", "run"):
        said = words(command, folder, "--out", tmp_path / command)
        assert "turn with the camera" in said
        assert "(images.yaml, mask: FILE)" in said
    (folder / "images.yaml").write_text("mask: mask.png\n")
    assert "turn with the camera" not in words("run", folder, "--out", tmp_path / "masked")
