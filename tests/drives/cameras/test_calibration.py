"""Calibration files of ROS, Kalibr and our own; hostile ones are refused in one line."""

import pytest
import yaml

from homeward.drives.cameras.calibration import read_calibration
from homeward.drives.cameras.lens import Lens
from homeward.errors import InputError

ROS = {
    "image_width": 640,
    "image_height": 480,
    "camera_name": "front",
    "camera_matrix": {"rows": 3, "cols": 3, "data": [500.0, 0, 320, 0, 510, 240, 0, 0, 1]},
    "distortion_model": "plumb_bob",
    "distortion_coefficients": {"rows": 1, "cols": 5, "data": [-0.2, 0.05, 0.001, 0, 0]},
}
CAM = {
    "camera_model": "pinhole",
    "intrinsics": [286.7, 286.8, 420.9, 396.9],
    "distortion_model": "equidistant",
    "distortion_coeffs": [-0.007, 0.04, -0.036, 0.006],
    "resolution": [848, 800],
}


def read(tmp_path, tree, camera=""):
    text = tree if isinstance(tree, str) else yaml.safe_dump(tree)
    (tmp_path / "camera.yaml").write_text(text, encoding="utf-8")
    return read_calibration(tmp_path, "camera.yaml" + camera)


def test_ros(tmp_path):
    wanted = Lens(
        fx=500, fy=510, cx=320, cy=240, distortion=(-0.2, 0.05, 0.001, 0, 0), width=640, height=480
    )
    assert read(tmp_path, ROS) == wanted


def test_kalibr(tmp_path):
    lens = read(tmp_path, {"cam0": CAM})
    assert (lens.model, lens.cx, lens.width) == ("equidistant", 420.9, 848)
    both = {"cam0": CAM, "cam1": {**CAM, "distortion_model": "radtan", "intrinsics": [9, 9, 8, 7]}}
    assert read(tmp_path, both, "#cam1").model == "plumb_bob"
    with pytest.raises(InputError, match="several cameras, 'cam0', 'cam1'; name one"):
        read(tmp_path, both)


def test_our_own(tmp_path):
    assert read(tmp_path, {"fx": 9, "fy": 9, "cx": 5, "cy": 5}) == Lens(fx=9, fy=9, cx=5, cy=5)


@pytest.mark.parametrize(
    "tree",
    [
        "",
        "- 1\n- 2\n",
        "%YAML:1.0\n---\nK: !!opencv-matrix\n  rows: 3\n",
        "&a [*a, *a]",
        {"cam0": {**CAM, "camera_model": "omni"}},
        {"cam0": {**CAM, "intrinsics": [1, 2]}},
        {"cam0": {**CAM, "intrinsics": ["x", 2, 3, 4]}},
        {"cam0": {**CAM, "resolution": 7}},
        {"cam0": {**CAM, "distortion_coeffs": [float("nan")] * 4}},
        {"cam0": {**CAM, "distortion_coeffs": 4}},
        {**ROS, "camera_matrix": 4},
        {**ROS, "camera_matrix": {"data": [1, 2]}},
        {**ROS, "camera_matrix": {"data": [0] * 9}},
        {**ROS, "distortion_model": "thin_prism"},
        {**ROS, "distortion_coefficients": None},
        {**ROS, "image_width": -3},
        {"fx": 1, "fy": 1, "cx": 0, "cy": 0, "surprise": 1},
        {"nothing": "here"},
    ],
)
def test_hostile_files(tmp_path, tree):
    with pytest.raises(InputError) as refused:
        read(tmp_path, tree)
    assert "camera.yaml" in str(refused.value)
    assert "\n" not in str(refused.value)


def test_no_file(tmp_path):
    with pytest.raises(InputError, match="cannot be read"):
        read_calibration(tmp_path, "nothing.yaml")
