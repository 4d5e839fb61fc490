"""The antworld data set, a grid of rendered panoramas: direction home.

The baselines are two methods without features: the image difference compass and min-warping.
"""

import csv
import math
from functools import cache

import numpy as np

from benchmarks.mrclam import data
from homeward.geometry.angles import wrap
from homeward.vision import Equirectangular, Features, compare, extract
from homeward.vision.cameras.image_files import read_grey

CAMERA = Equirectangular(horizon=0.8, tilt_sigma=0.005)
"""Rendered without tilt; the horizon was read from the pictures."""
NORTH = math.pi / 2  # direction of the middle column of the pictures


class Grid:
    def __init__(self) -> None:
        folder = data() / "antworld_rendered"
        with (folder / "grid.csv").open(encoding="utf-8", newline="") as stream:
            rows = list(csv.DictReader(stream, skipinitialspace=True))
        self.files = [folder / "grid" / row["Filename"].strip() for row in rows]
        place = np.array([[float(row["X [mm]"]), float(row["Y [mm]"])] for row in rows]) / 1e3
        cell = np.rint((place - place.min(axis=0)) / 0.1).astype(int)
        self.place = place
        self.at = {tuple(c): k for k, c in enumerate(cell.tolist())}
        self.view = cache(self._view)

    def image(self, k: int) -> np.ndarray:
        return read_grey(self.files[k])

    def _view(self, k: int) -> Features:
        return extract(self.image(k), CAMERA)

    def home_direction(self, home: int, now: int) -> float:
        """Return the true direction of home from the camera's axis [rad]."""
        x, y = self.place[home] - self.place[now]
        return math.atan2(y, x) - NORTH

    def pairs(self, steps: int, count: int, seed: int = 0) -> list[tuple[int, int]]:
        """Return pairs `steps` cells apart along a row or column of the grid."""
        rng, found = np.random.default_rng(seed), []
        ways = ((steps, 0), (-steps, 0), (0, steps), (0, -steps))
        while len(found) < count:
            a = tuple(rng.integers(0, 31, 2).tolist())
            way = ways[int(rng.integers(4))]
            b = (a[0] + way[0], a[1] + way[1])
            if b in self.at:
                found.append((self.at[a], self.at[b]))
        return found


def degrees_off(angle: float, truth: float) -> float:
    return abs(math.degrees(wrap(angle - truth)))


def antworld(count: int) -> None:
    grid = Grid()
    for steps in (1, 2, 3, 5):
        pairs = grid.pairs(steps, count)
        off, heading, refused, warped, turned = [], [], 0, [], []
        for home, now in pairs:
            seen = compare(grid.view(home), grid.view(now), CAMERA)
            truth = grid.home_direction(home, now)
            if seen.has_direction:
                off.append(degrees_off(seen.home_direction, truth))
                heading.append(degrees_off(seen.heading, 0.0))
            else:
                refused += 1
        for home, now in pairs[: max(count // 4, 10)]:
            a, b = grid.image(home), grid.image(now)
            turned.append(degrees_off(compass(a, b), 0.0))
            warped.append(degrees_off(min_warping(a, b)[1], grid.home_direction(home, now)))
        print(
            f"antworld, {steps / 10:.1f} m: accepted {1 - refused / count:.0%} of {count}; "
            f"direction home {np.mean(off):.1f} deg mean, {np.median(off):.1f} median, "
            f"{np.max(off):.0f} worst; heading {np.mean(heading):.1f} mean | "
            f"min-warping {np.mean(warped):.0f} mean, {np.median(warped):.0f} median; "
            f"image difference compass (heading) {np.mean(turned):.1f} mean, "
            f"{np.median(turned):.1f} median"
        )


def compass(home: np.ndarray, now: np.ndarray) -> float:
    """Return the heading now in the home frame [rad]: the rotation of least image difference.

    Zeil, Hofmann and Chahl, "Catchment areas of panoramic snapshots in outdoor scenes", JOSA A
    2003.
    """
    a, b = _centred(home), _centred(now)
    # Correlation for all rotations at once, row by row.
    spectrum = np.fft.rfft(a, axis=1) * np.conj(np.fft.rfft(b, axis=1))
    correlation = np.fft.irfft(spectrum.sum(axis=0), a.shape[1])
    shift = int(correlation.argmax())
    angle = 2 * math.pi * shift / a.shape[1]
    # Columns run clockwise: a scene shifted to the right by `shift` is a rotation to the right.
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
    """Return the columns now that a column at home may move to, both relative to the travel."""
    x = np.arange(width)
    # A point to the right of the direction of travel moves further right, up to the back.
    x, y = x[:, None], x[None, :]
    right = (x <= width // 2) & (y >= x) & (y <= width // 2)
    left = (x > width // 2) & (y <= x) & (y > width // 2)
    grown = np.abs(y - x) <= width // 6
    return (right | left) & grown


def _shrunk(image: np.ndarray, width: int = 72) -> np.ndarray:
    edges = np.linspace(0, image.shape[1], width + 1).astype(int)[:-1]
    sizes = np.diff(np.append(edges, image.shape[1]))
    return np.add.reduceat(image.astype(float), edges, axis=1) / sizes


def _centred(image: np.ndarray) -> np.ndarray:
    return image - image.mean(axis=1, keepdims=True)


def _normal(image: np.ndarray) -> np.ndarray:
    return image / np.maximum(np.linalg.norm(image, axis=0, keepdims=True), 1e-9)
