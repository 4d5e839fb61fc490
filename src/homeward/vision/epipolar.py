"""Two panoramas of one place: what their geometry says of a pair of directions.

The robot stands at home, and again somewhere else. Seen from the home camera, the other one lies in
direction `theta` and `rise` above the horizon, is turned by `alpha`, and tilted by `roll` and
`pitch` against it. How far away it is, two panoramas cannot tell. A point in direction x1 at home
and x2 now (unit vectors) satisfies t . (x1 x R x2) = 0.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from homeward.vision.camera import unit_vectors


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

    @cached_property
    def home_vectors(self) -> np.ndarray:
        """Unit vectors at home, (n, 3)."""
        return unit_vectors(*self.home.T)

    @cached_property
    def now_vectors(self) -> np.ndarray:
        """Unit vectors now, (n, 3)."""
        return unit_vectors(*self.now.T)

    @cached_property
    def home_tangents(self) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of `home_vectors` by azimuth and elevation."""
        return tangents(*self.home.T)

    @cached_property
    def now_tangents(self) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of `now_vectors` by azimuth and elevation."""
        return tangents(*self.now.T)

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


def tangents(azimuth: np.ndarray, elevation: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the derivatives of unit vectors, (n, 3), by azimuth and by elevation."""
    ca, sa, ce, se = np.cos(azimuth), np.sin(azimuth), np.cos(elevation), np.sin(elevation)
    return (
        np.stack([-ce * sa, ce * ca, np.zeros_like(ce)], axis=-1),
        np.stack([-se * ca, -se * sa, ce], axis=-1),
    )


class Residuals(NamedTuple):
    """How far pairs are from each of several motions, in standard deviations."""

    value: np.ndarray
    """(m, n)"""
    jacobian: np.ndarray
    """(m, n, 5), with respect to `Motion`."""
    possible: np.ndarray
    """(m, n) bool: the rays meet ahead of both cameras, and as far away as the features' sizes
    say, as far as errors allow to tell."""


IN_FRONT_SIGMAS = 3.0
GROWTH = 0.5
"""How far the logarithm of a feature's growth may be off: three times what was found (0.16)."""


def residuals(motions: np.ndarray, pairs: Pairs) -> Residuals:
    """Return the epipolar residual of each pair over its standard deviation (Sampson's).

    Parameters
    ----------
    motions : ndarray, shape (m, 5)
        Rows in the order of `Motion`.
    pairs : Pairs
        n matches.
    """
    theta, alpha, roll, pitch, rise = np.atleast_2d(motions).T
    t, t_theta, t_rise = _direction(theta, rise)
    x1, x2 = pairs.home_vectors, pairs.now_vectors
    leaned, by_roll, by_pitch = _leaned(x2, roll, pitch)
    y, y_roll, y_pitch = (_about_z(alpha, v) for v in (leaned, by_roll, by_pitch))
    normal, lever = cross(x1, y), cross(t, x1)
    jacobian = np.stack(
        [
            dot(normal, t_theta),
            lever[..., 1] * y[..., 0] - lever[..., 0] * y[..., 1],
            dot(lever, y_roll),
            dot(lever, y_pitch),
            dot(normal, t_rise),
        ],
        axis=-1,
    )
    deviation = _deviation(t, alpha, y, pairs)
    possible = _possible(t, x1, y, normal, pairs)
    return Residuals(dot(normal, t) / deviation, jacobian / deviation[..., None], possible)


def derivative_noise(motion: Motion, pairs: Pairs) -> tuple[np.ndarray, np.ndarray]:
    """Return the variance, (n,), that noise alone gives the normalised derivatives.

    Those by theta and by rise: where there is no parallax, noise looks like it.
    """
    theta, alpha, roll, pitch, rise = np.array([motion]).T
    t, t_theta, t_rise = _direction(theta, rise)
    y = _about_z(alpha, _leaned(pairs.now_vectors, roll, pitch)[0])
    own = _deviation(t, alpha, y, pairs)[0]
    by_theta, by_rise = (_deviation(way, alpha, y, pairs)[0] for way in (t_theta, t_rise))
    return (by_theta / own) ** 2 + 1e-12, (by_rise / own) ** 2 + 1e-12


def _deviation(t: np.ndarray, alpha: np.ndarray, y: np.ndarray, pairs: Pairs) -> np.ndarray:
    """Return the standard deviation, (m, n), of t . (x1 x y) for motions with t (m, 1, 3)."""
    home_slope = _slope(cross(y, t), pairs.home_tangents)
    # The gradient by x2, before the turn and the tilt: both leave its length as it is, and what
    # the tilt does to the directions of azimuth and elevation is of no account.
    lever = cross(t, pairs.home_vectors)
    now_slope = _slope(_about_z(-alpha, lever), pairs.now_tangents)
    deviation = np.hypot(pairs.home_sigma * home_slope, pairs.now_sigma * now_slope)
    return np.asarray(np.maximum(deviation, 1e-9))


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the vector product along the last axis; NumPy's own takes several times as long."""
    ax, ay, az = a[..., 0], a[..., 1], a[..., 2]
    bx, by, bz = b[..., 0], b[..., 1], b[..., 2]
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=-1)


def dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the scalar product along the last axis."""
    return np.asarray((a * b).sum(axis=-1))


def _direction(theta: np.ndarray, rise: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return t, (m, 1, 3), and its derivatives with respect to theta and rise."""
    c, s, cr, sr = np.cos(theta), np.sin(theta), np.cos(rise), np.sin(rise)
    none = np.zeros_like(theta)
    ways = ((c * cr, s * cr, sr), (-s * cr, c * cr, none), (-c * sr, -s * sr, cr))
    t, t_theta, t_rise = (np.stack(way, axis=-1)[:, None, :] for way in ways)
    return t, t_theta, t_rise


def _leaned(
    x: np.ndarray, roll: np.ndarray, pitch: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return Ry(pitch) Rx(roll) x, (m, n, 3), and its derivatives by roll and pitch."""
    cr, sr, cp, sp = (f(a)[:, None] for a in (roll, pitch) for f in (np.cos, np.sin))
    x, y, z = x[:, 0], x[:, 1], x[:, 2]
    rolled_y, rolled_z = cr * y - sr * z, sr * y + cr * z
    leaned = (cp * x + sp * rolled_z, rolled_y, cp * rolled_z - sp * x)
    by_roll = (sp * rolled_y, -rolled_z, cp * rolled_y)
    by_pitch = (leaned[2], np.zeros_like(leaned[2]), -leaned[0])
    a, b, c = (np.stack(np.broadcast_arrays(*v), axis=-1) for v in (leaned, by_roll, by_pitch))
    return a, b, c


def _about_z(angle: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return vectors, (m, n, 3), turned about z by (m,) angles [rad]."""
    c, s = np.cos(angle)[:, None], np.sin(angle)[:, None]
    x, y, z = x[..., 0], x[..., 1], x[..., 2]
    return np.stack([c * x - s * y, s * x + c * y, z], axis=-1)


def _slope(gradient: np.ndarray, tangents: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """Return the length of a gradient by (azimuth, elevation), from that by the unit vector."""
    by_azimuth, by_elevation = tangents
    return np.asarray(np.hypot(dot(gradient, by_azimuth), dot(gradient, by_elevation)))


def _possible(
    t: np.ndarray, x1: np.ndarray, y: np.ndarray, normal: np.ndarray, pairs: Pairs
) -> np.ndarray:
    """Whether both distances along the rays are positive, and in the ratio of the sizes.

    With l1 x1 - l2 y = t: l1 |n|^2 = (t x y) . n and l2 |n|^2 = (t x x1) . n, n = x1 x y. This is
    what tells a wrong match along the epipolar line from a right one.
    """
    slack = IN_FRONT_SIGMAS * np.hypot(pairs.home_sigma, pairs.now_sigma)
    good, far, doubt = np.ones(y.shape[:-1], bool), [], np.zeros(y.shape[:-1])
    for ray in (y, x1):
        arm = cross(t, ray)
        distance = dot(arm, normal)
        error = slack * np.sqrt(dot(arm, arm))
        good &= distance >= -error
        far.append(np.maximum(distance, 1e-12))
        doubt += error / far[-1]
    ratio = np.log(far[0] / far[1])
    return np.asarray(good & (np.abs(ratio - pairs.growth) <= GROWTH + doubt))
