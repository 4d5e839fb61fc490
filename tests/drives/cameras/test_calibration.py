"""Calibration files of all usual tools; hostile ones are refused in one line."""

import cv2
import numpy as np
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
    with pytest.raises(InputError, match="several cameras, 'cam0' and 'cam1'; name one, as in"):
        read(tmp_path, both)


ECHO = """header:
  stamp: {{sec: 1, nanosec: 2}}
  frame_id: front
height: 480
width: 640
distortion_model: plumb_bob
{d}: [-0.2, 0.05, 0.001, 0.0, 0.0]
{k}: [500.0, 0.0, 320.0, 0.0, 510.0, 240.0, 0.0, 0.0, 1.0]
binning_x: 0
---
"""


@pytest.mark.parametrize("names", [{"d": "d", "k": "k"}, {"d": "D", "k": "K"}])
def test_echo_of_a_topic(tmp_path, names):
    assert read(tmp_path, ECHO.format(**names) * 3) == read(tmp_path, ROS)


@pytest.mark.parametrize("suffix", ["yml", "xml", "json"])
def test_opencv_writes(tmp_path, suffix):
    path = tmp_path / f"calib.{suffix}"
    file = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    file.write("calibration_time", "Thu 02 Feb 2023 09:00:00")
    file.write("image_width", 640)
    file.write("image_height", 480)
    file.write("camera_matrix", np.array([[500.0, 0, 320], [0, 510, 240], [0, 0, 1]]))
    file.write("distortion_coefficients", np.array([[-0.2, 0.05, 1e-3, 0, 0]]))
    file.release()
    assert read_calibration(tmp_path, path.name) == read(tmp_path, ROS)


K = [[500, 0, 320], [0, 510, 240], [0, 0, 1]]


def test_matrices_as_lists(tmp_path):
    lens = read(tmp_path, {"camera_matrix": K, "dist_coeff": [[-0.2, 0.05, 0.001, 0, 0]]})
    assert lens == Lens(fx=500, fy=510, cx=320, cy=240, distortion=(-0.2, 0.05, 0.001, 0, 0))
    assert read(tmp_path, {"mtx": K, "dist": [0.1] * 8}).model == "rational_polynomial"
    assert read(tmp_path, {"K": K}).distortion == ()
    # Four coefficients are those of calibrateCamera or of fisheye.calibrate.
    four = {"K": K, "D": [0.1, 0.01, 0.001, 0.002]}
    with pytest.raises(InputError, match="4 distortion coefficients of an unknown model; add"):
        read(tmp_path, four)
    assert read(tmp_path, {**four, "distortion_model": "equidistant"}).model == "equidistant"
    assert read(tmp_path, {**four, "fisheye_model": 1}).model == "equidistant"


@pytest.mark.parametrize(
    ("row", "keys"),
    [
        ("SIMPLE_PINHOLE 640 480 500 320 240", {}),
        ("PINHOLE 640 480 500 510 320 240", {"fy": 510}),
        ("SIMPLE_RADIAL 640 480 500 320 240 -0.1", {"distortion": (-0.1, 0, 0, 0)}),
        ("RADIAL 640 480 500 320 240 -0.1 0.02", {"distortion": (-0.1, 0.02, 0, 0)}),
        (
            "OPENCV 640 480 500 510 320 240 -0.1 0.02 0.001 0.002",
            {"fy": 510, "distortion": (-0.1, 0.02, 0.001, 0.002)},
        ),
        (
            "FULL_OPENCV 640 480 500 510 320 240 .5 .1 0 0 .01 .8 .2 .03",
            {
                "fy": 510,
                "model": "rational_polynomial",
                "distortion": (0.5, 0.1, 0, 0, 0.01, 0.8, 0.2, 0.03),
            },
        ),
        (
            "OPENCV_FISHEYE,640,480,500,510,320,240,-0.02,0.005,-0.001,0.0002",
            {"fy": 510, "model": "equidistant", "distortion": (-0.02, 0.005, -0.001, 0.0002)},
        ),
        (
            "SIMPLE_RADIAL_FISHEYE 640 480 500 320 240 -0.02",
            {"model": "equidistant", "distortion": (-0.02, 0, 0, 0)},
        ),
    ],
)
def test_colmap(tmp_path, row, keys):
    head = "# Camera list with one line of data per camera:\n# Number of cameras: 1\n"
    plain = {"fx": 500, "fy": 500, "cx": 319.5, "cy": 239.5, "width": 640, "height": 480}
    separator = "," if "," in row else " "
    assert read(tmp_path, f"{head}1{separator}{row}\n") == Lens(**(plain | keys))
    two = f"{head}1 PINHOLE 640 480 9 9 5 5\n7{separator}{row}\n"
    assert read(tmp_path, two, "#7") == Lens(**(plain | keys))
    with pytest.raises(InputError, match="several cameras, '1' and '7'; name one, as in camera"):
        read(tmp_path, two)


def test_tilt_along_with_any_calibration(tmp_path):
    for tree in (ROS, CAM, {"K": K}, {"fx": 9, "fy": 9, "cx": 5, "cy": 5}):
        assert read(tmp_path, {**tree, "pitch": 0.2}).pitch == 0.2


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
        "---\n---\n",
        "<opencv_storage><camera_matrix><data>1 2</data></camera_matrix></opencv_storage>",
        "<opencv_storage><camera_matrix>",
        '<!DOCTYPE a [<!ENTITY b "bbbbbbbb">]><a>&b;</a>',
        "# oST version 5.0 parameters\n[image]\n\nwidth\n640\n",
        "1 PINHOLE 640 480 9 9 5\n",
        "1 PINHOLE 640 480 9 x 5 5\n",
        "1 RADIAL 640 480 500 320 240 -0.1\n",
        "1 FOV 640 480 500 510 320 240 0.9\n",
        "1 THIN_PRISM_FISHEYE 640 480 1 1 1 1\n",
        ECHO.format(d="d", k="k").replace("500.0", ".nan"),
        {"K": K[:2]},
        {"K": [[[1]], 2]},
        {"K": "numpy"},
        {"camera_matrix": K, "dist_coeff": "none"},
    ],
)
def test_hostile_files(tmp_path, tree):
    with pytest.raises(InputError) as refused:
        read(tmp_path, tree)
    assert "camera.yaml" in str(refused.value)
    assert "\n" not in str(refused.value)


def test_camera_that_was_never_calibrated(tmp_path):
    zeros = {"rows": 3, "cols": 3, "data": [0] * 9}
    with pytest.raises(InputError, match="camera matrix is zero, so the camera is not calibrated"):
        read(tmp_path, {**ROS, "camera_matrix": zeros})
