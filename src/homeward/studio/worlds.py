"""The set of worlds that the bearings of a drive so far cannot tell apart."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from homeward.errors import InputError
from homeward.geometry.frames import Pose, compose
from homeward.lab.observability.scene import Scene
from homeward.lab.observability.study import observe_scene, trace_family
from homeward.lab.simulation.live_robot import LiveRobot

MOST_POSES = 40
"""So many views tell what hundreds tell."""
MOST_KEPT = 10 * MOST_POSES


class Views:
    """Views spread evenly over a drive, a few hundred however long it is."""

    def __init__(self) -> None:
        self.kept: list[tuple[Pose, frozenset[str]]] = []
        """True poses of the robot in the home frame, and the ids that were seen from each."""
        self._count, self._every = 0, 1

    def add(self, pose: Pose, seen: frozenset[str]) -> None:
        """Take what was seen next."""
        if self._count % self._every == 0:
            self.kept.append((pose, seen))
        self._count += 1
        if len(self.kept) > MOST_KEPT:
            self.kept, self._every = self.kept[::2], 2 * self._every


def worlds_alike(robot: LiveRobot, views: Sequence[tuple[Pose, frozenset[str]]]) -> dict[str, Any]:
    """Return homes and landmarks of other worlds in which all was seen as it was, and words.

    Parameters
    ----------
    robot : LiveRobot
        In its world.
    views : sequence
        True poses of the robot in the home frame, and the ids that were seen from each.

    Raises
    ------
    InputError
        When nothing was seen yet.
    """
    world, few = robot.world, views[:: max(1, len(views) // MOST_POSES)]
    seen = [i for i in world.ids if any(i in ids for _, ids in few)]
    if not seen:
        raise InputError("nothing was seen yet: drive first")
    settings = robot.drive.settings
    poses = [compose(pose, settings.sensor.pose) for pose, _ in few]
    scene = Scene(
        names=tuple(seen),
        home=np.array(settings.home_mount.pose, float),
        landmarks=world.in_home_frame[[world.ids.index(i) for i in seen]],
        poses=np.array(poses, float),
        visible=np.array([[i in ids for i in seen] for _, ids in few]),
        stored=np.array([i in robot.drive.home and i not in world.moved for i in seen]),
    )
    view = observe_scene("", scene)
    curves = trace_family(scene)

    def placed(points: np.ndarray) -> list[list[float]]:
        x, y, _ = compose(world.home, Pose(points[:, 0], points[:, 1], 0.0))
        return [[float(a), float(b)] for a, b in zip(x, y, strict=True)]

    words = [freedom.words for freedom in view.freedoms]
    return {
        "words": words or ["Nothing: home and all landmarks that were seen are told."],
        "homes": [placed(curve.homes) for curve in curves],
        "landmarks": [
            [placed(m) for m in curve.landmarks(len(seen)).transpose(1, 0, 2)] for curve in curves
        ],
    }
