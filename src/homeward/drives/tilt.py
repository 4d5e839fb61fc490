"""Bearings of a robot that rolls and pitches: corrected where their elevation is known.

A robot tilted by a small angle w turns the bearing of a landmark at elevation e by up to w tan e.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from homeward.drives.cameras.camera import unit_vectors

TAN_ELEVATION = 0.5
"""Tangent of the elevation that is assumed where it is unknown: 27 degrees."""
MAX_TILT = math.radians(5.0)
"""Beyond this tilt, bearings of unknown elevation are unreliable [rad]."""
CORRECTED = "bearings corrected for the roll and pitch of the robot in {}"
NOISIER = "bearings without an elevation: the roll and pitch in {} are added to their noise"
UNRELIABLE = (
    f"bearings without an elevation while the robot was tilted by more than"
    f" {math.degrees(MAX_TILT):g} degrees according to {{}}: they are unreliable"
)


class Tilts(NamedTuple):
    """Roll and pitch of a robot, (n,) each, in order of time."""

    t: np.ndarray
    """[s]"""
    roll: np.ndarray
    """Positive: the left side is raised [rad]."""
    pitch: np.ndarray
    """Positive: the front is lowered [rad]."""

    def level(
        self,
        seen: dict[str, np.ndarray],
        yaw: float,
        source: str,
        remarks: dict[str, int],
    ) -> dict[str, np.ndarray]:
        """Return sightings with bearings as seen by a level robot.

        `seen` has the columns t, bearing, elevation (NaN: unknown) and sigma, (n,) each; `yaw` is
        that of their camera on the robot [rad]. Where the elevation is unknown, sigma grows.
        """
        roll, pitch = (np.interp(seen["t"], self.t, angle) for angle in (self.roll, self.pitch))
        known = np.isfinite(seen["elevation"])
        x, y, z = unit_vectors(seen["bearing"] + yaw, np.where(known, seen["elevation"], 0.0)).T
        y, z = np.cos(roll) * y - np.sin(roll) * z, np.sin(roll) * y + np.cos(roll) * z
        bearing = np.arctan2(y, np.cos(pitch) * x + np.sin(pitch) * z) - yaw
        size = np.hypot(roll, pitch)
        sigma = np.where(known, seen["sigma"], np.hypot(seen["sigma"], TAN_ELEVATION * size))
        large = ~known & (size > MAX_TILT)
        for words, which in ((CORRECTED, known), (NOISIER, ~known), (UNRELIABLE, large)):
            if which.any():
                words = words.format(source)
                remarks[words] = remarks.get(words, 0) + int(which.sum())
        return seen | {"bearing": np.where(known, bearing, seen["bearing"]), "sigma": sigma}


def roll_and_pitch(q: Any) -> tuple[float, float]:
    """Return roll and pitch [rad] of a quaternion; NaN for a zero one."""
    norm = q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w
    if not norm > 0:
        return math.nan, math.nan
    roll = math.atan2(2 * (q.w * q.x + q.y * q.z), norm - 2 * (q.x * q.x + q.y * q.y))
    return roll, math.asin(max(-1.0, min(1.0, 2 * (q.w * q.y - q.z * q.x) / norm)))
