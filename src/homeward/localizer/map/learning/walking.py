"""Landmarks that may walk: a steady walk as the alternative to standing, by its Bayes factor.

People, carts and doors move while they are looked at. One that keeps its way is seen from a robot
that keeps its own as one that stands elsewhere, and fits; only what bends in its sight lines tells
the two apart, as the robot turns. How far they do is a matter of information, and is computed: for
each landmark the evidence of a constant velocity against none, and by how much its place is off if
it walks. How large a share of all walks nobody knows; it is integrated out, as of those that were
moved (`homeward.localizer.home.evidence`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from homeward.localizer.map.elimination import NormalEquations, eliminate
from homeward.localizer.map.factors import WeighedSightings, sum_by, sum_by_pair
from homeward.localizer.map.landmarks import Landmark
from homeward.localizer.map.sightings import TIME
from homeward.localizer.map.smoother import Smoother
from homeward.localizer.motion.preintegration import NC
from homeward.localizer.tunables import FALSE_ALARM, UPHEAVAL, WALKS

SHARES = (np.arange(20) + 0.5) / 20
"""Shares of walking landmarks over which is integrated."""


class Walks(NamedTuple):
    """What sight lines say of n landmarks, were they to walk at a constant velocity."""

    log_factor: np.ndarray
    """(n,): log evidence against that of standing."""
    moment: np.ndarray
    """(n, 2, 2): second moment of how far each was at first from where it seems to stand [m^2]."""


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
    open_since, surveyed = smoother.first, set(smoother.known.ids.tolist())
    judged = [m for m in landmarks if m.first >= open_since and m.number not in surveyed]
    took = smoother.stamps[-1] - smoother.stamps[0]
    if not judged or not took > 0.0:
        return
    path = float(np.hypot(*np.diff(smoother.poses[:, :2], axis=0).T).sum())
    at = smoother.index(np.array([m.number for m in judged]))
    smoother.stands[at] = 1.0  # while they are judged
    begun = np.full(len(smoother.ids), np.inf)
    everything, seen = smoother.linearised()
    t = smoother.sightings[:, TIME]
    np.minimum.at(begun, seen.landmark, t)
    found = walks(everything, seen, t - begun[seen.landmark], path / took / math.sqrt(2.0))
    probabilities = walking_probabilities(found.log_factor[at])
    for landmark, p, moment in zip(judged, probabilities.tolist(), found.moment[at], strict=True):
        landmark.walks, landmark.astray = p, moment
    smoother.stands[at] = np.maximum(1.0 - probabilities, FALSE_ALARM)


def walks(
    everything: NormalEquations, seen: WeighedSightings, since: np.ndarray, speed: float
) -> Walks:
    """Weigh a constant velocity of each of n landmarks, all others standing, against none.

    Poses, calibration and all landmarks are unknown beside it, in both cases: a Bayes factor of
    linear models. Were they taken for known, their errors would pass for walks.

    Parameters
    ----------
    everything : NormalEquations
        All that is known of them, if all stand, around the solution.
    seen : WeighedSightings
        The sightings among it.
    since : ndarray, shape (m,)
        How long after the landmark's first sighting each was made [s].
    speed : float
        Standard deviation of each component of a walk's velocity [m/s].

    Raises
    ------
    numpy.linalg.LinAlgError
        When the normal equations are singular.
    """
    n = (len(everything.common) - NC) // 2
    by_velocity = speed * since[:, None] * seen.jacobian[:, 3 + NC :]
    columns = np.concatenate([by_velocity, seen.residual[:, None]], axis=1)
    own = sum_by(seen.landmark, by_velocity, columns, n)
    coupled = _couplings(seen, by_velocity, len(everything.own), n)
    pulled, settled = _taken_up(everything, coupled)
    each, by_landmark = np.arange(n), coupled.reshape(-1, n, 2)
    information = np.eye(2) + own[:, :, :2]
    information -= np.einsum("iku,ikv->kuv", by_landmark, pulled.reshape(-1, n, 2))
    slope = own[:, :, 2] - np.einsum("iku,i->ku", by_landmark, settled)
    covariance = np.linalg.inv(information)
    velocity = (covariance @ slope[:, :, None])[:, :, 0]
    gain = (slope * velocity).sum(axis=1)
    log_factor = 0.5 * (gain - np.linalg.slogdet(information)[1])
    moment = covariance + velocity[:, :, None] * velocity[:, None, :]
    lever = pulled[-2 * n :].reshape(n, 2, n, 2)[each, :, each]
    return Walks(log_factor, lever @ moment @ lever.transpose(0, 2, 1))


def _couplings(seen: WeighedSightings, by_velocity: np.ndarray, w: int, n: int) -> np.ndarray:
    """Return the Hessian of w poses, calibration and n places with velocities, (3 w + a, 2 n)."""
    by_pose, by_common = seen.jacobian[:, :3], seen.jacobian[:, 3:]
    poses = sum_by_pair(seen, by_pose, by_velocity, w, n).reshape(3 * w, 2 * n)
    own = sum_by(seen.landmark, by_common, by_velocity, n)
    calibration = own[:, :NC].transpose(1, 0, 2).reshape(NC, 2 * n)
    places = np.zeros((n, 2, n, 2))
    places[np.arange(n), :, np.arange(n)] = own[:, NC:]
    return np.concatenate([poses, calibration, places.reshape(2 * n, 2 * n)])


def _taken_up(everything: NormalEquations, coupled: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return how poses and what they share give way: to velocities (3 w + a, 2 n), as they are."""
    left, poses = eliminate(everything), 3 * len(everything.own)
    by_velocity = left.step(coupled[:poses].reshape(-1, 3, coupled.shape[1]), coupled[poses:])
    settled = left.step(everything.slope, everything.common_slope)
    pulled = np.concatenate([by_velocity[0].reshape(poses, -1), by_velocity[1]])
    return pulled, np.concatenate([settled[0].ravel(), settled[1]])


def walking_probabilities(log_factor: np.ndarray) -> np.ndarray:
    """Return how probable each of n landmarks is to walk, by its evidence (n,), and all others'.

    As a rule each does with a probability that is known; among people any share may.
    """
    share = np.append(SHARES, WALKS)[:, None]
    prior = np.append(np.full(SHARES.size, UPHEAVAL / SHARES.size), 1.0 - UPHEAVAL)
    walk, stand = np.log(share) + log_factor, np.log1p(-share)
    either = np.logaddexp(walk, stand)
    log = np.log(prior) + either.sum(axis=1)
    weights = np.exp(log - log.max())
    return np.asarray(weights @ np.exp(walk - either) / weights.sum())
