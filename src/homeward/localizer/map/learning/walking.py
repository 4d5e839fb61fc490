"""Landmarks that may walk: a steady walk as the alternative to standing, by its Bayes factor.

People, carts and doors move while they are looked at. One that keeps its way is seen from a robot
that keeps its own as one that stands elsewhere, and fits; only what bends in its sight lines tells
the two apart, as the robot turns. How far they do is a matter of information, and is computed: for
each landmark the evidence of a constant velocity against none, others walking or not, and by how
much its place is off if it walks. How large a share of all walks nobody knows; it is integrated
out, as of those that were moved (`homeward.localizer.home.evidence`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import expit, logsumexp

from homeward.localizer.map.elimination import NormalEquations, eliminate
from homeward.localizer.map.factors import WeighedSightings, sum_by, sum_by_pair
from homeward.localizer.map.landmarks import Landmark
from homeward.localizer.map.sightings import TIME
from homeward.localizer.map.smoother import Smoother
from homeward.localizer.motion.preintegration import NC
from homeward.localizer.tunables import FALSE_ALARM, UPHEAVAL, WALKING_PRIOR

SHARES = (np.arange(20) + 0.5) / 20
"""Shares of walking landmarks over which is integrated."""
ROUNDING = 1e-6
"""A set is not more probable for so small a gain of its log posterior."""


class Walks(NamedTuple):
    """What sight lines say of velocities of n landmarks, all together, over a walk's usual one."""

    information: np.ndarray
    """(2 n, 2 n): that of who walks a priori is in it."""
    slope: np.ndarray
    """(2 n,)"""
    lever: np.ndarray
    """(n, 2, 2 n): by how much each seems to stand elsewhere for all velocities [m]."""

    def given(self, walking: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Weigh walking against standing of each, it being known which others walk (n,), bool.

        Returns
        -------
        log_factor : ndarray, shape (n,)
            Log evidence of a walk against that of standing.
        moment : ndarray, shape (n, 2, 2)
            Second moment of how far each was at first, if it walks, from where it seems to stand
            [m^2].
        """
        n, known = walking.size, np.repeat(walking, 2)
        inverse = np.linalg.inv(self.information[known][:, known])
        k = len(inverse)
        gain = (self.information[:, known] @ inverse).reshape(n, 2, k)  # of all, by those who walk
        by_all = self.information[known].reshape(k, n, 2).transpose(1, 0, 2)
        information = _own(self.information) - gain @ by_all
        slope = self.slope.reshape(n, 2, 1) - gain @ self.slope[known, None]
        lever = _own(self.lever) - self.lever[:, :, known] @ gain.transpose(0, 2, 1)

        own = inverse.reshape(k, k // 2, 2).transpose(1, 0, 2)
        information[walking] = np.linalg.inv(_own(inverse))
        slope[walking] = information[walking] @ (inverse @ self.slope[known]).reshape(-1, 2, 1)
        lever[walking] = self.lever[walking][:, :, known] @ own @ information[walking]

        covariance = np.linalg.inv(information)
        velocity = covariance @ slope
        moment = covariance + velocity @ velocity.transpose(0, 2, 1)
        log_factor = 0.5 * ((slope * velocity).sum(axis=(1, 2)) - np.linalg.slogdet(information)[1])
        return log_factor, lever @ moment @ lever.transpose(0, 2, 1)


def _own(matrix: np.ndarray) -> np.ndarray:
    """Return the blocks (n, 2, 2) on the diagonal of a matrix, (2 n, 2 n) or (n, 2, 2 n)."""
    each = np.arange(matrix.shape[-1] // 2)
    return matrix.reshape(each.size, 2, each.size, 2)[each, :, each]


def judge_walking(smoother: Smoother, landmarks: Sequence[Landmark]) -> None:
    """Judge which landmarks may walk, after a solution; what is seen of these counts for less.

    A walk is thought to be about as fast as the robot's own. Where sightings of a landmark are
    closed already, it is what it was found to be before; where it was surveyed, it stands.

    Parameters
    ----------
    smoother : Smoother
        The map.
    landmarks : sequence of Landmark
        Of the map.

    Raises
    ------
    numpy.linalg.LinAlgError
        When the normal equations are singular.
    """
    open_since, surveyed = smoother.first, set(smoother.survey.ids.tolist())
    judged = [m for m in landmarks if m.first >= open_since and m.number not in surveyed]
    took = smoother.stamps[-1] - smoother.stamps[0]
    if not judged or not took > 0.0:
        return
    path = float(np.hypot(*np.diff(smoother.poses[:, :2], axis=0).T).sum())
    at = smoother.index(np.array([m.number for m in judged]))
    smoother.p_static[at] = 1.0  # while they are judged
    begun = np.full(len(smoother.ids), np.inf)
    everything, seen = smoother.linearised()
    t = smoother.sightings[:, TIME]
    np.minimum.at(begun, seen.landmark, t)
    speed = path / took / math.sqrt(2.0)
    found = walks(everything, seen, speed * (t - begun[seen.landmark]), at)
    probabilities, moments = judge_together(found)
    for landmark, moment in zip(judged, moments, strict=True):
        landmark.walk_moment = moment
    smoother.p_static[at] = np.maximum(1.0 - probabilities, FALSE_ALARM)


def judge_together(found: Walks) -> tuple[np.ndarray, np.ndarray]:
    """Return how probable each of n landmarks is to walk (n,), and the moments of `Walks.given`.

    One that walks pulls the map along, so that those that stand seem to walk until that is known.
    So a set of those that walk is looked for that no change of one makes more probable, by
    coordinate ascent from none, and each is judged with the others as that set has them.

    Raises
    ------
    numpy.linalg.LinAlgError
        When nothing can be said.
    """
    walking, log_prior = np.zeros(len(found.lever), bool), log_prior_of_walkers(len(found.lever))
    while True:
        log_factor, moments = found.given(walking)
        others = np.count_nonzero(walking) - walking
        log_odds = log_factor + log_prior[others + 1] - log_prior[others]
        if not np.isfinite(log_odds).all():
            raise np.linalg.LinAlgError("no evidence of walks")
        gain = np.where(walking, -log_odds, log_odds)
        best = int(gain.argmax())
        if gain[best] < ROUNDING:
            return np.asarray(expit(log_odds)), moments
        walking[best] = not walking[best]


def log_prior_of_walkers(n: int) -> np.ndarray:
    """Return the log prior (n + 1,) of a set of 0, 1, ... n walkers among n landmarks.

    As a rule each walks with a probability that is known; among people any share may.
    """
    share = np.append(SHARES, WALKING_PRIOR)[:, None]
    prior = np.append(np.full(SHARES.size, UPHEAVAL / SHARES.size), 1.0 - UPHEAVAL)[:, None]
    walk = np.arange(n + 1)
    log = np.log(prior) + walk * np.log(share) + (n - walk) * np.log1p(-share)
    return np.asarray(logsumexp(log, axis=0))


def walks(
    everything: NormalEquations, seen: WeighedSightings, gone: np.ndarray, which: np.ndarray
) -> Walks:
    """Weigh constant velocities of some landmarks, all others standing.

    Poses, calibration and all places are unknown beside them. Were they taken for known, their
    errors would pass for walks.

    Parameters
    ----------
    everything : NormalEquations
        All that is known of them, if all stand, around the solution.
    seen : WeighedSightings
        The sightings among it.
    gone : ndarray, shape (m,)
        How far each component of a walk has usually gone since the landmark's first sighting, one
        standard deviation, when each was made [m].
    which : ndarray, shape (k,), int
        Landmarks that may walk.

    Raises
    ------
    numpy.linalg.LinAlgError
        When the normal equations are singular.
    """
    k, n = which.size, (len(everything.common) - NC) // 2
    number = np.full(n, -1)
    number[which] = np.arange(k)
    of = number[seen.landmark]
    mine = WeighedSightings(*(part[of >= 0] for part in (*seen[:3], of)))
    by_velocity = gone[of >= 0, None] * mine.jacobian[:, 3 + NC :]
    columns = np.concatenate([by_velocity, mine.residual[:, None]], axis=1)
    own = sum_by(mine.landmark, by_velocity, columns, k)
    coupled = _couplings(mine, by_velocity, len(everything.own), which, n)
    pulled, settled = _taken_up(everything, coupled)
    information, each = np.eye(2 * k) - coupled.T @ pulled, np.arange(k)
    information.reshape(k, 2, k, 2)[each, :, each] += own[:, :, :2]
    slope = own[:, :, 2].ravel() - coupled.T @ settled
    return Walks(information, slope, pulled[-2 * n :].reshape(n, 2, 2 * k)[which])


def _couplings(
    mine: WeighedSightings, by_velocity: np.ndarray, w: int, which: np.ndarray, n: int
) -> np.ndarray:
    """Return the Hessian of w poses, calibration and n places with k velocities, (3 w + a, 2 k)."""
    k, by_pose, by_common = which.size, mine.jacobian[:, :3], mine.jacobian[:, 3:]
    poses = sum_by_pair(mine, by_pose, by_velocity, w, k).reshape(3 * w, 2 * k)
    own = sum_by(mine.landmark, by_common, by_velocity, k)
    calibration = own[:, :NC].transpose(1, 0, 2).reshape(NC, 2 * k)
    places = np.zeros((n, 2, k, 2))
    places[which, :, np.arange(k)] = own[:, NC:]
    return np.concatenate([poses, calibration, places.reshape(2 * n, 2 * k)])


def _taken_up(everything: NormalEquations, coupled: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return how poses and what they share give way: to velocities (3 w + a, 2 k), as they are."""
    left, poses = eliminate(everything), 3 * len(everything.own)
    by_velocity = left.step(coupled[:poses].reshape(-1, 3, coupled.shape[1]), coupled[poses:])
    settled = left.step(everything.slope, everything.common_slope)
    pulled = np.concatenate([by_velocity[0].reshape(poses, -1), by_velocity[1]])
    return pulled, np.concatenate([settled[0].ravel(), settled[1]])
