"""Table of the motions between keyframes."""

from __future__ import annotations

import math

import numpy as np

from homeward.localizer.motions import Motion
from homeward.localizer.reference.factors import (
    BY_CALIBRATION,
    FREE,
    INFORMATION,
    IS_ODOMETRY,
    STEP,
)

MIN_COVARIANCE = 1e-10 * np.eye(3)
"""Smallest covariance of a motion [m^2, rad^2]."""


def step_row(motion: Motion) -> np.ndarray:
    """Return a motion as a row (1, STEP) of the table."""
    row = np.empty((1, STEP))
    row[0, FREE] = motion.uncalibrated
    row[0, INFORMATION] = np.linalg.inv(motion.covariance + MIN_COVARIANCE).ravel()
    row[0, BY_CALIBRATION] = motion.jacobian.ravel()
    row[0, IS_ODOMETRY] = motion.is_odometry
    return row


def scale_steps(steps: np.ndarray, factors: np.ndarray) -> None:
    """Scale the variances of shift and turn by factors (2,), in rows of the table."""
    shift, turn = factors.tolist()
    both = math.sqrt(shift * turn)
    steps[:, INFORMATION] /= [shift, shift, both, shift, shift, both, both, both, turn]
