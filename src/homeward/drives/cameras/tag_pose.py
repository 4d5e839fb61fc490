"""Poses of tags with their covariances, from the corners of each tag and its size.

A tag that is small or nearly frontal looks almost the same when it is tilted the other way
(Schweighofer and Pinz, "Robust pose estimation from a planar target", PAMI 2006). Both solutions
are refined by least squares. The covariance is the second moment about the better one of a mixture:
both solutions with their Gaussian approximations, and the frontal pose, weighted by likelihood.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.special import chdtri

from homeward.drives.cameras.camera import MIN_TAG_AREA, Camera, Shape, rays_of

SQUARE = np.array([[-0.5, -0.5, 0], [0.5, -0.5, 0], [0.5, 0.5, 0], [-0.5, 0.5, 0]])
"""Corners in the tag's frame, in lengths of its side."""
ITERATIONS = 20
CONVERGED = 1e-4
"""Decrease of the misfit at which the iteration ends."""
NEAREST = 1e-3
"""Minimum distance of a corner along the axis [m]."""
PRIOR = np.diag([0.0, 0.0, 0.0, *(3.0 / math.pi**2,) * 3])
"""Information on the rotation: an unknown angle has a variance of pi^2 / 3."""
CLEARLY_WORSE = float(chdtri(1, 1e-4))
"""Increase of the misfit beyond which a solution is improbable."""
MIN_WEIGHT = 1.0 / (float(chdtri(6, 0.01)) - 6.0)
"""Minimum weight of a solution that is not: the 99 % ellipsoid contains it with its own errors."""
MAX_MISFIT = float(chdtri(2, 0.001))
"""Misfit beyond which the errors of the corners are larger than specified."""
NO_TAG = 100.0 * MAX_MISFIT
"""Misfit of corners that are not those of a tag: errors of ten times their sigma."""
SAME = 1e-3
"""Maximum rotation between two solutions that are the same [rad]."""


@dataclass(frozen=True)
class TagPose:
    """Pose of a tag in the frame of a camera: x along its axis, y to the left, z up."""

    position: np.ndarray
    """(3,), of the centre of the tag [m]."""
    rotation: np.ndarray
    """(3, 3), from the frame of the tag: x to its right, y down, z into the tag."""
    covariance: np.ndarray
    """(6, 6), of position [m] and rotation vector [rad], both along the axes of the camera."""
    other: tuple[np.ndarray, np.ndarray] | None
    """Position and rotation of the second solution; None where it is clearly worse. The covariance
    covers it."""


class _Fit(NamedTuple):
    """Solutions for n tags."""

    position: np.ndarray
    rotation: np.ndarray
    misfit: np.ndarray
    """(n,), sums of the squared normalised residuals."""
    covariance: np.ndarray
    """(n, 6, 6), by linearisation."""

    def shift(self, other: _Fit) -> np.ndarray:
        """Return the differences of position and rotation vector to another solution, (n, 6)."""
        turn = other.rotation @ np.swapaxes(self.rotation, -1, -2)
        return np.hstack([other.position - self.position, Rotation.from_matrix(turn).as_rotvec()])


def tag_poses(
    corners: np.ndarray, sigma: np.ndarray | float, sizes: np.ndarray, camera: Camera, shape: Shape
) -> list[TagPose | None]:
    """Return the poses of tags in the frame of a camera, with covariances.

    The covariances contain the errors of the corners, but not those of the camera's calibration and
    of the sizes. The known tilt is removed; the unknown tilt does not matter in this frame.

    Parameters
    ----------
    corners : ndarray, shape (n, 4, 2)
        Columns and rows [px]: top left, top right, bottom right, bottom left as in OpenCV, or
        bottom left, bottom right, top right, top left as in AprilTag 3.
    sigma : ndarray, shape (n,), or float
        Standard deviation of each coordinate [px].
    sizes : ndarray, shape (n,)
        Lengths of the sides of the tags [m]; NaN: unknown.
    camera : Camera
    shape : (int, int)
        Height and width of the image [px].

    Returns
    -------
    list of TagPose or None
        None where the size is unknown, or the corners are not the image of a tag.
    """
    u, v = np.moveaxis(corners, -1, 0)
    area = np.sum(u * np.roll(v, -1, axis=1) - v * np.roll(u, -1, axis=1), axis=1)
    corners = np.where((area < 0)[:, None, None], corners[:, ::-1], corners)
    out: list[TagPose | None] = [None] * len(corners)
    view = _view(rays_of(corners, camera, shape))
    half = 0.5 * np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]])
    points = rays_of(corners + half[:, None, None], camera, shape) @ view
    flat, right, left, below, above = points[..., :2] / points[..., 2:]
    sides = np.roll(flat, -1, axis=1) - flat
    after = np.roll(sides, -1, axis=1)
    turns = sides[..., 0] * after[..., 1] - sides[..., 1] * after[..., 0]
    is_square = (turns > MIN_TAG_AREA).all(axis=1)  # False where it is not convex, or NaN
    sigma = np.broadcast_to(np.asarray(sigma, float), area.shape)
    known = np.flatnonzero(is_square & (sizes > 0) & (sigma > 0))
    if not known.size:
        return out
    slope = np.stack([right - left, below - above], axis=-1)[known]
    whiten = np.linalg.inv(np.linalg.cholesky(slope @ np.swapaxes(slope, -1, -2)))
    seen, square = flat[known], SQUARE * sizes[known, None, None]
    fit = partial(_fit, seen, whiten / sigma[known, None, None, None], square)
    one = fit(*_start(seen, square))
    two = fit(one.position, _reversed(one))
    swap = two.misfit < one.misfit
    best, other = _choice(swap, two, one), _choice(swap, one, two)
    frontal = fit(best.position, _frontal(best), fixed_normal=True)
    covariance, is_open = _mixed(best, other, frontal)
    for row, k in enumerate(known.tolist()):
        if best.misfit[row] < NO_TAG:
            turn, both = view[k], np.kron(np.eye(2), view[k])
            second = turn @ other.position[row], turn @ other.rotation[row]
            out[k] = TagPose(
                turn @ best.position[row],
                turn @ best.rotation[row],
                both @ covariance[row] @ both.T,
                second if is_open[row] else None,
            )
    return out


def _mixed(best: _Fit, other: _Fit, frontal: _Fit) -> tuple[np.ndarray, np.ndarray]:
    """Return the covariances (n, 6, 6), and where the other solution is not clearly worse (n,)."""
    shifts = np.stack([best.shift(other), best.shift(frontal)])
    is_other = np.linalg.norm(shifts[0, :, 3:], axis=-1) > SAME
    excess = np.maximum(np.stack([other.misfit, frontal.misfit]) - best.misfit, 0.0)
    volume = (np.linalg.slogdet(other.covariance)[1] - np.linalg.slogdet(best.covariance)[1]) / 2
    weights = np.exp([is_other * volume, 0 * volume] - excess / 2)
    weights[0] *= is_other
    weights /= 1.0 + weights.sum(axis=0)
    covariance = best.covariance + weights[0, :, None, None] * (other.covariance - best.covariance)
    is_open = excess < CLEARLY_WORSE
    is_open[0] &= is_other
    weights = np.where(is_open, np.maximum(weights, MIN_WEIGHT), weights)
    covariance = covariance + np.einsum("kn,kni,knj->nij", weights, shifts, shifts)
    larger = np.where(best.misfit > MAX_MISFIT, best.misfit / 2.0, 1.0)  # of 2 degrees of freedom
    return covariance * larger[:, None, None], is_open[0]


def _choice(use: np.ndarray, one: _Fit, two: _Fit) -> _Fit:
    """Return the solutions of one where `use`, (n,), else of two."""
    pairs = zip(one, two, strict=True)
    return _Fit(*(np.where(use.reshape(-1, *(1,) * (a.ndim - 1)), a, b) for a, b in pairs))


def _view(rays: np.ndarray) -> np.ndarray:
    """Return axes (n, 3, 3) to the right, down and towards each tag, of its corners (n, 4, 3)."""
    ahead = rays.mean(axis=1)
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    up = np.where(np.abs(ahead[:, 2:]) < 0.9, [0.0, 0.0, 1.0], [0.0, 1.0, 0.0])
    right = np.cross(ahead, up)
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    return np.stack([right, np.cross(ahead, right), ahead], axis=-1)


def _start(seen: np.ndarray, square: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return positions (n, 3) and rotations (n, 3, 3) from homographies, as `_fit`."""
    known = np.concatenate([square[..., :2], np.ones_like(square[..., :1])], axis=-1)
    none = np.zeros_like(known)
    rows = [
        np.concatenate([*parts, -seen[..., k : k + 1] * square[..., :2]], axis=-1)
        for k, parts in enumerate(((known, none), (none, known)))
    ]
    found = np.linalg.solve(
        np.concatenate(rows, axis=1), np.hstack([*np.moveaxis(seen, -1, 0)])[..., None]
    )
    H = np.concatenate([found[..., 0], np.ones((len(seen), 1))], axis=1).reshape(-1, 3, 3)
    H = H * 2.0 / np.linalg.norm(H[:, :, :2], axis=1).sum(axis=1)[:, None, None]
    normal = np.cross(H[:, :, 0], H[:, :, 1])
    U, _, V = np.linalg.svd(np.stack([H[:, :, 0], H[:, :, 1], normal], axis=-1))
    return H[:, :, 2], U @ V


def _reversed(fit: _Fit) -> np.ndarray:
    """Return the rotations (n, 3, 3) of the tags mirrored in the plane across the line of sight."""
    ahead = fit.position / np.linalg.norm(fit.position, axis=1, keepdims=True)
    mirror = np.eye(3) - 2.0 * ahead[:, :, None] * ahead[:, None, :]
    return np.asarray(mirror @ fit.rotation @ np.diag([1.0, 1.0, -1.0]))


def _frontal(fit: _Fit) -> np.ndarray:
    """Return the rotations (n, 3, 3) of the tags turned towards the camera, by the least angle."""
    ahead = fit.position / np.linalg.norm(fit.position, axis=1, keepdims=True)
    normal = fit.rotation[:, :, 2]
    axis = np.cross(normal, ahead)
    sine = np.linalg.norm(axis, axis=1)
    angle = np.arctan2(sine, np.sum(normal * ahead, axis=1))
    turn = axis * (angle / np.maximum(sine, 1e-12))[:, None]
    return np.asarray(Rotation.from_rotvec(turn).as_matrix() @ fit.rotation)


def _fit(
    seen: np.ndarray,
    whiten: np.ndarray,
    square: np.ndarray,
    position: np.ndarray,
    rotation: np.ndarray,
    fixed_normal: bool = False,
) -> _Fit:
    """Refine poses by Levenberg and Marquardt's method; `fixed_normal` keeps the tags' planes.

    `seen` are the corners (n, 4, 2) in units of the distance along the axis; `whiten` (n, 4, 2, 2)
    normalises their errors; `square` are the corners (n, 4, 3) in the frame of each tag [m].
    """

    def residuals(
        position: np.ndarray, rotation: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return arms and points of the corners, (n, 4, 3) each, and normalised residuals."""
        arms = square @ np.swapaxes(rotation, -1, -2)
        points = position[:, None] + arms
        z = np.maximum(points[..., 2:], NEAREST)
        off = whiten @ (points[..., :2] / z - seen)[..., None]
        return arms, points, off.reshape(-1, 8)

    def jacobian(arms: np.ndarray, points: np.ndarray, rotation: np.ndarray) -> np.ndarray:
        """Return the derivatives of the residuals, (n, 8, 6)."""
        by_point = np.zeros((*arms.shape[:-1], 2, 3))
        z = np.maximum(points[..., 2], NEAREST)
        by_point[..., 0, 0] = by_point[..., 1, 1] = 1.0 / z
        by_point[..., 2] = -points[..., :2] / z[..., None] ** 2
        by_point = whiten @ by_point
        by_turn = np.cross(arms[..., None, :], by_point)
        if fixed_normal:  # rotations about the normal only
            normal = rotation[:, None, None, :, 2]
            by_turn = np.sum(by_turn * normal, axis=-1, keepdims=True) * normal
        return np.concatenate([by_point, by_turn], axis=-1).reshape(-1, 8, 6)

    arms, points, off = residuals(position, rotation)
    misfit, damping = np.sum(off**2, axis=1), np.full(len(off), 1e-3)
    for _ in range(ITERATIONS):
        slope = jacobian(arms, points, rotation)
        normal_matrix = np.swapaxes(slope, -1, -2) @ slope
        scale = damping[:, None] * np.einsum("nii->ni", normal_matrix) + 1e-9
        gradient = np.swapaxes(slope, -1, -2) @ off[..., None]
        step = -np.linalg.solve(normal_matrix + scale[..., None] * np.eye(6), gradient)[..., 0]
        turn = Rotation.from_rotvec(step[:, 3:]).as_matrix() @ rotation
        trial = residuals(position + step[:, :3], turn)
        trial_misfit = np.sum(trial[2] ** 2, axis=1)
        gain = misfit - trial_misfit
        better = gain > 0
        position = np.where(better[:, None], position + step[:, :3], position)
        rotation = np.where(better[:, None, None], turn, rotation)
        misfit, damping = np.minimum(trial_misfit, misfit), damping * np.where(better, 0.1, 10.0)
        arms, points, off = residuals(position, rotation)
        if (np.abs(gain) < CONVERGED).all():
            break
    slope = jacobian(arms, points, rotation)
    covariance = np.linalg.inv(np.swapaxes(slope, -1, -2) @ slope + PRIOR)
    return _Fit(position, rotation, misfit, covariance)
