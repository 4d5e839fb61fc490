"""Self-similarity on level planes: patches that recur on the floor or the ceiling.

Tiles do. In perspective no two of them look the same, but those of another room do, seen from a
place as far from its joints: features on them are matched, and agree on a motion. Repetition shows
only as seen from above (inverse perspective mapping: Mallot et al., Biological Cybernetics 1991).
The height is not needed: on a level plane, a direction gives the place in units of that height. So
each patch is aligned with its own panorama at every other feature of the plane, beginning at the
map that a shift along the plane would be.
"""

from __future__ import annotations

import numpy as np

from homeward.vision.cameras.panoramic import Panorama
from homeward.vision.features.detection import Features
from homeward.vision.features.match_propagation import MAX_GROWTH, MIN_LIKENESS, thinned
from homeward.vision.features.moved_groups import SCALE
from homeward.vision.features.patch_alignment import STEPS, align_patches, areas, radius_of

FLATTEST = np.radians(10.0)
"""Features nearer to the horizon, where a plane is too foreshortened, or to the vertical, where a
panorama is, are not looked at [rad]."""
APART = 1.5
"""Least distance of another feature, in radii of the patch: nothing recurs on itself."""


def self_similar(view: Features, rows: np.ndarray, camera: Panorama) -> np.ndarray:
    """Return which features are self-similar: seen elsewhere on their level plane, too.

    Parameters
    ----------
    view : Features
        One panorama.
    rows : ndarray of int, shape (n,)
        Features of it.
    camera : Panorama
        That took it.

    Returns
    -------
    ndarray of bool, shape (n,)
    """
    found = np.zeros(len(rows), bool)
    for up in (-view.elevation, view.elevation):
        plane = (up > FLATTEST) & (up < np.pi / 2 - FLATTEST)
        mine = np.flatnonzero(plane[rows])
        others = thinned(np.flatnonzero(plane), 500)  # of tiles there are more
        found[mine] = _recur(view, rows[mine], others, camera)
    return found


def _recur(view: Features, rows: np.ndarray, others: np.ndarray, camera: Panorama) -> np.ndarray:
    """Return which of the rows, (n,), show what is seen at one of the others, (m,), too."""
    maps = _scale(view, others, camera) @ np.linalg.inv(_scale(view, rows, camera))[:, None]
    area = areas(maps.reshape(-1, 2, 2)).reshape(maps.shape[:2])
    place = np.column_stack([view.column, view.row])
    step = place[others] - place[rows, None]
    step[..., 0] -= view.shape[1] * np.rint(step[..., 0] / view.shape[1])
    apart = np.hypot(*np.moveaxis(step, -1, 0))
    grown = view.size[others] / (view.size[rows, None] * np.sqrt(area))
    tried = (area > 1 / MAX_GROWTH) & (area < MAX_GROWTH)
    tried &= np.abs(np.log(grown)) < np.log(SCALE)
    tried &= apart > APART * radius_of(view.size[rows], view.pyramid)[:, None]
    one, other = np.nonzero(tried)
    start = np.dstack([maps[one, other], place[others[other]]])
    at_home, size = place[rows[one]], view.size[rows[one]]
    laid = align_patches(view.pyramid, view.pyramid, at_home, size, start, STEPS // 2)
    like = laid.found & (laid.likeness > MIN_LIKENESS)
    return np.bincount(one[like], minlength=len(rows)) > 0


def _scale(view: Features, rows: np.ndarray, camera: Panorama) -> np.ndarray:
    """Return how features move with a step on their level plane, (n, 2, 2) [px by its height]."""
    directions, slope = camera.directions_and_slope(view.column[rows], view.row[rows], view.shape)
    azimuth, elevation = directions.T
    far = 1 / np.tan(np.abs(elevation))
    c, s = np.cos(azimuth), np.sin(azimuth)
    nearer = -np.sign(elevation) / (1 + far**2)  # of the elevation, by a step straight away
    turned = np.stack([-s / far, c / far], axis=-1)
    raised = np.stack([c, s], axis=-1) * nearer[:, None]
    return np.asarray(np.linalg.inv(slope) @ np.stack([turned, raised], axis=1))
