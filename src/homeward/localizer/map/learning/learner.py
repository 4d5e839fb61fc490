"""Adaptive noise and extrinsics, and walking landmarks, by the residuals of a solved map."""

from __future__ import annotations

import numpy as np

from homeward.localizer.inputs.bearing_noise import BearingNoise
from homeward.localizer.map.landmarks import Landmarks
from homeward.localizer.map.learning.variance_components import Misfit, misfit
from homeward.localizer.map.learning.walking import update_walking
from homeward.localizer.map.sightings import GAP, LANDMARK, OWN, SIGMA
from homeward.localizer.map.smoother import Smoother
from homeward.localizer.motion.extrinsics import Extrinsics
from homeward.localizer.motion.odometry import shows_lag
from homeward.localizer.motion.process_noise import ProcessNoise
from homeward.localizer.motions import DELAY
from homeward.localizer.tunables import ODOMETRY_EVERY, USUAL_DISTANCE_M


class Learner:
    """Learns from the residuals of bearings and motions in solutions of a map.

    Prior standard deviations: `time_constant_sigma` of the odometry's time constant once it is free
    [s], `slip_sigma` of slip in bends, of robots in a room [m].
    """

    def __init__(
        self,
        noise: BearingNoise,
        process_noise: ProcessNoise,
        extrinsics: Extrinsics,
        time_constant_sigma: float | None,
        slip_sigma: float,
    ) -> None:
        self._noise, self._process_noise, self._extrinsics = noise, process_noise, extrinsics
        self._time_constant_sigma, self._slip_sigma = time_constant_sigma, slip_sigma
        self._updated_at = self._odometry_updated_at = 0

    @property
    def is_noise_confirmed(self) -> bool:
        """Whether residuals confirm the noise of the bearings."""
        return self._noise.confirmed

    def scale_noise_prior(self, smoother: Smoother) -> None:
        """Scale the prior of the odometry noise to the scene: robots are no larger than it.

        A robot k times as large that drives k times as far errs and slips k times as far, so its
        variance per metre is k times as large. In a hall the robot may be as small as in a room.
        """
        share = min(1.0, smoother.state.scale / USUAL_DISTANCE_M)
        smoother.scale_odometry(self._process_noise.scale_prior(share))
        smoother.slip_sigma = share * self._slip_sigma

    def learn_bearings(self, smoother: Smoother, landmarks: Landmarks) -> None:
        """Update the noise of bearings, then the walking landmarks.

        `numpy.linalg.LinAlgError` when the normal equations are singular.
        """
        newest, residuals = smoother.newest, smoother.residuals()
        own, total, gaps, numbers = smoother.sightings[:, [OWN, SIGMA, GAP, LANDMARK]].T
        since, self._updated_at = newest - self._updated_at, newest
        factor = self._noise.update(residuals, own, total, gaps, numbers, since)
        if factor != 1.0:
            smoother.scale_noise(factor)
            landmarks.scale_noise(factor)
        if smoother.converged:
            update_walking(smoother, [*landmarks.mapped.values(), *landmarks.former.values()])

    def learn_odometry(self, smoother: Smoother) -> None:
        """Update the noise of odometry, not at each solution.

        `numpy.linalg.LinAlgError` when the normal equations are singular.
        """
        since = smoother.newest - self._odometry_updated_at
        if since >= ODOMETRY_EVERY and smoother.converged:
            self._odometry_updated_at = smoother.newest
            sums, motions = _odometry_misfit(smoother), len(smoother.stamps) - 1
            smoother.scale_odometry(self._process_noise.update(*sums, motions, min(since, motions)))

    def free_contradicted(self, smoother: Smoother) -> bool:
        """Free extrinsics and time constant where the map contradicts zero; return whether so.

        That happens once for each, and requires another solution.
        """
        now = smoother.state
        calibration, variances = now.calibration, now.calibration_variances
        if not (smoother.converged and self._noise.confirmed):
            return False
        extrinsics = self._extrinsics.test(calibration, variances, now.scale)
        if extrinsics:
            smoother.mount_sigmas = self._extrinsics.sigmas
        sigma = self._time_constant_sigma
        if sigma is None or not shows_lag(calibration, variances):
            return extrinsics
        smoother.time_constant_prior, self._time_constant_sigma = (0.0, sigma), None
        # A negative delay with a time constant would be a filter of noise without a lag.
        smoother.one_sided.append(DELAY)
        return True


def _odometry_misfit(smoother: Smoother) -> Misfit:
    """Compare the residuals of motions in the last solution with their expectation."""
    given, rows = smoother.linearised(), smoother.sightings
    sigma, rng = rows[:, SIGMA], np.random.default_rng(smoother.newest)
    error = given.seen.residual * smoother.effective_sigmas(rows) / sigma
    return misfit(given, error, (rows[:, OWN] / sigma) ** 2, rng)
