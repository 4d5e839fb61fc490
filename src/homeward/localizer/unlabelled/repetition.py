"""Repetition: whether landmarks elsewhere are a copy of those at home, as in equal rooms.

A home that fits the map may be a copy of the true one, which is not mapped yet. The map shows how
probable that is: if places repeat, landmarks out of view from home are copies of those in view,
moved by one shift and rotation. This hypothesis is compared with that of independent positions.
"""

from __future__ import annotations

import math

import numpy as np

from homeward.geometry.angles import TWO_PI
from homeward.localizer.tunables import COPIED, DETECTED, INLIER, MAX_SCORED, NUM_CELLS
from homeward.localizer.unlabelled.constellation import Match, Sky


def log_repetition(sky: Sky, found: Match, kinds: np.ndarray) -> float:
    """Return the log Bayes factor that landmarks out of view from a home are copies.

    Each pair of these may be a copy of each pair in view, which determines shift and rotation. A
    copy has the class (n,) of its landmark, where both have one.
    """
    at, variance = sky.points @ [1.0, 1j], 0.5 * sky.covariances.trace(axis1=1, axis2=2)
    home = complex(*found.pose[:2])
    in_view = np.abs(at - home) < sky.reach
    in_view[found.landmark[found.landmark >= 0]] = True
    a, b = np.flatnonzero(in_view), np.flatnonzero(~in_view)
    none = b.size * math.log(1.0 - COPIED)
    if min(a.size, b.size) < 2:
        return none
    area = _area_out_of_view(sky, home)
    (i, j), (k, m) = np.argwhere(~np.eye(a.size, dtype=bool)).T, np.triu_indices(b.size, 1)
    same = (kinds[a, None] == kinds[b]) | (kinds[a, None] == "") | (kinds[b] == "")
    number = np.maximum(same.sum(axis=0), 1)
    of, copy = at[a[j]] - at[a[i]], (at[b[m]] - at[b[k]])[:, None]
    off, own = np.abs(copy) - np.abs(of), variance[a[i]] + variance[a[j]]
    own = own + (variance[b[k]] + variance[b[m]])[:, None]
    fits = (off**2 < INLIER**2 * own) & same[i, k[:, None]] & same[j, m[:, None]]
    pairs = np.argwhere(fits)[:: max(np.count_nonzero(fits) // MAX_SCORED, 1)]
    if not len(pairs):
        return none
    share, (q, p) = np.count_nonzero(fits) / len(pairs) / k.size, pairs.T
    length, own, off = np.abs(of[p]), own[q, p], off[q, p]
    gain = 2.0 * math.log(COPIED) - 0.5 * (off**2 / own + np.log(TWO_PI * own))
    gain -= np.log(TWO_PI * length / area * number[k[q]] * np.maximum(number[m[q]] - 1, 1))
    middle = 0.5 * (at[a[i[p]]] + at[a[j[p]]])[:, None]
    turn = np.exp(1j * np.angle(copy[q, 0] / of[p]))[:, None]
    copies = 0.5 * (at[b[k[q]]] + at[b[m[q]]])[:, None] + turn * (at[a] - middle)
    error = own[:, None] * (0.25 + np.abs(at[a] - middle) ** 2 / length[:, None] ** 2)
    total = (error + variance[a])[..., None] + variance
    square = np.abs(copies[..., None] - at) ** 2 / total
    density = np.exp(-0.5 * square[..., b]) / (TWO_PI * total[..., b])
    each = np.log1p(COPIED * (area * (density * same / number).sum(axis=1) - 1.0))
    each[np.arange(len(pairs)), k[q]] = each[np.arange(len(pairs)), m[q]] = 0.0
    is_missing = (square > INLIER**2).all(axis=2) & (np.abs(copies - home) < sky.reach)
    gain += each.sum(axis=1) + is_missing.sum(axis=1) * math.log(1.0 - DETECTED)
    return float(np.logaddexp(none, np.logaddexp.reduce(gain) + math.log(share)))


def _area_out_of_view(sky: Sky, home: complex) -> float:
    """Return the area of the map out of view from a home [m^2], by a grid of its bounds.

    In a larger one, landmarks of no copy would be less dense, and any two would seem to be copies.
    """
    low, high = sky.points.min(axis=0), sky.points.max(axis=0)
    x, y = np.linspace(low, high, NUM_CELLS).T
    is_out = np.abs(x + 1j * y[:, None] - home) > sky.reach
    return float((high - low).prod() * max(is_out.mean(), 1.0 / NUM_CELLS))
