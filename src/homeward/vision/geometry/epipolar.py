"""Epipolar geometry of two panoramas: motion, tilt, Sampson residuals, cheirality.

Seen from the home camera, the other one is in direction `theta`, `rise` above the horizon, rotated
by `alpha`, and tilted by `roll` and `pitch`. Its distance is not observable. A point in direction
x1 at home and x2 now (unit vectors) satisfies t . (x1 x R x2) = 0.

An unknown tilt shifts all bearings of one panorama in proportion to the tangent of their elevation,
with opposite signs ahead and behind. But home's panorama defines level: relative to a camera with
the tilt of home's, bearings are those of a planar scene, projected along home's vertical.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from homeward import core
from homeward.drives.cameras.camera import tilt_matrix, unit_vectors
from homeward.geometry.se2 import rotation


class Motion(NamedTuple):
    """Relative pose of the other camera, without the distance."""

    theta: float
    """Its direction seen from home [rad]."""
    alpha: float
    """Its heading in the home frame [rad]."""
    roll: float = 0.0
    """Its tilt relative to the home camera [rad]."""
    pitch: float = 0.0
    """[rad]"""
    rise: float = 0.0
    """Its elevation seen from home [rad]."""


WIDTH = 8
"""Number of matches that compiled code processes at once."""


@dataclass(frozen=True)
class Pairs:
    """n matches as pairs of directions, with quantities derived from each."""

    table: np.ndarray
    """(n, 21): the columns are those of the properties."""

    @classmethod
    def of(
        cls, home: np.ndarray, now: np.ndarray, covariance: np.ndarray, growth: np.ndarray
    ) -> Pairs:
        """Return pairs of directions at home and now, azimuth and elevation (n, 2) [rad].

        Their covariance now is (n, 2, 2) [rad^2]; those at home are exact: they define the points.
        For `growth` see the property.
        """
        first, both, second = covariance.reshape(-1, 4).T[[0, 1, 3]]
        largest = np.sqrt((first + second) / 2 + np.hypot((first - second) / 2, both))
        at_home = unit_vectors(*home.T), home
        at_now = unit_vectors(*now.T), *tangents(*now.T), now
        return cls(np.column_stack([*at_home, *at_now, first, both, second, largest, growth]))

    def __len__(self) -> int:
        return len(self.table)

    @property
    def home_vectors(self) -> np.ndarray:
        """Unit vectors at home, (n, 3)."""
        return self.table[:, :3]

    @property
    def home(self) -> np.ndarray:
        """Azimuth and elevation at home, (n, 2) [rad]."""
        return self.table[:, 3:5]

    @property
    def now_vectors(self) -> np.ndarray:
        """Unit vectors now, (n, 3)."""
        return self.table[:, 5:8]

    @property
    def now_tangents(self) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of `now_vectors` by azimuth and elevation, (n, 3) each."""
        return self.table[:, 8:11], self.table[:, 11:14]

    @property
    def now(self) -> np.ndarray:
        """Azimuth and elevation now, (n, 2) [rad]."""
        return self.table[:, 14:16]

    @property
    def covariance(self) -> np.ndarray:
        """Variance of the azimuth now, covariance, variance of the elevation: (n, 3) [rad^2]."""
        return self.table[:, 16:19]

    @property
    def sigma(self) -> np.ndarray:
        """Standard deviation of the azimuth now, (n,) [rad]."""
        return np.asarray(np.sqrt(self.table[:, 16]))

    @property
    def largest_sigma(self) -> np.ndarray:
        """Largest standard deviation of a direction now, (n,) [rad]."""
        return self.table[:, 19]

    @property
    def growth(self) -> np.ndarray:
        """Logarithm of the feature's size now over that at home, (n,)."""
        return self.table[:, 20]

    @cached_property
    def columns(self) -> np.ndarray:
        """The table for compiled code, (21, n or more), zero-padded to a multiple of `WIDTH`."""
        columns = np.zeros((self.table.shape[1], -(-len(self) // WIDTH) * WIDTH))
        columns[:, : len(self)] = self.table.T
        return columns

    def __getitem__(self, rows: np.ndarray) -> Pairs:
        return Pairs(self.table[rows])

    def __add__(self, other: Pairs) -> Pairs:
        """Return these pairs and others after them."""
        return Pairs(np.concatenate([self.table, other.table]))

    def mixed(self, home: np.ndarray, now: np.ndarray) -> Pairs:
        """Return the directions at home of some rows, (k,), paired with those now of others."""
        return Pairs(np.hstack([self.table[home, :5], self.table[now, 5:]]))


def tangents(azimuth: np.ndarray, elevation: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the derivatives of unit vectors, (n, 3), by azimuth and by elevation."""
    ca, sa, ce, se = np.cos(azimuth), np.sin(azimuth), np.cos(elevation), np.sin(elevation)
    return (
        np.stack([-ce * sa, ce * ca, np.zeros_like(ce)], axis=-1),
        np.stack([-se * ca, -se * sa, ce], axis=-1),
    )


_Vectors = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Separate components: arrays of three along their last axis take twice the time."""


class Residuals(NamedTuple):
    """Epipolar residuals of pairs for several motions, in standard deviations."""

    value: np.ndarray
    """(m, n)"""
    jacobian: np.ndarray
    """(m, n, 5), with respect to `Motion`."""
    possible: np.ndarray
    """(m, n) bool: whether, within errors, the rays meet ahead of both cameras (cheirality), at
    distances in the ratio of the features' sizes, and at less than `MAX_PARALLAX`."""


INLIER = 3.0
"""Maximum error of an inlier [standard deviations]: of a residual, a ray that misses the other one,
a landmark in a resection. It is also the scale of robust losses."""
MAX_PARALLAX = np.radians(60.0)
"""Maximum parallax of a point [rad]: beyond, nothing looks the same."""
MAX_GROWTH_ERROR = 0.5
"""Maximum error of the logarithm of a feature's growth: three times the one measured (0.16)."""
LIMITS = np.array([INLIER, np.cos(MAX_PARALLAX), MAX_GROWTH_ERROR])
"""For compiled code."""


def residuals(motions: np.ndarray, pairs: Pairs, looseness: float = 0.0) -> Residuals:
    """Return Sampson's epipolar residual of each pair over its standard deviation.

    Rows of the motions, (m, 5), are in the order of `Motion`; `looseness` is an additional error of
    each direction now [rad].
    """
    if core.compiled is not None:
        shape = len(motions), pairs.columns.shape[1]
        value, jacobian, possible = np.empty(shape), np.empty((5, *shape)), np.empty(shape, bool)
        given = (np.array(motions, float, order="C"), pairs.columns, looseness, LIMITS)
        core.compiled.residuals(*given, value, jacobian, possible)
        n = len(pairs)
        return Residuals(value[:, :n], np.moveaxis(jacobian[..., :n], 0, -1), possible[:, :n])
    theta, alpha, roll, pitch, rise = motions.T[..., None]
    t, t_theta, t_rise = _direction(theta, rise)
    x1, x2 = _parts(pairs.home_vectors), _parts(pairs.now_vectors)
    leaned, by_roll, by_pitch = _leaned(x2, roll, pitch)
    y, y_roll, y_pitch = (_about_z(alpha, v) for v in (leaned, by_roll, by_pitch))
    normal, lever = _cross(x1, y), _cross(t, x1)
    deviation = _deviation(alpha, lever, pairs, looseness)
    jacobian = np.empty((*deviation.shape, 5))
    jacobian[..., 0] = _dot(normal, t_theta)
    jacobian[..., 1] = lever[1] * y[0] - lever[0] * y[1]
    jacobian[..., 2] = _dot(lever, y_roll)
    jacobian[..., 3] = _dot(lever, y_pitch)
    jacobian[..., 4] = _dot(normal, t_rise)
    jacobian /= deviation[..., None]
    sigma = np.hypot(pairs.largest_sigma, looseness)
    possible = _possible(t, x1, y, normal, pairs.growth, sigma)
    return Residuals(_dot(normal, t) / deviation, jacobian, possible)


def derivative_noise(motion: Motion, pairs: Pairs) -> tuple[np.ndarray, np.ndarray]:
    """Return the variances, (n,), of the normalised derivatives by theta and rise from noise alone.

    Without parallax, noise looks like it.
    """
    theta, alpha, _, _, rise = np.array(motion)[:, None, None]
    # Three motions along t and its derivatives.
    ways = np.array([np.broadcast_arrays(*way) for way in _direction(theta, rise)])[..., 0]
    x, y, z = ways.swapaxes(0, 1)
    own, by_theta, by_rise = _deviation(alpha, _cross((x, y, z), _parts(pairs.home_vectors)), pairs)
    return (by_theta / own) ** 2 + 1e-12, (by_rise / own) ** 2 + 1e-12


def _deviation(
    alpha: np.ndarray, lever: _Vectors, pairs: Pairs, looseness: float = 0.0
) -> np.ndarray:
    """Return the standard deviation, (m, n), of t . (x1 x y), given `lever`, t x x1."""
    # The gradient by x2, before rotation and tilt, which preserve its length. The effect of the
    # tilt on the directions of azimuth and elevation is negligible.
    gradient = _about_z(-alpha, lever)
    across, up = (_dot(gradient, _parts(tangent)) for tangent in pairs.now_tangents)
    first, both, second = pairs.covariance.T
    loose = looseness**2
    variance = (first + loose) * across**2 + 2 * both * across * up + (second + loose) * up**2
    return np.asarray(np.sqrt(np.maximum(variance, 1e-18)))


def _parts(vectors: np.ndarray) -> _Vectors:
    """Return the components of vectors, (n, 3), each (n,) and contiguous."""
    x, y, z = np.ascontiguousarray(vectors.T)
    return x, y, z


def _cross(a: _Vectors, b: _Vectors) -> _Vectors:
    (ax, ay, az), (bx, by, bz) = a, b
    return ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx


def _dot(a: _Vectors, b: _Vectors) -> np.ndarray:
    return np.asarray(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


def _direction(theta: np.ndarray, rise: np.ndarray) -> tuple[_Vectors, _Vectors, _Vectors]:
    """Return t, its components (m, 1), and its derivatives with respect to theta and rise."""
    c, s, cr, sr = np.cos(theta), np.sin(theta), np.cos(rise), np.sin(rise)
    none = np.zeros_like(theta)
    return (c * cr, s * cr, sr), (-s * cr, c * cr, none), (-c * sr, -s * sr, cr)


def _leaned(
    x: _Vectors, roll: np.ndarray, pitch: np.ndarray
) -> tuple[_Vectors, _Vectors, _Vectors]:
    """Return Ry(pitch) Rx(roll) x, components (m, n), and its derivatives by roll and pitch."""
    cr, sr, cp, sp = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch)
    along, y, z = x
    rolled_y, rolled_z = cr * y - sr * z, sr * y + cr * z
    leaned = (cp * along + sp * rolled_z, rolled_y, cp * rolled_z - sp * along)
    by_roll = (sp * rolled_y, -rolled_z, cp * rolled_y)
    return leaned, by_roll, (leaned[2], np.zeros_like(rolled_y), -leaned[0])


def _about_z(angle: np.ndarray, x: _Vectors) -> _Vectors:
    """Return vectors rotated about z by (m, 1) angles [rad]."""
    c, s = np.cos(angle), np.sin(angle)
    return c * x[0] - s * x[1], s * x[0] + c * x[1], x[2]


def _possible(
    t: _Vectors,
    x1: _Vectors,
    y: _Vectors,
    normal: _Vectors,
    growth: np.ndarray,
    sigma: np.ndarray,
) -> np.ndarray:
    """Return whether both rays can show the same point, (m, n) bool.

    Both distances along them are positive and in the ratio of the sizes, and the angle between them
    is at most `MAX_PARALLAX`. With l1 x1 - l2 y = t: l1 |n|^2 = (t x y) . n and l2 |n|^2 =
    (t x x1) . n, n = x1 x y. This detects wrong matches along the epipolar line.
    """
    good, far, doubt = _dot(x1, y) > np.cos(MAX_PARALLAX), [], 0.0
    for ray in (y, x1):
        arm = _cross(t, ray)
        distance = _dot(arm, normal)
        error = INLIER * sigma * np.sqrt(_dot(arm, arm))
        good &= distance >= -error
        far.append(np.maximum(distance, 1e-12))
        doubt = doubt + error / far[-1]
    ratio = np.log(far[0] / far[1])
    return np.asarray(good & (np.abs(ratio - growth) <= MAX_GROWTH_ERROR + doubt))


@dataclass(frozen=True)
class Tilt:
    """Tilt of a camera relative to home's."""

    rotation: np.ndarray
    """(3, 3), from the camera's frame to one with the same heading and home's tilt."""
    covariance: np.ndarray
    """(2, 2), of roll and pitch [rad^2]."""

    @classmethod
    def of(cls, motion: Motion, covariance: np.ndarray) -> Tilt:
        """Return the tilt of a motion relative to home."""
        return cls(tilt_matrix(motion.roll, motion.pitch), covariance)

    def then(self, motion: Motion, covariance: np.ndarray) -> Tilt:
        """Return the tilt of a picture from its motion relative to a picture of this tilt."""
        turn = rotation(motion.alpha)
        whole = self.rotation @ turn @ tilt_matrix(motion.roll, motion.pitch)
        back = rotation(-math.atan2(whole[1, 0], whole[0, 0]))
        ours = turn[:2, :2].T @ self.covariance @ turn[:2, :2]
        return Tilt(back @ whole, ours + covariance)

    def level(self, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return bearings (n,) [rad] as of a camera with home's tilt, and their derivatives.

        `directions` (n, 2) are azimuth and elevation in the tilted camera's frame [rad]. The
        derivatives (n, 2) are those by an additional roll and pitch [1].
        """
        x, y, z = self.rotation @ unit_vectors(*directions.T).T
        out = np.maximum(np.hypot(x, y), 0.05)  # azimuth is undefined at the vertical
        return np.arctan2(y, x), -np.column_stack([x, y]) * (z / out**2)[:, None]

    def variance(self, lean: np.ndarray) -> np.ndarray:
        """Return the variances of bearings, (n,), from the uncertainty of the tilt."""
        return np.asarray(np.einsum("ni,ij,nj->n", lean, self.covariance, lean))


AS_HOME = Tilt(np.eye(3), np.zeros((2, 2)))
"""Tilt of home's picture itself."""
