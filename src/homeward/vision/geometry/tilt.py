"""Tilt of a camera relative to home's, and its effect on bearings.

An unknown tilt shifts all bearings of one panorama in proportion to the tangent of their elevation,
with opposite signs ahead and behind. But home's panorama defines level: relative to a camera with
the tilt of home's, bearings are those of a planar scene, projected along home's vertical.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from homeward.drives.cameras.camera import tilt_matrix, unit_vectors
from homeward.geometry.se2 import rotation
from homeward.vision.geometry.epipolar import Motion


@dataclass(frozen=True)
class Tilt:
    """Tilt of a camera relative to home's."""

    rotation: np.ndarray
    """(3, 3), from the camera's frame to one with the same heading and home's tilt."""
    covariance: np.ndarray
    """(2, 2), of roll and pitch [rad^2]."""

    @classmethod
    def of(cls, motion: Motion, covariance: np.ndarray) -> Tilt:
        """Return the tilt of a motion relative to home."""
        return cls(tilt_matrix(motion.roll, motion.pitch), covariance)

    def then(self, motion: Motion, covariance: np.ndarray) -> Tilt:
        """Return the tilt of a picture from its motion relative to a picture of this tilt."""
        turn = rotation(motion.alpha)
        whole = self.rotation @ turn @ tilt_matrix(motion.roll, motion.pitch)
        back = rotation(-math.atan2(whole[1, 0], whole[0, 0]))
        ours = turn[:2, :2].T @ self.covariance @ turn[:2, :2]
        return Tilt(back @ whole, ours + covariance)

    def level(self, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return bearings (n,) [rad] as of a camera with home's tilt, and their derivatives.

        `directions` (n, 2) are azimuth and elevation in the tilted camera's frame [rad]. The
        derivatives (n, 2) are those by an additional roll and pitch [1].
        """
        x, y, z = self.rotation @ unit_vectors(*directions.T).T
        out = np.maximum(np.hypot(x, y), 0.05)  # azimuth is undefined at the vertical
        return np.arctan2(y, x), -np.column_stack([x, y]) * (z / out**2)[:, None]

    def variance(self, lean: np.ndarray) -> np.ndarray:
        """Return the variances of bearings, (n,), from the uncertainty of the tilt."""
        return np.asarray(np.einsum("ni,ij,nj->n", lean, self.covariance, lean))


AS_HOME = Tilt(np.eye(3), np.zeros((2, 2)))
"""Tilt of home's picture itself."""
