"""Table of sightings, and table of frames: where the camera was at each stamp.

The camera's pose at a stamp is its keyframe's pose, composed with odometry and extrinsics, linear
in the calibration; all sightings of a stamp share it.
"""

from __future__ import annotations

import numpy as np

from homeward.localizer.inputs.bearing_noise import WeighedFrame
from homeward.localizer.inputs.correlated_errors import CorrelatedErrors
from homeward.localizer.motions import NC, Motion
from homeward.localizer.reference.window import cameras

KEYFRAME, FRAME, LANDMARK, BEARING, SIGMA, OWN, GAP, TIME, LOG_RANGE, RANGE_SIGMA = range(10)
COLUMNS = 10
"""Columns of the table of sightings: numbers of keyframe, frame and landmark (-1: not mapped), the
bearing [rad], its standard deviation [rad] with and without the odometry noise since the keyframe,
the time since the landmark's last sighting [s] (infinite for the first), the stamp [s], and the
logarithm of the range [m] and its standard deviation (NaN where there is none)."""


class Frames:
    """Table of frames: the camera relative to its keyframe at f stamps, numbered consecutively."""

    def __init__(self) -> None:
        self.first = 0
        """Number of the oldest frame."""
        self.keyframes = np.zeros(0, int)
        """(f,): numbers of the keyframes."""
        self.stamps = np.zeros(0)
        """(f,): their times [s]."""
        self.free = np.zeros((0, 3))
        """(f, 3): camera's pose in its keyframe's frame for a calibration of zero ..."""
        self.jacobians = np.zeros((0, 3, NC))
        """(f, 3, 9): ... and its Jacobian by the calibration."""
        self.offsets: dict[int, np.ndarray] = {}
        """Pose (3,) of the camera in the frame of the first one, by number, if it is another."""

    @property
    def next(self) -> int:
        """Number of the next frame."""
        return self.first + len(self.keyframes)

    def add(self, keyframe: int, camera: Motion, frame: WeighedFrame) -> np.ndarray:
        """Add a frame, `camera` being the motion from its keyframe.

        Return its rows in the table of sightings (m, COLUMNS), with landmarks still open (-1).
        """
        rows = np.empty((len(frame.names), COLUMNS))
        rows[:, KEYFRAME], rows[:, LANDMARK], rows[:, GAP] = keyframe, -1, np.inf
        rows[:, FRAME], rows[:, TIME] = self.first + len(self.keyframes), frame.t
        rows[:, BEARING], rows[:, SIGMA], rows[:, OWN] = frame.bearings, frame.sigmas, frame.sigmas
        rows[:, LOG_RANGE:] = np.nan if frame.ranges is None else frame.ranges
        if frame.offset is not None:
            self.offsets[self.next] = frame.offset
        uncalibrated = camera.delta - camera.jacobian @ camera.calibration
        self.keyframes = np.concatenate([self.keyframes, [keyframe]])
        self.stamps = np.concatenate([self.stamps, [frame.t]])
        self.free = np.concatenate([self.free, uncalibrated[None]])
        self.jacobians = np.concatenate([self.jacobians, camera.jacobian[None]])
        return rows

    def drop_newest(self) -> None:
        """Drop the newest frame."""
        self.keyframes, self.free = self.keyframes[:-1], self.free[:-1]
        self.jacobians, self.stamps = self.jacobians[:-1], self.stamps[:-1]
        self.offsets.pop(self.next, None)

    def since(self, number: int) -> Frames:
        """Return the frames from a number on."""
        some, begin = Frames(), number - self.first
        some.first, some.keyframes = number, self.keyframes[begin:]
        some.free, some.jacobians = self.free[begin:], self.jacobians[begin:]
        some.stamps = self.stamps[begin:]
        return some

    def take_before(self, keyframe: int) -> Frames:
        """Remove and return the frames of keyframes before a number."""
        old, count = Frames(), int((self.keyframes < keyframe).sum())
        old.first = self.first
        old.keyframes, self.keyframes = self.keyframes[:count], self.keyframes[count:]
        old.free, self.free = self.free[:count], self.free[count:]
        old.jacobians, self.jacobians = self.jacobians[:count], self.jacobians[count:]
        old.stamps, self.stamps = self.stamps[:count], self.stamps[count:]
        self.first += count
        for number in [n for n in self.offsets if n < self.first]:
            del self.offsets[number]
        return old

    def replace(self, index: int, camera: Motion) -> None:
        """Replace the motion of a frame."""
        self.free[index], self.jacobians[index] = camera.uncalibrated, camera.jacobian

    @staticmethod
    def joined(parts: list[Frames]) -> Frames:
        """Return consecutive tables as one."""
        whole = Frames()
        whole.first = parts[0].first
        whole.keyframes = np.concatenate([p.keyframes for p in parts])
        whole.free = np.concatenate([p.free for p in parts])
        whole.jacobians = np.concatenate([p.jacobians for p in parts])
        whole.stamps = np.concatenate([p.stamps for p in parts])
        return whole

    def eyes(self, poses: np.ndarray, calibration: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the camera's poses in the odometry frame (f, 3), and their Jacobians (f, 3, 12).

        From keyframe poses (f, 3) or (3,) and the present calibration (9,); Jacobians are by both.
        """
        return cameras(self.free, self.jacobians, poses, calibration)


def effective_sigmas(rows: np.ndarray, correlated: CorrelatedErrors) -> np.ndarray:
    """Return effective standard deviations of rows (m,) [rad]: larger for correlated errors."""
    excess = correlated.excess(rows[:, GAP])
    return np.asarray(np.sqrt(rows[:, SIGMA] ** 2 + rows[:, OWN] ** 2 * excess))


def scale_noise(rows: np.ndarray, factor: float) -> None:
    """Scale the measurement noise in rows (m, COLUMNS); that of odometry stays."""
    added = rows[:, SIGMA] ** 2 - rows[:, OWN] ** 2
    rows[:, OWN] *= factor
    rows[:, SIGMA] = np.sqrt(added + rows[:, OWN] ** 2)
