"""Peer of the nights: a laser scanner, and localisation by scan matching in the map of day 0.

The map is made of scans at true poses. A scan is taken at one moment, without delay. Each is
matched to the map by GICP (small_gicp), beginning at the pose that odometry predicts from the last
match.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import mujoco
import numpy as np
import small_gicp

from examples.warehouse.world import World
from homeward.drives.drive import Odometry
from homeward.geometry.frames import Pose, between, compose
from homeward.odometry.history import dead_reckoning

BEAMS, RANGE_M, NOISE_M = 360, 10.0, 0.01
HEIGHT_M = 0.22
"""Height of the scanner, at which it sees the boxes on the floor and in the lowest shelves [m]."""
LAYERS_M = (-0.05, 0.0, 0.05)
"""Copies of each point above and below it, so that a wall is a plane for GICP [m]."""
VOXEL_M = 0.05
MAX_MATCH_M = 0.5
"""Maximum distance of matched points [m]: of 0.3, 0.5 and 1.0 the best on seed 20."""


@dataclass(frozen=True)
class Scan:
    """Points at time `t` [s], (n, 2) in the robot's frame [m], and the true pose."""

    t: float
    points: np.ndarray
    truth: Pose


class LaserPeer:
    """The first robot's scans of a day, and where scan matching puts them."""

    def __init__(self, world: World, seed: int) -> None:
        self._world, self._rng = world, np.random.default_rng([seed, 8])
        self._scans: list[Scan] = []
        self._map: _Map | None = None
        angle = np.arange(BEAMS) * (math.tau / BEAMS)
        self._beams = np.stack([np.cos(angle), np.sin(angle)], axis=1)

    def scan(self, truth: Pose) -> None:
        """Take a scan all round now; `truth` is the robot's true pose in the home frame."""
        world, robot = self._world, self._world.robots[0]
        x, y, heading = robot.pose
        c, s = math.cos(heading), math.sin(heading)
        rays = np.pad(self._beams @ np.array([[c, s], [-s, c]]), ((0, 0), (0, 1)))
        hit, distance = np.zeros(BEAMS, np.int32), np.zeros(BEAMS)
        mujoco.mj_multiRay(
            world.model, world.data, np.array([x, y, HEIGHT_M]), rays.ravel(), None, 1, robot.body,
            hit, distance, None, BEAMS, RANGE_M,
        )  # fmt: skip
        is_hit = hit >= 0
        far = distance[is_hit] + NOISE_M * self._rng.standard_normal(is_hit.sum())
        self._scans.append(Scan(world.t, self._beams[is_hit] * far[:, None], truth))

    def rmse(self, odometry: Odometry) -> float:
        """Return the position RMSE of the day [m], and begin the next day."""
        scans, self._scans = self._scans, []
        if self._map is None:
            self._map = _Map(scans)
        error = np.subtract(self._map.poses(scans, odometry), [s.truth for s in scans])[:, :2]
        return float(np.sqrt(np.mean(np.sum(error**2, axis=1))))


class _Map:
    """Map of scans at true poses."""

    def __init__(self, scans: list[Scan]) -> None:
        points = [np.column_stack(compose(s.truth, Pose(*s.points.T, 0.0))[:2]) for s in scans]
        self._points, self._tree = _prepared(np.concatenate(points))

    def poses(self, scans: list[Scan], odometry: Odometry) -> list[Pose]:
        """Return the pose at each scan in the home frame, from the true pose at the first."""
        reckoned = np.column_stack(dead_reckoning(odometry, np.array([s.t for s in scans])))
        found = [scans[0].truth]
        for (before, now), scan in zip(pairwise(reckoned), scans[1:], strict=True):
            predicted = compose(found[-1], between(Pose(*before), Pose(*now)))
            found.append(self._match(scan, predicted))
        return found

    def _match(self, scan: Scan, predicted: Pose) -> Pose:
        """Return the pose of a scan; the predicted one where the match does not converge."""
        c, s = math.cos(predicted.heading), math.sin(predicted.heading)
        guess = np.eye(4)
        guess[:2, :2], guess[:2, 3] = ((c, -s), (s, c)), predicted[:2]
        result = small_gicp.align(
            self._points, _prepared(scan.points)[0], self._tree, guess,
            max_correspondence_distance=MAX_MATCH_M,
        )  # fmt: skip
        if not result.converged:
            return predicted
        there = result.T_target_source
        return Pose(*there[:2, 3].tolist(), math.atan2(there[1, 0], there[0, 0]))


def _prepared(points: np.ndarray) -> tuple[small_gicp.PointCloud, small_gicp.KdTree]:
    """Return points (n, 2) for GICP, and their tree."""
    layers = [np.column_stack([points, np.full(len(points), z)]) for z in LAYERS_M]
    cloud, tree = small_gicp.preprocess_points(np.concatenate(layers), VOXEL_M)
    return cloud, tree
