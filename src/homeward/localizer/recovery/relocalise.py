"""Relocalisation: the pose of a lost robot in its map, by resection along a short path.

Unlike home bearings, these come from several poses connected by odometry. For a given heading every
sight line is a line for the position too, and two of them intersect in one point. So headings are
scanned, pairs of lines intersected, and the best poses refined.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from homeward.angles import TWO_PI, wrap
from homeward.localizer.geometry import compose, lever, sight
from homeward.localizer.tunables import CLOSE, FIX_SHARE, INLIER, LINEAR, MINIMAL, VERIFIED

HEADINGS = 120
MAX_PAIRS = 40
STEPS = 8
MAX_CANDIDATES = 6
"""Poses that are refined by Gauss-Newton."""


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


def relocalise(lines: SightLines, min_inliers: int = 0) -> tuple[np.ndarray, np.ndarray] | None:
    """Return the pose in the map where the search began, and its covariance.

    Parameters
    ----------
    lines : SightLines
        Its sight lines since then.
    min_inliers : int, optional
        Smallest number of inliers.

    Returns
    -------
    pose : ndarray, shape (3,)
        x [m], y [m], heading [rad].
    covariance : ndarray, shape (3, 3)
        None instead of both if the pose is undetermined or ambiguous.
    """
    if len(lines.names) < VERIFIED or np.unique(lines.names).size < MINIMAL:
        return None
    found: list[tuple[int, np.ndarray, np.ndarray]] = []
    for start in _candidates(lines):
        refined = _refine(start, lines)
        if refined is None:
            continue
        within = CLOSE * float(_distances(refined[1][None], lines)[0])
        if not any(_same(refined[1], f[1], within) for f in found):
            found.append(refined)
    found.sort(key=lambda f: -f[0])
    enough = max(VERIFIED, FIX_SHARE * len(lines.names), min_inliers)
    if not found or found[0][0] < enough:
        return None
    if len(found) > 1 and found[1][0] >= found[0][0] - 1:
        return None
    pose, covariance = found[0][1:]
    most = CLOSE * float(_distances(pose[None], lines)[0])
    return (pose, covariance) if np.diag(covariance)[:2].max() < most**2 else None


def _candidates(lines: SightLines) -> np.ndarray:
    """Return the best distinct poses, shape (k, 3), by truncated residuals."""
    i, j = np.triu_indices(len(lines.names), 1)
    other = lines.names[i] != lines.names[j]
    i, j = i[other][-MAX_PAIRS:], j[other][-MAX_PAIRS:]
    heading = np.arange(HEADINGS)[:, None] * TWO_PI / HEADINGS
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
    tolerance = INLIER * lines.sigmas + TWO_PI / HEADINGS
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


def _refine(start: np.ndarray, lines: SightLines) -> tuple[int, np.ndarray, np.ndarray] | None:
    """Refine a pose by robust Gauss-Newton; return the number of inliers, pose, covariance."""
    pose, longest = start.copy(), LINEAR * np.ones(3)
    longest[:2] *= _distances(start[None], lines)[0]
    for _ in range(STEPS):
        r, by_place, eyes = (a[0] for a in _residuals(pose[None], lines))
        variance = lines.sigmas**2 + np.einsum(
            "mi,mij,mj->m", by_place, lines.covariances, by_place
        )
        by_eye = np.column_stack([-by_place, -np.ones(len(r))])
        jacobian = (by_eye[:, None] @ lever(eyes - pose))[:, 0]
        weight = 1.0 / (variance * np.maximum(r * r / (variance * INLIER**2), 1.0))
        information = (jacobian.T * weight) @ jacobian + 1e-6 * np.eye(3)
        covariance = np.linalg.inv(information)
        step = covariance @ (jacobian.T @ (weight * r))
        pose = pose + step / max(1.0, float((np.abs(step) / longest).max()))
    agree = np.abs(r) < INLIER * np.sqrt(variance)
    if np.unique(lines.names[agree]).size < MINIMAL:
        return None
    return int(agree.sum()), pose, covariance


def _distances(poses: np.ndarray, lines: SightLines) -> np.ndarray:
    """Return the median distance of the landmarks from each pose, shape (k,) [m]."""
    off = lines.positions - poses[:, None, :2]
    return np.asarray(np.median(np.hypot(off[:, :, 0], off[:, :, 1]), axis=1))


def _same(a: np.ndarray, b: np.ndarray, within: float) -> bool:
    """Return whether two poses, within `within` [m], are the same solution."""
    near = np.hypot(a[0] - b[0], a[1] - b[1]) < within
    return bool(near and abs(wrap(a[2] - b[2])) < LINEAR)
