"""Self-similarity on level planes: patches that recur on the floor or the ceiling, such as tiles.

In perspective, no two tiles of one floor look the same. But tiles of another room do, seen from the
same position relative to their joints: their features are matched, and agree on a motion.
Repetition appears only in the view from above (inverse perspective mapping: Mallot et al.,
Biological Cybernetics 1991). The height is not needed: a direction gives the position on a level
plane in units of that height. So each patch is aligned with its own panorama at every other feature
of the plane, starting from the map of a shift along the plane.
"""

from __future__ import annotations

import numpy as np

from homeward.vision.cameras.panoramic import Panorama
from homeward.vision.features.detection import Features
from homeward.vision.features.matching import MAX_GROWTH, MIN_CORRELATION, thinned
from homeward.vision.features.moved_groups import MAX_SCALE
from homeward.vision.features.patch_alignment import STEPS, align_patches, areas, radius_of

MIN_ANGLE = np.radians(10.0)
"""Minimum angle of tested features from the horizon, where a plane is too foreshortened, and from
the vertical, where a panorama is [rad]."""
APART = 1.5
"""Minimum distance of another feature, in radii of the patch: otherwise it overlaps itself."""


def self_similar(view: Features, rows: np.ndarray, camera: Panorama) -> np.ndarray:
    """Return which features, in rows (n,) of a view, recur elsewhere on their level plane."""
    found = np.zeros(len(rows), bool)
    for up in (-view.elevation, view.elevation):
        plane = (up > MIN_ANGLE) & (up < np.pi / 2 - MIN_ANGLE)
        mine = np.flatnonzero(plane[rows])
        others = thinned(np.flatnonzero(plane), 500)
        found[mine] = _recur(view, rows[mine], others, camera)
    return found


def _recur(view: Features, rows: np.ndarray, others: np.ndarray, camera: Panorama) -> np.ndarray:
    """Return which features, in rows (n,), look like one of the others, in rows (m,)."""
    maps = _scale(view, others, camera) @ np.linalg.inv(_scale(view, rows, camera))[:, None]
    area = areas(maps.reshape(-1, 2, 2)).reshape(maps.shape[:2])
    place = np.column_stack([view.column, view.row])
    step = place[others] - place[rows, None]
    step[..., 0] -= view.shape[1] * np.rint(step[..., 0] / view.shape[1])
    apart = np.hypot(*np.moveaxis(step, -1, 0))
    grown = view.size[others] / (view.size[rows, None] * np.sqrt(area))
    tried = (area > 1 / MAX_GROWTH) & (area < MAX_GROWTH)
    tried &= np.abs(np.log(grown)) < np.log(MAX_SCALE)
    tried &= apart > APART * radius_of(view.size[rows], view.pyramid)[:, None]
    one, other = np.nonzero(tried)
    start = np.dstack([maps[one, other], place[others[other]]])
    at_home, size = place[rows[one]], view.size[rows[one]]
    found = align_patches(view.pyramid, view.pyramid, at_home, size, start, STEPS // 2)
    alike = found.found & (found.correlation > MIN_CORRELATION)
    return np.bincount(one[alike], minlength=len(rows)) > 0


def _scale(view: Features, rows: np.ndarray, camera: Panorama) -> np.ndarray:
    """Return the image motion per step on the level plane, (n, 2, 2) [px per height]."""
    directions, slope = camera.directions_and_slope(view.column[rows], view.row[rows], view.shape)
    azimuth, elevation = directions.T
    far = 1 / np.tan(np.abs(elevation))
    c, s = np.cos(azimuth), np.sin(azimuth)
    nearer = -np.sign(elevation) / (1 + far**2)  # derivative of elevation by distance
    turned = np.stack([-s / far, c / far], axis=-1)
    raised = np.stack([c, s], axis=-1) * nearer[:, None]
    return np.asarray(np.linalg.inv(slope) @ np.stack([turned, raised], axis=1))
