"""What else of home lies about a feature that was found again, and where it lies now.

Of a panorama's features a tenth are found again: most are not detected twice, or look like several
others. But a patch that was laid tells how what surrounds it is carried, be it detected now or not:
features of home beside it are laid where its map takes them, and those beside these in turn
(Lhuillier and Quan, "Match propagation for image-based modeling and rendering", PAMI 2002). No
motion is assumed in that: they are measurements of their own, two to three times as many as there
were matches. They say nothing of whether two panoramas have anything in common, though, since they
are right or wrong together with the match by which they were found.
"""

from __future__ import annotations

import numpy as np

from homeward.vision.alignment import Alignment, lay, radius_of
from homeward.vision.features import View

NEAR = 4.0
"""A map holds within so many radii of its patch."""
GUIDES = 2
"""Of each feature, the nearest ones: that after whose map it looks most alike is believed."""
ROUNDS = 2
STEPS = 4
"""Half of what a match takes: a map begins nearer than a feature's own size and turn."""
LEAST_LIKENESS = 0.9
"""More than of a match, for which its descriptor speaks, too."""
MOST_FEATURES, MOST_GUIDES = 1500, 300
"""More of a picture are thinned out evenly: its own matches tell enough, and a comparison takes no
longer than it may. Rooms have half as many, even with 2048 columns."""
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
    rows : ndarray of int, shape (m,)
        Other features of home, at other places.
    laid : Alignment
        Where they lie now.
    """
    others, found = _thinned(_others(home, known), MOST_FEATURES), []
    for _ in range(ROUNDS):
        guides = _thinned(np.arange(len(known)), MOST_GUIDES)
        known, laid = _beside(home, now, others, known[guides], laid[guides])
        others = np.setdiff1d(others, known, assume_unique=True)
        found.append((known, laid))
    rows, parts = zip(*found, strict=True)
    return np.concatenate(rows), Alignment.joined(parts)


def _others(home: View, known: np.ndarray) -> np.ndarray:
    """Return the features of home at other places than the known ones, one of each place."""
    order = np.concatenate([known, np.delete(np.arange(len(home)), known)])
    place = home.column[order].round() + 1j * home.row[order].round()
    first = np.unique(place, return_index=True)[1]
    return np.sort(order[first[first >= len(known)]])


def _thinned(rows: np.ndarray, most: int) -> np.ndarray:
    """Return the rows, or evenly chosen ones of too many."""
    return rows if len(rows) <= most else rows[np.arange(most) * len(rows) // most]


def _beside(
    home: View, now: View, others: np.ndarray, guides: np.ndarray, laid: Alignment
) -> tuple[np.ndarray, Alignment]:
    """Return those of the others that lie where a guide's map takes them, and where that is."""
    which, guide, step = _near(home, others, guides)
    carried = (laid.shape[guide] @ step[..., None])[..., 0] + laid.place[guide]
    area = laid.area[guide]
    inside = (carried[:, 1] > 0) & (carried[:, 1] < now.shape[0] - 1)
    kept = inside & (area > 1 / MOST_GROWTH) & (area < MOST_GROWTH)
    which, start = others[which[kept]], np.dstack([laid.shape[guide], carried])[kept]
    at_home = np.column_stack([home.column[which], home.row[which]])
    tried = lay(home.picture, now.picture, at_home, home.size[which], start, STEPS)
    alike = np.flatnonzero(tried.found & (tried.likeness > LEAST_LIKENESS))
    best_first = alike[np.argsort(-tried.likeness[alike], kind="stable")]
    rows, first = np.unique(which[best_first], return_index=True)
    return rows, tried[best_first[first]]


def _near(
    home: View, others: np.ndarray, guides: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return which others lie near which guides, (k,) places in both, and steps there, (k, 2)."""
    width = home.shape[1]
    # Guides down, others across: what is least in each column is found fastest.
    across = home.column[others] - home.column[guides, None]
    across -= width * np.rint(across / width)
    down = home.row[others] - home.row[guides, None]
    apart = (across**2 + down**2) / radius_of(home.size[guides, None], home.picture) ** 2
    farther = apart.copy()
    for _ in range(min(GUIDES, len(guides)) - 1):
        farther[farther.argmin(axis=0), np.arange(len(others))] = np.inf
    near = (apart < NEAR**2) & (apart <= farther.min(axis=0, initial=np.inf))
    which, guide = np.nonzero(near.T)  # what is laid after several maps, in turn
    return which, guide, np.column_stack([across[guide, which], down[guide, which]])
