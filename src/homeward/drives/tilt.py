"""Bearings of a robot that rolls and pitches: corrected where their elevation is known.

A robot tilted by a small angle w turns the bearing of a landmark at elevation e by up to w tan e.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np

from homeward.drives.cameras.camera import unit_vectors
from homeward.drives.drive import Sightings, Tilt
from homeward.drives.settings import DriveSettings
from homeward.geometry.angles import wrap

TAN_ELEVATION = 0.5
"""Tangent of the elevation that is assumed where it is unknown: 27 degrees."""
MAX_TILT = math.radians(5.0)
"""Beyond this tilt, bearings of unknown elevation are unreliable [rad]."""
CORRECTED = "bearings corrected for the roll and pitch of the robot"
NOISIER = "bearings without an elevation: the roll and pitch of the robot are added to their noise"
UNRELIABLE = (
    f"bearings without an elevation while the robot was tilted by more than"
    f" {math.degrees(MAX_TILT):g} degrees: they are unreliable"
)


def levelled(
    seen: Sightings, tilt: Tilt, settings: DriveSettings, remarks: dict[str, int]
) -> Sightings:
    """Return sightings with bearings as seen by a level robot; `remarks` counts the changes.

    `settings` have the yaw of the cameras, and the standard deviation of bearings without their
    own.
    """
    yaw, sigma = np.full(seen.t.size, settings.sensor.yaw), settings.sensor.bearing_sigma
    for name, camera in settings.cameras.items():
        yaw[seen.camera == name] = camera.yaw
    own = seen.sigma if sigma is None else np.where(np.isnan(seen.sigma), sigma, seen.sigma)
    roll, pitch = (np.interp(seen.t, tilt.t, angle) for angle in (tilt.roll, tilt.pitch))
    bearing, sigmas = level(seen.bearing, seen.elevation, own, yaw, (roll, pitch))
    known = np.isfinite(seen.elevation)
    large = ~known & (np.hypot(roll, pitch) > MAX_TILT)
    for words, which in ((CORRECTED, known), (NOISIER, ~known), (UNRELIABLE, large)):
        if which.any():
            remarks[words] = int(which.sum())
    sigmas = np.where(known, seen.sigma, sigmas)
    nothing = np.full(seen.t.size, np.nan)
    return dataclasses.replace(seen, bearing=bearing, sigma=sigmas, elevation=nothing)


def level(
    bearing: np.ndarray,
    elevation: np.ndarray,
    sigma: np.ndarray,
    yaw: np.ndarray | float,
    tilt: tuple[np.ndarray | float, np.ndarray | float],
) -> tuple[np.ndarray, np.ndarray]:
    """Return bearings as seen by a level robot, and their standard deviations [rad], (n,) each.

    `yaw` is that of the camera on the robot, `tilt` its roll and pitch [rad]. Where the elevation
    is NaN, the bearing stays, and sigma grows.
    """
    (roll, pitch), known = tilt, np.isfinite(elevation)
    x, y, z = unit_vectors(bearing + yaw, np.where(known, elevation, 0.0)).T
    y, z = np.cos(roll) * y - np.sin(roll) * z, np.sin(roll) * y + np.cos(roll) * z
    turned = wrap(np.arctan2(y, np.cos(pitch) * x + np.sin(pitch) * z) - yaw)
    noisier = np.hypot(sigma, TAN_ELEVATION * np.hypot(roll, pitch))
    return np.where(known, turned, bearing), np.where(known, sigma, noisier)


def roll_and_pitch(q: Any) -> tuple[float, float]:
    """Return roll and pitch [rad] of a quaternion; NaN for a zero one."""
    norm = q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w
    if not norm > 0:
        return math.nan, math.nan
    roll = math.atan2(2 * (q.w * q.x + q.y * q.z), norm - 2 * (q.x * q.x + q.y * q.y))
    return roll, math.asin(max(-1.0, min(1.0, 2 * (q.w * q.y - q.z * q.x) / norm)))
