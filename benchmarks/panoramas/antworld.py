"""The antworld grid of panoramas (rendered by others): direction home, and home along keyframes."""

from __future__ import annotations

import csv
import math
from functools import cache

import numpy as np

from benchmarks.mrclam import data
from benchmarks.panoramas.baselines import compass, min_warping
from homeward.geometry.angles import wrap
from homeward.vision import Equirectangular, Features, compare, extract
from homeward.vision.cameras.image_files import read_grey

CAMERA = Equirectangular(horizon=0.8, tilt_sigma=0.005)
"""Rendered without any tilt; the horizon was read off the pictures."""
NORTH = math.pi / 2
"""The middle column of the pictures looks along y."""
BLIND_AT_MOST = 3
"""A robot that has recognised no keyframe for so many steps stops."""


class Grid:
    """The antworld grid."""

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
        """Return pairs so many cells apart along a row or column of the grid."""
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
    """Goal 2: direction home in the antworld, beside the baselines."""
    grid = Grid()
    for steps in (1, 2, 3, 5):
        pairs = grid.pairs(steps, count)
        off, heading, refused, warped, turned = [], [], 0, [], []
        for home, now in pairs:
            seen, truth = (
                compare(grid.view(home), grid.view(now), CAMERA),
                grid.home_direction(home, now),
            )
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


def chained(grid: Grid, first: int = 0, routes: int = 12) -> None:
    """Goal 2, second part: along a path of 1.5 m, home again from keyframe to keyframe."""
    ends = [back_along_keyframes(grid, seed) for seed in range(first, first + routes)]
    off, taken, blind = np.array(ends).T
    print(
        f"antworld, chain: from 1.5 m back along keyframes 0.1 m apart, {np.sum(off <= 0.1)} of "
        f"{routes} ended within 0.1 m of home; {np.median(taken):.0f} steps of 0.1 m or 0.14 m, "
        f"{np.median(blind):.0f} of them as remembered (medians)"
    )


def back_along_keyframes(grid: Grid, seed: int) -> tuple[float, int, int]:
    """Drive back along a path of the grid.

    Each keyframe is kept with the way that odometry told from it to the one before. Where no
    keyframe nearer home tells a direction, that way is driven, turned by what the image says of the
    heading. The robot is at a keyframe when no parallax shows: one whose direction is merely
    uncertain may still be far. Returned are the distance from home at the end [m], the steps taken,
    and how many of them were driven as remembered.
    """
    rng = np.random.default_rng(seed)
    row, start = int(rng.integers(0, 31)), int(rng.integers(0, 16))
    path = [(start + k, row) if seed % 2 else (row, start + k) for k in range(16)]
    here, goal, taken, blind, unseen = np.array(path[-1]), len(path) - 2, 0, 0, 0
    while taken < 60 and unseen < BLIND_AT_MOST and tuple(here.tolist()) in grid.at:
        now = grid.view(grid.at[tuple(here.tolist())])
        window = range(max(goal - 2, 0), min(goal + 3, len(path)))
        seen = {g: compare(grid.view(grid.at[path[g]]), now, CAMERA) for g in window}
        accepted = [g for g in window if seen[g].accepted]
        reached = [g for g in accepted if not seen[g].shows_parallax]
        if reached and reached[0] == 0:
            break
        goal = min([goal, *(g - 1 for g in reached)])
        known = [g for g in window if seen[g].has_direction and g <= goal + 1]
        if known:
            way, unseen = seen[known[0]].home_direction + NORTH, 0
        else:
            leg = np.subtract(path[goal], path[goal + 1])
            turned = seen[accepted[0]].heading if accepted else 0.0
            way = math.atan2(leg[1], leg[0]) - turned
            goal, blind, unseen = max(goal - 1, 0), blind + 1, 0 if accepted else unseen + 1
        here = here + np.rint([math.cos(way), math.sin(way)]).astype(int)
        taken += 1
    return 0.1 * float(np.hypot(*(here - path[0]))), taken, blind
