"""What others use of a localiser beyond the pose: calibration, predicted bearings, the map."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from homeward.drives.drive import HomeBearing
from homeward.geometry.angles import wrap
from homeward.geometry.se2 import rotation
from homeward.localizer.inputs.bearing_noise import BearingNoise
from homeward.localizer.map.bodies import find_bodies, given_bodies
from homeward.localizer.map.landmarks import numbers
from homeward.localizer.map.map import Map
from homeward.localizer.map.smoother import Smoother
from homeward.localizer.map.state import Marginal
from homeward.localizer.map.survey.evidence import (
    Residuals,
    is_another_size,
    stretch,
    tested,
)
from homeward.localizer.map.survey.factors import Datum, SurveyFactors, align, rotated
from homeward.localizer.motion.extrinsics import Extrinsics
from homeward.localizer.motion.odometry import ProcessNoise
from homeward.localizer.motions import (
    CAMERA_X,
    CAMERA_Y,
    CAMERA_YAW,
    HEAD,
    NC,
    SIDEWAYS_SCALE,
    SPEED_SCALE,
    TIME_CONSTANT,
    TURN_SLIP,
    Motion,
)
from homeward.localizer.reference.factors import bearing_residuals, cameras
from homeward.localizer.tunables import FIXED_TIME_CONSTANT_S, NEGLIGIBLE_CALIBRATION

__all__ = [
    "Datum",
    "EstimatedCalibration",
    "MapSnapshot",
    "PredictedBearings",
    "align",
    "estimated_calibration",
    "moved_probabilities",
    "predicted_bearings",
    "relative_size",
    "rotated",
]


@dataclass(frozen=True)
class EstimatedCalibration:
    """Calibration of odometry and camera, and noise, as estimated; in the order of `motions`."""

    mean: np.ndarray
    """(10,): corrections of the given calibration."""
    covariance: np.ndarray
    """(10, 10): their covariance, ..."""
    priors: np.ndarray
    """(10,): ... and the variances of their priors."""
    is_open: np.ndarray
    """(10,), bool: which of them are estimated; others are fixed, or as given."""
    bearing_sigma: float
    """Standard deviation of a bearing [rad]."""
    process_rates: np.ndarray
    """(3, 3): variances by unit of time of the motion along, across and of the heading, for a unit
    of time, of speed and of turn rate."""
    is_noise_raised: bool
    """Whether the noise of bearings or odometry is larger than given."""


@dataclass(frozen=True)
class PredictedBearings:
    """Bearings of all mapped landmarks from a camera, in view or not."""

    landmarks: tuple[str, ...]
    """Their names."""
    bearings: np.ndarray
    """(n,): from the camera's axis [rad], in (-pi, pi]."""
    covariance: np.ndarray
    """(n, n): of these bearings, by the uncertainty of pose, calibration and map [rad^2]; the noise
    of a measurement comes in addition."""


def estimated_calibration(
    smoother: Smoother,
    of_odometry: np.ndarray,
    camera: Extrinsics,
    noise: BearingNoise,
    process_noise: ProcessNoise,
    scale_rest: float,
) -> EstimatedCalibration:
    """Return the calibration of a solution.

    `of_odometry` (7,) has the prior standard deviations of the odometry's part, and `scale_rest`
    is that of the scale which is in no state, since ranges leave it unknown.
    """
    state, lag_sigma = smoother.state, smoother.time_constant_prior[1]
    priors = np.concatenate([of_odometry, camera.sigmas]) ** 2
    priors[TIME_CONSTANT], priors[TURN_SLIP] = lag_sigma**2, smoother.slip_sigma**2
    covariance, is_open = state.covariance[3:HEAD, 3:HEAD].copy(), np.ones(NC, bool)
    covariance[SPEED_SCALE, SPEED_SCALE] += scale_rest**2
    priors[SPEED_SCALE] += scale_rest**2
    learnt = camera.learnt(state.calibration)
    is_open[[CAMERA_X, CAMERA_Y, CAMERA_YAW]] = [name in learnt for name in ("x", "y", "yaw")]
    is_open[TURN_SLIP] = state.calibration[TURN_SLIP] > NEGLIGIBLE_CALIBRATION  # not at its bound
    is_observed = covariance[SIDEWAYS_SCALE, SIDEWAYS_SCALE] < priors[SIDEWAYS_SCALE]
    is_open[SIDEWAYS_SCALE] = is_observed  # where the robot has not strafed, it drifts only
    is_open[TIME_CONSTANT] = lag_sigma > FIXED_TIME_CONSTANT_S  # the map contradicts zero
    is_raised = noise.scale > 1.0 or bool((process_noise.scales > 1.0).any())
    found = state.calibration, covariance, priors, is_open
    return EstimatedCalibration(*found, noise.sigma, process_noise.rates, is_raised)


def predicted_bearings(
    known: Map, motion: Motion, slip: np.ndarray, offset: np.ndarray | None
) -> PredictedBearings:
    """Predict the bearings from a camera after a motion from the newest keyframe.

    `slip` (3, 3) is the covariance of what wheels may slip in it, and `offset` (3,) the pose of the
    camera in the frame of the first one; None for the first.
    """
    names, mapped = tuple(known.landmarks.mapped), known.landmarks.mapped.values()
    found, now = known.smoother.all_landmarks.linear(numbers(mapped)), known.smoother.state
    after, by_head = now.pose_after(motion)
    eye = known.camera(Motion.identity(), offset)
    camera = cameras(eye.uncalibrated, eye.jacobian, after, now.calibration)
    places = found.mean[HEAD:].reshape(-1, 2)
    residual, jacobian = bearing_residuals(np.zeros(len(names)), *camera, places)
    by_pose, by_place = jacobian[:, :3], jacobian[:, None, HEAD:]
    by_state = by_pose @ by_head
    by_state[:, 3:] += jacobian[:, 3:HEAD]

    def propagated(rows: np.ndarray) -> np.ndarray:
        by_places = by_place @ rows[HEAD:].reshape(len(names), 2, rows.shape[1])
        return np.asarray(by_state @ rows[:HEAD] + by_places[:, 0])

    by_window, errors = propagated(found.by_window), propagated(found.errors)
    by_motion = by_pose @ rotation(float(now.mean[2]))
    covariance = by_window @ found.of_window @ by_window.T + errors @ errors.T
    covariance += by_motion @ (motion.covariance + slip) @ by_motion.T
    at = np.arange(len(names))
    covariance[at, at] += (by_place @ found.own @ by_place.transpose(0, 2, 1))[:, 0, 0]
    covariance[at, at] = np.maximum(covariance[at, at], 0.0)
    return PredictedBearings(names, np.asarray(wrap(-residual)), covariance)


@dataclass(frozen=True)
class MapSnapshot:
    """Map of one drive by its own measurements, in the frame of the robot's pose at the start."""

    names: tuple[str, ...]
    """Names of the n present landmarks."""
    positions: np.ndarray
    """(n, 2) [m]"""
    covariance: np.ndarray
    """(2 n, 2 n): covariance of their coordinates in order [m^2]."""
    home: np.ndarray | None
    """(3,): pose of the robot at home; None unless found by home bearings."""
    home_bearings: Mapping[str, HomeBearing]
    """The home bearings with their present standard deviations."""
    home_mounts: Mapping[str, np.ndarray]
    """Poses (3,) of their cameras on the robot at home."""


def moved_probabilities(
    before: tuple[np.ndarray, np.ndarray],
    now: tuple[np.ndarray, np.ndarray],
    prior: np.ndarray,
    size: float,
    names: Sequence[str],
    together: Iterable[Sequence[str]],
) -> np.ndarray:
    """Return the probability of each of k landmarks to have moved between two maps, (k,).

    Parameters
    ----------
    before, now : tuple of ndarray, shapes (k, 2) and (2 k, 2 k)
        Positions [m] and covariances [m^2], each map in a frame of its own.
    prior : ndarray, shape (k,)
        Prior probability of each to have moved.
    size : float
        Size of the site [m].
    names : sequence of str
        The landmarks.
    together : iterable of sequences of str
        Groups of landmarks that move together, as given.
    """
    factors, free = _as_survey(before, now)
    at = np.arange(len(factors.places))
    bodies = find_bodies(names, factors.places, given_bodies(together, names), size)
    return tested(factors, free, at, prior, size, bodies).wrong


def relative_size(
    before: tuple[np.ndarray, np.ndarray], now: tuple[np.ndarray, np.ndarray], size: float
) -> float:
    """Return the size of a map over that of a second one [1], or 1 if they do not contradict.

    The arguments are those of `moved_probabilities`, of landmarks that did not move.
    """
    factors, free = _as_survey(before, now)
    found = 1.0 + stretch(Residuals.of(factors, free, np.arange(len(factors.places)), size))
    return found if is_another_size(found) else 1.0


def _as_survey(
    before: tuple[np.ndarray, np.ndarray], now: tuple[np.ndarray, np.ndarray]
) -> tuple[SurveyFactors, Marginal]:
    """Return the first of two maps of k landmarks as a survey, and the second as a state."""
    (places, surveyed), (positions, mapped) = before, now
    k, none = len(places), (np.zeros((0, 2), int), np.zeros(0), np.zeros(0))
    factors = SurveyFactors(np.arange(k), places, surveyed, *none)
    covariance = np.zeros((HEAD + 2 * k, HEAD + 2 * k))
    covariance[HEAD:, HEAD:] = mapped
    return factors, Marginal(np.concatenate([np.zeros(HEAD), positions.ravel()]), covariance)
