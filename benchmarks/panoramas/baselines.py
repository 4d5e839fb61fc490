"""Two ways without features, as baselines: the image difference compass and min-warping."""

from __future__ import annotations

import math

import numpy as np


def compass(home: np.ndarray, now: np.ndarray) -> float:
    """Return the heading now in the home frame [rad]: the turn of the least image difference.

    Zeil, Hofmann and Chahl, "Catchment areas of panoramic snapshots in outdoor scenes", JOSA A
    2003.
    """
    a, b = _centred(home), _centred(now)
    # Correlation over all turns at once, row by row.
    spectrum = np.fft.rfft(a, axis=1) * np.conj(np.fft.rfft(b, axis=1))
    likeness = np.fft.irfft(spectrum.sum(axis=0), a.shape[1])
    shift = int(likeness.argmax())
    angle = 2 * math.pi * shift / a.shape[1]
    # Columns run clockwise: a scene shifted to the right by `shift` is a turn to the right.
    return -math.remainder(angle, math.tau)


def min_warping(home: np.ndarray, now: np.ndarray) -> tuple[float, float]:
    """Return heading now and direction of home from now [rad].

    Search over heading, direction and, per column, distance (Moeller, Krzykawski and Gerstmayr,
    "Three 2D-warping schemes for visual robot navigation", Auton. Robots 2010): a column at home
    that lies at x to the direction of travel is looked for at every y now that triangulates, at
    the least cost; the costs are summed over the columns.
    """
    a, b = _centred(_shrunk(home)), _centred(_shrunk(now))
    width = a.shape[1]
    cost = 1.0 - _normal(a).T @ _normal(b)
    columns = np.arange(width)
    best = (math.inf, 0.0, 0.0)
    allowed = _allowed(width)
    for turn in range(width):
        turned = cost[:, (columns + turn) % width]
        for travel in range(0, width, 2):
            place = (columns + travel) % width
            rolled = turned[place[:, None], place]
            total = float(np.where(allowed, rolled, np.inf).min(axis=1).sum())
            if total < best[0]:
                best = (total, turn, travel)
    _, turn, travel = best
    step = math.tau / width
    heading = math.remainder(turn * step, math.tau)
    away = (width / 2 - 0.5 - travel) * step
    return heading, math.remainder(away + math.pi - heading, math.tau)


def _allowed(width: int) -> np.ndarray:
    """Return which column now a column at home may move to, both counted from the travel."""
    x = np.arange(width)
    # A point at x to the right of the travel moves on to the right, never beyond the back.
    x, y = x[:, None], x[None, :]
    right = (x <= width // 2) & (y >= x) & (y <= width // 2)
    left = (x > width // 2) & (y <= x) & (y > width // 2)
    grown = np.abs(y - x) <= width // 6
    return (right | left) & grown


def _shrunk(image: np.ndarray, width: int = 72) -> np.ndarray:
    """Return an image of `width` columns, by the mean of its columns."""
    edges = np.linspace(0, image.shape[1], width + 1).astype(int)[:-1]
    sizes = np.diff(np.append(edges, image.shape[1]))
    return np.add.reduceat(image.astype(float), edges, axis=1) / sizes


def _centred(image: np.ndarray) -> np.ndarray:
    return image - image.mean(axis=1, keepdims=True)


def _normal(image: np.ndarray) -> np.ndarray:
    return image / np.maximum(np.linalg.norm(image, axis=0, keepdims=True), 1e-9)
