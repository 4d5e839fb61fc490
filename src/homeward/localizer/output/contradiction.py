"""Contradiction of odometry and bearings: odometry moves, but the bearings stay.

The camera may be frozen, with some jitter, or the wheels spin on the spot: bearings and odometry
alone do not distinguish the two. In the first case the robot is where odometry has it, in the other
where it was, so that no pose is verified, and the covariance contains both.
"""

from __future__ import annotations

import dataclasses
import math
from typing import NamedTuple

import numpy as np

from homeward.angles import wrap
from homeward.estimator import Estimate, Status
from homeward.localizer.geometry import between, compose, lever, rotation, sight
from homeward.localizer.inputs.bearing_noise import WeighedFrame
from homeward.localizer.map.map import Map
from homeward.localizer.motion.preintegration import Motion
from homeward.localizer.motion.twists import DeadReckoning, Twists
from homeward.localizer.recovery.relocalise import MIN_LOG_ODDS
from homeward.localizer.tunables import INLIER, MAJORITY
from homeward.reasons import Reason

ODOMETRY_ERROR = 0.1
"""Systematic error of an uncalibrated odometry: share of shift and rotation [1]."""
LASTS_S = 0.5
"""A contradiction that lasts for less may be a lag between odometry and camera; a shorter change of
the bearings, on the other hand, may be an outlier [s]."""
UNSEEN_S = 2.0
"""A reference frame of which no landmark is in sight is kept for this long [s]."""


class _Reference(NamedTuple):
    """First of the frames whose bearings have stayed."""

    t: float
    """[s]"""
    seen: dict[str, list[float]]
    """Of each mapped landmark: bearing and its standard deviation [rad], and distance [m], which
    the map changes if the contradiction lasts."""
    odometry: np.ndarray
    """(3,): pose by odometry alone."""
    pose: np.ndarray
    """(3,): pose in the map."""


class Contradiction:
    """Test of whether the bearings say that the robot stands, while odometry moves."""

    def __init__(self) -> None:
        self._reference: _Reference | None = None
        self._reckoning = DeadReckoning()
        self._moved = np.zeros(3)
        """Motion by odometry since the reference, in the robot's frame there."""
        self._is_proved = False
        """Whether the bearings contradict odometry by a Bayes factor of 370."""
        self._newest = self._stayed = -math.inf
        """Stamps of the newest frame, and of the newest whose bearings have stayed [s]."""

    def add_bearings(
        self, frame: WeighedFrame, known: Map, motion: Motion, rates: np.ndarray, twists: Twists
    ) -> None:
        """Compare a frame with the reference, and with what odometry predicts since then.

        Parameters
        ----------
        frame : WeighedFrame
            The frame.
        known : Map
            The map.
        motion : Motion
            From its newest keyframe to the frame.
        rates : ndarray, shape (3, 3)
            Process noise of odometry; see `homeward.drives.odometry_noise.noise_rates`.
        twists : Twists
            History of odometry.
        """
        here = np.array(self._reckoning.advance(frame.t, twists))
        self._newest, reference = frame.t, self._reference
        if reference is not None and (self._is_proved or twists.moves(frame.t)):
            self._moved = between(reference.odometry, here)
            camera = known.camera(Motion.identity()).delta
            log_odds = self._log_odds(reference, frame, camera, rates)
            if log_odds is not None:
                self._is_proved |= log_odds > MIN_LOG_ODDS
                self._stayed = frame.t
            if log_odds is not None or (self._is_proved and frame.t - self._stayed < LASTS_S):
                return
        mapped, state = known.landmarks.mapped, known.state
        rows = [row for row, name in enumerate(frame.names) if name in mapped]
        names = [frame.names[row] for row in rows]
        index = known.landmarks.index([mapped[n] for n in names])
        eye = state.pose_after(known.camera(motion))[0]
        distances = np.hypot(*(state.positions[index] - eye[:2]).T)
        columns = np.column_stack([frame.bearings[rows], frame.sigmas[rows], distances])
        seen = dict(zip(names, columns.tolist(), strict=True))
        self._reference = _Reference(frame.t, seen, here, state.pose_after(motion)[0])
        self._is_proved, self._moved = False, np.zeros(3)

    def _log_odds(
        self, reference: _Reference, frame: WeighedFrame, camera: np.ndarray, rates: np.ndarray
    ) -> float | None:
        """Return the log Bayes factor of bearings that stayed.

        None where most of them changed, or one as odometry predicts.
        """
        elapsed = frame.t - reference.t
        common = [row for row, name in enumerate(frame.names) if name in reference.seen]
        if not common:
            return -math.inf if elapsed < UNSEEN_S else None
        then = np.array([reference.seen[frame.names[row]] for row in common])
        variance = frame.sigmas[common] ** 2 + then[:, 1] ** 2
        change = np.asarray(wrap(frame.bearings[common] - then[:, 0]))
        direction = then[:, 0] + camera[2]
        places = np.stack([np.cos(direction), np.sin(direction)], axis=-1) * then[:, 2:]
        moved = compose(self._moved, camera)
        view = sight(moved, places + camera[:2])
        by_eye = np.column_stack([-view.by_place, -np.ones(len(change))])
        jacobian = by_eye @ lever(moved - self._moved)
        off = np.asarray(wrap(then[:, 0] + change - view.bearing))
        covariance = self._motion_covariance(rates, elapsed)
        predicted = variance + ((jacobian @ covariance) * jacobian).sum(axis=1)
        stays = np.abs(change) <= INLIER * np.sqrt(variance)
        follows = np.abs(off) <= INLIER * np.sqrt(predicted)
        if np.count_nonzero(stays) < MAJORITY * len(common) or (follows & ~stays).any():
            return None
        return _log_bayes_factor(
            change[stays], off[stays], variance[stays], jacobian[stays], covariance
        )

    @property
    def _systematic(self) -> np.ndarray:
        """(3,): systematic error of odometry's motion since the reference [m, m, rad]."""
        shift, turn = float(np.hypot(*self._moved[:2])), abs(float(self._moved[2]))
        return ODOMETRY_ERROR * np.array([shift, shift, turn])

    def _motion_covariance(self, rates: np.ndarray, elapsed: float) -> np.ndarray:
        """Return the covariance (3, 3) of odometry's motion since the reference."""
        shift, turn = self._systematic[1:] / ODOMETRY_ERROR
        return np.diag(rates @ [elapsed, shift, turn] + self._systematic**2)

    def applied(self, found: Estimate, pose: np.ndarray) -> Estimate:
        """Return an estimate whose covariance contains the pose of either case, and its status.

        Parameters
        ----------
        found : Estimate
            An estimate with a pose.
        pose : ndarray, shape (3,)
            The same pose in the map.
        """
        reference = self._reference
        if not self._is_proved or reference is None or found.pose is None:
            return found
        off = np.stack([reference.pose, compose(reference.pose, self._moved)]) - pose
        off[:, 2] = wrap(off[:, 2])
        off = off @ rotation(found.pose.heading - float(pose[2])).T
        spread = off.T @ off + np.diag(self._systematic**2)
        found = dataclasses.replace(found, covariance=found.covariance + spread)
        if self._newest - reference.t < LASTS_S:
            return found
        why = Reason.CONTRADICTED.words
        return dataclasses.replace(found, status=Status.UNVERIFIED, reason=why)


def _log_bayes_factor(
    change: np.ndarray,
    off: np.ndarray,
    variance: np.ndarray,
    jacobian: np.ndarray,
    covariance: np.ndarray,
) -> float:
    """Return the log Bayes factor of bearings that stayed against ones that follow odometry.

    Parameters
    ----------
    change, off : ndarray, shape (m,)
        Change of the bearings, and that beyond the change that odometry predicts [rad].
    variance : ndarray, shape (m,)
        Variance of the change [rad^2].
    jacobian : ndarray, shape (m, 3)
        Of the predicted change by odometry's motion.
    covariance : ndarray, shape (3, 3)
        Of that motion.
    """
    information, slope = (jacobian.T / variance) @ jacobian, jacobian.T @ (off / variance)
    spread = np.eye(3) + covariance @ information
    explained = slope @ np.linalg.solve(spread, covariance @ slope)
    square = float(((off**2 - change**2) / variance).sum() - explained)
    return 0.5 * (square + float(np.linalg.slogdet(spread)[1]))
