"""Camera calibrations: files of ROS, OpenCV, Kalibr and COLMAP, CameraInfo messages, and our own.

A file is recognised from its content. Matrices of ROS and OpenCV may have any of the usual names,
and be lists, lists of lists or ``!!opencv-matrix``.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from homeward.drives.cameras.camera import Camera
from homeward.drives.cameras.lens import Lens
from homeward.errors import InputError
from homeward.io.naming import listing
from homeward.io.reading import read_small
from homeward.io.settings import MAX_SETTINGS_BYTES, parse_yaml, validated
from homeward.io.table import quoted

SUFFIXES = (".yaml", ".yml", ".xml", ".json", ".txt")
UNKNOWN = (
    "not a known calibration; use a camera_info of ROS, a file of OpenCV (camera_matrix, "
    "distortion_coefficients), a camchain of Kalibr, a cameras.txt of COLMAP, or the keys fx, fy, "
    "cx, cy"
)
NOT_CALIBRATED = "its camera matrix is zero, so the camera is not calibrated; calibrate it first"
MATRIX = ("cameramatrix", "k", "mtx", "intrinsicmatrix")
DISTORTION = (
    *("distortioncoefficients", "distortioncoeffs", "distcoeffs", "distcoeff", "distortion"),
    *("dist", "d"),
)
WIDTH, HEIGHT = ("imagewidth", "width"), ("imageheight", "height")
"""Names of keys, in lower case and without separators."""
COLMAP = {
    "SIMPLE_PINHOLE": ("plumb_bob", 1, 0),
    "PINHOLE": ("plumb_bob", 2, 0),
    "SIMPLE_RADIAL": ("plumb_bob", 1, 1),
    "RADIAL": ("plumb_bob", 1, 2),
    "OPENCV": ("plumb_bob", 2, 4),
    "FULL_OPENCV": ("rational_polynomial", 2, 8),
    "OPENCV_FISHEYE": ("equidistant", 2, 4),
    "SIMPLE_RADIAL_FISHEYE": ("equidistant", 1, 1),
    "RADIAL_FISHEYE": ("equidistant", 1, 2),
}
"""By COLMAP's name: the model of `Lens`, and the numbers of focal lengths and of coefficients."""
COLMAP_ROW = re.compile(r"\s*\d+[,\s]+[A-Z][A-Z_]+[,\s]+\d+[,\s]+\d+[,\s]")
COLMAP_CENTRE = 0.5
"""Centre of the first pixel in COLMAP [px]; it is 0 here."""


def is_calibration(name: str) -> bool:
    """Whether a name is that of a calibration file, or of a camera in one: ``FILE.yaml#cam1``."""
    return name.partition("#")[0].lower().endswith(SUFFIXES)


def read_calibration(folder: Path, name: str) -> Lens:
    """Read a camera from a file in a folder, or one of several from ``FILE#cam1``.

    The keys of `Camera`, such as `pitch`, may be added to a YAML file. `InputError` for an unknown
    format, an ambiguous camera, or invalid numbers.
    """
    file, _, camera = name.partition("#")
    path = folder / file
    text = read_small(path, MAX_SETTINGS_BYTES, "a calibration")
    try:
        return validated(Lens, _values(_tree(text, path), camera, path), path)
    except (TypeError, ValueError, KeyError, IndexError, AttributeError):
        raise InputError(UNKNOWN, path) from None


def _tree(data: bytes, path: Path) -> Any:
    """Return the keys and values of a file in any format."""
    text = data.decode("utf-8-sig")
    if text.lstrip().startswith("<"):
        return _of_xml(text, path)
    lines = text.splitlines()
    if rows := [line for line in lines if COLMAP_ROW.match(line)]:
        return dict(_of_colmap(line, path) for line in rows)
    # OpenCV writes %YAML:1.0, which is no YAML; ros2 topic echo separates messages by lines of ---.
    plain = ["" if line.startswith("%") else line.replace("!!opencv-matrix", "") for line in lines]
    ends = [k for k, line in enumerate(plain) if line.startswith("---")] + [len(plain)]
    end = next((k for k in ends if any(line.strip() for line in plain[:k])), 0)
    first = ["" if line.startswith("---") else line for line in plain[:end]]
    return parse_yaml("\n".join(first), path, typed=True)


def _of_xml(text: str, path: Path) -> dict[str, Any]:
    """Return the keys and values of OpenCV's XML; matrices as in its YAML."""
    if "<!" in text.replace("<!--", ""):  # entities may expand without limit
        advice = "remove the lines that begin with <!"
        raise InputError("XML with a document type", path, advice=advice)
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise InputError(f"not XML: {error}", path) from None
    return {
        one.tag: one.text if (data := one.find("data")) is None else (data.text or "").split()
        for one in root
    }


def _of_colmap(line: str, path: Path) -> tuple[str, dict[str, Any]]:
    """Return the id of a camera and the keys of a `Lens` from a line of COLMAP."""
    name, model, width, height, *numbers = re.split(r"[,\s]+", line.strip())
    if model not in COLMAP:
        advice = f"use one of {', '.join(COLMAP)}"
        raise InputError(f"the model {quoted(model)} is not supported", path, advice=advice)
    kind, focal, count = COLMAP[model]
    values = [float(number) for number in numbers]
    if len(values) != focal + 2 + count:
        raise ValueError(line)
    fx, fy, (cx, cy) = values[0], values[focal - 1], values[focal : focal + 2]
    # Coefficients that a model of COLMAP lacks are zero.
    distortion = values[focal + 2 :] + [0.0] * (4 - count if count in (1, 2) else 0)
    return name, {
        **{"fx": fx, "fy": fy, "cx": cx - COLMAP_CENTRE, "cy": cy - COLMAP_CENTRE},
        **{"model": kind, "distortion": distortion, "width": width, "height": height},
    }


def _values(tree: Mapping[str, Any], camera: str, path: Path) -> dict[str, Any]:
    """Return the keys of a `Lens` from those of any calibration."""
    cameras = {"": tree} if not camera and _is_camera(tree) else {}
    cameras = cameras or {str(name): one for name, one in tree.items() if _is_camera(one)}
    if not cameras:
        raise InputError(UNKNOWN, path)
    if camera not in cameras and (camera or len(cameras) > 1):
        names, first = [quoted(name) for name in cameras], next(iter(cameras))
        problem = (
            f"contains {'several cameras' if len(names) > 1 else 'the camera'}, {listing(names)}"
        )
        raise InputError(problem, path, advice=f"name one, as in {path.name}#{first}")
    return _of_one(cameras.get(camera) or next(iter(cameras.values())), path)


def _named(tree: Mapping[str, Any]) -> dict[str, Any]:
    """Return a tree with its keys in lower case, without separators."""
    return {re.sub(r"[^a-z]", "", str(key).lower()): value for key, value in tree.items()}


def _is_camera(tree: Any) -> bool:
    """Whether a tree has the keys of one camera."""
    if not isinstance(tree, Mapping):
        return False
    return "fx" in tree or not {"intrinsics", *MATRIX}.isdisjoint(_named(tree))


def _of_one(tree: Mapping[str, Any], path: Path) -> dict[str, Any]:
    """Return the keys of a `Lens` from those of one camera."""
    if "fx" in tree:
        return dict(tree)
    tilt = {key: tree[key] for key in Camera.model_fields if key in tree}
    if "intrinsics" in tree:
        return _of_kalibr(tree, path) | tilt
    keys = _named(tree)
    k, given = _numbers(_first(keys, MATRIX)), _first(keys, DISTORTION)
    if len(k) != 9 or (given is None and any("dist" in key for key in keys)):
        raise ValueError(UNKNOWN)
    d = [] if given is None else _numbers(given)
    if not any(k):
        raise InputError(NOT_CALIBRATED, path)
    model = keys.get("distortionmodel") or _model_of(d, keys.get("fisheyemodel"), path)
    size = {"width": _first(keys, WIDTH) or None, "height": _first(keys, HEIGHT) or None}
    return ros_values(k, d, model) | size | tilt


def _model_of(d: list[float], fisheye: Any, path: Path) -> str:
    """Return the model of distortion coefficients of OpenCV, whose files do not name it."""
    if fisheye is not None and float(fisheye):
        return "equidistant"
    if len(d) == 4 and any(d) and fisheye is None:
        advice = (
            "add the line distortion_model: plumb_bob (of cv2.calibrateCamera), "
            "or equidistant (of cv2.fisheye.calibrate)"
        )
        raise InputError("4 distortion coefficients of an unknown model", path, advice=advice)
    return "plumb_bob" if len(d) <= 5 else "rational_polynomial"


def _first(keys: Mapping[str, Any], names: Iterable[str]) -> Any:
    """Return the value of the first of several names that is there; None without one."""
    return next((keys[name] for name in names if name in keys), None)


def _numbers(matrix: Any) -> list[float]:
    """Return the numbers of a matrix, row by row: of a list, or of the key data."""
    data = matrix["data"] if isinstance(matrix, Mapping) else matrix
    numbers: list[float] = np.asarray(data, float).ravel().tolist()
    return numbers


def ros_values(k: Any, d: Any, model: str) -> dict[str, Any]:
    """Return the keys of a `Lens` from a CameraInfo: K (9,), D and the distortion model."""
    # Cameras without distortion are published without a model.
    return {
        **dict(zip(("fx", "fy", "cx", "cy"), (k[0], k[4], k[2], k[5]), strict=True)),
        "model": model or "plumb_bob",
        "distortion": tuple(d),
    }


def _of_kalibr(camera: Mapping[str, Any], path: Path) -> dict[str, Any]:
    kind, model = camera.get("camera_model"), camera.get("distortion_model")
    if kind != "pinhole" or len(camera["intrinsics"]) != 4:
        advice = "use pinhole with 4 intrinsics"
        raise InputError(f"camera_model {quoted(str(kind))} is not supported", path, advice=advice)
    width, height = camera.get("resolution", (None, None))
    return {
        **dict(zip(("fx", "fy", "cx", "cy"), camera["intrinsics"], strict=True)),
        "model": "plumb_bob" if model in (None, "none") else model,
        "distortion": tuple(camera.get("distortion_coeffs", ())),
        "width": width,
        "height": height,
    }


def from_camera_info(message: Any, rectified: bool) -> Lens:
    """Return the model of a CameraInfo message; without distortion for rectified images.

    `ValueError` where the camera is not calibrated, or of another model.
    """
    if rectified:
        p = np.asarray(_either(message, "p"))
        return Lens(fx=p[0], fy=p[5], cx=p[2], cy=p[6])
    k, d = (np.asarray(_either(message, name)).tolist() for name in "kd")
    size = {name: getattr(message, name) or None for name in ("width", "height")}
    return Lens(**ros_values(k, d, message.distortion_model), **size)


def _either(message: Any, name: str) -> Any:
    return getattr(message, name if hasattr(message, name) else name.upper())
