"""Groups of outliers that share a similarity transform: objects that were moved.

The features of one object keep their arrangement. Position, size and orientation of a match's two
features give the similarity that maps the object from one panorama to the other (Lowe, "Distinctive
image features from scale-invariant keypoints", IJCV 2004, section 7.3). If enough outliers nearby
have the same similarity, they are assumed to be one object.
"""

from __future__ import annotations

import numpy as np

from homeward.vision.features.detection import Features

NEAR = 0.35
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
        & (np.abs(a) < NEAR)
        & (np.abs(b) < NEAR)
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
