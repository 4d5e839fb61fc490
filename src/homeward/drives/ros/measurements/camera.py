"""The camera models of sensor_msgs/CameraInfo: pixels to bearings."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np

from homeward.drives.drive import Finite, Positive, Strict
from homeward.errors import InputError

ITERATIONS = 30
"""Of the inversion of a lens's distortion; it stops being exact where the lens folds over."""


class Intrinsics(Strict):
    """A camera model, as CameraInfo has it. The camera is level; its axis is its optical one."""

    fx: Positive
    """Focal length along the rows [pixel]."""
    fy: Positive
    """And along the columns [pixel]."""
    cx: Finite
    """Where the axis meets the image, along the rows [pixel]."""
    cy: Finite
    """And along the columns [pixel]."""
    model: Literal["plumb_bob", "rational_polynomial", "equidistant"] = "plumb_bob"
    distortion: tuple[Finite, ...] = ()
    """k1, k2, p1, p2, k3 (then k4, k5, k6); k1 to k4 of the equidistant model."""

    def bearings(self, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return bearings [rad] from the axis, anti-clockwise seen from above, shape (n,).

        `u` and `v`, (n,), are column and row of points in the raw image [pixel].
        """
        x, y = (u - self.cx) / self.fx, (v - self.cy) / self.fy
        if not any(self.distortion):
            return np.asarray(-np.arctan(x))
        k = np.zeros(8)
        k[: len(self.distortion)] = self.distortion
        if self.model == "equidistant":
            return _equidistant(x, y, k)
        return np.asarray(-np.arctan(_straightened(x, y, k)))


class CameraRows:
    """The CameraInfo of a topic, of which the first counts."""

    def __init__(self, topic: str, rectified: bool) -> None:
        self._topic, self._rectified = topic, rectified
        self._first: Any = None

    def add(self, _: float, message: Any) -> None:
        """Take a message."""
        if self._first is None:
            self._first = message

    def model(self) -> Intrinsics | None:
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


def from_camera_info(message: Any, rectified: bool) -> Intrinsics:
    """Return the model that a CameraInfo message tells; in rectified images it has no distortion.

    Raises
    ------
    ValueError
        When it is not calibrated, or of another model.
    """
    if rectified:
        p = np.asarray(_either(message, "p"))
        return Intrinsics(fx=p[0], fy=p[5], cx=p[2], cy=p[6])
    k = np.asarray(_either(message, "k"))
    return Intrinsics(
        fx=k[0],
        fy=k[4],
        cx=k[2],
        cy=k[5],
        model=message.distortion_model or "plumb_bob",
        distortion=tuple(np.asarray(_either(message, "d")).tolist())[:8],
    )


def _either(message: Any, name: str) -> Any:
    return (
        getattr(message, name, None) if hasattr(message, name) else getattr(message, name.upper())
    )


def _straightened(xd: np.ndarray, yd: np.ndarray, k: np.ndarray) -> np.ndarray:
    """Undo radial and tangential distortion by fixed-point iteration; returns x alone."""
    k1, k2, p1, p2, k3, k4, k5, k6 = k
    x, y = xd, yd
    for _ in range(ITERATIONS):
        r2 = x * x + y * y
        radial = (1 + r2 * (k4 + r2 * (k5 + r2 * k6))) / (1 + r2 * (k1 + r2 * (k2 + r2 * k3)))
        x, y = (
            (xd - 2 * p1 * x * y - p2 * (r2 + 2 * x * x)) * radial,
            (yd - p1 * (r2 + 2 * y * y) - 2 * p2 * x * y) * radial,
        )
    return x


def _equidistant(x: np.ndarray, y: np.ndarray, k: np.ndarray) -> np.ndarray:
    """Bearings through a fisheye lens (Kannala, Brandt), to beyond a right angle."""
    distorted = np.hypot(x, y)
    angle = distorted.copy()
    for _ in range(ITERATIONS):
        a2 = angle * angle
        angle = distorted / (1 + a2 * (k[0] + a2 * (k[1] + a2 * (k[2] + a2 * k[3]))))
    sideways = np.divide(x, distorted, out=np.zeros_like(x), where=distorted > 0)
    return np.asarray(-np.arctan2(np.sin(angle) * sideways, np.cos(angle)))
