"""The camera models of sensor_msgs/CameraInfo."""

from __future__ import annotations

from typing import Any

import numpy as np

from homeward.drives.cameras.calibration import ros_values
from homeward.drives.cameras.lens import Lens
from homeward.errors import InputError


class CameraRows:
    """The CameraInfo of a topic, of which the first counts."""

    def __init__(self, topic: str, rectified: bool) -> None:
        self._topic, self._rectified = topic, rectified
        self._first: Any = None

    def add(self, _: float, message: Any) -> None:
        """Take a message."""
        if self._first is None:
            self._first = message

    def model(self) -> Lens | None:
        """Return the model of the camera; None when there was no message.

        Raises
        ------
        InputError
            When it is not calibrated, or of another model.
        """
        try:
            return None if self._first is None else from_camera_info(self._first, self._rectified)
        except (ValueError, IndexError, AttributeError):
            reason = f"{self._topic}: not the model of a calibrated camera that is known here"
            raise InputError(reason) from None


def from_camera_info(message: Any, rectified: bool) -> Lens:
    """Return the model that a CameraInfo message tells; in rectified images it has no distortion.

    Raises
    ------
    ValueError
        When it is not calibrated, or of another model.
    """
    if rectified:
        p = np.asarray(_either(message, "p"))
        return Lens(fx=p[0], fy=p[5], cx=p[2], cy=p[6])
    k, d = (np.asarray(_either(message, name)).tolist() for name in "kd")
    size = {name: getattr(message, name) or None for name in ("width", "height")}
    return Lens(**ros_values(k, d, message.distortion_model), **size)


def _either(message: Any, name: str) -> Any:
    return getattr(message, name if hasattr(message, name) else name.upper())
