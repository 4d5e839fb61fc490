"""Calibrations out of files: ROS camera_info, Kalibr, or the keys of `Lens` themselves."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from homeward.drives.cameras.lens import Lens
from homeward.errors import InputError
from homeward.io.settings import read_tree, validated
from homeward.io.table import quoted

SUFFIXES = (".yaml", ".yml")
NOT_KNOWN = (
    "no calibration that is known: a camera_info of ROS (camera_matrix, distortion_model), a "
    "camchain of Kalibr (cam0: intrinsics, distortion_model), or fx, fy, cx, cy"
)


def is_calibration(name: str) -> bool:
    """Whether a name is that of a file, and perhaps of a camera in it: ``FILE.yaml#cam1``."""
    return name.partition("#")[0].lower().endswith(SUFFIXES)


def read_calibration(folder: Path, name: str) -> Lens:
    """Read a camera from the file ``FILE.yaml`` in a folder, or from ``FILE.yaml#cam1``.

    Raises
    ------
    InputError
        When the file is no calibration, holds several cameras and none was named, or numbers that
        no camera has.
    """
    file, _, camera = name.partition("#")
    path = folder / file
    tree = read_tree(path)
    try:
        return validated(Lens, _values(tree, camera, path), path)
    except (TypeError, ValueError, KeyError, IndexError, AttributeError):
        raise InputError(NOT_KNOWN, path) from None


def _values(tree: dict[str, Any], camera: str, path: Path) -> dict[str, Any]:
    """Return the keys of a `Lens` from those of any calibration."""
    if "camera_matrix" in tree:
        size = {"width": tree.get("image_width"), "height": tree.get("image_height")}
        told = tree["distortion_coefficients"]["data"]
        return ros_values(tree["camera_matrix"]["data"], told, tree["distortion_model"]) | size
    cameras = {k: v for k, v in tree.items() if isinstance(v, dict) and "intrinsics" in v}
    if not cameras:
        if "fx" not in tree:
            raise InputError(NOT_KNOWN, path)
        return tree
    if camera not in cameras and (camera or len(cameras) > 1):
        names = ", ".join(quoted(str(name)) for name in cameras)
        raise InputError(f"holds {names}: name one, as in {path.name}#cam0", path)
    return _of_kalibr(cameras.get(camera) or next(iter(cameras.values())), path)


def ros_values(k: Any, d: Any, model: str) -> dict[str, Any]:
    """Return the keys of a `Lens` from what a CameraInfo tells: K (9,), D and its model."""
    # Cameras without distortion are published without a model.
    return {
        **dict(zip(("fx", "fy", "cx", "cy"), (k[0], k[4], k[2], k[5]), strict=True)),
        "model": model or "plumb_bob",
        "distortion": tuple(d),
    }


def _of_kalibr(camera: dict[str, Any], path: Path) -> dict[str, Any]:
    kind, model = camera.get("camera_model"), camera.get("distortion_model")
    if kind != "pinhole" or len(camera["intrinsics"]) != 4:
        raise InputError(f"a camera of the model {quoted(str(kind))}, which is not known", path)
    width, height = camera.get("resolution", (None, None))
    return {
        **dict(zip(("fx", "fy", "cx", "cy"), camera["intrinsics"], strict=True)),
        "model": "plumb_bob" if model in (None, "none") else model,
        "distortion": tuple(camera.get("distortion_coeffs", ())),
        "width": width,
        "height": height,
    }
