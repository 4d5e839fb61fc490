"""Bearing measurements: the table of sightings by keyframe, and the measurement model."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from homeward.angles import wrap
from homeward.localizer.geometry import compose, lever, rotation, sight
from homeward.localizer.motion.preintegration import (
    CALIBRATION,
    CAMERA_X,
    CAMERA_Y,
    CAMERA_YAW,
    Motion,
)

NC = len(CALIBRATION)
KEYFRAME, LANDMARK, BEARING, SIGMA, OWN, OFFSET = 0, 1, 2, 3, 4, slice(5, 8)
OFFSET_JACOBIAN = slice(8, 8 + 3 * NC)
COLUMNS = 8 + 3 * NC
"""Columns of the table of sightings: numbers of keyframe and landmark, bearing [rad], its standard
deviation [rad] with and without what the way from the keyframe adds, the camera's pose in the
keyframe's, and its derivative by the calibration."""


class WeighedFrame(NamedTuple):
    """Weighed frame: what the camera saw at one stamp, each bearing with its noise."""

    t: float
    """[s]"""
    names: list[str]
    """Of m landmarks."""
    bearings: np.ndarray
    """(m,) [rad]"""
    sigmas: np.ndarray
    """(m,): their standard deviations [rad]."""


def sighting_rows(
    keyframe: int, frame: WeighedFrame, motion: Motion, mount: np.ndarray, calibration: np.ndarray
) -> np.ndarray:
    """Return rows of the table for the sightings of one stamp, their landmarks still open (-1).

    Parameters
    ----------
    keyframe : int
        Its number.
    frame : WeighedFrame
        Of m landmarks.
    motion : Motion
        From the keyframe to the stamp.
    mount : ndarray, shape (3,)
        Pose of the camera on the robot.
    calibration : ndarray, shape (7,)
        Where `motion` was linearised.

    Returns
    -------
    ndarray, shape (m, COLUMNS)
    """
    camera = [CAMERA_X, CAMERA_Y, CAMERA_YAW]
    offset = compose(motion.delta, mount + calibration[camera])
    jacobian = lever(offset - motion.delta) @ motion.jacobian
    jacobian[:, camera] += rotation(motion.delta[2])
    rows = np.empty((len(frame.names), COLUMNS))
    rows[:, KEYFRAME], rows[:, LANDMARK] = keyframe, -1
    rows[:, BEARING], rows[:, SIGMA], rows[:, OWN] = frame.bearings, frame.sigmas, frame.sigmas
    rows[:, OFFSET] = offset - jacobian @ calibration
    rows[:, OFFSET_JACOBIAN] = jacobian.ravel()
    return rows


def scale_noise(rows: np.ndarray, factor: float) -> None:
    """Let the bearings' own deviations be so many times as large, in rows (m, COLUMNS)."""
    added = rows[:, SIGMA] ** 2 - rows[:, OWN] ** 2
    rows[:, OWN] *= factor
    rows[:, SIGMA] = np.sqrt(added + rows[:, OWN] ** 2)


def cameras(rows: np.ndarray, poses: np.ndarray, calibration: np.ndarray) -> np.ndarray:
    """Return the camera's pose at each row, in the odometry frame.

    Parameters
    ----------
    rows : ndarray, shape (m, COLUMNS)
        Of the table.
    poses : ndarray, shape (m, 3)
        Of the rows' keyframes.
    calibration : ndarray, shape (7,)
        As it is believed to be.

    Returns
    -------
    ndarray, shape (m, 3)
    """
    offsets = rows[:, OFFSET] + rows[:, OFFSET_JACOBIAN].reshape(-1, 3, NC) @ calibration
    return compose(poses, offsets)


def directions(rows: np.ndarray, poses: np.ndarray, calibration: np.ndarray) -> np.ndarray:
    """Return the directions of sight lines in the odometry frame, shape (m,) [rad], not wrapped.

    Parameters are those of `cameras`.
    """
    own = rows[:, BEARING] + rows[:, OFFSET.stop - 1]
    return np.asarray(poses[:, 2] + own + rows[:, -NC:] @ calibration)


def bearing_residuals(
    poses: np.ndarray, calibration: np.ndarray, positions: np.ndarray, rows: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return measured minus expected bearings and the Jacobian of the expected ones.

    Parameters
    ----------
    poses : ndarray, shape (m, 3) or (3,)
        Of the rows' keyframes.
    calibration : ndarray, shape (7,)
        As it is believed to be.
    positions : ndarray, shape (m, 2)
        Of the rows' landmarks [m].
    rows : ndarray, shape (m, COLUMNS)
        Of the table.

    Returns
    -------
    residual : ndarray, shape (m,)
        [rad], wrapped.
    jacobian : ndarray, shape (m, 12)
        By keyframe's pose, calibration and landmark.
    """
    by_calibration = rows[:, OFFSET_JACOBIAN].reshape(-1, 3, NC)
    eyes = compose(poses, rows[:, OFFSET] + by_calibration @ calibration)
    seen = sight(eyes, positions)
    gx, gy = seen.by_place.T
    arm, c, s = eyes - poses, np.cos(poses[..., 2]), np.sin(poses[..., 2])
    by_offset = np.empty((len(rows), 1, 3))
    by_offset[:, 0, 0], by_offset[:, 0, 1] = -c * gx - s * gy, s * gx - c * gy
    by_offset[:, 0, 2] = -1.0
    jacobian = np.empty((len(rows), 5 + NC))
    jacobian[:, 0], jacobian[:, 1] = -gx, -gy
    jacobian[:, 2] = gx * arm[:, 1] - gy * arm[:, 0] - 1.0
    jacobian[:, 3 : 3 + NC] = (by_offset @ by_calibration)[:, 0]
    jacobian[:, 3 + NC :] = seen.by_place
    return np.asarray(wrap(rows[:, BEARING] - seen.bearing)), jacobian


def without_landmark(rows: np.ndarray, number: int) -> np.ndarray:
    """Return the rows without those of a landmark; those after it move up by one number."""
    rows = rows[rows[:, LANDMARK] != number]
    rows[:, LANDMARK] -= rows[:, LANDMARK] > number
    return rows
