"""Moving landmarks: constant velocity against zero velocity, by the Bayes factor.

People, carts and doors move while they are observed. From a robot of constant velocity, a landmark
of constant velocity looks like a static one elsewhere; only turns of the robot distinguish them.
Computed for each landmark are the evidence of a constant velocity against none, given which others
walk, and the offset of its position if it walks. The share of walking landmarks is unknown, and
integrated out, as that of moved ones (`homeward.localizer.reference.labels`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache
from typing import NamedTuple

import numpy as np
from scipy.special import expit, logsumexp

from homeward.localizer import kernels
from homeward.localizer.map.landmarks import Landmark
from homeward.localizer.map.sightings import TIME
from homeward.localizer.map.smoother import Smoother
from homeward.localizer.motions import HEAD, NC
from homeward.localizer.reference.extension import Unknown
from homeward.localizer.reference.window import Linearised
from homeward.localizer.tunables import FALSE_ALARM, MIN_GAIN, UPHEAVAL, WALKING_PRIOR

SHARES = (np.arange(20) + 0.5) / 20
"""Shares of walking landmarks, for the integral over it."""


class Walks(NamedTuple):
    """Joint information on the velocities of n landmarks, in units of a typical walk."""

    information: np.ndarray
    """(2 n, 2 n): including the prior of walking landmarks."""
    slope: np.ndarray
    """(2 n,): its product with the estimate."""
    lever: np.ndarray
    """(n, 2, 2 n): Jacobian of the positions by all velocities [m]."""

    def conditional_on(self, walking: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Compare walking with standing still for each, given which others walk, (n,) bool.

        Return the log Bayes factors (n,), and the second moments (n, 2, 2) of the initial offset of
        each from its estimated position, if it walks [m^2].
        """
        n, known = walking.size, np.repeat(walking, 2)
        inverse = np.linalg.inv(self.information[known][:, known])
        k = len(inverse)
        gain = (self.information[:, known] @ inverse).reshape(n, 2, k)  # of all by these
        by_all = self.information[known].reshape(k, n, 2).transpose(1, 0, 2)
        information = _diagonal_blocks(self.information) - gain @ by_all
        slope = self.slope.reshape(n, 2, 1) - gain @ self.slope[known, None]
        lever = _diagonal_blocks(self.lever) - self.lever[:, :, known] @ gain.transpose(0, 2, 1)

        own = inverse.reshape(k, k // 2, 2).transpose(1, 0, 2)
        information[walking] = np.linalg.inv(_diagonal_blocks(inverse))
        slope[walking] = information[walking] @ (inverse @ self.slope[known]).reshape(-1, 2, 1)
        lever[walking] = self.lever[walking][:, :, known] @ own @ information[walking]

        covariance = np.linalg.inv(information)
        velocity = covariance @ slope
        moment = covariance + velocity @ velocity.transpose(0, 2, 1)
        log_factor = 0.5 * ((slope * velocity).sum(axis=(1, 2)) - np.linalg.slogdet(information)[1])
        return log_factor, lever @ moment @ lever.transpose(0, 2, 1)


def _diagonal_blocks(matrix: np.ndarray) -> np.ndarray:
    """Return the diagonal blocks (n, 2, 2) of a matrix, (2 n, 2 n) or (n, 2, 2 n)."""
    each = np.arange(matrix.shape[-1] // 2)
    return matrix.reshape(each.size, 2, each.size, 2)[each, :, each]


def update_walking(smoother: Smoother, landmarks: Sequence[Landmark]) -> None:
    """Update the probabilities of landmarks to be static, after a solution.

    A typical walk is as fast as the robot. Landmarks whose first sightings have been marginalised
    keep their probability; surveyed ones are static. `numpy.linalg.LinAlgError` when the normal
    equations are singular.
    """
    open_since, surveyed = smoother.first, set(smoother.survey.ids.tolist())
    tested = [m for m in landmarks if m.first >= open_since and m.number not in surveyed]
    duration = smoother.stamps[-1] - smoother.stamps[0]
    if not tested or not duration > 0.0:
        return
    path = float(np.hypot(*np.diff(smoother.poses[:, :2], axis=0).T).sum())
    at = smoother.index(np.array([m.number for m in tested]))
    smoother.p_static = smoother.p_static.copy()  # others keep the old one
    smoother.p_static[at] = 1.0  # during the test
    first_seen = np.full(len(smoother.ids), np.inf)
    given, t = smoother.linearised(), smoother.sightings[:, TIME]
    np.minimum.at(first_seen, given.seen.landmark, t)
    speed = path / duration / math.sqrt(2.0)
    found = walks(given, speed * (t - first_seen[given.seen.landmark]), at)
    probabilities, moments = walking_probabilities(found)
    for landmark, moment in zip(tested, moments, strict=True):
        landmark.walk_moment = moment
    smoother.p_static[at] = np.maximum(1.0 - probabilities, FALSE_ALARM)


def walking_probabilities(found: Walks) -> tuple[np.ndarray, np.ndarray]:
    """Return the probability of each of n landmarks to walk (n,), and its second moments.

    A walking landmark drags the map along, so that static ones seem to walk until it is known. So
    the most probable set of walking ones is sought by coordinate ascent from the empty set, until
    no single change improves it; each landmark is then evaluated given the others in that set. The
    moments are those of `Walks.conditional_on`.

    `numpy.linalg.LinAlgError` when the evidence is not finite.
    """
    walking, log_prior = np.zeros(len(found.lever), bool), log_prior_of_walkers(len(found.lever))
    while True:
        log_factor, moments = found.conditional_on(walking)
        others = np.count_nonzero(walking) - walking
        log_odds = log_factor + log_prior[others + 1] - log_prior[others]
        if not np.isfinite(log_odds).all():
            raise np.linalg.LinAlgError("no evidence of walks")
        gain = np.where(walking, -log_odds, log_odds)
        best = int(gain.argmax())
        if gain[best] < MIN_GAIN:
            return np.asarray(expit(log_odds)), moments
        walking[best] = not walking[best]


@cache
def log_prior_of_walkers(n: int) -> np.ndarray:
    """Return the log prior (n + 1,) of a set of 0, 1, ... n walking landmarks among n.

    As a rule each walks with a known probability; in a crowd any share may.
    """
    share = np.append(SHARES, WALKING_PRIOR)[:, None]
    prior = np.append(np.full(SHARES.size, UPHEAVAL / SHARES.size), 1.0 - UPHEAVAL)[:, None]
    walk = np.arange(n + 1)
    log = np.log(prior) + walk * np.log(share) + (n - walk) * np.log1p(-share)
    return np.asarray(logsumexp(log, axis=0))


def walks(given: Linearised, displacement: np.ndarray, which: np.ndarray) -> Walks:
    """Return the information on constant velocities of some landmarks, the others being static.

    `given` is the window with all landmarks static, `displacement` (m,) the standard deviation of
    each component of a walk at each sighting, since the landmark's first one [m], and `which` (k,)
    are the landmarks that may walk. `numpy.linalg.LinAlgError` when the normal equations are
    singular.
    """
    n = (len(given.equations.common) - NC) // 2
    block = np.full(n, -1)
    block[which] = np.arange(which.size)
    by_bearing = displacement[:, None] * given.seen.jacobian[:, HEAD:]
    unknown = Unknown(by_bearing, block[given.seen.landmark], np.ones(2 * which.size))
    extra = kernels.extend(given, unknown)
    return Walks(extra.information, extra.slope, extra.shared[NC:].reshape(n, 2, -1)[which])
