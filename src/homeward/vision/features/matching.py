"""Matching: descriptors, propagation to patches nearby, moved groups, self-similarity.

Match propagation: Lhuillier and Quan, "Match propagation for image-based modeling and rendering",
PAMI 2002. Only a tenth of a panorama's features are matched: most are not detected twice, or look
like several others. But the map of an aligned patch predicts the positions of its neighbours,
detected now or not. They are aligned from there, and then their neighbours. No motion is assumed,
so these are separate measurements, about four for each match. They are correct or wrong together
with their match, and are no evidence that the panoramas show the same.

Moved groups: outliers that share a similarity transform are on an object that was moved. The
features of one object keep their arrangement. Position, size and orientation of a match's two
features give the similarity that maps the object from one panorama to the other (Lowe, "Distinctive
image features from scale-invariant keypoints", IJCV 2004, section 7.3). If enough outliers nearby
have the same similarity, they are assumed to be one object.

Self-similarity: patches that recur on the floor or the ceiling, such as tiles. In perspective, no
two tiles of one floor look the same. But tiles of another room do, seen from the same position
relative to their joints: their features are matched, and agree on a motion. Repetition appears only
in the view from above (inverse perspective mapping: Mallot et al., Biological Cybernetics 1991).
The height is not needed: a direction gives the position on a level plane in units of that height.
So each patch is aligned with its own panorama at every other feature of the plane, starting from
the map of a shift along the plane.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from homeward.vision.cameras.panoramic import Panorama
from homeward.vision.features.detection import Features
from homeward.vision.features.patch_alignment import (
    STEPS,
    Alignment,
    align_patches,
    areas,
    radius_of,
)

RATIO = 0.85
"""Maximum ratio of the distances to the nearest and the second descriptor (Lowe, IJCV 2004)."""
EXCLUDED = -1.0
"""Cosine of opposite descriptors: excludes a pair."""


def match(
    a: np.ndarray, b: np.ndarray, ratio: float = RATIO, possible: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Match descriptors, unit vectors (n, k) and (m, k): mutual nearest neighbours.

    They must be nearer than the second by `ratio` in both directions (Lowe). Pairs that are not
    `possible` (n, m) are neither the nearest nor the second. Return rows of both, (p, 2), and the
    larger of the two ratios, (p,); smaller is better.
    """
    if len(a) < 2 or len(b) < 2:
        return np.zeros((0, 2), int), np.zeros(0)
    cosine = a @ b.T
    if possible is not None:
        cosine[~possible] = EXCLUDED
    forth = cosine.argmax(axis=1)
    nearest = cosine[np.arange(len(a)), forth]
    rows = np.flatnonzero((nearest == cosine.max(axis=0)[forth]) & (nearest > EXCLUDED))
    # Of several identical rows, the first; the others are then the second nearest.
    rows = np.sort(rows[np.unique(forth[rows], return_index=True)[1]])
    nearest, columns = nearest[rows], forth[rows]
    cosine[rows, columns] = EXCLUDED
    second = np.maximum(cosine.max(axis=1)[rows], cosine.max(axis=0)[columns])
    ratios = np.sqrt(_squared_distance(nearest) / _squared_distance(second))
    kept = ratios < ratio
    return np.column_stack([rows, columns])[kept], ratios[kept]


def _squared_distance(cosine: np.ndarray) -> np.ndarray:
    return np.asarray(np.maximum(2.0 - 2.0 * cosine, 1e-12))


NEAR = 4.0
"""A map is used within this distance of its patch, in radii of the patch."""
NUM_GUIDES = 2
"""Number of maps, of the nearest patches, that are tried; the best correlation counts."""
MIN_CORRELATION = 0.9
"""Higher than for a match, which has the support of its descriptor, too."""
SIGMA_FACTOR = 1.6
"""Standard deviation of a position relative to that of a match of the same correlation. Measured on
rendered rooms: many corners are formed by a near and a far edge, and are no fixed point."""
MAX_PATCHES, MAX_GUIDES = 1500, 300
"""Maximum numbers, to bound the time; beyond them, every n-th is used. Rooms have half as many with
1024 columns, as many with 2048."""
MAX_GROWTH = 10.0
"""Maps that change an area by a larger factor, or shrink it so, are not used."""


def propagate_matches(
    home: Features, now: Features, matched: np.ndarray, alignment: Alignment
) -> tuple[np.ndarray, Alignment]:
    """Align patches of home that are next to matched features.

    Given are the matched rows of home, (n,), and the alignment of their patches now. Return columns
    and rows of other patches of home, (2, m) [px], and the alignment of these.
    """
    (patches, of), found = home.patches, []
    guides = of[matched]
    free = np.ones(len(patches), bool)
    for _ in range(3):
        free[guides] = False
        some = thinned(np.arange(len(guides)), MAX_GUIDES)
        others = thinned(np.flatnonzero(free), MAX_PATCHES)
        guides, alignment = _propagate(home, now, others, guides[some], alignment.rows(some))
        found.append((guides, alignment))
    rows, parts = zip(*found, strict=True)
    every = Alignment.joined(parts)
    every = replace(every, covariance=SIGMA_FACTOR**2 * every.covariance)
    return patches[np.concatenate(rows), :2].T, every


def thinned(rows: np.ndarray, most: int) -> np.ndarray:
    """Return at most `most` of the rows, evenly chosen."""
    return rows if len(rows) <= most else rows[np.arange(most) * len(rows) // most]


def _propagate(
    home: Features, now: Features, others: np.ndarray, guides: np.ndarray, alignment: Alignment
) -> tuple[np.ndarray, Alignment]:
    """Return the other patches that align from the map of a guide, and their alignment."""
    at_home, size = np.split(home.patches[0], [2], axis=1)
    radius = radius_of(size[:, 0], home.pyramid)
    which, guide = _near(at_home[others], at_home[guides], radius[guides], home.shape[1])
    step = at_home[others[which]] - at_home[guides[guide]]
    step[:, 0] -= home.shape[1] * np.rint(step[:, 0] / home.shape[1])
    carried = (alignment.shape[guide] @ step[..., None])[..., 0] + alignment.place[guide]
    area = alignment.area[guide]
    inside = (carried[:, 1] > 0) & (carried[:, 1] < now.shape[0] - 1)
    kept = inside & (area > 1 / MAX_GROWTH) & (area < MAX_GROWTH)
    which, start = others[which[kept]], np.dstack([alignment.shape[guide], carried])[kept]
    tried = align_patches(
        home.pyramid, now.pyramid, at_home[which], size[which, 0], start, STEPS // 2
    )
    alike = np.flatnonzero(tried.found & (tried.correlation > MIN_CORRELATION))
    best_first = alike[np.argsort(-tried.correlation[alike], kind="stable")]
    rows, first = np.unique(which[best_first], return_index=True)
    return rows, tried.rows(best_first[first])


def _near(
    others: np.ndarray, guides: np.ndarray, radius: np.ndarray, width: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return which others, (n, 2), are near which guides, (m, 2) of a radius: rows of both, (k,).

    Distances are those on a cylinder, since the panorama wraps round.
    """
    one, other = _on_cylinder(guides, width), _on_cylinder(others, width)
    # Guides are rows and others columns: the minimum of each column is found fastest.
    apart = one @ (-2 * other.T)
    apart += (one**2).sum(axis=1)[:, None]
    apart += (other**2).sum(axis=1)
    apart /= (NEAR * radius[:, None]) ** 2
    columns, nearest = np.arange(len(others)), []
    for _ in range(min(NUM_GUIDES, len(guides))):
        best = apart.argmin(axis=0)
        nearest.append(np.where(apart[best, columns] < 1, best, -1))
        apart[best, columns] = np.inf
    guide = np.array(nearest, int).reshape(len(nearest), len(others)).T  # several maps, in turn
    which = np.nonzero(guide >= 0)[0]
    return which, guide[guide >= 0]


def _on_cylinder(places: np.ndarray, width: int) -> np.ndarray:
    """Return positions in a panorama, (n, 2), on a cylinder: (n, 3) [px]."""
    turn = 2 * math.pi / width
    across = places[:, 0] * turn
    return np.column_stack([np.cos(across) / turn, np.sin(across) / turn, places[:, 1]])


OBJECT_EXTENT = 0.35
"""Maximum angle between two features of one object [rad]."""
TOLERANCE = 0.3
"""Maximum error of a feature's position, as a share of its distance, in addition to its size."""
MAX_SCALE, MAX_TURN = 1.6, 0.5
"""Maximum ratio of scales, and difference of rotations [rad], within one object."""
MIN_MATCHES = 4
"""Minimum number of matches that share one similarity."""


def moved_groups(
    home: Features, now: Features, rows: np.ndarray, candidates: np.ndarray
) -> np.ndarray:
    """Return which matches, rows (n, 2) of both, are on moved objects: (n,) bool.

    Candidates, (n,) bool, are the outliers of the motion.
    """
    moved = np.zeros(len(rows), bool)
    chosen = np.flatnonzero(candidates)
    if chosen.size < MIN_MATCHES:
        return moved
    i, j = rows[chosen].T
    a, b = _offsets(home, i), _offsets(now, j)
    ratio = np.log((now.size[j] / now.shape[1]) / (home.size[i] / home.shape[1]))
    # Image rows run downwards; OpenCV's angle and the offsets have the same sense.
    turn = now.angle[j] - home.angle[i]
    carried = a * np.exp(ratio + 1j * turn)[:, None]
    reach = TOLERANCE * np.abs(carried) + _angular(now, now.size[j])[:, None]
    follows = (
        (np.abs(b - carried) <= reach)
        & (np.abs(a) < OBJECT_EXTENT)
        & (np.abs(b) < OBJECT_EXTENT)
        & (np.abs(ratio[:, None] - ratio[None, :]) < np.log(MAX_SCALE))
        & (np.abs(np.angle(np.exp(1j * (turn[:, None] - turn[None, :])))) < MAX_TURN)
    )
    # Several features at one position count once.
    apart = np.abs(a) > _angular(home, home.size[i])[:, None] / 2
    support = (follows & apart).sum(axis=1) + 1
    for seed in np.flatnonzero(support >= MIN_MATCHES):
        moved[chosen[follows[seed]]] = True
    return moved


def _offsets(view: Features, rows: np.ndarray) -> np.ndarray:
    """Return the image vector from each feature (row) to each (column), x + iy [rad]."""
    scale = 2 * np.pi / view.shape[1]
    x, y = view.column[rows] * scale, view.row[rows] * scale
    dx = np.angle(np.exp(1j * (x[None, :] - x[:, None])))
    return np.asarray(dx + 1j * (y[None, :] - y[:, None]))


def _angular(view: Features, pixels: np.ndarray) -> np.ndarray:
    return np.asarray(pixels * 2 * np.pi / view.shape[1])


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
