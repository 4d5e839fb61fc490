"""Learning from the map: noise of bearings and odometry, the camera's place, and who may walk."""

from __future__ import annotations

import numpy as np

from homeward.localizer.inputs.bearing_noise import BearingNoise
from homeward.localizer.map.elimination import eliminate
from homeward.localizer.map.landmarks import Landmarks
from homeward.localizer.map.learning.variance_components import BearingErrors, Misfit, misfit
from homeward.localizer.map.learning.walking import judge_walking
from homeward.localizer.map.sightings import GAP, LANDMARK, OWN, SIGMA
from homeward.localizer.map.smoother import Smoother
from homeward.localizer.motion.extrinsics import Extrinsics
from homeward.localizer.motion.process_noise import ProcessNoise
from homeward.localizer.tunables import USUAL_DISTANCE_M

LEARNS_EVERY = 10
"""Keyframes from which the odometry's noise is learnt at once."""


class Learner:
    """Learns from what solutions of a map leave of bearings and motions.

    Parameters
    ----------
    noise : BearingNoise
        Of bearings.
    process_noise : ProcessNoise
        Of motions.
    extrinsics : Extrinsics
        What is believed of the camera's place on the robot.
    slip_sigma : float
        Of slip in bends, as is usual of robots in a room [m].
    """

    def __init__(
        self,
        noise: BearingNoise,
        process_noise: ProcessNoise,
        extrinsics: Extrinsics,
        slip_sigma: float,
    ) -> None:
        self._noise, self._process_noise, self._extrinsics = noise, process_noise, extrinsics
        self._slip_sigma = slip_sigma
        self._learnt_at = self._odometry_learnt_at = 0

    def scale_noise_prior(self, smoother: Smoother) -> None:
        """Expect of odometry what is usual of a robot that is no larger than its scene.

        One k times as large that drives k times as far errs and slips k times as far, and so has k
        times the variance per metre. In a hall it may be as small as in a room.
        """
        share = min(1.0, smoother.state.scale / USUAL_DISTANCE_M)
        smoother.scale_odometry(self._process_noise.scale_prior(share))
        smoother.slip_sigma = share * self._slip_sigma

    def learn(self, smoother: Smoother, landmarks: Landmarks) -> None:
        """Learn from the last solution: bearings' noise, then who walks by that, then odometry's.

        Raises
        ------
        numpy.linalg.LinAlgError
            When the normal equations are singular.
        """
        newest, residuals = smoother.newest, smoother.residuals()
        own, total, gaps, numbers = smoother.sightings[:, [OWN, SIGMA, GAP, LANDMARK]].T
        since, self._learnt_at = newest - self._learnt_at, newest
        wider = self._noise.update(residuals, own, total, gaps, numbers, since)
        if wider != 1.0:
            smoother.scale_noise(wider)
            landmarks.scale_noise(wider)
        if smoother.converged:
            judge_walking(smoother, [*landmarks.mapped.values(), *landmarks.former.values()])
        since = newest - self._odometry_learnt_at
        if since >= LEARNS_EVERY and smoother.converged and landmarks.mapped:
            self._odometry_learnt_at = newest
            left, motions = _odometry_misfit(smoother), len(smoother.stamps) - 1
            smoother.scale_odometry(self._process_noise.update(*left, motions, min(since, motions)))

    def frees_extrinsics(self, smoother: Smoother) -> bool:
        """Let the camera be anywhere on the robot if bearings deny its place; return whether so.

        They do so once, and need a solution then.
        """
        now, sound = smoother.state, smoother.converged and self._noise.confirmed
        calibration = now.calibration, now.calibration_variances
        if not (sound and self._extrinsics.test(*calibration, now.scale)):
            return False
        smoother.mount_sigmas = self._extrinsics.sigmas
        return True


def _odometry_misfit(smoother: Smoother) -> Misfit:
    """Compare what the last solution left of motions with what it was expected to leave."""
    everything, seen = smoother.linearised()
    rows = smoother.sightings
    sigma, effective = rows[:, SIGMA], smoother.effective_sigmas(rows)
    error, own = seen.residual * effective / sigma, (rows[:, OWN] / sigma) ** 2
    bearings = BearingErrors(error, *seen[1:], own)
    rng = np.random.default_rng(smoother.newest)
    return misfit(eliminate(everything), smoother.odometry_errors(), bearings, rng)
