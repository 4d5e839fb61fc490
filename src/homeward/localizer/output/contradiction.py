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

from homeward.estimator import Estimate, Status
from homeward.geometry.angles import wrap
from homeward.geometry.se2 import between, compose, composition, difference, rotation, sight
from homeward.localizer.inputs.bearing_noise import WeighedFrame
from homeward.localizer.map.map import Map
from homeward.localizer.map.state import Marginal
from homeward.localizer.motions import Motion
from homeward.localizer.tunables import (
    FROZEN_S,
    INLIER,
    MAJORITY,
    MIN_LOG_ODDS,
    ODOMETRY_ERROR,
    UNSEEN_S,
)
from homeward.odometry.history import Reckoned
from homeward.reasons import Reason


class _Reference(NamedTuple):
    """First of the frames whose bearings have stayed."""

    frame: WeighedFrame
    """The frame."""
    ids: np.ndarray
    """(m,): the smoother's ids of its landmarks, -1 of those not mapped."""
    state: Marginal
    """The state of the map at its newest keyframe, before the contradiction changes it ..."""
    known: np.ndarray
    """(n,): ... the ids of the landmarks in it ..."""
    motion: Motion
    """... and the motion from that keyframe to the frame."""
    odometry: np.ndarray
    """(3,): pose by odometry alone."""


class Contradiction:
    """Test of whether the bearings indicate a stationary robot while odometry moves."""

    def __init__(self) -> None:
        self._reference: _Reference | None = None
        self._here = np.zeros(3)
        """Pose by odometry alone at the newest frame."""
        self.is_proved = False
        """Whether the bearings contradict odometry by a Bayes factor of 370."""
        self._newest = self._stayed = -math.inf
        """Stamps of the newest frame, and of the newest whose bearings have stayed [s]."""

    def add_bearings(
        self,
        frame: WeighedFrame,
        known: Map,
        motion: Motion,
        rates: np.ndarray,
        reckoned: Reckoned,
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
            Process noise of odometry; see `homeward.drives.settings.noise_rates`.
        reckoned : Reckoned
            Dead reckoning at the frame.
        """
        self._here = np.array(reckoned.pose)
        self._newest, reference = frame.t, self._reference
        if reference is not None and (self.is_proved or reckoned.moves):
            log_odds = self._log_odds(reference, frame, known, rates)
            if log_odds is not None:
                self.is_proved |= log_odds > MIN_LOG_ODDS
                self._stayed = frame.t
            if log_odds is not None or (self.is_proved and frame.t - self._stayed < FROZEN_S):
                return
        ids, smoother = known.landmarks.ids(frame.names), known.smoother
        self._reference = _Reference(frame, ids, smoother.state, smoother.ids, motion, self._here)
        self.is_proved = False

    def _log_odds(
        self, reference: _Reference, frame: WeighedFrame, known: Map, rates: np.ndarray
    ) -> float | None:
        """Return the log Bayes factor of bearings that stayed.

        None where most of them changed, or one as odometry predicts.
        """
        before = reference.frame
        elapsed = frame.t - before.t
        each = zip(before.names, reference.ids.tolist(), strict=True)
        row_before = {name: row for row, (name, number) in enumerate(each) if number >= 0}
        if frame.offset is not before.offset:  # another camera
            row_before = {}
        rows = [(row, row_before[n]) for row, n in enumerate(frame.names) if n in row_before]
        if not rows:
            return -math.inf if elapsed < UNSEEN_S else None
        common, then = np.array(rows).T
        change = np.asarray(wrap(frame.bearings[common] - before.bearings[then]))
        variance = frame.sigmas[common] ** 2 + before.sigmas[then] ** 2
        stays = np.abs(change) <= INLIER * np.sqrt(variance)
        if np.count_nonzero(stays) < MAJORITY * len(common):
            return None
        camera = known.camera_pose(frame.offset)
        at, state = reference.known.searchsorted(reference.ids[then]), reference.state
        eye = compose(compose(state.mean[:3], reference.motion.delta), camera)
        distances = np.hypot(*(state.positions[at] - eye[:2]).T)
        direction = before.bearings[then] + camera[2]
        places = np.stack([np.cos(direction), np.sin(direction)], axis=-1) * distances[:, None]
        motion = between(reference.odometry, self._here)
        moved, by_motion, _ = composition(motion, camera)
        view = sight(moved, places + camera[:2])
        by_eye = np.column_stack([-view.by_place, -np.ones(len(change))])
        jacobian = by_eye @ by_motion
        off = np.asarray(wrap(before.bearings[then] + change - view.bearing))
        shift, turn = float(np.hypot(*motion[:2])), abs(float(motion[2]))
        covariance = np.diag(rates @ [elapsed, shift, turn]) + _systematic_covariance(motion)
        predicted = variance + ((jacobian @ covariance) * jacobian).sum(axis=1)
        follows = np.abs(off) <= INLIER * np.sqrt(predicted)
        if (follows & ~stays).any():
            return None
        return _log_bayes_factor(
            change[stays], off[stays], variance[stays], jacobian[stays], covariance
        )

    def applied(self, found: Estimate, state: Marginal, motion: Motion) -> Estimate:
        """Return an estimate whose covariance contains the pose of either case, and its status.

        Parameters
        ----------
        found : Estimate
            An estimate with a pose, while `is_proved`: that in the map after a `motion` from the
            newest keyframe, of which `state` is the state.
        """
        reference = self._reference
        if reference is None or found.pose is None:
            return found
        pose = state.pose_after(motion)[0]
        before = reference.state.pose_after(reference.motion)[0]
        moved = between(reference.odometry, self._here)
        off = difference(np.stack([before, compose(before, moved)]), pose)
        off = off @ rotation(found.pose.heading - float(pose[2])).T
        spread = off.T @ off + _systematic_covariance(moved)
        found = dataclasses.replace(found, covariance=found.covariance + spread)
        if self._newest - reference.frame.t < FROZEN_S:
            return found
        why = Reason.CONTRADICTED.words
        return dataclasses.replace(found, status=Status.UNVERIFIED, reason=why)


def _systematic_covariance(motion: np.ndarray) -> np.ndarray:
    """Return the covariance (3, 3) of a motion (3,) by the systematic error of odometry."""
    shift, turn = float(np.hypot(*motion[:2])), abs(float(motion[2]))
    return np.diag((ODOMETRY_ERROR * np.array([shift, shift, turn])) ** 2)


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
