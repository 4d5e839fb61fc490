"""Bearing measurements: the table of sightings by keyframe, and the measurement model."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from homeward.angles import wrap
from homeward.localizer.compiled import compiled
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
    x, y, turn = motion.delta.tolist()
    c, s = math.cos(turn), math.sin(turn)
    at_x, at_y = mount[0] + calibration[CAMERA_X], mount[1] + calibration[CAMERA_Y]
    swung_x, swung_y = c * at_x - s * at_y, s * at_x + c * at_y
    jacobian = motion.jacobian.copy()
    jacobian[0] -= swung_y * jacobian[2]
    jacobian[1] += swung_x * jacobian[2]
    jacobian[2, CAMERA_YAW] += 1.0
    jacobian[:2, CAMERA_X : CAMERA_Y + 1] += [[c, -s], [s, c]]
    offset = np.array([x + swung_x, y + swung_y, turn + mount[2] + calibration[CAMERA_YAW]])
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
    return np.asarray(poses + _arms(rows, poses, calibration))


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
    poses : ndarray, shape (m, 3)
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
    native = compiled()
    if native is not None:
        residual, jacobian = np.empty(len(rows)), np.empty((len(rows), 5 + NC))
        arguments = (poses, calibration, positions, rows, residual, jacobian)
        native.residuals(len(rows), *arguments)
        return residual, jacobian
    arms = _arms(rows, poses, calibration)
    sight = positions - poses[:, :2] - arms[:, :2]
    square = np.maximum((sight * sight).sum(axis=1), 1e-6)
    gx, gy = -sight[:, 1] / square, sight[:, 0] / square
    expected = np.arctan2(sight[:, 1], sight[:, 0]) - poses[:, 2] - arms[:, 2]
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    by_offset = np.stack([-(gx * c + gy * s), gx * s - gy * c, -np.ones(len(rows))], axis=1)
    jacobian = np.empty((len(rows), 5 + NC))
    jacobian[:, 0], jacobian[:, 1] = -gx, -gy
    jacobian[:, 2] = gx * arms[:, 1] - gy * arms[:, 0] - 1.0
    by_calibration = rows[:, OFFSET_JACOBIAN].reshape(-1, 3, NC)
    jacobian[:, 3 : 3 + NC] = (by_offset[:, None, :] @ by_calibration)[:, 0]
    jacobian[:, 3 + NC], jacobian[:, 4 + NC] = gx, gy
    return np.asarray(wrap(rows[:, BEARING] - expected)), jacobian


def without_landmark(rows: np.ndarray, number: int) -> np.ndarray:
    """Return the rows without those of a landmark; those after it move up by one number."""
    rows = rows[rows[:, LANDMARK] != number]
    rows[:, LANDMARK] -= rows[:, LANDMARK] > number
    return rows


def _arms(rows: np.ndarray, poses: np.ndarray, calibration: np.ndarray) -> np.ndarray:
    """Return how the camera's pose differs from the keyframe's, in the odometry frame (m, 3)."""
    arms = rows[:, OFFSET] + rows[:, OFFSET_JACOBIAN].reshape(-1, 3, NC) @ calibration
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    x, y = arms[:, 0], arms[:, 1]
    arms[:, 0], arms[:, 1] = c * x - s * y, s * x + c * y
    return np.asarray(arms)
