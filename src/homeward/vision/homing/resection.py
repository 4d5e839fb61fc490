"""Resection from home's landmarks: each lies on the ray along which home saw it.

Its distance is the map's, or a guess. Near home these distances cancel, and so do the map's errors,
which they do not in a pose within the map. The unknown tilt is common to all bearings: two unknowns
beside the pose.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from homeward.drives.drive import Columns
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose
from homeward.geometry.robust import robust_loss, robust_weight
from homeward.vision.cameras.panoramic import WINDOW
from homeward.vision.geometry.epipolar import INLIER
from homeward.vision.geometry.jackknife import leave_windows_out

BLUR = 0.01
"""Standard deviation added to bearings while places are tried [rad]."""
NEAR_HOME = 0.3
"""A direction counts as told from this far [m] where home is nearer: there, its error is larger
than its covariance says."""
LEAST_NEAR = 0.05
"""Least distance of a landmark from the camera [m]."""


@dataclass(frozen=True)
class HomeLandmarks(Columns):
    """Landmarks of home that are seen now. All arrays have n rows."""

    home: np.ndarray
    """Bearing from home [rad]."""
    now: np.ndarray
    """Bearing from here [rad]."""
    sigma: np.ndarray
    """Of the difference of the two [rad]."""
    distance: np.ndarray
    """From home [m]."""
    distance_sigma: np.ndarray
    """[m]"""
    mapped: np.ndarray
    """bool, whether the distance is the map's, as that of one is at least; else it is a guess."""
    lean: np.ndarray
    """(n, 2): how the bearings from here change with roll and pitch of the camera [1]."""

    def __len__(self) -> int:
        return self.home.size


@dataclass(frozen=True)
class Direction:
    """Direction and heading of the second of two panoramas, by these alone."""

    theta: float
    """Direction from home [rad]."""
    alpha: float
    """Heading [rad]."""
    covariance: np.ndarray
    """(2, 2), of both."""


@dataclass(frozen=True)
class Resection:
    """Where the camera is, in the frame of home's."""

    pose: Pose
    covariance: np.ndarray
    """(3, 3), of x [m], y [m], heading [rad]."""
    agrees: np.ndarray
    """(n,) bool, which landmarks are inliers."""


def resect(anchors: HomeLandmarks, seen: Direction, tilt: np.ndarray) -> Resection | None:
    """Fit a pose to home's landmarks, and to the direction that the two panoramas tell.

    The direction counts where the map is poor; near home it fades by its own covariance.

    Parameters
    ----------
    anchors : HomeLandmarks
        The landmarks.
    seen : Direction
        By the two panoramas alone.
    tilt : ndarray, shape (2, 2)
        Covariance of what is left of the camera's roll and pitch [rad^2].

    Returns
    -------
    Resection or None
        None where they do not fix a pose.
    """
    if len(anchors) < 3:
        return None
    # Guessed distances are worth little afar, much near home: what they hold there, they hold fast.
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
    """(5,): x [m], y [m], heading, and what is left of roll and pitch [rad]."""
    information: np.ndarray
    """(5, 5)"""
    weight: np.ndarray
    """(n,): of each landmark [rad^-2]."""
    residual: np.ndarray
    """(n,): of its bearing [rad]."""
    variance: np.ndarray
    """(n,): of that [rad^2]."""
    jacobian: np.ndarray
    """(n, 5): of the bearing."""
    loss: float
    """How unlikely the bearings of mapped landmarks are, the tilt, and what the two pictures alone
    tell: of a distance that is guessed nobody knows how likely it is."""


def _fit(
    anchors: HomeLandmarks, seen: Direction, upright: np.ndarray, x: np.ndarray
) -> _Fit | None:
    """Fit a pose that begins at `x`, (5,); None where the landmarks do not fix one.

    `upright`, (2, 2), is the information that no roll or pitch is left.
    """
    across, known = _direction(seen, max(float(np.hypot(*x[:2])), NEAR_HOME))
    for _ in range(10):
        residual, jacobian, variance = predict_bearings(anchors, x)
        off = np.array([0.0, wrap(seen.alpha - x[2])]) - np.array([across[0] @ x, 0.0])
        weight = robust_weight(residual**2 / (INLIER**2 * variance)) / variance
        told = robust_weight(off @ known @ off / (INLIER**2 * off.size)) * across.T @ known
        information = (jacobian.T * weight) @ jacobian + told @ across
        information[3:, 3:] += upright
        slope = (jacobian.T * weight) @ residual + told @ off
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

    What leaving out any one direction would change, one step of the fit, says how far landmarks of
    one thing err together. Errors of the map's distances, mostly alike for all landmarks, are one
    factor of the distance from home.
    """
    left_out = ~leave_windows_out(anchors.home, np.ones(len(anchors), bool))
    weight, jacobian = fit.weight, fit.jacobian
    rest = fit.information - np.einsum("wn,n,ni,nj->wij", left_out, weight, jacobian, jacobian)
    slope = -np.einsum("wn,n,ni->wi", left_out, weight * fit.residual, jacobian)
    regular = np.linalg.cond(rest) < 1e10  # else the rest fixes no pose
    change = np.linalg.solve(rest[regular], slope[regular, :, None])[:, :, 0]
    share = anchors.distance_sigma / np.maximum(anchors.distance, LEAST_NEAR)
    scale = float(np.median(share[anchors.mapped]))
    out = scale * np.array([fit.x[0], fit.x[1], 0.0])
    together = change.T @ change / WINDOW
    return np.asarray((np.linalg.inv(fit.information) + together)[:3, :3] + np.outer(out, out))


def _direction(seen: Direction, distance: float) -> tuple[np.ndarray, np.ndarray]:
    """Return, (2, 5), what takes `_Fit.x` to (off the line from home [m], heading).

    And the information, (2, 2), of these.
    """
    across = np.zeros((2, 5))
    across[0, :2], across[1, 2] = (-np.sin(seen.theta), np.cos(seen.theta)), 1.0
    lever = np.diag([distance, 1.0])
    return across, np.linalg.inv(lever @ seen.covariance @ lever)


def _begin(anchors: HomeLandmarks, seen: Direction) -> np.ndarray:
    """Return the best of some places in a direction from home, as of `_Fit.x`.

    They go as far as twice the median distance of the landmarks.
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
    """Return residuals (m, n) [rad] of bearings from places (m, 5), and their variances.

    And the derivatives of the predicted bearings by the place, (m, n, 2) [rad/m].
    """
    ray = np.column_stack([np.cos(anchors.home), np.sin(anchors.home)])
    dx, dy = np.moveaxis(anchors.distance[:, None] * ray - places[:, None, :2], -1, 0)
    square = np.maximum(dx**2 + dy**2, LEAST_NEAR**2)
    level = anchors.now + places[:, 2:3] + places[:, 3:] @ anchors.lean.T
    residual = wrap(level - np.arctan2(dy, dx))
    by_distance = (dx * ray[:, 1] - dy * ray[:, 0]) / square
    variance = anchors.sigma**2 + (by_distance * anchors.distance_sigma) ** 2
    return np.asarray(residual), variance, np.stack([dy / square, -dx / square], axis=-1)
