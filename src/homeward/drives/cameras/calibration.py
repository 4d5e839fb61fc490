"""Camera calibrations: ROS camera_info files and messages, Kalibr, or the keys of `Lens`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from homeward.drives.cameras.lens import Lens
from homeward.errors import InputError
from homeward.io.settings import read_tree, validated
from homeward.io.table import quoted

SUFFIXES = (".yaml", ".yml")
UNKNOWN = (
    "not a known calibration; use a camera_info of ROS (camera_matrix, distortion_model), a "
    "camchain of Kalibr (cam0: intrinsics, distortion_model), or the keys fx, fy, cx, cy"
)


def is_calibration(name: str) -> bool:
    """Whether a name is that of a YAML file, or of a camera in one: ``FILE.yaml#cam1``."""
    return name.partition("#")[0].lower().endswith(SUFFIXES)


def read_calibration(folder: Path, name: str) -> Lens:
    """Read a camera from ``FILE.yaml`` in a folder, or one of several from ``FILE.yaml#cam1``.

    `InputError` for an unknown format, an ambiguous camera, or invalid numbers.
    """
    file, _, camera = name.partition("#")
    path = folder / file
    tree = read_tree(path)
    try:
        return validated(Lens, _values(tree, camera, path), path)
    except (TypeError, ValueError, KeyError, IndexError, AttributeError):
        raise InputError(UNKNOWN, path) from None


def _values(tree: dict[str, Any], camera: str, path: Path) -> dict[str, Any]:
    """Return the keys of a `Lens` from those of any calibration."""
    if "camera_matrix" in tree:
        size = {"width": tree.get("image_width"), "height": tree.get("image_height")}
        d = tree["distortion_coefficients"]["data"]
        return ros_values(tree["camera_matrix"]["data"], d, tree["distortion_model"]) | size
    cameras = {k: v for k, v in tree.items() if isinstance(v, dict) and "intrinsics" in v}
    if not cameras:
        if "fx" not in tree:
            raise InputError(UNKNOWN, path)
        return tree
    if camera not in cameras and (camera or len(cameras) > 1):
        names = ", ".join(quoted(str(name)) for name in cameras)
        raise InputError(
            f"contains several cameras, {names}; name one, as in {path.name}#cam0", path
        )
    return _of_kalibr(cameras.get(camera) or next(iter(cameras.values())), path)


def ros_values(k: Any, d: Any, model: str) -> dict[str, Any]:
    """Return the keys of a `Lens` from a CameraInfo: K (9,), D and the distortion model."""
    # Cameras without distortion are published without a model.
    return {
        **dict(zip(("fx", "fy", "cx", "cy"), (k[0], k[4], k[2], k[5]), strict=True)),
        "model": model or "plumb_bob",
        "distortion": tuple(d),
    }


def _of_kalibr(camera: dict[str, Any], path: Path) -> dict[str, Any]:
    kind, model = camera.get("camera_model"), camera.get("distortion_model")
    if kind != "pinhole" or len(camera["intrinsics"]) != 4:
        raise InputError(
            f"camera_model {quoted(str(kind))} is not supported; use pinhole with 4 intrinsics",
            path,
        )
    width, height = camera.get("resolution", (None, None))
    return {
        **dict(zip(("fx", "fy", "cx", "cy"), camera["intrinsics"], strict=True)),
        "model": "plumb_bob" if model in (None, "none") else model,
        "distortion": tuple(camera.get("distortion_coeffs", ())),
        "width": width,
        "height": height,
    }


class CameraRows:
    """The first CameraInfo of a topic."""

    def __init__(self, topic: str, rectified: bool) -> None:
        self._topic, self._rectified = topic, rectified
        self._first: Any = None

    def add(self, _: float, message: Any) -> None:
        """Add a message."""
        if self._first is None:
            self._first = message

    def model(self) -> Lens | None:
        """Return the camera model; None without a message, `InputError` for an unknown model."""
        try:
            return None if self._first is None else from_camera_info(self._first, self._rectified)
        except (ValueError, IndexError, AttributeError):
            problem = f"{self._topic}: the camera is not calibrated, or its model is unknown"
            raise InputError(problem) from None


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
