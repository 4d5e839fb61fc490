"""What else of home lies about a feature that was found again, and where it lies now.

Of a panorama's features a tenth are found again: most are not detected twice, or look like several
others. But a patch that was laid tells how what surrounds it is carried, be it detected now or not:
features and corners of home beside it are laid where its map takes them, and those beside these in
turn (Lhuillier and Quan, "Match propagation for image-based modeling and rendering", PAMI 2002).
Where they are laid, no motion is assumed: they are measurements of their own, some four times as
many as there were matches. They say nothing of whether two panoramas have anything in common,
though, since they are right or wrong together with the match by which they were found.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from homeward.vision.features.detection import View
from homeward.vision.features.patch_alignment import Alignment, lay, radius_of

NEAR = 4.0
"""A map holds within so many radii of its patch."""
GUIDES = 2
"""Of each patch, the nearest ones: that after whose map it looks most alike is believed."""
ROUNDS = 3
STEPS = 4
"""Half of what a match takes: a map begins nearer than a feature's own size and turn."""
LEAST_LIKENESS = 0.9
"""More than of a match, for which its descriptor speaks, too."""
SIGMA_TIMES = 1.6
"""How much farther off than a match that looks as alike, as was found on rendered rooms: there are
corners that nothing has, where something near ends before something far away."""
MOST_PATCHES, MOST_GUIDES = 1500, 300
"""More of a picture are thinned out evenly: its own matches tell enough, and a comparison takes no
longer than it may. Rooms have half as many with 1024 columns, as many with 2048."""
MOST_GROWTH = 10.0
"""Of an area: maps that change it more, either way, carry nothing."""


def neighbours(
    home: View, now: View, known: np.ndarray, laid: Alignment
) -> tuple[np.ndarray, Alignment]:
    """Find what lies beside features that were found.

    Parameters
    ----------
    home, now : View
        The two panoramas.
    known : ndarray of int, shape (n,)
        Features of home that were found.
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
    for _ in range(ROUNDS):
        free[guides] = False
        some = thinned(np.arange(len(guides)), MOST_GUIDES)
        others = thinned(np.flatnonzero(free), MOST_PATCHES)
        guides, laid = _beside(home, now, others, guides[some], laid[some])
        found.append((guides, laid))
    rows, parts = zip(*found, strict=True)
    laid = Alignment.joined(parts)
    return patches[np.concatenate(rows), :2].T, replace(laid, spread=SIGMA_TIMES**2 * laid.spread)


def thinned(rows: np.ndarray, most: int) -> np.ndarray:
    """Return the rows, or evenly chosen ones of too many."""
    return rows if len(rows) <= most else rows[np.arange(most) * len(rows) // most]


def _beside(
    home: View, now: View, others: np.ndarray, guides: np.ndarray, laid: Alignment
) -> tuple[np.ndarray, Alignment]:
    """Return those of other patches that lie where a guide's map takes them, and where that is."""
    at_home, size = np.split(home.patches[0], [2], axis=1)
    radius = radius_of(size[:, 0], home.picture)
    which, guide = _near(at_home[others], at_home[guides], radius[guides], home.shape[1])
    step = at_home[others[which]] - at_home[guides[guide]]
    step[:, 0] -= home.shape[1] * np.rint(step[:, 0] / home.shape[1])
    carried = (laid.shape[guide] @ step[..., None])[..., 0] + laid.place[guide]
    area = laid.area[guide]
    inside = (carried[:, 1] > 0) & (carried[:, 1] < now.shape[0] - 1)
    kept = inside & (area > 1 / MOST_GROWTH) & (area < MOST_GROWTH)
    which, start = others[which[kept]], np.dstack([laid.shape[guide], carried])[kept]
    tried = lay(home.picture, now.picture, at_home[which], size[which, 0], start, STEPS)
    alike = np.flatnonzero(tried.found & (tried.likeness > LEAST_LIKENESS))
    best_first = alike[np.argsort(-tried.likeness[alike], kind="stable")]
    rows, first = np.unique(which[best_first], return_index=True)
    return rows, tried[best_first[first]]


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
