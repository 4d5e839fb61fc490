"""Two panoramas of one place: what their geometry says of a pair of directions.

The robot stands at home, and again somewhere else. Seen from the home camera, the other one lies in
direction `theta` and `rise` above the horizon, is turned by `alpha`, and tilted by `roll` and
`pitch` against it. How far away it is, two panoramas cannot tell. A point in direction x1 at home
and x2 now (unit vectors) satisfies t . (x1 x R x2) = 0.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from homeward.vision.camera import tilt_matrix, unit_vectors


class Motion(NamedTuple):
    """Where the other camera is, but for the distance."""

    theta: float
    """Its direction seen from home [rad]."""
    alpha: float
    """Its heading in the home frame [rad]."""
    roll: float = 0.0
    """Its tilt against the home camera [rad]."""
    pitch: float = 0.0
    """[rad]"""
    rise: float = 0.0
    """Its elevation seen from home [rad]."""


@dataclass(frozen=True)
class Pairs:
    """Matched directions, n of them."""

    home: np.ndarray
    """(n, 2): azimuth and elevation at home [rad]."""
    now: np.ndarray
    """(n, 2): azimuth and elevation now [rad]."""
    home_sigma: np.ndarray
    """(n,): standard deviation of either angle [rad]."""
    now_sigma: np.ndarray
    """(n,): [rad]"""
    growth: np.ndarray
    """(n,): logarithm of how much larger the feature looks now than at home."""

    def __len__(self) -> int:
        return len(self.home)

    def __getitem__(self, rows: np.ndarray) -> Pairs:
        return Pairs(
            self.home[rows],
            self.now[rows],
            self.home_sigma[rows],
            self.now_sigma[rows],
            self.growth[rows],
        )

    def loosened(self, sigma: float) -> Pairs:
        """Return the same pairs with a further error of `sigma` [rad] at either end."""
        return replace(
            self,
            home_sigma=np.hypot(self.home_sigma, sigma),
            now_sigma=np.hypot(self.now_sigma, sigma),
        )


class Residuals(NamedTuple):
    """How far pairs are from a motion, in standard deviations."""

    value: np.ndarray
    """(n,)"""
    jacobian: np.ndarray
    """(n, 5), with respect to `Motion`."""
    possible: np.ndarray
    """(n,) bool: the rays meet ahead of both cameras, and as far away as the features' sizes say,
    as far as errors allow to tell."""


IN_FRONT_SIGMAS = 3.0
GROWTH = 0.5
"""How far the logarithm of a feature's growth may be off: three times what was found (0.16)."""


def residuals(motion: Motion, pairs: Pairs) -> Residuals:
    """Return the epipolar residual of each pair over its standard deviation (Sampson's)."""
    t, t_theta, t_rise = _direction(motion.theta, motion.rise)
    turn, d_roll, d_pitch = _rotation(motion)
    x1, x2 = (unit_vectors(*side.T) for side in (pairs.home, pairs.now))
    y = x2 @ turn.T
    normal = cross(x1, y)
    lever = cross(t, x1)
    y_alpha = np.stack([-y[:, 1], y[:, 0], np.zeros(len(y))], axis=1)
    jacobian = np.stack(
        [
            normal @ t_theta,
            np.sum(lever * y_alpha, axis=1),
            np.sum(lever * (x2 @ d_roll.T), axis=1),
            np.sum(lever * (x2 @ d_pitch.T), axis=1),
            normal @ t_rise,
        ],
        axis=1,
    )
    home_slope = _slope(cross(y, t), pairs.home)
    now_slope = _slope(lever @ turn, pairs.now)
    deviation = np.sqrt((pairs.home_sigma * home_slope) ** 2 + (pairs.now_sigma * now_slope) ** 2)
    deviation = np.maximum(deviation, 1e-9)
    return Residuals(
        (normal @ t) / deviation, jacobian / deviation[:, None], _possible(t, x1, y, normal, pairs)
    )


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the vector product along the last axis; NumPy's own takes several times as long."""
    ax, ay, az = a[..., 0], a[..., 1], a[..., 2]
    bx, by, bz = b[..., 0], b[..., 1], b[..., 2]
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=-1)


def parallax(motion: Motion, pairs: Pairs) -> np.ndarray:
    """Return the angle between the two rays of each pair in one frame [rad], shape (n,)."""
    turn, _, _ = _rotation(motion)
    x1, y = unit_vectors(*pairs.home.T), unit_vectors(*pairs.now.T) @ turn.T
    away, along = np.linalg.norm(cross(x1, y), axis=1), np.sum(x1 * y, axis=1)
    return np.asarray(np.arctan2(away, along))


def _direction(theta: float, rise: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return t and its derivatives with respect to theta and rise."""
    c, s, cr, sr = np.cos(theta), np.sin(theta), np.cos(rise), np.sin(rise)
    return (
        np.array([c * cr, s * cr, sr]),
        np.array([-s * cr, c * cr, 0.0]),
        np.array([-c * sr, -s * sr, cr]),
    )


def _rotation(motion: Motion) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return R = Rz(alpha) Ry(pitch) Rx(roll) and its derivatives by roll and pitch."""
    c, s = np.cos(motion.alpha), np.sin(motion.alpha)
    about_z = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    generator_x = np.array([[0.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    generator_y = np.array([[0.0, 0, 1], [0, 0, 0], [-1, 0, 0]])
    turn = about_z @ tilt_matrix(motion.roll, motion.pitch)
    about_y = tilt_matrix(0.0, motion.pitch)
    about_x = tilt_matrix(motion.roll, 0.0)
    return turn, turn @ generator_x, about_z @ about_y @ generator_y @ about_x


def _slope(gradient: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """Return the length of a gradient by (azimuth, elevation), from that by the unit vector."""
    (a, e), (gx, gy, gz) = angles.T, gradient.T
    ca, sa, ce, se = np.cos(a), np.sin(a), np.cos(e), np.sin(e)
    by_azimuth = ce * (ca * gy - sa * gx)
    by_elevation = ce * gz - se * (ca * gx + sa * gy)
    return np.asarray(np.hypot(by_azimuth, by_elevation))


def _possible(
    t: np.ndarray, x1: np.ndarray, y: np.ndarray, normal: np.ndarray, pairs: Pairs
) -> np.ndarray:
    """Whether both distances along the rays are positive, and in the ratio of the sizes.

    With l1 x1 - l2 y = t: l1 |n|^2 = (t x y) . n and l2 |n|^2 = (t x x1) . n, n = x1 x y. This is
    what tells a wrong match along the epipolar line from a right one.
    """
    slack = IN_FRONT_SIGMAS * np.hypot(pairs.home_sigma, pairs.now_sigma)
    good, far, doubt = np.ones(len(x1), bool), [], np.zeros(len(x1))
    for ray in (y, x1):
        arm = cross(t, ray)
        distance = np.sum(arm * normal, axis=1)
        error = slack * np.sqrt(np.sum(arm * arm, axis=1))
        good &= distance >= -error
        far.append(np.maximum(distance, 1e-12))
        doubt += error / far[-1]
    ratio = np.log(far[0] / far[1])
    return np.asarray(good & (np.abs(ratio - pairs.growth) <= GROWTH + doubt))
