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

from homeward.localizer.map.landmarks import Landmark
from homeward.localizer.map.sightings import LANDMARK, SIGMA, TIME
from homeward.localizer.map.smoother import Smoother
from homeward.localizer.tunables import GATE, UPHEAVAL, WALKS

SHARES = (np.arange(20) + 0.5) / 20
"""Shares of walking landmarks over which is integrated."""
LEAST_SHARE = 1e-9
"""So much of what is known of a place is known across, too: where it is seen along one line [1]."""


class Walks(NamedTuple):
    """What sight lines say of n landmarks, were they to walk at a constant velocity."""

    log_factor: np.ndarray
    """(n,): log evidence against that of standing."""
    moment: np.ndarray
    """(n, 2, 2): second moment of how far each was at first from where it seems to stand [m^2]."""


def judge_walking(smoother: Smoother, landmarks: Sequence[Landmark]) -> None:
    """Judge which landmarks may walk, after a solution, and by how much they are off then.

    A walk is thought to be about as fast as the robot's own. Where sightings of a landmark are
    closed already, it is what it was found to be before; where it was surveyed, it stands.

    Parameters
    ----------
    smoother : Smoother
        The map.
    landmarks : sequence of Landmark
        Of the map.
    """
    open_since, surveyed = smoother.first, set(smoother.known.ids.tolist())
    judged = [m for m in landmarks if m.first >= open_since and m.number not in surveyed]
    took = smoother.stamps[-1] - smoother.stamps[0]
    if not judged or not took > 0.0:
        return
    path = float(np.hypot(*np.diff(smoother.poses[:, :2], axis=0).T).sum())
    rows, (residual, by_place, sigma) = smoother.sightings, smoother.sight_lines()
    of, n = smoother.index(rows[:, LANDMARK]), len(smoother.ids)
    begun = np.full(n, np.inf)
    np.minimum.at(begun, of, rows[:, TIME])
    sigma *= np.maximum(np.abs(residual) / (GATE * rows[:, SIGMA]), 1.0)
    lines = residual / sigma, by_place / sigma[:, None], rows[:, TIME] - begun[of]
    found = walks(*lines, of, n, path / took / math.sqrt(2.0))
    at = smoother.index(np.array([m.number for m in judged]))
    probabilities = walking_probabilities(found.log_factor[at])
    for landmark, p, moment in zip(judged, probabilities.tolist(), found.moment[at], strict=True):
        landmark.walks, landmark.astray = p, moment


def walks(
    residual: np.ndarray,
    by_place: np.ndarray,
    since: np.ndarray,
    of: np.ndarray,
    n: int,
    speed: float,
) -> Walks:
    """Weigh a constant velocity of each of n landmarks against none, by all its sight lines.

    Parameters
    ----------
    residual, by_place : ndarray, shape (m,), (m, 2)
        Measured minus expected bearing, and the derivative of the latter by the landmark's place,
        both over the bearing's standard deviation [1], [1/m].
    since : ndarray, shape (m,)
        How long after the landmark's first sighting [s].
    of : ndarray, shape (m,), int
        Of which landmark.
    n : int
        How many there are.
    speed : float
        Standard deviation of each component of a walk's velocity [m/s].
    """
    columns = np.column_stack([by_place, speed * since[:, None] * by_place, residual])
    products = np.zeros((n, 5, 5))
    np.add.at(products, of, columns[:, :, None] * columns[:, None, :])
    place = products[:, :2, :2].copy()
    whole = place[:, 0, 0] + place[:, 1, 1]
    place += np.where(whole > 0.0, LEAST_SHARE * whole, 1.0)[:, None, None] * np.eye(2)
    lever = np.linalg.solve(place, products[:, :2, 2:])  # of the place, by velocity and residual
    left = products[:, 2:, 2:] - products[:, 2:, :2] @ lever
    information, slope = left[:, :2, :2] + np.eye(2), left[:, :2, 2]
    covariance = np.linalg.inv(information)
    velocity = (covariance @ slope[:, :, None])[:, :, 0]
    gain = (slope * velocity).sum(axis=1)
    log_factor = 0.5 * (gain - np.linalg.slogdet(information)[1])
    moment = covariance + velocity[:, :, None] * velocity[:, None, :]
    by_velocity = lever[:, :, :2]
    return Walks(log_factor, by_velocity @ moment @ by_velocity.transpose(0, 2, 1))


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
