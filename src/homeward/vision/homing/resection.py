"""Resection from home's landmarks: each is on the ray of its home bearing.

Its distance is the map's, or a guess. Near home these distances cancel, and with them the map's
errors, which affect a pose within the map. The unknown tilt is common to all bearings: two unknowns
in addition to the pose.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from homeward.drives.drive import Columns
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose
from homeward.geometry.statistics import robust_loss, robust_weight
from homeward.vision.cameras.panoramic import WINDOW
from homeward.vision.geometry.epipolar import INLIER
from homeward.vision.geometry.refinement import leave_windows_out

BLUR = 0.01
"""Standard deviation added to bearings in the search for a start [rad]."""
NEAR_HOME = 0.3
"""Minimum distance [m] at which a direction is applied: nearer to home, its error exceeds its
covariance."""
MIN_DISTANCE = 0.05
"""Minimum distance of a landmark from the camera [m]."""


@dataclass(frozen=True)
class HomeLandmarks(Columns):
    """Landmarks of home that are seen now. All arrays have n rows."""

    home: np.ndarray
    """Bearing from home [rad]."""
    now: np.ndarray
    """Bearing now [rad]."""
    sigma: np.ndarray
    """Of the difference of the two [rad]."""
    distance: np.ndarray
    """From home [m]."""
    distance_sigma: np.ndarray
    """[m]"""
    mapped: np.ndarray
    """bool, whether the distance is the map's (at least one is); else it is a guess."""
    lean: np.ndarray
    """(n, 2): derivatives of the bearings now by roll and pitch of the camera [1]."""

    def __len__(self) -> int:
        return self.home.size


@dataclass(frozen=True)
class Direction:
    """Direction and heading from two panoramas alone."""

    theta: float
    """Direction from home [rad]."""
    alpha: float
    """Heading [rad]."""
    covariance: np.ndarray
    """(2, 2), of both."""


@dataclass(frozen=True)
class Resection:
    """Pose of the camera in the frame of home's camera."""

    pose: Pose
    covariance: np.ndarray
    """(3, 3), of x [m], y [m], heading [rad]."""
    agrees: np.ndarray
    """(n,) bool, which landmarks are inliers."""


def resect(anchors: HomeLandmarks, seen: Direction, tilt: np.ndarray) -> Resection | None:
    """Fit a pose to home's landmarks and to the direction from the two panoramas.

    The direction matters where the map is poor; near home its covariance reduces its weight. `tilt`
    (2, 2) is the covariance of the remaining roll and pitch of the camera [rad^2]. None if the
    landmarks do not determine a pose.
    """
    if len(anchors) < 3:
        return None
    # Guessed distances have little weight far from home and much near it, also at a wrong start.
    of_map = anchors.rows(anchors.mapped)
    upright = np.linalg.inv(tilt)
    found = _fit(of_map, seen, upright, _begin(of_map, seen))
    starts = [_begin(anchors, seen), *([] if found is None else [found.x])]
    fits = [fit for x in starts if (fit := _fit(anchors, seen, upright, x)) is not None]
    if not fits:
        return None
    best = min(fits, key=lambda fit: fit.loss)
    x, y, heading = best.x[:3].tolist()
    agrees = best.residual**2 <= INLIER**2 * best.variance
    return Resection(Pose(x, y, float(wrap(heading))), _covariance(anchors, best), agrees)


@dataclass(frozen=True)
class _Fit:
    """A pose fitted to n landmarks."""

    x: np.ndarray
    """(5,): x [m], y [m], heading, and remaining roll and pitch [rad]."""
    information: np.ndarray
    """(5, 5)"""
    weight: np.ndarray
    """(n,): of each landmark [rad^-2]."""
    residual: np.ndarray
    """(n,): of its bearing [rad]."""
    variance: np.ndarray
    """(n,): of the residual [rad^2]."""
    jacobian: np.ndarray
    """(n, 5): of the bearing."""
    loss: float
    """Negative log-likelihood of the bearings of mapped landmarks, the tilt, and the direction from
    the two pictures; guessed distances have no likelihood."""


def _fit(
    anchors: HomeLandmarks, seen: Direction, upright: np.ndarray, x: np.ndarray
) -> _Fit | None:
    """Fit a pose, starting from `x`, (5,); None if the landmarks do not determine one.

    `upright`, (2, 2), is the information that roll and pitch are zero.
    """
    across, known = _direction(seen, max(float(np.hypot(*x[:2])), NEAR_HOME))
    for _ in range(10):
        residual, jacobian, variance = predict_bearings(anchors, x)
        off = np.array([0.0, wrap(seen.alpha - x[2])]) - np.array([across[0] @ x, 0.0])
        weight = robust_weight(residual**2 / (INLIER**2 * variance)) / variance
        direction = robust_weight(off @ known @ off / (INLIER**2 * off.size)) * across.T @ known
        information = (jacobian.T * weight) @ jacobian + direction @ across
        information[3:, 3:] += upright
        slope = (jacobian.T * weight) @ residual + direction @ off
        slope[3:] -= upright @ x[3:]
        try:
            step = np.linalg.solve(information, slope)
        except np.linalg.LinAlgError:
            return None
        x = x + step
        if np.abs(step).max() < 1e-5:
            break
    if not np.isfinite(x).all():
        return None
    residual, jacobian, variance = predict_bearings(anchors, x)
    unlike = robust_loss(residual**2 / (INLIER**2 * variance)) * INLIER**2
    unlike += np.log(variance / anchors.sigma**2)
    of_direction = INLIER**2 * off.size * robust_loss(off @ known @ off / (INLIER**2 * off.size))
    loss = float(unlike[anchors.mapped].sum() + of_direction + x[3:] @ upright @ x[3:])
    return _Fit(x, information, weight, residual, variance, jacobian, loss)


def _covariance(anchors: HomeLandmarks, fit: _Fit) -> np.ndarray:
    """Return the covariance (3, 3) of a pose.

    One step of the fit without each window of directions shows the correlated errors of landmarks
    on one object. Errors of the map's distances, mostly common to all landmarks, are a scale error
    of the distance from home.
    """
    left_out = ~leave_windows_out(anchors.home, np.ones(len(anchors), bool))
    weight, jacobian = fit.weight, fit.jacobian
    rest = fit.information - np.einsum("wn,n,ni,nj->wij", left_out, weight, jacobian, jacobian)
    slope = -np.einsum("wn,n,ni->wi", left_out, weight * fit.residual, jacobian)
    regular = np.linalg.cond(rest) < 1e10  # else the rest does not determine a pose
    change = np.linalg.solve(rest[regular], slope[regular, :, None])[:, :, 0]
    share = anchors.distance_sigma / np.maximum(anchors.distance, MIN_DISTANCE)
    scale = float(np.median(share[anchors.mapped]))
    out = scale * np.array([fit.x[0], fit.x[1], 0.0])
    together = change.T @ change / WINDOW
    return np.asarray((np.linalg.inv(fit.information) + together)[:3, :3] + np.outer(out, out))


def _direction(seen: Direction, distance: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the map, (2, 5), from `_Fit.x` to (offset from the line from home [m], heading).

    And the information, (2, 2), of these.
    """
    across = np.zeros((2, 5))
    across[0, :2], across[1, 2] = (-np.sin(seen.theta), np.cos(seen.theta)), 1.0
    lever = np.diag([distance, 1.0])
    return across, np.linalg.inv(lever @ seen.covariance @ lever)


def _begin(anchors: HomeLandmarks, seen: Direction) -> np.ndarray:
    """Return the best of some positions in a direction from home, as in `_Fit.x`.

    They extend to twice the median distance of the landmarks.
    """
    R = np.linspace(0.0, 2.0 * float(np.median(anchors.distance)), 60)
    places = np.zeros((R.size, 5))
    places[:, 0], places[:, 1] = R * np.cos(seen.theta), R * np.sin(seen.theta)
    places[:, 2] = seen.alpha
    residual, variance, _ = _sighted(anchors, places)
    costs = np.minimum(residual**2 / (variance + BLUR**2), INLIER**2).sum(axis=1)
    return np.asarray(places[np.argmin(costs)])


def predict_bearings(
    anchors: HomeLandmarks, x: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return residuals (n,) [rad], derivatives (n, 5) and variances (n,) of bearings from `x`.

    Residuals are measured minus predicted; derivatives are those of the predicted bearings.
    """
    residual, variance, per_metre = (a[0] for a in _sighted(anchors, x[None]))
    jacobian = np.column_stack([per_metre, -np.ones(len(anchors)), -anchors.lean])
    return residual, jacobian, variance


def _sighted(
    anchors: HomeLandmarks, places: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return residuals (m, n) [rad] of bearings from positions (m, 5), and their variances.

    And the derivatives of the predicted bearings by the position, (m, n, 2) [rad/m].
    """
    ray = np.column_stack([np.cos(anchors.home), np.sin(anchors.home)])
    dx, dy = np.moveaxis(anchors.distance[:, None] * ray - places[:, None, :2], -1, 0)
    square = np.maximum(dx**2 + dy**2, MIN_DISTANCE**2)
    level = anchors.now + places[:, 2:3] + places[:, 3:] @ anchors.lean.T
    residual = wrap(level - np.arctan2(dy, dx))
    by_distance = (dx * ray[:, 1] - dy * ray[:, 0]) / square
    variance = anchors.sigma**2 + (by_distance * anchors.distance_sigma) ** 2
    return np.asarray(residual), variance, np.stack([dy / square, -dx / square], axis=-1)
