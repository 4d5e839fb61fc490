"""Patch alignment: affine, inverse compositional Lucas-Kanade, all patches at once.

Baker and Matthews, "Lucas-Kanade 20 years on", IJCV 2004. SIFT locates a feature to a third of a
pixel in each panorama separately; aligning its patch at home with the panorama now (shift, scale,
rotation, shear) locates it to a tenth. Grey values are normalised to zero mean and unit length, so
that light has no effect, and weighted towards the centre. The residual between the patches gives
the covariance of the position, and rejects patches that do not show the same: corners formed by a
near and a far edge, look-alikes.

Patches are sampled from an image pyramid of the panorama, between pixels and across the seam.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import ModuleType

import numpy as np

from homeward import core
from homeward.drives.drive import Columns
from homeward.vision.opencv import opencv

LEVELS = 3
"""Levels of the pyramid, each half the size of the one before."""
BLUR = 0.5
"""Standard deviation of the smoothing of the first level [px]."""
MARGIN = 64
"""Maximum number of columns by which the image is continued beyond its seam on each side."""


@dataclass(frozen=True)
class Pyramid:
    """A smoothed panorama at several scales."""

    levels: tuple[np.ndarray, ...]
    """float32, continued beyond the seam by `margin` columns of the first."""
    times: int
    """Size of the first level, as a multiple of the panorama's."""
    width: int
    """Width of the panorama [px]."""
    margin: int
    """Continuation beyond the seam [columns of the first level]."""

    @classmethod
    def of(cls, image: np.ndarray, times: int = 1) -> Pyramid:
        """Return the pyramid of a grey panorama, uint8 (height, width), enlarged `times`."""
        cv2, width = opencv(), image.shape[1]
        around = min(MARGIN, width)
        wide = cv2.copyMakeBorder(image, 0, 0, around, around, cv2.BORDER_WRAP)
        wide = enlarged(wide.astype(np.float32), times)
        levels = [cv2.GaussianBlur(wide, (0, 0), BLUR)]
        for _ in range(LEVELS - 1):
            levels.append(cv2.pyrDown(levels[-1]))
        return cls(tuple(levels), times, width, around * times)

    def layout(self) -> np.ndarray:
        """Return `times`, `width` and `margin`: for compiled code."""
        return np.array([self.times, self.width, self.margin], float)

    def sample(self, points: np.ndarray, spacing: np.ndarray) -> np.ndarray:
        """Return interpolated grey values, float32 (n, k), of n patches.

        Points are columns and rows (n, 2, k) [px], which may be across the seam. The distance
        between those of each patch, `spacing` (n,) [px], determines the level.
        """
        column, row = points[:, 0], points[:, 1]
        around = np.floor((column.mean(axis=1, keepdims=True) + 0.5) / self.width) * self.width
        column = (column - around + 0.5) * self.times - 0.5 + self.margin
        row = (row + 0.5) * self.times - 0.5
        level = np.clip(np.rint(np.log2(spacing * self.times)), 0, len(self.levels) - 1).astype(int)
        grey = np.empty(column.shape, np.float32)
        for k in np.unique(level):
            rows = level == k
            x, y = (np.float32(v[rows] / 2**k) for v in (column, row))
            cv2 = opencv()
            grey[rows] = cv2.remap(
                self.levels[k], x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
            )
        return grey


def enlarged(image: np.ndarray, times: int) -> np.ndarray:
    """Return an image enlarged by a factor."""
    if times == 1:
        return image
    cv2 = opencv()
    return np.asarray(cv2.resize(image, None, fx=times, fy=times, interpolation=cv2.INTER_CUBIC))


HALF = 6
"""A patch is sampled at (2 HALF + 1)^2 points."""
MIN_RADIUS, MAX_RADIUS, RADIUS_PER_SIZE = 5.0, 12.0, 2.0
"""Radius of a patch [px]: minimum, maximum, and as a multiple of the feature's diameter."""
WINDOW = 0.6
"""Standard deviation of the Gaussian weight about the centre, in radii."""
STEPS = 8
"""Iterations; half as many for a map that starts from that of another patch."""
STIFFNESS = (0.05 / 0.3) ** 2
"""Prior information on the map's matrix, from the features' own size and orientation: variance of
the grey values of a unit-length patch over that of the matrix."""
MIN_AREA = 0.01
"""Minimum factor by which one iteration may shrink a patch."""
MIN_CORRELATION = 0.8
"""Correlation below which two patches do not show the same."""
MAX_SHIFT = 0.5
"""Maximum change of a parameter in one iteration, and of the position in total, in radii: beyond,
the patch has slid onto something else."""
MIN_SIGMA, SIGMA_FACTOR = 0.02, 2.8
"""Standard deviation of a position: minimum [px], and factor over that from independent noise. The
factor was measured on rendered rooms: residuals are correlated from pixel to pixel."""

_across, _down = (
    a.ravel().astype(np.float32) for a in np.meshgrid(*2 * [np.arange(-HALF, HALF + 1) / HALF])
)
_GRID = np.stack([_across, _down, np.ones_like(_across)])
_ROOT = np.exp(-(_across**2 + _down**2) / (4 * WINDOW**2))
_ROOT /= np.linalg.norm(_ROOT)
_GRIDS = np.pad(np.stack([_across, _down, _ROOT]), [(0, 0), (0, -_ROOT.size % 16)])
"""For compiled code, which adds sixteen numbers at a time."""
_PRIOR = np.array([1e-6, 1e-6, *4 * [STIFFNESS]])
"""Prior information on a step; negligible for the shift."""


@dataclass(frozen=True)
class Alignment(Columns):
    """Positions now of n patches of home."""

    column: np.ndarray
    """(n,) [px]"""
    row: np.ndarray
    """(n,) [px]"""
    shape: np.ndarray
    """(n, 2, 2): linear map of a step at home, right and down [px now per px at home]."""
    covariance: np.ndarray
    """(n, 2, 2): of column and row [px^2], from the residual between the two patches."""
    correlation: np.ndarray
    """(n,): of the two patches."""
    found: np.ndarray
    """(n,) bool: whether the two patches show the same."""

    def __len__(self) -> int:
        return len(self.column)

    @property
    def place(self) -> np.ndarray:
        """Column and row, (n, 2) [px]."""
        return np.column_stack([self.column, self.row])

    @property
    def area(self) -> np.ndarray:
        """Factor by which an area is larger now, (n,)."""
        return areas(self.shape)


def align_patches(
    home: Pyramid,
    now: Pyramid,
    at_home: np.ndarray,
    size: np.ndarray,
    start: np.ndarray,
    steps: int = STEPS,
) -> Alignment:
    """Align patches of home with the panorama now, starting from given affine maps.

    Features at home have columns and rows (n, 2) and diameters (n,) [px]; maps, (n, 2, 3), are from
    steps at home to columns and rows now. `steps` is the number of iterations.
    """
    radius = radius_of(size, home)
    begun = start.copy()
    begun[:, :, :2] *= radius[:, None, None]
    reach = np.sqrt(areas(begun))
    task = _Task(home, now, at_home, radius, begun, reach, steps)
    carried, correlation, spread = _align(task)
    left = np.maximum(2 - 2 * correlation, 0) / (_ROOT.size / 2)
    shape = carried[:, :, :2]
    noise = shape @ spread @ shape.swapaxes(1, 2)
    shift = np.hypot(*(carried[:, :, 2] - start[:, :, 2]).T)
    return Alignment(
        column=carried[:, 0, 2],
        row=carried[:, 1, 2],
        shape=shape / radius[:, None, None],
        covariance=MIN_SIGMA**2 * np.eye(2) + SIGMA_FACTOR**2 * left[:, None, None] * noise,
        correlation=correlation,
        found=(correlation > MIN_CORRELATION) & (shift < MAX_SHIFT * reach),
    )


def areas(maps: np.ndarray) -> np.ndarray:
    """Return the factor by which maps, (n, 2, 2 or 3), enlarge an area."""
    return np.asarray(np.abs(maps[:, 0, 0] * maps[:, 1, 1] - maps[:, 0, 1] * maps[:, 1, 0]))


def radius_of(size: np.ndarray, home: Pyramid) -> np.ndarray:
    """Return the radius of patches around features of a diameter `size` [px]."""
    return np.asarray(
        np.clip(RADIUS_PER_SIZE * size * home.times, MIN_RADIUS, MAX_RADIUS) / home.times
    )


@dataclass(frozen=True)
class _Task:
    """Alignment of n patches."""

    home: Pyramid
    now: Pyramid
    at: np.ndarray
    """(n, 2): column and row at home [px]."""
    radius: np.ndarray
    """(n,): at home [px]."""
    start: np.ndarray
    """(n, 2, 3): maps from a patch's own coordinates to columns and rows now."""
    reach: np.ndarray
    """(n,): radius now, according to these maps [px]."""
    steps: int


def _align(task: _Task) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the maps, (n, 2, 3), the correlation of each pair of patches, (n,), and covariances.

    The latter, (n, 2, 2) [radii^2], are those of positions for grey values of unit variance.
    """
    if core.compiled is not None:
        return _align_compiled(core.compiled, task)
    patch, slopes = _template(task.home, task.at, task.radius)
    information = slopes.swapaxes(1, 2) @ slopes + np.diag(_PRIOR)
    known, spacing = np.linalg.inv(information), task.reach / HALF
    back, carried = np.linalg.inv(task.start[:, :, :2]), task.start
    for _ in range(task.steps):
        sampled = _normal(task.now.sample(carried @ _GRID, spacing))[0]
        # The patch itself contributes nothing: slopes are orthogonal to it.
        gradient = (sampled[:, None, :] @ slopes)[:, 0]
        gradient[:, 2:] += (back @ carried[:, :, :2] - np.eye(2)).reshape(-1, 4) * _PRIOR[2:]
        step = (known @ gradient[..., None])[..., 0]
        carried = carried @ _inverse(np.clip(step, -MAX_SHIFT, MAX_SHIFT))
    sampled = _normal(task.now.sample(carried @ _GRID, spacing))[0]
    return carried, (sampled * patch).sum(axis=1), known[:, :2, :2]


def _align_compiled(native: ModuleType, task: _Task) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Do the same as `_align` in compiled code."""
    limits = np.array([HALF, MAX_SHIFT, MIN_AREA])
    given = (task.at, task.radius, task.reach, task.start)
    at, radius, reach, maps = (np.array(a, float, order="C") for a in given)
    correlation, spread = np.empty(len(at)), np.empty((len(at), 2, 2))
    native.align(
        *(task.home.levels, task.home.layout(), task.now.levels, task.now.layout()),
        *(_GRIDS, limits, _PRIOR, task.steps, at, radius, reach, maps, correlation, spread),
    )
    return maps, correlation, spread


def _template(home: Pyramid, at: np.ndarray, radius: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return patches, (n, k), and their derivatives by the six parameters, (n, k, 6).

    In units of the patch's radius: shift (right, down), then the matrix row by row. Components that
    change only the mean or the length of a patch are removed, as in the patches.
    """
    spacing = radius / HALF
    points = similarity(at, radius, np.zeros_like(radius)) @ _GRID
    patch, length = _normal(home.sample(points, spacing))
    slope = []
    for way in np.eye(2):
        half = spacing[:, None, None] * way[:, None] / 2
        ahead, behind = (home.sample(points + side * half, spacing) for side in (1, -1))
        slope.append((ahead - behind) * _ROOT * HALF / length[:, None])
    x, y = slope
    slopes = np.stack([x, y, x * _across, x * _down, y * _across, y * _down], axis=-1)
    for known in (np.broadcast_to(_ROOT, patch.shape), patch):
        slopes -= known[..., None] * (known[:, None, :] @ slopes)
    return patch, slopes


def similarity(at: np.ndarray, scale: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """Return similarity maps, (n, 2, 3), of steps to columns and rows around `at`, (n, 2).

    They enlarge by `scale` and rotate clockwise by `turn` [rad], (n,).
    """
    c, s = scale * np.cos(turn), scale * np.sin(turn)
    return np.stack([np.stack([c, -s, at[:, 0]], -1), np.stack([s, c, at[:, 1]], -1)], axis=1)


def _inverse(step: np.ndarray) -> np.ndarray:
    """Return the inverse, (n, 3, 3), of the map that a step describes."""
    x, y, a, b, c, d = (step + np.array([0, 0, 1, 0, 0, 1])).T
    area = np.maximum(a * d - b * c, MIN_AREA)
    inverse = np.zeros((len(step), 3, 3))
    inverse[:, 0] = np.column_stack([d, -b, b * y - d * x]) / area[:, None]
    inverse[:, 1] = np.column_stack([-c, a, c * x - a * y]) / area[:, None]
    inverse[:, 2, 2] = 1.0
    return inverse


def _normal(grey: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return weighted patches of zero mean and unit length, and their length before."""
    weighted = grey * _ROOT
    weighted -= (weighted @ _ROOT)[:, None] * _ROOT
    length = np.maximum(np.linalg.norm(weighted, axis=1), 1e-3)
    return weighted / length[:, None], length
