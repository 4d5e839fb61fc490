"""Relocalisation: the pose of a lost robot in its map, by resection along a short path.

Unlike home bearings, these come from several poses connected by odometry. For a given heading every
sight line is a line for the position too, and two of them intersect in one point. So headings are
scanned, pairs of lines intersected, and the best poses refined.

Poses are compared by Bayes factors, with the pose integrated out (Laplace's method): how much
better the mapped positions of the landmarks explain the lines than free positions would. That three
landmarks fit some pose anyway is in the Occam factor of an unknown pose, and that a landmark seen
again from the same place is no further evidence is in its free position, which explains all lines
through it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, fields

import numpy as np

from homeward.geometry.angles import TWO_PI, wrap
from homeward.geometry.covariance import ROUNDING
from homeward.geometry.se2 import MIN_DISTANCE, compose, lever, sight
from homeward.localizer.map.bodies import find_bodies
from homeward.localizer.tunables import (
    CLOSE,
    INLIER,
    LINEAR,
    MAX_CANDIDATES,
    MAX_LINE_PAIRS,
    MIN_LOG_ODDS,
    MINIMAL,
    NUM_HEADINGS,
    RELOCALISATION_STEPS,
    UPHEAVAL,
)


@dataclass(frozen=True)
class SightLines:
    """Sight lines of a lost robot to landmarks of the map. Arrays of m rows, the newest last."""

    cameras: np.ndarray
    """(m, 3): camera's poses in the frame in which the search began."""
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


@dataclass(frozen=True)
class Located:
    """Pose that fits the sight lines."""

    pose: np.ndarray
    """(3,): x [m], y [m], heading [rad]."""
    covariance: np.ndarray
    """(3, 3)"""
    log_likelihood: float
    """Log likelihood ratio: landmarks where they are mapped, over landmarks anywhere."""

    def log_density(self, mean: np.ndarray, covariance: np.ndarray) -> float:
        """Return the log density of the pose in a Gaussian, shapes (3,) and (3, 3)."""
        off = self.pose - mean
        off[2] = wrap(off[2])
        square = float(off @ np.linalg.solve(covariance, off))
        return -0.5 * (square + float(np.linalg.slogdet(TWO_PI * covariance)[1]))

    def log_evidence(self, log_prior: float) -> float:
        """Return the log Bayes factor with the pose integrated out, by its log prior density."""
        log_volume = 0.5 * float(np.linalg.slogdet(TWO_PI * self.covariance)[1])
        return self.log_likelihood + log_prior + log_volume


def relocalise(
    lines: SightLines,
    expected: tuple[np.ndarray, np.ndarray] | None = None,
    near: Sequence[tuple[np.ndarray, np.ndarray]] = (),
) -> tuple[np.ndarray, np.ndarray] | None:
    """Return the pose (3,) in the map where the search began, and its covariance (3, 3).

    By the sight lines since then. `expected` is the pose by odometry and its covariance, if the
    robot may still be there; `near` are means and covariances of the pose if the robot was only
    displaced: each is as probable as that the robot is anywhere. None instead of both if the pose
    is undetermined or ambiguous, or may be the expected one.
    """
    if np.unique(lines.names).size < MINIMAL:
        return None
    found: list[tuple[float, Located]] = []
    for start in _candidates(lines):
        located = _refine(start, lines)
        if located is None:
            continue
        distance = float(_distances(located.pose[None], lines)[0])
        if not any(_same(located.pose, f.pose, CLOSE * distance) for _, f in found):
            log_priors = [_log_in_sight(distance), *(located.log_density(*each) for each in near)]
            log_prior = float(np.logaddexp.reduce(log_priors)) - math.log(len(log_priors))
            found.append((located.log_evidence(log_prior), located))
    if not found:
        return None
    found.sort(key=lambda f: -f[0])
    log_evidence, best = found[0]
    # Rival: no landmark is where it is mapped. It is improbable for a robot that was displaced.
    elsewhere = math.log(UPHEAVAL / (1.0 - UPHEAVAL)) if near else 0.0
    rivals = [elsewhere, *(f[0] for f in found[1:]), *_carried_bodies(best.pose, lines)]
    if not _is_proved(log_evidence, rivals):
        return None
    if expected is not None:
        rivals.append(_log_evidence_of(*expected, lines))
        if not _is_proved(log_evidence, rivals):
            return None
    most = CLOSE * float(_distances(best.pose[None], lines)[0])
    uncertain = np.diag(best.covariance)[:2].max() >= most**2
    return None if uncertain else (best.pose, best.covariance)


def relocalise_near(
    lines: SightLines, last: np.ndarray, covariance: np.ndarray, motions: Sequence[np.ndarray]
) -> tuple[np.ndarray, np.ndarray] | None:
    """Return the pose by a single frame, near the `last` one; None if it is undetermined.

    `motions` are covariances (3, 3) of what may have moved the robot since; each is as probable as
    that it is anywhere. Any three landmarks fit some pose, so that more are needed.
    """
    if lines.names.size <= MINIMAL:
        return None
    return relocalise(lines, near=[(last, covariance + motion) for motion in motions])


def _carried_bodies(pose: np.ndarray, lines: SightLines) -> list[float]:
    """Return the log evidence that only the lines of a carried body fit a pose, for each body."""
    names, first = np.unique(lines.names, return_index=True)
    places = lines.positions[first]
    bodies = find_bodies(
        names.astype(str).tolist(), places, (), float(np.ptp(places, axis=0).max())
    )
    evidence = []
    for members, one_body in zip(bodies.members, bodies.one_body.tolist(), strict=True):
        of = np.isin(lines.names, names[members])
        body = SightLines(*(getattr(lines, f.name)[of] for f in fields(lines)))
        alone = Located(pose, _step(pose, body)[1], _log_likelihood(pose, body))
        log_prior = _log_in_sight(float(_distances(pose[None], body)[0]))
        fits = min(alone.log_likelihood, alone.log_evidence(log_prior))  # if it leaves a pose open
        evidence.append(math.log(one_body * UPHEAVAL / (1.0 - UPHEAVAL)) + fits)
    return evidence


def _log_in_sight(distance: float) -> float:
    """Return the log prior density of a pose in sight of landmarks at a distance [m]."""
    return -math.log(TWO_PI * math.pi * distance**2)


def _is_proved(log_evidence: float, rivals: list[float]) -> bool:
    """Return whether a pose is more probable than all its rivals together, by `MIN_LOG_ODDS`."""
    return log_evidence - float(np.logaddexp.reduce(rivals)) >= MIN_LOG_ODDS


def _log_evidence_of(pose: np.ndarray, covariance: np.ndarray, lines: SightLines) -> float:
    """Return the log Bayes factor of a pose with a Gaussian prior."""
    there = _log_likelihood(pose, lines)
    near = _refine(pose, lines)
    if near is None:
        return there
    prior = near.log_density(pose, covariance + 1e-12 * np.eye(3))
    return max(there, near.log_evidence(prior))


def _candidates(lines: SightLines) -> np.ndarray:
    """Return the best distinct poses, shape (k, 3), by truncated residuals."""
    i, j = np.triu_indices(len(lines.names), 1)
    other = lines.names[i] != lines.names[j]
    i, j = i[other][-MAX_LINE_PAIRS:], j[other][-MAX_LINE_PAIRS:]
    heading = np.arange(NUM_HEADINGS)[:, None] * TWO_PI / NUM_HEADINGS
    c, s = np.cos(heading), np.sin(heading)
    dx, dy = lines.cameras[:, 0], lines.cameras[:, 1]
    x = lines.positions[:, 0] - (c * dx - s * dy)  # (headings, m)
    y = lines.positions[:, 1] - (s * dx + c * dy)
    direction = heading + lines.cameras[:, 2] + lines.bearings
    nx, ny = -np.sin(direction), np.cos(direction)
    offset = nx * x + ny * y
    det = nx[:, i] * ny[:, j] - ny[:, i] * nx[:, j]
    det = np.where(np.abs(det) < 0.05, np.nan, det)
    px = (offset[:, i] * ny[:, j] - ny[:, i] * offset[:, j]) / det
    py = (nx[:, i] * offset[:, j] - offset[:, i] * nx[:, j]) / det
    poses = np.stack([px, py, np.broadcast_to(heading, px.shape)], axis=-1).reshape(-1, 3)
    poses = np.asarray(poses[np.isfinite(poses).all(axis=1)])
    if not len(poses):
        return poses
    tolerance = INLIER * lines.sigmas + TWO_PI / NUM_HEADINGS
    cost = np.minimum(np.abs(_residuals(poses, lines)[0]) / tolerance, 1.0).sum(axis=1)
    chosen: list[np.ndarray] = []
    best = poses[np.argsort(cost)[:200]]
    for pose, within in zip(best, (CLOSE * _distances(best, lines)).tolist(), strict=True):
        if not any(_same(pose, p, within) for p in chosen):
            chosen.append(pose)
        if len(chosen) == MAX_CANDIDATES:
            break
    return np.array(chosen)


def _residuals(poses: np.ndarray, lines: SightLines) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return residuals (k, m), their Jacobian by the landmarks' positions, and the cameras."""
    eyes = compose(poses[:, None], lines.cameras)
    seen = sight(eyes, lines.positions)
    return np.asarray(wrap(lines.bearings - seen.bearing)), seen.by_place, eyes


def _refine(start: np.ndarray, lines: SightLines) -> Located | None:
    """Refine a pose by robust Gauss-Newton (a redescending M-estimator)."""
    pose, longest = start.copy(), LINEAR * np.ones(3)
    longest[:2] *= _distances(start[None], lines)[0]
    for _ in range(RELOCALISATION_STEPS):
        step, covariance, inliers = _step(pose, lines)
        pose = pose + step / max(1.0, float((np.abs(step) / longest).max()))
    if np.unique(lines.names[inliers]).size < MINIMAL:
        return None
    return Located(pose, covariance, _log_likelihood(pose, lines))


def _step(pose: np.ndarray, lines: SightLines) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return a Gauss-Newton step, the covariance of the pose, and the inliers (m,)."""
    r, by_place, eyes = (a[0] for a in _residuals(pose[None], lines))
    variance = _variances(by_place, lines)
    by_eye = np.column_stack([-by_place, -np.ones(len(r))])
    jacobian = (by_eye[:, None] @ lever(eyes - pose))[:, 0]
    weight = 1.0 / (variance * np.maximum(r * r / (variance * INLIER**2), 1.0))
    covariance = _inverse((jacobian.T * weight) @ jacobian)
    return (
        covariance @ (jacobian.T @ (weight * r)),
        covariance,
        np.abs(r) < INLIER * np.sqrt(variance),
    )


def _inverse(information: np.ndarray) -> np.ndarray:
    """Return the covariance (3, 3) of a pose by the information of sight lines.

    They may leave directions open, as lines to one landmark do, which then have a weak prior: above
    the rounding of the information, in which a small one may be lost.
    """
    for prior in (1e-6, ROUNDING * float(information.trace())):
        with suppress(np.linalg.LinAlgError):
            covariance = np.linalg.inv(information + prior * np.eye(3))
            if (covariance.diagonal() > 0.0).all():
                return np.asarray(covariance)
    raise np.linalg.LinAlgError("the sight lines are not finite")


def _variances(by_place: np.ndarray, lines: SightLines) -> np.ndarray:
    """Return the variances of the residuals, by bearings and mapped positions, shape (m,)."""
    by_map = np.einsum("mi,mij,mj->m", by_place, lines.covariances, by_place)
    return np.asarray(lines.sigmas**2 + by_map)


def _log_likelihood(pose: np.ndarray, lines: SightLines) -> float:
    """Return the log likelihood ratio of the lines: landmarks as mapped over landmarks anywhere.

    A landmark is where it is mapped unless it moved or is mistaken for another; then it is off by
    about its distance. Most of its lines must be inliers.
    """
    r, by_place, eyes = (a[0] for a in _residuals(pose[None], lines))
    inliers = np.abs(r) < INLIER * np.sqrt(_variances(by_place, lines))
    _, first, landmark = np.unique(lines.names, return_index=True, return_inverse=True)
    weighted = by_place * (inliers / lines.sigmas**2)[:, None]
    information, slope = np.zeros((len(first), 2, 2)), np.zeros((len(first), 2))
    np.add.at(information, landmark, weighted[:, :, None] * by_place[:, None])
    np.add.at(slope, landmark, weighted * r[:, None])
    square = ((lines.positions - eyes[:, :2])[first] ** 2).sum(axis=1)
    mapped = lines.covariances[first]
    anywhere = mapped + square[:, None, None] * np.eye(2)
    log_ratio = _log_marginal(mapped, information, slope)
    log_ratio -= _log_marginal(anywhere, information, slope)
    most = np.bincount(landmark, inliers) > 0.5 * np.bincount(landmark)
    log_ratio = np.where(most, math.log1p(-UPHEAVAL) + log_ratio, -np.inf)
    return float(np.logaddexp(math.log(UPHEAVAL), log_ratio).sum())


def _log_marginal(prior: np.ndarray, information: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """Return log marginal likelihoods (n,) of positions with prior covariances (n, 2, 2).

    Up to a constant that does not depend on the priors; (n, 2, 2) and (n, 2) are the information
    on the positions, and its gradient.

    Of I + P H, P the prior and H the information, the determinant is 1 + tr P H + det P det H, and
    its inverse times P is P + det P (tr H - H), over that determinant. No term is negative, so that
    a single sighting, whose information is singular, does not make it negative by rounding.
    """
    area = np.maximum(_determinants(prior), 0.0)
    volume = area * np.maximum(_determinants(information), 0.0)
    volume = 1.0 + np.maximum((prior * information).sum(axis=(1, 2)), 0.0) + volume
    across = information.trace(axis1=1, axis2=2)[:, None, None] * np.eye(2) - information
    posterior = prior + area[:, None, None] * across
    square = (slope[:, None] @ posterior @ slope[:, :, None])[:, 0, 0] / volume
    return np.asarray(0.5 * (np.maximum(square, 0.0) - np.log(volume)))


def _determinants(matrices: np.ndarray) -> np.ndarray:
    """Return the determinants (n,) of matrices (n, 2, 2)."""
    (a, b), (c, d) = matrices.transpose(1, 2, 0)
    return np.asarray(a * d - b * c)


def _distances(poses: np.ndarray, lines: SightLines) -> np.ndarray:
    """Return the median distance of the landmarks from each pose, shape (k,) [m].

    At least `MIN_DISTANCE`: the pose may be that of a landmark.
    """
    off = lines.positions - poses[:, None, :2]
    median = np.median(np.hypot(off[:, :, 0], off[:, :, 1]), axis=1)
    return np.asarray(np.maximum(median, MIN_DISTANCE))


def _same(a: np.ndarray, b: np.ndarray, within: float) -> bool:
    """Return whether two poses, within `within` [m], are the same solution."""
    near = np.hypot(a[0] - b[0], a[1] - b[1]) < within
    return bool(near and abs(wrap(a[2] - b[2])) < LINEAR)
