"""Route: the path of a drive through a place, which a robot can repeat (teach and repeat).

Localisation in the place keeps a repeat near the taught path. (Krajnik et al., "Navigation without
localisation", 2018, show that correcting only the heading suffices; a map corrects the pose.)
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from homeward.control.following import LOOKAHEAD, Path
from homeward.errors import HomewardError, InputError
from homeward.estimator import LandmarkEstimate
from homeward.geometry.angles import wrap
from homeward.geometry.frames import position_sigma
from homeward.geometry.se2 import MIN_SQUARED_DISTANCE
from homeward.io.table import quoted
from homeward.places.joint_map import JointMap
from homeward.track import Track

NODE_SPACING, NODE_TURN = 0.5, 0.2
"""Distance [m] or rotation [rad] between nodes. The chord of an arc of radius r and this rotation
deviates from it by r / 200, less than the error of a pose. The distance is small next to that of
landmarks, so that nodes can move with the landmarks that are seen from them."""
MIN_STEP = 0.05
"""Minimum distance of nodes [m]."""
STILL_S, STILL_M, STILL_TURN = 1.0, 0.03, 0.05
"""A robot is stopped if it moves and rotates less than this in this time [s, m, rad]."""
MIN_DWELL_S = 2.0
"""Minimum duration of a stop that becomes a way point [s]."""
MIN_DISTANCE = 0.5
"""Nearer landmarks get the weight of this distance [m]."""


@dataclass(frozen=True)
class Node:
    """Pose on a route, in the frame of the place's first home."""

    x: float
    y: float
    heading: float
    """[rad]"""
    sigma: float
    """Position uncertainty when it was taught, along the worst direction [m]."""
    waypoint: str = ""
    """Name of the way point; empty for other nodes."""
    dwell: float = 0.0
    """Duration of the stop here [s]."""


@dataclass(frozen=True)
class Route:
    """Path through two or more poses; see `taught`."""

    taught: float
    """[days since 1970]"""
    nodes: tuple[Node, ...]

    @property
    def poses(self) -> np.ndarray:
        """(n, 3): x, y [m] and heading [rad] of the nodes."""
        return np.array([(n.x, n.y, n.heading) for n in self.nodes])

    @property
    def length(self) -> float:
        """Length of the path [m]."""
        return float(np.hypot(*np.diff(self.poses[:, :2], axis=0).T).sum())

    @property
    def waypoints(self) -> tuple[Node, ...]:
        """Nodes that are way points."""
        return tuple(n for n in self.nodes if n.waypoint)

    @property
    def path(self) -> Path:
        """The path for a `homeward.control.following.Follower`."""
        last = len(self.nodes) - 1
        stops = [
            (i, n.heading, n.dwell, n.waypoint)
            for i, n in enumerate(self.nodes)
            if n.waypoint or i == last
        ]
        return Path(self.poses[:, :2], stops)

    def transferred(self, before: JointMap, after: JointMap, same: Sequence[str]) -> Route:
        """Return the route in the frame of another map of the same place.

        Each node moves rigidly with the landmarks in the `same` place in both maps (two or more).
        A position error e rotates the bearing of a landmark at distance d by e / d, so the weight
        of a landmark is 1 / d^2.
        """
        at = [m.columns(same).reshape(-1, 2) for m in (before, after)]
        p, q = (m.mean[c] @ [1.0, 1.0j] for m, c in zip((before, after), at, strict=True))
        nodes = []
        for node in self.nodes:
            here = complex(node.x, node.y)
            weight = 1.0 / np.maximum(np.abs(p - here), MIN_DISTANCE) ** 2
            p0, q0 = np.average(p, weights=weight), np.average(q, weights=weight)
            turn = np.vdot(p - p0, weight * (q - q0))
            # Landmarks at one place give no direction, although rounding has one.
            has_turn = abs(turn) > MIN_SQUARED_DISTANCE * weight.sum()
            turn = turn / abs(turn) if has_turn else 1.0
            there = q0 + turn * (here - p0)
            heading = float(wrap(node.heading + np.angle(turn)))
            nodes.append(replace(node, x=float(there.real), y=float(there.imag), heading=heading))
        return replace(self, nodes=tuple(nodes))


def route_of(routes: Mapping[str, Route], name: str) -> Route:
    """Return a route by its name; `InputError` if there is none."""
    if name not in routes:
        there = f"there are {', '.join(routes)}" if routes else "there are no routes"
        raise InputError(f"no route {quoted(name)}; {there}")
    return routes[name]


def map_of_estimates(landmarks: Iterable[LandmarkEstimate]) -> JointMap:
    """Return the map of estimated landmarks, with zero covariance."""
    known = {m.landmark: (m.x, m.y) for m in landmarks if np.isfinite(m.x)}
    mean = np.array(list(known.values())).ravel()
    return JointMap(tuple(known), (), mean, np.zeros((mean.size, mean.size)))


def taught(track: Track, when: float) -> Route:
    """Return the path of a track, preferably smoothed, as a route; stops become way points.

    `HomewardError` if poses are missing or uncertain, or the robot did not move.
    """
    rows = np.flatnonzero(track.has_pose)
    t, poses = track.t[rows], np.column_stack([track.x, track.y, track.heading])[rows]
    return taught_along(t, poses, position_sigma(track.covariance[rows]), when)


def taught_along(t: np.ndarray, poses: np.ndarray, sigmas: np.ndarray, when: float) -> Route:
    """Return poses (n, 3) at times `t` (n,) [s] as a route; see `taught`.

    `sigmas` (n,) are position uncertainties along the worst direction [m].
    """
    stopped = stops(t, poses)
    rows = _node_rows(poses, [row for row, _ in stopped])
    if len(rows) < 2:
        raise HomewardError("no route to store: the robot did not move on this drive")
    for a, b in pairwise(rows):
        if (gap := float(np.diff(t[a : b + 1]).max())) > STILL_S:
            raise HomewardError(f"no route to store: the drive has no pose for {gap:.1f} s")
    if (sigma := float(sigmas[rows].max())) > LOOKAHEAD:
        raise HomewardError(
            f"no route to store: poses are uncertain by {sigma:.2f} m, and the limit is "
            f"{LOOKAHEAD:g} m"
        )
    dwells, names = dict(stopped), {row: str(i) for i, (row, _) in enumerate(stopped, 1)}
    nodes = []
    for i in rows:
        x, y, heading = poses[i].tolist()
        sigma, dwell = round(float(sigmas[i]), 4), round(dwells.get(i, 0.0), 1)
        nodes.append(Node(x, y, heading, sigma, names.get(i, ""), dwell))
    return Route(when, tuple(nodes))


def _node_rows(poses: np.ndarray, stopped: Sequence[int]) -> list[int]:
    """Return the rows of poses, (n, 3), that become nodes; these include both ends and stops."""
    if not len(poses):
        return []
    rows, stop, end = [0], set(stopped), len(poses) - 1
    for i, pose in enumerate(poses):
        last = poses[rows[-1]]
        step, turn = np.hypot(*(pose - last)[:2]), abs(wrap(pose[2] - last[2]))
        if i in stop or step > NODE_SPACING or (turn > NODE_TURN and step > MIN_STEP):
            rows.append(i)
    near = np.hypot(*(poses[end] - poses[rows[-1]])[:2]) < MIN_STEP
    if near and (len(rows) == 1 or rows[-1] in stop):
        return rows
    return [*(rows[:-1] if near else rows), end]


def stops(t: np.ndarray, poses: np.ndarray) -> list[tuple[int, float]]:
    """Return the last row and the duration [s] of each stop, given times (n,) and poses (n, 3).

    Stops at the start and the end of the drive do not count.
    """
    later = np.minimum(np.searchsorted(t, t + STILL_S), t.size - 1)
    moved = np.hypot(*(poses[later] - poses)[:, :2].T)
    still = (moved < STILL_M) & (np.abs(wrap(poses[later, 2] - poses[:, 2])) < STILL_TURN)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], still, [0]])))
    spells = [(a, b) for a, b in edges.reshape(-1, 2).tolist() if a > 0 and b < t.size]
    long = [(b - 1, float(t[later[b - 1]] - t[a])) for a, b in spells]
    return [(row, dwell) for row, dwell in long if dwell >= MIN_DWELL_S]
