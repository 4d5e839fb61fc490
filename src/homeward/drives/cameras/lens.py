"""Cameras with a lens: pinhole with plumb_bob or rational distortion, and fisheye.

The models are those of OpenCV and ROS. With X to the right, Y down, Z ahead, x = X/Z and
y = Y/Z:

- plumb_bob and rational_polynomial (Brown and Conrady): with r2 = x^2 + y^2 and the radial factor
  (1 + k1 r2 + k2 r2^2 + k3 r2^3) / (1 + k4 r2 + k5 r2^2 + k6 r2^3), and p1, p2 tangential;
- equidistant (Kannala and Brandt, "A generic camera model and calibration method", PAMI 2006): the
  angle a from the axis is drawn at the radius a (1 + k1 a^2 + k2 a^4 + k3 a^6 + k4 a^8).

A distortion polynomial is monotonic up to some radius; beyond it pixels have no ray, and rays no
pixel.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cached_property
from typing import Annotated, Any, Literal

import numpy as np
from numpy.polynomial import Polynomial

from homeward.drives.cameras.camera import Camera, angles, tilt_matrix, unit_vectors
from homeward.drives.settings import Finite, Positive
from homeward.errors import InputError
from homeward.io.checks import Field
from homeward.io.models import model_validator

ITERATIONS = 60
"""Iterations of a bisection to double precision; Newton's method needs fewer."""
MIN_STEP = 1e-13
"""Step at which Newton's method ends [focal lengths]."""
MAX_ERROR = 1e-9
"""Maximum error of a ray in the image [focal lengths]."""
SYNONYMS = {
    "pinhole": "plumb_bob",
    "radtan": "plumb_bob",
    "rational": "rational_polynomial",
    "fisheye": "equidistant",
    "kannala_brandt": "equidistant",
}
"""Other names of the models, as in OpenCV and Kalibr."""
COEFFICIENTS = {"plumb_bob": (0, 4, 5), "rational_polynomial": (0, 8), "equidistant": (0, 4)}
"""Valid numbers of coefficients by model."""
Pixels = Annotated[int, Field(ge=1, le=100_000)]


class Lens(Camera):
    """A calibrated camera; its axis is the optical axis."""

    fx: Positive
    """Horizontal focal length [px]."""
    fy: Positive
    """Vertical focal length [px]."""
    cx: Finite
    """Column of the principal point [px]."""
    cy: Finite
    """Row of the principal point [px]."""
    model: Literal["plumb_bob", "rational_polynomial", "equidistant"] = "plumb_bob"
    distortion: tuple[Finite, ...] = ()
    """k1, k2, p1, p2, k3 (then k4, k5, k6); k1 to k4 of the equidistant model."""
    width: Pixels | None = None
    """Width of the calibrated images [px]."""
    height: Pixels | None = None
    """Height of the calibrated images [px]."""

    @model_validator(mode="before")
    @classmethod
    def _resolve_synonym(cls, tree: Any) -> Any:
        if isinstance(tree, dict) and isinstance(model := tree.get("model"), str):
            return {**tree, "model": SYNONYMS.get(model, model)}
        return tree

    @model_validator(mode="after")
    def _check(self) -> Lens:
        count, k = len(self.distortion), self.distortion
        while k and k[-1] == 0.0 and len(k) not in COEFFICIENTS[self.model]:
            k = k[:-1]
        if len(k) not in COEFFICIENTS[self.model]:
            several = " or ".join(map(str, COEFFICIENTS[self.model][1:]))
            raise ValueError(f"distortion: {self.model} has {several} coefficients, not {count}")
        for name, centre, size in (("cx", self.cx, self.width), ("cy", self.cy, self.height)):
            if size is not None and not 0 <= centre <= size:
                raise ValueError(f"{name}: {centre:g} is outside the image, 0 to {size}")
        if self._reach < 0.05:
            raise ValueError(
                "distortion: invalid beyond 3 deg from the axis; check the coefficients"
            )
        return self

    def require_shape(self, shape: tuple[int, int]) -> None:
        """Raise InputError when images of (height, width) [px] differ from the calibrated ones."""
        known = self.height or shape[0], self.width or shape[1]
        if known != shape:
            raise InputError(
                f"{shape[1]}x{shape[0]} pixels, but the camera is calibrated for "
                f"{known[1]}x{known[0]}",
                advice="calibrate it for this resolution",
            )

    def in_pixels(self, shares: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Return `column` and `row` from shares of the size of the image [px]; others stay."""
        size = {"column": self.width or 2.0 * self.cx, "row": self.height or 2.0 * self.cy}
        return {role: size[role] * v if role in size else v for role, v in shares.items()}

    def directions(
        self, columns: np.ndarray, rows: np.ndarray, shape: tuple[int, int] | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return azimuth and elevation [rad] of pixels; as `Camera.directions`."""
        x, y = (columns - self.cx) / self.fx, (rows - self.cy) / self.fy
        right, down, ahead = (self._off_axis if self.model == "equidistant" else self._straight)(
            np.asarray(x, float), np.asarray(y, float)
        )
        rays = np.stack([ahead, -right, -down], axis=-1)
        return angles(rays @ tilt_matrix(self.roll, self.pitch).T)

    def pixels(
        self, azimuth: np.ndarray, elevation: np.ndarray, shape: tuple[int, int] | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return columns and rows [px] of directions [rad]; as `Camera.pixels`."""
        rays = unit_vectors(*self._tilted(azimuth, elevation))
        ahead, right, down = rays[..., 0], -rays[..., 1], -rays[..., 2]
        aside = np.hypot(right, down)
        with np.errstate(divide="ignore", invalid="ignore"):
            if self.model == "equidistant":
                angle = np.arctan2(aside, ahead)
                scale = self._radius(angle) / np.where(aside > 0, aside, 1.0)
                x, y, seen = scale * right, scale * down, angle <= self._reach
            else:
                x, y = right / ahead, down / ahead
                seen = (ahead > 0) & (np.hypot(x, y) <= self._reach)
                (x, y), _ = self._distorted(x, y)
        return (
            np.where(seen, self.fx * x + self.cx, np.nan),
            np.where(seen, self.fy * y + self.cy, np.nan),
        )

    @cached_property
    def _k(self) -> tuple[float, ...]:
        return (*self.distortion, *(0.0,) * 8)[:8]

    @cached_property
    def _reach(self) -> float:
        """Limit of the monotonic distortion: radius [focal lengths], or angle [rad]."""
        if self.model == "equidistant":
            slope = Polynomial([1, *(np.array([3, 5, 7, 9]) * self._k[:4])])
            return min(math.pi, math.sqrt(_first_root(slope)))
        k1, k2, _, _, k3, k4, k5, k6 = self._k
        up, low = Polynomial([1, k1, k2, k3]), Polynomial([1, k4, k5, k6])
        square = Polynomial([0, 2])
        slope = up * low + square * (up.deriv() * low - up * low.deriv())
        return math.sqrt(min(_first_root(slope), _first_root(low)))

    def _radius(self, angle: np.ndarray) -> np.ndarray:
        """Return the image radius [focal lengths] of angles from a fisheye's axis [rad]."""
        k, square = self._k, angle * angle
        higher = k[0] + square * (k[1] + square * (k[2] + square * k[3]))
        return np.asarray(angle * (1 + square * higher))

    def _off_axis(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return rays of a fisheye, by bisection of the angle that gives the radius."""
        radius = np.hypot(x, y)
        low, high = np.zeros_like(radius), np.full_like(radius, self._reach)
        if not any(self._k):
            low = high = radius
        for _ in range(ITERATIONS if any(self._k) else 0):
            middle = (low + high) / 2
            beyond = self._radius(middle) > radius
            low, high = np.where(beyond, low, middle), np.where(beyond, middle, high)
        angle = np.where(radius <= self._radius(np.array(self._reach)) + MAX_ERROR, low, np.nan)
        scale = np.divide(np.sin(angle), radius, out=np.ones_like(radius), where=radius > 0)
        return x * scale, y * scale, np.cos(angle)

    def _distorted(
        self, x: np.ndarray, y: np.ndarray
    ) -> tuple[tuple[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """Return distorted x and y, and their derivatives: dx/dx, dx/dy = dy/dx, dy/dy."""
        k1, k2, p1, p2, k3, k4, k5, k6 = self._k
        r2 = x * x + y * y
        up, low = 1 + r2 * (k1 + r2 * (k2 + r2 * k3)), 1 + r2 * (k4 + r2 * (k5 + r2 * k6))
        radial = up / low
        up_slope, low_slope = k1 + r2 * (2 * k2 + r2 * 3 * k3), k4 + r2 * (2 * k5 + r2 * 3 * k6)
        slope = 2 * (up_slope - radial * low_slope) / low
        distorted = (
            x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
            y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
        )
        return distorted, (
            radial + x * x * slope + 2 * p1 * y + 6 * p2 * x,
            x * y * slope + 2 * p1 * x + 2 * p2 * y,
            radial + y * y * slope + 6 * p1 * y + 2 * p2 * x,
        )

    def _straight(
        self, xd: np.ndarray, yd: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return rays of a pinhole camera, undistorted by Newton's method within `_reach`."""
        if not any(self._k):
            return xd, yd, np.ones_like(xd)
        x, y = self._within(xd, yd)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            for _ in range(ITERATIONS):
                (u, v), (a, b, d) = self._distorted(x, y)
                det = a * d - b * b
                right, down = (
                    (d * (xd - u) - b * (yd - v)) / det,
                    (a * (yd - v) - b * (xd - u)) / det,
                )
                if not np.nanmax(np.abs(right) + np.abs(down), initial=0.0) > MIN_STEP:
                    break
                x, y = self._within(x + right, y + down)
            (u, v), _ = self._distorted(x, y)
            found = np.hypot(u - xd, v - yd) < MAX_ERROR
        return np.where(found, x, np.nan), y, np.ones_like(x)

    def _within(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        with np.errstate(divide="ignore", invalid="ignore"):
            shorter = np.minimum(1.0, self._reach / np.hypot(x, y))
        return x * shorter, y * shorter


def _first_root(polynomial: Polynomial) -> float:
    """Return the smallest positive real root; infinity without one."""
    roots = polynomial.trim().roots()
    real = roots[np.abs(roots.imag) < 1e-9 * (1 + np.abs(roots))].real
    return float(min(real[real > 0], default=math.inf))
