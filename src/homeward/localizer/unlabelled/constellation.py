"""Constellation: the pose from which bearings without ids fit a map, over all assignments.

Three bearings determine a pose for each triple of landmarks (resection). The poses that fit all
bearings best are refined by least squares, in which each bearing is of the nearest landmark. The
evidence of a pose is a Bayes factor against bearings that belong to no landmark: with the pose
integrated out (Laplace's method), and each landmark of a bearing equally probable before.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from typing import NamedTuple

import numpy as np
from scipy.special import chdtri

from homeward.geometry.angles import TWO_PI, wrap
from homeward.geometry.se2 import difference, sight
from homeward.localizer.resection import from_triples
from homeward.localizer.tunables import (
    ANNEALED,
    BEARING_BINS,
    CLOSE,
    CONSTELLATION_PAD,
    DETECTED,
    FALSE_ALARM,
    INLIER,
    LINEAR,
    MAX_BEARING_TRIPLES,
    MAX_HYPOTHESES,
    MAX_SCORED,
    MAX_STARTS,
    MIN_TRIPLES,
    MINIMAL,
    NATS_APART,
    NATS_KEPT,
    NUM_MATCHES,
    UNMATCHED,
)


@dataclass(frozen=True)
class Sky:
    """Landmarks of a map, and m bearings of them from an unknown pose."""

    points: np.ndarray
    """(n, 2): positions of the landmarks [m]."""
    covariance: np.ndarray
    """(n, 2, n, 2): of their errors."""
    bearings: np.ndarray
    """(m,) [rad]"""
    variances: np.ndarray
    """(m,): of the bearings [rad^2]."""
    allowed: np.ndarray
    """(m, n), bool: which landmark a bearing may be of."""
    reach: float = math.inf
    """Distance within which most landmarks are seen [m], ..."""
    edge: float = LINEAR
    """... and over which detection falls off beyond it [reach]."""
    near: tuple[float, float, float] | None = None
    """Circle in which the pose is with a probability of a half: x, y, radius [m]; None: anywhere.
    """

    start: np.ndarray | None = None
    """(3,): pose that was found before."""

    @cached_property
    def covariances(self) -> np.ndarray:
        """(n, 2, 2): of each landmark."""
        each = np.arange(len(self.points))
        return np.asarray(self.covariance[each, :, each])

    @property
    def box(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper corner of the region in which the pose may be [m]."""
        low, high = self.points.min(axis=0), self.points.max(axis=0)
        pad = min(CONSTELLATION_PAD * float((high - low).max()), self.reach)
        return low - pad, high + pad

    @property
    def density(self) -> float:
        """Density of the bearings that are of no landmark of the map [1/rad]."""
        return max(UNMATCHED * self.bearings.size, 0.5) / TWO_PI

    def log_prior(self, pose: np.ndarray) -> float:
        """Return the log prior density of a pose (3,)."""
        low, high = self.box
        anywhere = -math.log(TWO_PI * float((high - low).prod()))
        if self.near is None:
            return anywhere
        x, y, radius = self.near
        if math.hypot(pose[0] - x, pose[1] - y) > radius:
            return anywhere + math.log(0.5)
        return float(
            np.logaddexp(anywhere, -math.log(TWO_PI * math.pi * radius**2)) + math.log(0.5)
        )

    @property
    def max_distance(self) -> float:
        """Distance within which a bearing begins a hypothesis [m]."""
        return (1.0 + LINEAR) * self.reach

    def detected(self, poses: np.ndarray) -> np.ndarray:
        """Return the probability to see each landmark from poses (k, 3), shape (k, n)."""
        distance = np.linalg.norm(self.points - poses[:, None, :2], axis=2)
        beyond = np.maximum(distance / self.reach - 1.0, 0.0) / self.edge
        return np.asarray(DETECTED * np.maximum(np.exp(-(beyond**2)), CLOSE / 2))


class Match(NamedTuple):
    """A pose from which bearings fit."""

    pose: np.ndarray
    """(3,): x [m], y [m], heading [rad]."""
    landmark: np.ndarray
    """(m,), int: landmark of each bearing, -1 for none."""
    log_evidence: float
    covariance: np.ndarray
    """(3, 3)"""
    square: float
    """Sum of the squared residuals [variances]."""


class HomeResiduals(NamedTuple):
    """Residuals of m bearings of n landmarks at k poses."""

    residual: np.ndarray
    """(k, m, n) [rad]"""
    variance: np.ndarray
    """(k, m, n) [rad^2]"""
    by_pose: np.ndarray
    """(k, n, 3): Jacobian of a predicted bearing by the pose, ..."""
    by_place: np.ndarray
    """(k, n, 2): ... and by the landmark."""


class Ranked(NamedTuple):
    """The best match, and how much better it is than those elsewhere."""

    best: Match
    margin: float
    """Log evidence over that of all other poses [nats]."""


def search(sky: Sky) -> Ranked | None:
    """Return the best match; None if there is none of three landmarks."""
    if min(sky.allowed.any(axis=1).sum(), sky.allowed.any(axis=0).sum()) < MINIMAL:
        return None
    starts = _starts(sky)
    poses = _refined(starts if sky.start is None else np.vstack([sky.start, starts]), sky)
    matches = [m for pose in _best_first(poses, sky) if (m := match(pose, sky)) is not None]
    if not matches:
        return None
    matches.sort(key=lambda m: -m.log_evidence)
    best, distinct = matches[0], list[Match]()
    for each in matches[1:]:
        if each.log_evidence < best.log_evidence - 2.0 * NATS_APART:
            break
        if not any(_is_same(each, known, sky) for known in (best, *distinct)):
            distinct.append(each)
    rival = np.logaddexp.reduce([m.log_evidence for m in distinct]) if distinct else -math.inf
    is_repeated = any(_is_copy(each, best) for each in distinct)
    margin = best.log_evidence - float(rival)
    return Ranked(best, min(margin, 0.0) if is_repeated else margin)


def _is_copy(one: Match, best: Match) -> bool:
    """Return whether other landmarks explain the bearings as well but for residuals within 3 sigma.

    Then the map repeats itself, and errors of the map decide which of the two fits better.
    """
    shared = np.count_nonzero((one.landmark == best.landmark) & (best.landmark >= 0))
    number = np.count_nonzero(one.landmark >= 0)
    fits = one.square < chdtri(max(number - MINIMAL, 1), FALSE_ALARM)
    lost = best.log_evidence + 0.5 * best.square - one.log_evidence - 0.5 * one.square
    return bool(2 * shared <= number and fits and lost < NATS_KEPT)


def match(pose: np.ndarray, sky: Sky) -> Match | None:
    """Return the match at a refined pose (3,), each landmark having one bearing at most.

    Errors that its landmarks have in common contradict nothing: their joint covariance is used.
    """
    for _ in range(2):
        (gain,), (unseen,), (residual, variance, jacobian, by_place) = _gains(pose[None], sky)
        landmark = _one_to_one(gain)
        rows = np.flatnonzero(landmark >= 0)
        if rows.size < MINIMAL:
            return None
        of = landmark[rows]
        r, v, by_pose, by_map = (
            residual[0, rows, of],
            variance[0, rows, of],
            jacobian[0, of],
            by_place[0, of],
        )
        joint = np.einsum("ki,kilj,lj->kl", by_map, sky.covariance[of][:, :, of], by_map)
        joint = joint + np.diag(sky.variances[rows])
        weighted = np.linalg.solve(joint, np.column_stack([by_pose, r]))
        information = by_pose.T @ weighted[:, :3] + 1e-9 * np.eye(3)
        step = np.linalg.solve(information, by_pose.T @ weighted[:, 3])
        pose = pose + step
    covariance, square = np.linalg.inv(information), float(r @ weighted[:, 3])
    volume = 0.5 * float(np.linalg.slogdet(TWO_PI * covariance)[1])
    correlated = 0.5 * float((np.log(v) + r**2 / v).sum() - np.linalg.slogdet(joint)[1] - square)
    return Match(
        pose,
        landmark,
        float(gain[rows, of].sum() + unseen) + correlated + volume + sky.log_prior(pose),
        covariance,
        square - float(step @ information @ step),
    )


def _residuals(poses: np.ndarray, sky: Sky) -> HomeResiduals:
    """Return the residuals at poses (k, 3)."""
    bearing, by_place, _ = sight(poses[:, None], sky.points)
    by_map = np.einsum("kni,nij,knj->kn", by_place, sky.covariances, by_place)
    jacobian = np.concatenate([-by_place, np.full((*bearing.shape, 1), -1.0)], axis=2)
    variance = by_map[:, None] + sky.variances[:, None]
    return HomeResiduals(
        wrap(sky.bearings[:, None] - bearing[:, None]), variance, jacobian, by_place
    )


def _starts(sky: Sky) -> np.ndarray:
    """Return the poses (k, 3) from triples of bearings, each of any landmarks, that fit best."""
    apart = np.hypot(*(sky.points[:, None] - sky.points).T)
    near = (apart < 2.0 * sky.max_distance) & ~np.eye(len(apart), dtype=bool)
    landmarks = np.argwhere(near[:, :, None] & near[:, None] & near)
    usable = np.flatnonzero(sky.allowed.any(axis=1)).tolist()
    triples = np.array(list(combinations(usable, MINIMAL)))
    number = max(MAX_HYPOTHESES // max(len(landmarks), 1), MIN_TRIPLES)
    some = np.random.default_rng(0).permutation(triples)[: min(number, MAX_BEARING_TRIPLES)]
    poses = _promising(np.vstack([_from_triple(rows, landmarks, sky) for rows in some]), sky)
    return poses[np.argsort(-_scores(poses, sky, math.sqrt(sky.variances.max())))[:MAX_STARTS]]


def _from_triple(rows: np.ndarray, landmarks: np.ndarray, sky: Sky) -> np.ndarray:
    """Return the poses (k, 3) from which three bearings are of triples of landmarks (q, 3)."""
    of = landmarks[sky.allowed[rows, landmarks].all(axis=1)]
    bearings = np.tile(sky.bearings[rows], (len(of), 1))
    with np.errstate(divide="ignore", invalid="ignore"):
        poses = from_triples(sky.points, *of.T, *bearings.T)
        away = sky.points[of] - poses[:, None, :2]
        off = wrap(np.arctan2(away[..., 1], away[..., 0]) - poses[:, 2:] - bearings)
        fits = (np.hypot(away[..., 0], away[..., 1]) < sky.max_distance) & (np.abs(off) < LINEAR)
    return np.asarray(poses[fits.all(axis=1)])


def _promising(poses: np.ndarray, sky: Sky) -> np.ndarray:
    """Return those of poses (k, 3) from which most bearings are near that of any landmark."""
    if len(poses) <= MAX_SCORED:
        return poses
    away, bins = sky.points - poses[:, None, :2], BEARING_BINS / TWO_PI
    in_reach = np.hypot(away[..., 0], away[..., 1]) < sky.max_distance
    row, landmark = np.nonzero(in_reach)
    bearing = np.arctan2(away[..., 1], away[..., 0])[row, landmark] - poses[row, 2]
    is_near = np.zeros((len(poses), BEARING_BINS), bool)
    for shift in (-1, 0, 1):
        is_near[row, (np.floor(bearing * bins).astype(int) + shift) % BEARING_BINS] = True
    hits = is_near[:, np.floor(sky.bearings * bins).astype(int) % BEARING_BINS].sum(axis=1)
    votes = hits * math.log(DETECTED / (1.0 - DETECTED) / sky.density * bins / 3)
    votes += in_reach.sum(axis=1) * math.log(1.0 - DETECTED)
    return poses[np.argpartition(-votes, MAX_SCORED)[:MAX_SCORED]]


def _refined(poses: np.ndarray, sky: Sky) -> np.ndarray:
    """Return poses (k, 3) refined by least squares, with tolerances that shrink."""
    k, (low, high) = np.arange(len(poses))[:, None], sky.box
    longest = LINEAR * float((high - low).max())
    for tolerance in ANNEALED:
        residual, variance, jacobian, _ = _residuals(poses, sky)
        square = np.where(sky.allowed, residual**2 / variance, np.inf)
        of = square.argmin(axis=2)
        m = np.arange(of.shape[1])
        r, v = residual[k, m, of], variance[k, m, of]
        weight = (np.abs(r) < np.maximum(tolerance, INLIER * np.sqrt(v))) / v
        by_pose = jacobian[k, of]
        weighted = by_pose * weight[..., None]
        information = weighted.swapaxes(1, 2) @ by_pose
        information += (
            1e-6 * np.maximum(information.trace(axis1=1, axis2=2), 1.0)[:, None, None] * np.eye(3)
        )
        slope = (weighted * r[..., None]).sum(axis=1)
        step = np.linalg.solve(information, slope[..., None])[..., 0]
        length = np.maximum(np.hypot(step[:, 0], step[:, 1]) / longest, np.abs(step[:, 2]) / LINEAR)
        poses = poses + step / np.maximum(length, 1.0)[:, None]
    return poses


def _scores(poses: np.ndarray, sky: Sky, blur: float = 0.0) -> np.ndarray:
    """Return the log likelihood ratios (k,) of poses (k, 3), each bearing of its best landmark.

    The standard deviation `blur` [rad] is added.
    """
    gain, unseen = _gains(poses, sky, blur)[:2]
    return np.asarray(np.maximum(gain.max(axis=2), 0.0).sum(axis=1) + unseen)


def _gains(
    poses: np.ndarray, sky: Sky, blur: float = 0.0
) -> tuple[np.ndarray, np.ndarray, HomeResiduals]:
    """Return log likelihood ratios of pairs (k, m, n) and those without any (k,); residuals."""
    found = _residuals(poses, sky)
    detected, total = sky.detected(poses), found.variance + blur**2
    gain = np.log(detected / (1.0 - detected) / sky.density)[:, None]
    gain = gain - 0.5 * (np.log(TWO_PI * total) + found.residual**2 / total)
    gain = np.where(sky.allowed, gain, -np.inf)
    return gain, np.log1p(-detected).sum(axis=1), found


def _best_first(poses: np.ndarray, sky: Sky) -> np.ndarray:
    """Return the distinct poses with the largest likelihoods."""
    unit = CLOSE * float((sky.box[1] - sky.box[0]).max()) / 10
    chosen: list[int] = []
    for i in np.argsort(-_scores(poses, sky)).tolist():
        off = np.abs(poses[chosen] - poses[i])
        near = (off[:, :2].max(axis=1) < unit) & (np.abs(wrap(off[:, 2])) < CLOSE)
        if not near.any():
            chosen.append(i)
            if len(chosen) == NUM_MATCHES:
                break
    return poses[chosen]


def _one_to_one(gain: np.ndarray) -> np.ndarray:
    """Return a landmark for each bearing, (m,), -1 for none: the pairs that gain most first."""
    landmark, gain = np.full(len(gain), -1), gain.copy()
    for _ in range(min(gain.shape)):
        i, j = np.unravel_index(gain.argmax(), gain.shape)
        if not gain[i, j] > 0.0:
            break
        landmark[i] = j
        gain[i], gain[:, j] = -np.inf, -np.inf
    return landmark


def _is_same(one: Match, other: Match, sky: Sky) -> bool:
    """Return whether two poses are the same within their uncertainty, or close together."""
    off = difference(one.pose, other.pose)
    distance = float(np.median(np.hypot(*(sky.points - other.pose[:2]).T)))
    if math.hypot(off[0], off[1]) < 0.2 * CLOSE * distance and abs(off[2]) < 0.2 * CLOSE:
        return True
    joint = one.covariance + other.covariance
    return bool(off @ np.linalg.solve(joint, off) < INLIER**2)
