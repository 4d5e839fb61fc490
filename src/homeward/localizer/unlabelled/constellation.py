"""Constellation: the pose from which bearings without ids fit a map, over all assignments.

Each cell of a grid of positions gets votes for its headings, one from each bearing and landmark;
the best cells are refined by least squares, in which each bearing is of the nearest landmark. The
evidence of a pose is a Bayes factor against bearings that belong to no landmark: with the pose
integrated out (Laplace's method), and each landmark of a bearing equally probable before.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from homeward.geometry.angles import TWO_PI, wrap
from homeward.geometry.se2 import sight
from homeward.localizer.tunables import (
    ANNEALED,
    CLOSE,
    CONSTELLATION_HEADINGS,
    CONSTELLATION_PAD,
    CONSTELLATION_STEP,
    DETECTED,
    INLIER,
    LINEAR,
    MAX_CELLS,
    MAX_STARTS,
    MINIMAL,
    NATS_APART,
    NUM_MATCHES,
    UNMATCHED,
)


@dataclass(frozen=True)
class Sky:
    """Landmarks of a map, and m bearings of them from an unknown pose."""

    points: np.ndarray
    """(n, 2): positions of the landmarks [m]."""
    covariances: np.ndarray
    """(n, 2, 2)"""
    bearings: np.ndarray
    """(m,) [rad]"""
    variances: np.ndarray
    """(m,): of the bearings [rad^2]."""
    allowed: np.ndarray
    """(m, n), bool: which landmark a bearing may be of."""
    reach: float = math.inf
    """Distance within which most landmarks are seen [m]."""
    near: tuple[float, float, float] | None = None
    """Circle in which the pose is with a probability of a half: x, y, radius [m]; None: anywhere.
    """

    start: np.ndarray | None = None
    """(3,): pose that was found before."""

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

    def detected(self, pose: np.ndarray) -> np.ndarray:
        """Return the probability to see each landmark from a pose (3,), shape (n,)."""
        distance = np.hypot(*(self.points - pose[:2]).T)
        beyond = np.maximum(distance / self.reach - 1.0, 0.0) / LINEAR
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
    return Ranked(best, best.log_evidence - float(rival))


def match(pose: np.ndarray, sky: Sky) -> Match | None:
    """Return the match at a refined pose (3,), each landmark having one bearing at most."""
    for _ in range(2):
        residual, variance, jacobian = _residuals(pose[None], sky)
        detected = sky.detected(pose)
        gain = np.log(detected / (1.0 - detected) / sky.density)
        gain = gain - 0.5 * (np.log(TWO_PI * variance[0]) + residual[0] ** 2 / variance[0])
        landmark = _one_to_one(np.where(sky.allowed, gain, -np.inf))
        rows = np.flatnonzero(landmark >= 0)
        if rows.size < MINIMAL:
            return None
        of = landmark[rows]
        r, v, by_pose = residual[0, rows, of], variance[0, rows, of], jacobian[0, of]
        information = (by_pose / v[:, None]).T @ by_pose + 1e-9 * np.eye(3)
        step = np.linalg.solve(information, by_pose.T @ (r / v))
        pose = pose + step
    unseen = np.log1p(-detected).sum()
    covariance = np.linalg.inv(information)
    volume = 0.5 * float(np.linalg.slogdet(TWO_PI * covariance)[1])
    return Match(
        pose,
        landmark,
        float(gain[rows, of].sum() + unseen) + volume + sky.log_prior(pose),
        covariance,
    )


def _residuals(poses: np.ndarray, sky: Sky) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return residuals and variances (k, m, n) at poses (k, 3), and Jacobians (k, n, 3)."""
    bearing, by_place, _ = sight(poses[:, None], sky.points)
    by_map = np.einsum("kni,nij,knj->kn", by_place, sky.covariances, by_place)
    jacobian = np.concatenate([-by_place, np.full((*bearing.shape, 1), -1.0)], axis=2)
    variance = by_map[:, None] + sky.variances[:, None]
    return wrap(sky.bearings[:, None] - bearing[:, None]), variance, jacobian


def _starts(sky: Sky) -> np.ndarray:
    """Return the poses (k, 3) with most votes."""
    (x0, y0), (x1, y1) = sky.box
    size = max(x1 - x0, y1 - y0)
    step = max(CONSTELLATION_STEP * min(sky.reach, 0.5 * size), size / MAX_CELLS)
    grid = np.stack(np.meshgrid(np.arange(x0, x1, step), np.arange(y0, y1, step)), -1)
    cells, bins = grid.reshape(-1, 2), CONSTELLATION_HEADINGS
    off = sky.points - cells[:, None]
    distance = np.hypot(off[..., 0], off[..., 1])
    in_reach = distance < (1.0 + LINEAR) * sky.reach
    in_reach &= (in_reach.sum(axis=1) >= MINIMAL)[:, None]
    cell, landmark = np.nonzero(in_reach)
    away, off = np.maximum(distance[in_reach], 0.5 * step), off[in_reach]
    tolerance = np.minimum(0.5 * step / away, LINEAR) + 2.0 * math.sqrt(sky.variances.max())
    angle = np.arctan2(off[:, 1], off[:, 0])
    pair, row = np.nonzero(sky.allowed.T[landmark])
    heading, around = wrap(angle[pair] - sky.bearings[row]), tolerance[pair]
    first = np.floor((heading - around + math.pi) * (bins / TWO_PI)).astype(int)
    last = np.floor((heading + around + math.pi) * (bins / TWO_PI)).astype(int) + 1
    # Votes that begin and end are summed along each row, with space at both ends: they wrap round.
    pad, at = bins // 2, cell[pair] * (2 * bins) + bins // 2
    weight = np.log1p(1.0 / around)
    change = np.bincount(at + first, weight, len(cells) * 2 * bins)
    change -= np.bincount(at + last, weight, len(cells) * 2 * bins)
    spread = change.reshape(len(cells), 2 * bins).cumsum(axis=1)
    votes = spread[:, pad : pad + bins]
    votes[:, :pad] += spread[:, pad + bins :]
    votes[:, bins - pad :] += spread[:, :pad]
    number = min(MAX_STARTS, votes.size - 1)
    cell, turn = np.divmod(np.argpartition(-votes.ravel(), number)[:number], bins)
    return np.column_stack([cells[cell], (turn + 0.5) * (TWO_PI / bins) - math.pi])


def _refined(poses: np.ndarray, sky: Sky) -> np.ndarray:
    """Return poses (k, 3) refined by least squares, with tolerances that shrink."""
    k, (low, high) = np.arange(len(poses))[:, None], sky.box
    longest = LINEAR * float((high - low).max())
    for tolerance in ANNEALED:
        residual, variance, jacobian = _residuals(poses, sky)
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


def _best_first(poses: np.ndarray, sky: Sky) -> np.ndarray:
    """Return the distinct poses with the largest likelihoods."""
    residual, variance, _ = _residuals(poses, sky)
    square = np.where(sky.allowed, residual**2 + 0.0 * variance, np.inf) / variance
    nearest = square.min(axis=2)
    score = np.maximum(0.5 * (INLIER**2 - nearest), 0.0).sum(axis=1)
    score += MINIMAL * np.count_nonzero(nearest < INLIER**2, axis=1)
    order, unit = np.argsort(-score), CLOSE * float((sky.box[1] - sky.box[0]).max()) / 10
    chosen: list[int] = []
    for i in order.tolist():
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
    off = one.pose - other.pose
    off[2] = wrap(off[2])
    distance = float(np.median(np.hypot(*(sky.points - other.pose[:2]).T)))
    if math.hypot(off[0], off[1]) < 0.2 * CLOSE * distance and abs(off[2]) < 0.2 * CLOSE:
        return True
    joint = one.covariance + other.covariance
    return bool(off @ np.linalg.solve(joint, off) < INLIER**2)
