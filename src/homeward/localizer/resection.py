"""Resection: the pose of a rigid set of eyes from their bearings of known points.

The eyes are the cameras of a robot, or one camera along a short path. Three bearings to known
points determine a pose (unless it is on the circle through them). So poses are computed from
triples and scored by all bearings under a mixture: each is either an inlier, with the uncertainty
of its point included, or a uniform outlier. The best are refined by robust least squares.

Poses are compared by Bayes factors, with the pose integrated out (Laplace's method): how much
better the known positions of the landmarks explain the bearings than free positions would. That
three landmarks fit some pose anyway is in the Occam factor of an unknown pose, and that a landmark
seen again from the same place is no further evidence is in its free position, which explains all
lines through it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations
from typing import NamedTuple

import numpy as np

from homeward.geometry.angles import TWO_PI, wrap
from homeward.geometry.se2 import MIN_DISTANCE, between, compose, difference, sight
from homeward.geometry.statistics import ROUNDING
from homeward.localizer.reference.labels import moved_share
from homeward.localizer.tunables import (
    CLOSE,
    CLOSE_STEPS,
    INLIER,
    LINEAR,
    MAX_CANDIDATES,
    MAX_RANGE,
    MAX_TRIPLES,
    MINIMAL,
    RESECTION_STEPS,
    UPHEAVAL,
)


class LineInnovations(NamedTuple):
    """Innovations of sight lines, measured minus predicted bearings, at k poses."""

    off: np.ndarray
    """(k, m) [rad]"""
    variance: np.ndarray
    """(k, m): of the predictions, by the map [rad^2]."""
    by_place: np.ndarray
    """(k, m, 2): Jacobian of the bearing by its landmark."""
    eyes: np.ndarray
    """(k, m, 3), or (k, 1, 3) where they are the pose itself: poses of the eyes."""


@dataclass(frozen=True)
class SightLines:
    """Sight lines to landmarks of the map, from eyes. Arrays of m rows, the newest last."""

    cameras: np.ndarray
    """(m, 3): the eyes' poses in the frame whose pose is unknown."""
    bearings: np.ndarray
    """[rad]"""
    sigmas: np.ndarray
    """[rad]"""
    names: np.ndarray
    """Landmark of each (int)."""
    positions: np.ndarray
    """(m, 2): positions of the landmarks in the map [m]."""
    covariances: np.ndarray
    """(m, 2, 2)"""

    def of(self, rows: np.ndarray) -> SightLines:
        """Return some of the lines; `rows` (m,), bool."""
        return SightLines(*(each[rows] for each in vars(self).values()))

    def innovations(self, poses: np.ndarray) -> LineInnovations:
        """Return the innovations at poses (k, 3)."""
        eyes = poses[:, None]
        if self.cameras.any():
            eyes = compose(eyes, self.cameras)
        bearing, by_place, _ = sight(eyes, self.positions)
        gx, gy = by_place[..., 0], by_place[..., 1]
        (xx, xy), (_, yy) = self.covariances.transpose(1, 2, 0)
        variance = gx * (xx * gx + 2.0 * xy * gy) + yy * gy * gy
        return LineInnovations(wrap(self.bearings - bearing), variance, by_place, eyes)

    def distances(self, poses: np.ndarray) -> np.ndarray:
        """Return the median distance of the landmarks from each pose, shape (k,) [m].

        At least `MIN_DISTANCE`: the pose may be that of a landmark.
        """
        away = np.hypot(*np.moveaxis(self.positions - poses[:, None, :2], -1, 0))
        return np.asarray(np.maximum(np.median(away, axis=1), MIN_DISTANCE))


@dataclass(frozen=True)
class Located:
    """Pose by sight lines."""

    pose: np.ndarray
    """(3,): x [m], y [m], heading [rad]."""
    covariance: np.ndarray
    """(3, 3)"""
    log_likelihood: float
    """Log likelihood ratio: landmarks where they are mapped, over landmarks anywhere."""
    distance: float
    """Median distance of the landmarks [m]."""
    landmarks: int
    """Number of landmarks that agree."""

    @property
    def log_in_sight(self) -> float:
        """Log prior density of a pose anywhere in sight of its landmarks."""
        return -math.log(TWO_PI * math.pi * self.distance**2)

    def log_density(self, mean: np.ndarray, covariance: np.ndarray) -> float:
        """Return the log density of the pose in a Gaussian, shapes (3,) and (3, 3)."""
        off = difference(self.pose, mean)
        square = float(off @ np.linalg.solve(covariance, off))
        return -0.5 * (square + float(np.linalg.slogdet(TWO_PI * covariance)[1]))

    def log_evidence(self, *log_priors: float) -> float:
        """Return the log Bayes factor with the pose integrated out.

        By its log prior density, or several equally probable ones.
        """
        log_prior = float(np.logaddexp.reduce(log_priors)) - math.log(len(log_priors))
        log_volume = 0.5 * float(np.linalg.slogdet(TWO_PI * self.covariance)[1])
        return self.log_likelihood + log_prior + log_volume


def resect(lines: SightLines) -> list[Located]:
    """Return the distinct poses that agree with at least three landmarks."""
    poses = poses_from_triples(lines.positions, lines.bearings, lines.cameras)
    scores = mixture_scores(*lines.innovations(poses)[:2], lines.sigmas, UPHEAVAL)[0]
    starts = poses[np.argsort(-scores)[:200]]
    found = located(starts[_distinct(starts, lines)[:MAX_CANDIDATES]], lines, RESECTION_STEPS)
    best = [found[i] for i in _distinct(np.array([f.pose for f in found]).reshape(-1, 3), lines)]
    return [each for each in best if each.landmarks >= MINIMAL]


def located(poses: np.ndarray, lines: SightLines, steps: int = 0) -> list[Located]:
    """Return poses (k, 3) after steps of robust Gauss-Newton (a redescending M-estimator)."""
    longest = LINEAR * np.ones((len(poses), 3))
    longest[:, :2] *= lines.distances(poses)[:, None]
    for _ in range(steps):
        step = _step(poses, lines)[0]
        poses = poses + step / np.maximum(1.0, (np.abs(step) / longest).max(axis=1))[:, None]
    covariances = _step(poses, lines)[1]
    log_likelihoods, landmarks = _log_likelihoods(poses, lines)
    numbers = log_likelihoods.tolist(), lines.distances(poses).tolist(), landmarks.tolist()
    return [Located(*each) for each in zip(poses, covariances, *numbers, strict=True)]


def _step(poses: np.ndarray, lines: SightLines) -> tuple[np.ndarray, np.ndarray]:
    """Return Gauss-Newton steps (k, 3), and the covariances of the poses, (k, 3, 3).

    The lines may leave directions open, as those to one landmark do, which then have a weak prior:
    above the rounding of the information, in which a small one may be lost.
    """
    off, variance, by_place, eyes = lines.innovations(poses)
    variance, shift = variance + lines.sigmas**2, eyes - poses[:, None]
    turn = by_place[..., 0] * shift[..., 1] - by_place[..., 1] * shift[..., 0] - 1.0
    jacobian = np.concatenate([-by_place, turn[..., None]], axis=-1)
    weight = 1.0 / (variance * np.maximum(off * off / (variance * INLIER**2), 1.0))
    weighted = (jacobian * weight[..., None]).swapaxes(1, 2)
    information = weighted @ jacobian
    prior = np.maximum(1e-6, ROUNDING * information.trace(axis1=1, axis2=2))
    covariance = np.linalg.inv(information + prior[:, None, None] * np.eye(3))
    return (covariance @ (weighted @ off[..., None]))[..., 0], covariance


def _log_likelihoods(poses: np.ndarray, lines: SightLines) -> tuple[np.ndarray, np.ndarray]:
    """Return log likelihood ratios (k,): landmarks as mapped over landmarks anywhere.

    And the numbers of landmarks that agree, (k,). A landmark is where it is mapped unless it moved
    or is mistaken for another; then it is off by about its distance. Most of its lines must be
    inliers.
    """
    off, variance, by_place, eyes = lines.innovations(poses)
    inliers = np.abs(off) < INLIER * np.sqrt(lines.sigmas**2 + variance)
    names, first = np.unique(lines.names, return_index=True)
    of = (lines.names == names[:, None]).astype(float)  # (n, m)
    weighted = by_place * (inliers / lines.sigmas**2)[..., None]
    information = np.einsum("nm,kmi,kmj->knij", of, weighted, by_place)
    slope = of @ (weighted * off[..., None])
    away = (lines.positions - eyes[..., :2])[:, first]
    anywhere = lines.covariances[first] + (away**2).sum(axis=-1)[..., None, None] * np.eye(2)
    log_ratio = _log_marginal(lines.covariances[first], information, slope)
    log_ratio = log_ratio - _log_marginal(anywhere, information, slope)
    most = inliers @ of.T > 0.5 * of.sum(axis=1)
    log_ratio = np.where(most, math.log1p(-UPHEAVAL) + log_ratio, -np.inf)
    log_likelihoods = np.logaddexp(math.log(UPHEAVAL), log_ratio).sum(axis=1)
    return log_likelihoods, np.count_nonzero(inliers @ of.T, axis=1)


def _log_marginal(prior: np.ndarray, information: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """Return log marginal likelihoods (...) of positions with prior covariances (..., 2, 2).

    Up to a constant that does not depend on the priors; (..., 2, 2) and (..., 2) are the
    information on the positions, and its gradient.

    Of I + P H, P the prior and H the information, the determinant is 1 + tr P H + det P det H, and
    its inverse times P is P + det P (tr H - H), over that determinant. No term is negative, so that
    a single sighting, whose information is singular, does not make it negative by rounding.
    """
    area = np.maximum(_determinants(prior), 0.0)
    volume = area * np.maximum(_determinants(information), 0.0)
    volume = 1.0 + np.maximum((prior * information).sum(axis=(-2, -1)), 0.0) + volume
    trace = information.trace(axis1=-2, axis2=-1)[..., None, None]
    posterior = prior + area[..., None, None] * (trace * np.eye(2) - information)
    square = (slope[..., None, :] @ posterior @ slope[..., None])[..., 0, 0] / volume
    return np.asarray(0.5 * (np.maximum(square, 0.0) - np.log(volume)))


def _determinants(matrices: np.ndarray) -> np.ndarray:
    """Return the determinants (...) of matrices (..., 2, 2)."""
    (a, b), (c, d) = np.moveaxis(matrices, (-2, -1), (0, 1))
    return np.asarray(a * d - b * c)


def _distinct(poses: np.ndarray, lines: SightLines) -> list[int]:
    """Return the indices of distinct poses (k, 3): of those that are the same, the first."""
    chosen: list[int] = []
    for i, within in enumerate((CLOSE * lines.distances(poses)).tolist()):
        off = np.abs(poses[chosen] - poses[i])
        near = np.hypot(off[:, 0], off[:, 1]) < within
        if not (near & (np.abs(wrap(off[:, 2])) < LINEAR)).any():
            chosen.append(i)
    return chosen


def poses_from_triples(
    points: np.ndarray, bearings: np.ndarray, offsets: np.ndarray | None = None
) -> np.ndarray:
    """Return the pose from each triple of landmarks (Pierlot and Van Droogenbroeck, 2014, ToTal).

    From landmarks `points` (q, 2) [m] and their bearings (q,) [rad] seen from the unknown pose: the
    finite poses of the camera (k, 3), x [m], y [m], heading [rad]. `offsets` (q, 3) are the poses
    of several cameras in a frame whose poses are returned instead: the bearings of the first of a
    triple's cameras are predicted from the pose found before.
    """
    if len(bearings) < MINIMAL:
        return np.zeros((0, 3))
    triples = _triples(len(bearings))
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
        if offsets is None:
            eyes = from_triples(points, *triples.T, *bearings[triples].T)
        else:
            places, of = points[triples], offsets[triples]
            own = between(of[:, :1], of)
            eyes = from_triples(points, *triples.T, *(bearings[triples] + own[..., 2]).T)
            for _ in range(CLOSE_STEPS if own.any() else 0):
                first, each = eyes[:, None], compose(eyes[:, None], own)
                change = sight(first, places).bearing - sight(each, places).bearing
                eyes = from_triples(points, *triples.T, *(bearings[triples] + change).T)
            eyes = compose(eyes, between(of[:, 0], np.zeros(3)))
    reach = MAX_RANGE * np.ptp(points, axis=0).max()
    near = np.abs(eyes[:, :2] - points.mean(axis=0)).max(axis=1) < reach
    return np.asarray(eyes[np.isfinite(eyes).all(axis=1) & near])


def from_triples(
    points: np.ndarray,
    a: np.ndarray,
    b: np.ndarray,
    c: np.ndarray,
    to_a: np.ndarray,
    to_b: np.ndarray,
    to_c: np.ndarray,
) -> np.ndarray:
    """Return a pose (k, 3) for each triple of `points`: indices (k,) and bearings (k,) [rad]."""
    cot_ab = 1.0 / np.tan(to_b - to_a)
    cot_bc = 1.0 / np.tan(to_c - to_b)
    cot_ca = (1.0 - cot_ab * cot_bc) / (cot_ab + cot_bc)
    x1, y1 = (points[a] - points[b]).T
    x3, y3 = (points[c] - points[b]).T
    x12, y12 = x1 + cot_ab * y1, y1 - cot_ab * x1
    x23, y23 = x3 - cot_bc * y3, y3 + cot_bc * x3
    x31, y31 = (x3 + x1) + cot_ca * (y3 - y1), (y3 + y1) - cot_ca * (x3 - x1)
    k31 = x1 * x3 + y1 * y3 + cot_ca * (x1 * y3 - x3 * y1)
    determinant = (x12 - x23) * (y23 - y31) - (y12 - y23) * (x23 - x31)
    x = points[b, 0] + k31 * (y12 - y23) / determinant
    y = points[b, 1] + k31 * (x23 - x12) / determinant
    eyes = np.stack([x, y, to_a], axis=1)
    eyes[:, 2] = wrap(sight(eyes, points[a]).bearing)
    return eyes


def mixture_scores(
    off: np.ndarray, variance: np.ndarray, sigmas: np.ndarray, moved_prior: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the log likelihood of each pose (k,), and its inlier bearings (k, q), bool.

    `off` and `variance` are of `LineInnovations`, `sigmas` (q,) of the bearings [rad];
    `moved_prior` is the prior probability that a landmark moved.
    """
    variance, q = variance + sigmas**2, sigmas.size
    exponent = -0.5 * off**2 / variance
    # Underflow would make the exponential many times slower.
    inlier = np.exp(np.maximum(exponent, -700.0)) / np.sqrt(variance)
    inlier *= math.sqrt(TWO_PI)  # against the uniform density
    right = (1.0 - moved_prior) * inlier > moved_prior
    number = np.arange(q + 1)
    share = moved_share(number, q - number, moved_prior)[np.count_nonzero(right, axis=1), None]
    return np.log((1.0 - share) * inlier + share).sum(axis=1), right


@lru_cache(maxsize=64)
def _triples(q: int) -> np.ndarray:
    """Return triples of q indices, shape (k, 3)."""
    if math.comb(q, 3) <= MAX_TRIPLES:
        return np.array(list(combinations(range(q), 3)), int).reshape(-1, 3)
    draw = np.random.default_rng(0)
    return np.argsort(draw.random((MAX_TRIPLES, q)), axis=1)[:, :3]
