"""Local map: directions and inverse distances of landmarks from a camera, with their covariance.

It is a Kalman filter in the frame of the camera (robocentric; Castellanos et al., 2007), with
inverse distances (Civera et al., 2008). The bearing of a landmark is a state, so that a measurement
is linear, and errors of the odometry are common to all landmarks.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from homeward.geometry.angles import wrap
from homeward.localizer.tunables import CLOSE, YAW_LAG_S, YAW_SCALE_SIGMA

SCALE, LAG, NUM_SHARED = range(3)
"""States of the odometry: error of the scale of its rotation [1], its delay [s]; their number."""


class LocalMap:
    """Directions and inverse distances of n landmarks; see the module."""

    def __init__(self) -> None:
        self._mean = np.array([0.0, YAW_LAG_S])
        self._covariance = np.diag([YAW_SCALE_SIGMA, YAW_LAG_S]) ** 2
        self._turn_rate = 0.0

    def __len__(self) -> int:
        return (self._mean.size - NUM_SHARED) // 2

    @property
    def bearings(self) -> np.ndarray:
        """Predicted bearings of the landmarks, (n,) [rad]."""
        return self._mean[NUM_SHARED::2]

    @property
    def inverse_distances(self) -> np.ndarray:
        """Inverse distances of the landmarks, (n,) [1/m]."""
        return self._mean[NUM_SHARED + 1 :: 2]

    @property
    def bearing_covariance(self) -> np.ndarray:
        """Covariance of the predicted bearings, (n, n) [rad^2]."""
        return self._covariance[NUM_SHARED::2, NUM_SHARED::2]

    def differences(self, of: np.ndarray, from_: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return differences of landmarks by pairs, (q, 2), and their covariance (q, 2, q, 2)."""
        n = len(self)
        state = self._mean[NUM_SHARED:].reshape(n, 2)
        difference = state[of] - state[from_]
        difference[:, 0] = wrap(difference[:, 0])
        joint = self._covariance[NUM_SHARED:, NUM_SHARED:].reshape(n, 2, n, 2)
        rows = joint[of] - joint[from_]
        return difference, rows[:, :, of] - rows[:, :, from_]

    def move(self, motion: np.ndarray, variances: np.ndarray, turn_rate: float) -> None:
        """Predict a motion (3,) of the camera [m, m, rad], with the variances of its components.

        `turn_rate` is that of the odometry at its end [rad/s].
        """
        change, self._turn_rate = turn_rate - self._turn_rate, turn_rate
        n = len(self)
        if not n:
            return
        dx, dy, turn = motion.tolist()
        bearing, inverse = self.bearings, self.inverse_distances
        c, s = np.cos(bearing), np.sin(bearing)
        x, y = c - inverse * dx, s - inverse * dy
        square = np.maximum(x * x + y * y, CLOSE**2)
        ratio = np.sqrt(square)
        cube = square * ratio
        jacobian = np.zeros((n, 2, n, 2))
        i = np.arange(n)
        jacobian[i, 0, i, 0] = (x * c + y * s) / square
        jacobian[i, 0, i, 1] = (y * dx - x * dy) / square
        jacobian[i, 1, i, 0] = inverse * (x * s - y * c) / cube
        jacobian[i, 1, i, 1] = 1.0 / ratio + inverse * (x * dx + y * dy) / cube
        by_motion = np.zeros((n, 2, 3))
        by_motion[:, 0] = np.column_stack([inverse * y / square, -inverse * x / square, -(x**0)])
        by_motion[:, 1, :2] = (inverse**2 / cube)[:, None] * np.column_stack([x, y])
        whole = np.eye(self._mean.size)
        whole[NUM_SHARED:, NUM_SHARED:] = jacobian.reshape(2 * n, 2 * n)
        whole[NUM_SHARED::2, :NUM_SHARED] = -turn, change
        noise = by_motion.reshape(2 * n, 3)
        self._covariance = whole @ self._covariance @ whole.T
        self._covariance[NUM_SHARED:, NUM_SHARED:] += (noise * variances) @ noise.T
        scale, delay = self._mean[[SCALE, LAG]].tolist()
        turned = (1.0 + scale) * turn - delay * change
        self._mean[NUM_SHARED::2] = wrap(np.arctan2(y, x) - turned)
        self._mean[NUM_SHARED + 1 :: 2] = inverse / ratio

    def add_bearings(
        self, of: np.ndarray, bearings: np.ndarray, variances: np.ndarray, common: float
    ) -> None:
        """Add bearings (k,) of the landmarks `of` (k,), and a variance that they have in common."""
        i = NUM_SHARED + 2 * of
        own = self._covariance[np.ix_(i, i)] + np.diag(variances) + common
        self._update(self._covariance[:, i], own, wrap(bearings - self._mean[i]))

    def join(self, one: int, other: int, sigmas: np.ndarray) -> None:
        """Add that two landmarks are the same, up to small differences (2,)."""
        i, j = (NUM_SHARED + 2 * k + np.arange(2) for k in (one, other))
        across = self._covariance[:, i] - self._covariance[:, j]
        off = self._mean[j] - self._mean[i]
        off[0] = wrap(off[0])
        self._update(across, across[i] - across[j] + np.diag(sigmas**2), off)

    def _update(self, across: np.ndarray, own: np.ndarray, off: np.ndarray) -> None:
        """Update the state by innovations (k,) with covariance `own`."""
        gain = np.linalg.solve(own, across.T).T
        covariance = self._covariance - gain @ across.T
        self._covariance = 0.5 * (covariance + covariance.T)
        self._mean = self._mean + gain @ off
        self._mean[NUM_SHARED::2] = wrap(self._mean[NUM_SHARED::2])
        inverse = self._mean[NUM_SHARED + 1 :: 2]
        self._mean[NUM_SHARED + 1 :: 2] = np.maximum(inverse, 0.0)

    def add(self, bearing: float, variance: float, nearest: float) -> None:
        """Add a landmark that is hardly nearer than `nearest` [m]."""
        inverse = 0.5 / nearest
        n = self._mean.size
        self._mean = np.append(self._mean, [bearing, inverse])
        covariance = np.zeros((n + 2, n + 2))
        covariance[:n, :n] = self._covariance
        covariance[n, n], covariance[n + 1, n + 1] = variance, inverse**2
        self._covariance = covariance

    def keep(self, kept: Sequence[int]) -> None:
        """Keep some landmarks, in this order, and remove the others."""
        of = [NUM_SHARED + 2 * k + e for k in kept for e in range(2)]
        rows = np.array([*range(NUM_SHARED), *of])
        self._mean, self._covariance = self._mean[rows], self._covariance[np.ix_(rows, rows)]
