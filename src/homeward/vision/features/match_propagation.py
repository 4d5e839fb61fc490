"""Match propagation: patches beside a match are aligned by its affine map.

Lhuillier and Quan, "Match propagation for image-based modeling and rendering", PAMI 2002. A tenth
of a panorama's features are matched: most are not detected twice, or look like several others. But
the map of an aligned patch predicts where its neighbours lie, detected now or not; they are aligned
from there, and theirs in turn. No motion is assumed, so that these are measurements of their own,
some four for each match. They are right or wrong together with the match that led to them: whether
two panoramas have anything in common, they do not tell.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from homeward.vision.features.detection import Features
from homeward.vision.features.patch_alignment import STEPS, Alignment, align_patches, radius_of

NEAR = 4.0
"""A map is used within so many radii of its patch."""
GUIDES = 2
"""So many maps, of the nearest patches, are tried; that of the best correlation counts."""
MIN_LIKENESS = 0.9
"""More than of a match, which its descriptor supports, too."""
SIGMA_TIMES = 1.6
"""Standard deviation of a place, beside that of a match of the same correlation. Measured on
rendered rooms: corners of which the near side moves and the far side does not, stand on no
point."""
MAX_PATCHES, MAX_GUIDES = 1500, 300
"""Of more, every n-th is used, so that the time is bounded. Rooms have half as many with 1024
columns, as many with 2048."""
MAX_GROWTH = 10.0
"""Maps that change an area by a larger factor, either way, are not used."""


def propagate_matches(
    home: Features, now: Features, known: np.ndarray, laid: Alignment
) -> tuple[np.ndarray, Alignment]:
    """Align patches of home that lie beside matched features.

    Parameters
    ----------
    home, now : Features
        The two panoramas.
    known : ndarray of int, shape (n,)
        Features of home that were matched.
    laid : Alignment
        Where they lie now.

    Returns
    -------
    places : ndarray, shape (2, m)
        Columns and rows of other patches of home [px].
    laid : Alignment
        Where they lie now.
    """
    (patches, of), found = home.patches, []
    guides = of[known]
    free = np.ones(len(patches), bool)
    for _ in range(3):
        free[guides] = False
        some = thinned(np.arange(len(guides)), MAX_GUIDES)
        others = thinned(np.flatnonzero(free), MAX_PATCHES)
        guides, laid = _beside(home, now, others, guides[some], laid.rows(some))
        found.append((guides, laid))
    rows, parts = zip(*found, strict=True)
    laid = Alignment.joined(parts)
    return patches[np.concatenate(rows), :2].T, replace(laid, spread=SIGMA_TIMES**2 * laid.spread)


def thinned(rows: np.ndarray, most: int) -> np.ndarray:
    """Return the rows, or evenly chosen ones of too many."""
    return rows if len(rows) <= most else rows[np.arange(most) * len(rows) // most]


def _beside(
    home: Features, now: Features, others: np.ndarray, guides: np.ndarray, laid: Alignment
) -> tuple[np.ndarray, Alignment]:
    """Return those of other patches that lie where a guide's map takes them, and where that is."""
    at_home, size = np.split(home.patches[0], [2], axis=1)
    radius = radius_of(size[:, 0], home.pyramid)
    which, guide = _near(at_home[others], at_home[guides], radius[guides], home.shape[1])
    step = at_home[others[which]] - at_home[guides[guide]]
    step[:, 0] -= home.shape[1] * np.rint(step[:, 0] / home.shape[1])
    carried = (laid.shape[guide] @ step[..., None])[..., 0] + laid.place[guide]
    area = laid.area[guide]
    inside = (carried[:, 1] > 0) & (carried[:, 1] < now.shape[0] - 1)
    kept = inside & (area > 1 / MAX_GROWTH) & (area < MAX_GROWTH)
    which, start = others[which[kept]], np.dstack([laid.shape[guide], carried])[kept]
    tried = align_patches(
        home.pyramid, now.pyramid, at_home[which], size[which, 0], start, STEPS // 2
    )
    alike = np.flatnonzero(tried.found & (tried.likeness > MIN_LIKENESS))
    best_first = alike[np.argsort(-tried.likeness[alike], kind="stable")]
    rows, first = np.unique(which[best_first], return_index=True)
    return rows, tried.rows(best_first[first])


def _near(
    others: np.ndarray, guides: np.ndarray, radius: np.ndarray, width: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return which others, (n, 2), lie near which guides, (m, 2) of a radius: rows of both, (k,).

    On a cylinder: the panorama is closed, and near is as near there as on the picture.
    """
    one, other = _on_cylinder(guides, width), _on_cylinder(others, width)
    # Guides down, others across: what is least in each column is found fastest.
    apart = one @ (-2 * other.T)
    apart += (one**2).sum(axis=1)[:, None]
    apart += (other**2).sum(axis=1)
    apart /= (NEAR * radius[:, None]) ** 2
    columns, nearest = np.arange(len(others)), []
    for _ in range(min(GUIDES, len(guides))):
        best = apart.argmin(axis=0)
        nearest.append(np.where(apart[best, columns] < 1, best, -1))
        apart[best, columns] = np.inf
    guide = np.array(nearest, int).reshape(len(nearest), len(others)).T  # several maps, in turn
    which = np.nonzero(guide >= 0)[0]
    return which, guide[guide >= 0]


def _on_cylinder(places: np.ndarray, width: int) -> np.ndarray:
    """Return places of a panorama, (n, 2), rolled up: (n, 3) [px]."""
    turn = 2 * math.pi / width
    across = places[:, 0] * turn
    return np.column_stack([np.cos(across) / turn, np.sin(across) / turn, places[:, 1]])
