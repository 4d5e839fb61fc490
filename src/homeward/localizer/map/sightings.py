"""Tables of sightings, of frames (where the camera was at each stamp), and of motions.

The camera's pose at a stamp is its keyframe's pose, composed with odometry and extrinsics, linear
in the calibration; all sightings of a stamp share it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from homeward.localizer.inputs.bearing_noise import CorrelatedErrors, WeighedFrame
from homeward.localizer.motions import NC, Motion
from homeward.localizer.reference.factors import (
    BY_CALIBRATION,
    FREE,
    INFORMATION,
    PER_S,
    STEP,
)
from homeward.localizer.tunables import MEAN_S
from homeward.table import GrowingTable

KEYFRAME, FRAME, LANDMARK, BEARING, SIGMA, OWN, GAP, AGE, TIME, LOG_RANGE, RANGE_SIGMA = range(11)
COLUMNS = 11
"""Columns of the table of sightings: numbers of keyframe, frame and landmark (-1: not mapped), the
bearing [rad], its standard deviation [rad] with and without the odometry noise since the keyframe,
the times since the landmark's last sighting (infinite for the first) and its first one [s], the
stamp [s], and the logarithm of the range [m] and its standard deviation (NaN where there is none).
"""


class Frames:
    """Table of frames: the camera relative to its keyframe at f stamps, numbered consecutively."""

    def __init__(self, first: int = 0, table: GrowingTable | None = None) -> None:
        self.first = first
        """Number of the oldest frame."""
        self._table = table or GrowingTable((5 + 3 * NC,))
        self.offsets: dict[int, np.ndarray] = {}
        """Pose (3,) of the camera in the frame of the first one, by number, if it is another."""

    @property
    def keyframes(self) -> np.ndarray:
        """(f,): numbers of the keyframes."""
        return self._table.rows[:, 0].astype(int)

    @property
    def stamps(self) -> np.ndarray:
        """(f,): their times [s]."""
        return self._table.rows[:, 1]

    @property
    def free(self) -> np.ndarray:
        """(f, 3): camera's pose in its keyframe's frame for a calibration of zero ..."""
        return self._table.rows[:, 2:5]

    @property
    def jacobians(self) -> np.ndarray:
        """(f, 3, 10): ... and its Jacobian by the calibration."""
        return self._table.rows[:, 5:].reshape(-1, 3, NC)

    @property
    def next(self) -> int:
        """Number of the next frame."""
        return self.first + len(self._table)

    def add(
        self, keyframe: int, free: np.ndarray, jacobian: np.ndarray, frame: WeighedFrame
    ) -> np.ndarray:
        """Add a frame; return its rows in the table of sightings (m, COLUMNS).

        `free` (3,) and `jacobian` (3, 10) are as in the table. Landmarks are still open (-1).
        """
        rows = np.empty((len(frame.names), COLUMNS))
        rows[:, KEYFRAME], rows[:, LANDMARK], rows[:, GAP] = keyframe, -1, np.inf
        rows[:, FRAME], rows[:, AGE], rows[:, TIME] = self.next, 0.0, frame.t
        rows[:, BEARING], rows[:, SIGMA], rows[:, OWN] = frame.bearings, frame.sigmas, frame.sigmas
        rows[:, LOG_RANGE:] = np.nan if frame.ranges is None else frame.ranges
        if frame.offset is not None:
            self.offsets[self.next] = frame.offset
        self._table.add(np.concatenate([(keyframe, frame.t), free, jacobian.ravel()]))
        return rows

    def drop_newest(self) -> None:
        """Drop the newest frame."""
        self._table.drop_last(1)
        self.offsets.pop(self.next, None)

    def take_before(self, keyframe: int) -> Frames:
        """Remove and return the frames of keyframes before a number."""
        count = int((self.keyframes < keyframe).sum())
        old = Frames(self.first, GrowingTable.of(self._table.rows[:count].copy()))
        self._table.drop_first(count)
        self.first += count
        for number in [n for n in self.offsets if n < self.first]:
            del self.offsets[number]
        return old

    def replace(self, index: int, camera: Motion) -> None:
        """Replace the motion of a frame."""
        self.free[index], self.jacobians[index] = camera.uncalibrated, camera.jacobian

    @staticmethod
    def joined(parts: Sequence[Frames]) -> Frames:
        """Return consecutive tables as one."""
        rows = np.concatenate([part._table.rows for part in parts])
        return Frames(parts[0].first, GrowingTable.of(rows))


def effective_sigmas(rows: np.ndarray, correlated: CorrelatedErrors) -> np.ndarray:
    """Return effective standard deviations of rows (m,) [rad]: larger for correlated errors."""
    excess = correlated.excess(rows[:, GAP])
    return np.asarray(np.sqrt(rows[:, SIGMA] ** 2 + rows[:, OWN] ** 2 * excess))


def scale_noise(rows: np.ndarray, factor: float) -> None:
    """Scale the measurement noise in rows (m, COLUMNS); that of odometry stays."""
    added = rows[:, SIGMA] ** 2 - rows[:, OWN] ** 2
    rows[:, OWN] *= factor
    rows[:, SIGMA] = np.sqrt(added + rows[:, OWN] ** 2)


MIN_COVARIANCE = 1e-10 * np.eye(3)
"""Smallest covariance of a motion [m^2, rad^2]."""


def step_row(motion: Motion, duration: float = math.inf) -> np.ndarray:
    """Return a motion of a duration [s] as a row (1, STEP) of the table."""
    row = np.empty((1, STEP))
    row[0, FREE] = motion.uncalibrated
    row[0, INFORMATION] = np.linalg.inv(motion.covariance + MIN_COVARIANCE).ravel()
    row[0, BY_CALIBRATION] = motion.jacobian.ravel()
    row[0, PER_S] = motion.is_odometry / max(duration, MEAN_S)
    return row


def scale_steps(steps: np.ndarray, factors: np.ndarray) -> None:
    """Scale the variances of shift and turn by factors (2,), in rows of the table."""
    shift, turn = factors.tolist()
    both = math.sqrt(shift * turn)
    steps[:, INFORMATION] /= [shift, shift, both, shift, shift, both, both, both, turn]
