"""Ring images of catadioptric or fisheye cameras that look up or down, unwrapped to panoramas."""

from __future__ import annotations

import math
from typing import Annotated, Literal, NamedTuple

import numpy as np

from homeward.drives.cameras.camera import Directions
from homeward.drives.settings import Finite, NonNegative, Positive
from homeward.errors import InputError
from homeward.geometry.angles import wrap
from homeward.io.checks import Field
from homeward.io.models import model_validator
from homeward.vision.cameras.grey import as_grey
from homeward.vision.cameras.panoramic import MAX_WIDTH, MIN_WIDTH, Panorama
from homeward.vision.opencv import opencv

TABLE = 512
"""Number of radii at which the elevation is tabulated."""
MIN_RAYS = 30
"""Minimum number, out of 360, of rays for a refinement of a ring's edge."""
BLURRED_EDGE = 2.0
"""Width that is cut off at both edges of a detected ring, since they are blurred [px]."""


class Ring(Panorama):
    """A ring image: the angle round its centre is azimuth, the radius is elevation.

    The elevation at a radius r [px] is given in one of three ways. It is linear between the values
    at both edges of the ring. Or it follows Scaramuzza's polynomial: the ray of radius r has the
    direction (r, f(r)), f(r) = a0 + a1 r + a2 r^2 + ..., f being the upward component ("A toolbox
    for easily calibrating omnidirectional cameras", IROS 2006, with the sign of z reversed). Or it
    is that of a hyperbolic mirror of eccentricity e over a camera of focal length f [px] (Baker and
    Nayar, "A theory of single-viewpoint catadioptric image formation", IJCV 1999).
    """

    model: Literal["ring"] = "ring"
    centre: tuple[Finite, Finite]
    """Column and row [px]."""
    inner: NonNegative
    """Radius of the ring's inner edge [px]."""
    outer: Positive
    """Radius of its outer edge [px]."""
    elevations: tuple[Finite, Finite] | None = None
    """At the inner and the outer edge [rad]."""
    polynomial: Annotated[tuple[Finite, ...], Field(min_length=1, max_length=12)] | None = None
    """a0, a1, ... of f(r) in px."""
    mirror: tuple[Positive, Positive] | None = None
    """Eccentricity (above 1) of a hyperbolic mirror and the camera's focal length [px]. The camera
    looks up into the mirror; the ring's inner edge shows the ground."""
    axis_direction: Finite = 0.0
    """Direction of azimuth 0 in the image [rad], anti-clockwise from the right."""
    mirrored: bool = True
    """Whether azimuth runs clockwise in the image, as it does in a mirror seen from below and in a
    fisheye that looks up; false for a camera that looks down."""

    @model_validator(mode="after")
    def _one_model(self) -> Ring:
        if (self.axis, self.horizon) != (0.5, 0.5):
            raise ValueError("a ring has no axis and horizon; give axis_direction and elevations")
        if self.outer - self.inner < 8:
            raise ValueError("outer must be at least 8 px beyond inner")
        if sum(way is not None for way in (self.elevations, self.polynomial, self.mirror)) != 1:
            raise ValueError("give one of elevations, polynomial and mirror")
        if self.mirror is not None and self.mirror[0] <= 1.0:
            raise ValueError("mirror: the eccentricity of a hyperbola must be above 1")
        span = self.elevation_table()[1]
        steps = np.diff(span)
        if not (np.all(steps > 0) or np.all(steps < 0)):
            raise ValueError("the elevation must rise or fall monotonically from inner to outer")
        return self

    def panorama(self, image: np.ndarray) -> np.ndarray:
        """Unwrap a ring image to an equirectangular panorama with square pixels."""
        grey = as_grey(image)
        height, width = grey.shape
        (x, y), margin = self.centre, 1.5
        if not (
            self.outer - margin <= x <= width - 1 - self.outer + margin
            and self.outer - margin <= y <= height - 1 - self.outer + margin
        ):
            raise InputError(
                f"{width}x{height} pixels do not contain a ring of radius {self.outer:g} px "
                f"around ({x:g}, {y:g}); check centre and outer"
            )
        columns, rows = self._map()
        cv2 = opencv()
        return np.asarray(cv2.remap(grey, columns, rows, cv2.INTER_LINEAR))

    def ring_directions(self, columns: np.ndarray, rows: np.ndarray) -> Directions:
        """Return azimuth and elevation [rad] of pixels of the ring image, in the tilted frame.

        They are NaN outside the ring.
        """
        right, up = columns - self.centre[0], self.centre[1] - rows
        angle = np.arctan2(up, right) - self.axis_direction
        elevation = np.interp(np.hypot(right, up), *self.elevation_table(), np.nan, np.nan)
        azimuth = np.asarray(wrap(-angle if self.mirrored else angle))
        return np.where(np.isnan(elevation), np.nan, azimuth), elevation

    def _map(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the column and row in the ring image of each pixel of the panorama."""
        radii, elevation = self.elevation_table()
        width = self._width()
        step = self.column_angle(width)
        top, bottom = self._edges()
        height = max(int((top - bottom) / step), 16)
        wanted = top - (np.arange(height) + 0.5) * step
        rising = elevation[-1] > elevation[0]
        order = slice(None) if rising else slice(None, None, -1)
        radius = np.interp(wanted, elevation[order], radii[order])[:, None]
        azimuth = (width / 2 - 0.5 - np.arange(width))[None, :] * step
        # Rows run downwards in the image.
        angle = self.axis_direction + (-azimuth if self.mirrored else azimuth)
        columns = self.centre[0] + radius * np.cos(angle)
        rows = self.centre[1] - radius * np.sin(angle)
        return columns.astype(np.float32), rows.astype(np.float32)

    def _width(self) -> int:
        """Return the number of columns: the circumference of the middle of the ring [px]."""
        around = math.pi * (self.inner + self.outer)
        return int(np.clip(16 * round(around / 16), MIN_WIDTH, MAX_WIDTH))

    def _elevation(self, above: np.ndarray) -> np.ndarray:
        top, bottom = self._edges()
        return above + (top + bottom) / 2

    def _above(self, elevation: np.ndarray) -> np.ndarray:
        top, bottom = self._edges()
        return elevation - (top + bottom) / 2

    def _edges(self) -> tuple[float, float]:
        """Return the largest and the smallest elevation [rad]."""
        elevation = self.elevation_table()[1]
        return float(elevation.max()), float(elevation.min())

    def elevation_table(self) -> tuple[np.ndarray, np.ndarray]:
        """Return radii [px] and the elevation at each [rad]."""
        radii = np.linspace(self.inner, self.outer, TABLE)
        if self.elevations is not None:
            return radii, np.linspace(*self.elevations, TABLE)
        if self.polynomial is not None:
            up = np.polynomial.polynomial.polyval(radii, np.array(self.polynomial))
            return radii, np.arctan2(up, radii)
        assert self.mirror is not None
        e, focal = self.mirror
        nadir = np.arctan2(radii, focal)
        # From the mirror's focus: the tangents of half the angles have the ratio (e + 1) / (e - 1).
        from_axis = 2 * np.arctan((e + 1) / (e - 1) * np.tan(nadir / 2))
        return radii, from_axis - math.pi / 2


class FoundRing(NamedTuple):
    """Centre and radii of a ring in an image [px]."""

    centre: tuple[float, float]
    inner: float
    outer: float


def find_ring(image: np.ndarray) -> FoundRing:
    """Find centre and radii of the bright ring of a catadioptric or fisheye image.

    Circles are fitted to the points with half the contrast to the dark surround, and to the dark
    middle if there is one. `BLURRED_EDGE` is cut off at both: a rim in the panorama turns with the
    camera, and would match the rim in the home image. The image has any format of `as_grey`;
    `InputError` if it is no picture, or has no dark surround.
    """
    image, cv2 = as_grey(image), opencv()
    blur = max(image.shape) / 250
    smooth = cv2.GaussianBlur(image, (0, 0), blur)
    border = np.concatenate([smooth[0], smooth[-1], smooth[:, 0], smooth[:, -1]])
    dark = float(np.percentile(border, 25))
    bright = float(np.percentile(smooth, 90))
    if bright - dark < 20:
        raise InputError("no bright ring on a dark surround in the image")
    lit = smooth > dark + 0.25 * (bright - dark)
    row, column = np.nonzero(lit)
    centre = np.array([np.median(column), np.median(row)])
    for _ in range(5):
        outer_edge = _edge(lit, centre, outwards=False)
        centre, outer = _circle(outer_edge)
    inner_edge = _edge(lit, centre, outwards=True)
    inner = float(np.median(np.linalg.norm(inner_edge - centre, axis=1)))
    # Blur has moved these edges by a few pixels out of the ring.
    reach, contrast = 2 * blur + 3, 0.25 * (bright - dark)
    for _ in range(2):
        rim = _half_way(image, centre, outer, reach, contrast)
        if len(rim) >= MIN_RAYS:
            centre, outer = _circle(rim)
    if inner > 3:
        rim = _half_way(image, centre, inner, -reach, contrast)
        if len(rim) >= MIN_RAYS:
            inner = float(np.median(np.linalg.norm(rim - centre, axis=1)))
        inner += BLURRED_EDGE
    else:
        inner = 0.0
    return FoundRing((float(centre[0]), float(centre[1])), inner, outer - BLURRED_EDGE)


def _half_way(
    image: np.ndarray, centre: np.ndarray, radius: float, reach: float, contrast: float
) -> np.ndarray:
    """Return the points, (n, 2), with half the contrast between ring and surround.

    On each ray they are searched within `reach` of `radius`; `reach` is negative for the inner
    edge. Rays of less contrast, where the ring itself is dark, are left out.
    """
    cv2 = opencv()
    angles = np.linspace(-math.pi, math.pi, 360, endpoint=False)
    radii = np.maximum(radius + np.linspace(-reach, reach, 8 * math.ceil(abs(reach)) + 1), 0.0)
    x = centre[0] + np.outer(np.cos(angles), radii)
    y = centre[1] + np.outer(np.sin(angles), radii)
    smooth = cv2.GaussianBlur(image, (0, 0), 0.7).astype(np.float32)
    grey = cv2.remap(smooth, x.astype(np.float32), y.astype(np.float32), cv2.INTER_LINEAR)
    few = len(radii) // 4
    ring, surround = np.median(grey[:, :few], axis=1), np.median(grey[:, -few:], axis=1)
    lit = grey > (ring + surround)[:, None] / 2
    last = len(radii) - 1 - lit[:, ::-1].argmax(axis=1)
    within = (x >= 0) & (x <= image.shape[1] - 1) & (y >= 0) & (y <= image.shape[0] - 1)
    clear = np.flatnonzero((ring - surround > contrast) & within.all(axis=1))
    return np.column_stack([x[clear, last[clear]], y[clear, last[clear]]])


def _edge(lit: np.ndarray, centre: np.ndarray, outwards: bool) -> np.ndarray:
    """Return the first lit point, (n, 2), on each ray from the centre, or from the rim inwards."""
    angles = np.linspace(-math.pi, math.pi, 360, endpoint=False)
    reach = np.arange(0.0, math.hypot(*lit.shape), 0.5)
    x = centre[0] + np.outer(np.cos(angles), reach)
    y = centre[1] + np.outer(np.sin(angles), reach)
    height, width = lit.shape
    inside = (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)
    row, column = (
        y.round().astype(int).clip(0, height - 1),
        x.round().astype(int).clip(0, width - 1),
    )
    on = inside & lit[row, column]
    hit = on.any(axis=1)
    first = on.argmax(axis=1) if outwards else on.shape[1] - 1 - on[:, ::-1].argmax(axis=1)
    rows = np.flatnonzero(hit)
    return np.column_stack([x[rows, first[rows]], y[rows, first[rows]]])


def _circle(points: np.ndarray) -> tuple[np.ndarray, float]:
    """Fit a circle robustly to points, (n, 2)."""
    weight = np.ones(len(points))
    centre, radius = points.mean(axis=0), 1.0
    for _ in range(20):
        design = np.column_stack([2 * points, np.ones(len(points))]) * weight[:, None]
        x, y, c = np.linalg.lstsq(design, (points**2).sum(axis=1) * weight, rcond=None)[0]
        centre, radius = np.array([x, y]), math.sqrt(max(c + x * x + y * y, 0.0))
        off = np.abs(np.linalg.norm(points - centre, axis=1) - radius)
        weight = 1.0 / (1.0 + (off / max(1.5 * float(np.median(off)), 0.5)) ** 2)
    return centre, radius
