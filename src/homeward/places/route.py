"""A route: the way of a drive through a place, to be driven again.

Teach once, repeat many: what keeps a repeat near the taught way is the place's localiser, which
corrects the pose by bearings all along it (Krajnik et al., "Navigation without localisation", 2018,
show that correcting the heading alone suffices for that; a map corrects all three).
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
from homeward.io.table import quoted
from homeward.places.joint_map import JointMap
from homeward.track import Track

SPACING, TURN = 0.5, 0.2
"""A node comes after so far [m], or such a turn [rad]: the chord of an arc of radius r that turns
by that is off it by r / 200, less than a pose is; and half a metre is little beside the distance of
landmarks, so that nodes follow those which they see."""
LEAST_STEP = 0.05
"""Nodes are this far apart at least [m]: on the spot there is no way."""
STILL_S, STILL_M, STILL_TURN = 1.0, 0.03, 0.05
"""A robot that moves and turns less than so much in so long stands [s, m, rad]."""
LEAST_DWELL = 2.0
"""Where it stood for so long there is a way point; less is a hesitation [s]."""
NEAREST = 0.5
"""Landmarks nearer than this count no more than there [m]."""


@dataclass(frozen=True)
class Node:
    """A pose on a route, in the frame of the place's first home."""

    x: float
    y: float
    heading: float
    """[rad]"""
    sigma: float
    """How uncertain its place was when it was taught, along the worst direction [m]."""
    waypoint: str = ""
    """The name of the way point, if it is one."""
    dwell: float = 0.0
    """To stand there [s]."""


@dataclass(frozen=True)
class Route:
    """A chain of poses to be driven along; see `taught`."""

    taught: float
    """When [days since 1970]."""
    nodes: tuple[Node, ...]
    """Two at least."""

    @property
    def poses(self) -> np.ndarray:
        """(n, 3): x, y [m], heading [rad] of the nodes."""
        return np.array([(n.x, n.y, n.heading) for n in self.nodes])

    @property
    def length(self) -> float:
        """How long it is [m]."""
        return float(np.hypot(*np.diff(self.poses[:, :2], axis=0).T).sum())

    @property
    def waypoints(self) -> tuple[Node, ...]:
        """Those with a name."""
        return tuple(n for n in self.nodes if n.waypoint)

    @property
    def path(self) -> Path:
        """What a `homeward.control.following.Follower` drives along."""
        last = len(self.nodes) - 1
        stops = [
            (i, n.heading, n.dwell, n.waypoint)
            for i, n in enumerate(self.nodes)
            if n.waypoint or i == last
        ]
        return Path(self.poses[:, :2], stops)

    def carried(self, before: JointMap, after: JointMap, same: Sequence[str]) -> Route:
        """Return the route in another map, in which its landmarks are elsewhere or seen anew.

        It is in the frame of `before`, and is to be in that of `after`; landmarks of both that did
        not move are the `same`, two at least. Each node moves as the landmarks round it do, all
        together: one at distance d tells it by a bearing that an error across it turns by the error
        over d, so it weighs 1 / d^2.
        """
        at = [m.columns(same).reshape(-1, 2) for m in (before, after)]
        p, q = (m.mean[c] @ [1.0, 1.0j] for m, c in zip((before, after), at, strict=True))
        nodes = []
        for node in self.nodes:
            here = complex(node.x, node.y)
            weight = 1.0 / np.maximum(np.abs(p - here), NEAREST) ** 2
            p0, q0 = np.average(p, weights=weight), np.average(q, weights=weight)
            turn = np.vdot(p - p0, weight * (q - q0))
            turn = turn / abs(turn) if turn else 1.0
            there = q0 + turn * (here - p0)
            heading = float(wrap(node.heading + np.angle(turn)))
            nodes.append(replace(node, x=float(there.real), y=float(there.imag), heading=heading))
        return replace(self, nodes=tuple(nodes))


def route_of(routes: Mapping[str, Route], name: str) -> Route:
    """Return a route by its name, else raise `InputError`."""
    if name not in routes:
        there = f"there are {', '.join(routes)}" if routes else "there is none"
        raise InputError(f"no route {quoted(name)}; {there}")
    return routes[name]


def seen_along(landmarks: Iterable[LandmarkEstimate]) -> JointMap:
    """Return where landmarks are, in the frame of the answers, without their uncertainty."""
    known = {m.landmark: (m.x, m.y) for m in landmarks if np.isfinite(m.x)}
    mean = np.array(list(known.values())).ravel()
    return JointMap(tuple(known), (), mean, np.zeros((mean.size, mean.size)))


def taught(track: Track, when: float) -> Route:
    """Return the path of a track, best a smoothed one, as a route; stops are way points.

    `HomewardError` where poses are missing on the way, or it leads nowhere.
    """
    rows = np.flatnonzero(track.has_pose)
    t, poses = track.t[rows], np.column_stack([track.x, track.y, track.heading])[rows]
    return taught_along(t, poses, position_sigma(track.covariance[rows]), when)


def taught_along(t: np.ndarray, poses: np.ndarray, sigmas: np.ndarray, when: float) -> Route:
    """Return the path along poses (n, 3) at times `t` (n,) [s] as a route; see `taught`.

    `sigmas` (n,) are position uncertainties along the worst direction [m].
    """
    stood = stands(t, poses)
    picked = _picked(poses, [row for row, _ in stood])
    if len(picked) < 2:
        raise HomewardError("this drive leads nowhere, so there is no route to keep")
    for a, b in pairwise(picked):
        if (gap := float(np.diff(t[a : b + 1]).max())) > STILL_S:
            raise HomewardError(
                f"the drive did not know where it was for {gap:.1f} s on its way, so there is no "
                "route to keep"
            )
    if (least := float(sigmas[picked].max())) > LOOKAHEAD:
        raise HomewardError(
            f"the drive knew its way to {least:.2f} m only, so there is no route to keep"
        )
    dwells, names = dict(stood), {row: str(i) for i, (row, _) in enumerate(stood, 1)}
    nodes = []
    for i in picked:
        x, y, heading = poses[i].tolist()
        sigma, dwell = round(float(sigmas[i]), 4), round(dwells.get(i, 0.0), 1)
        nodes.append(Node(x, y, heading, sigma, names.get(i, ""), dwell))
    return Route(when, tuple(nodes))


def _picked(poses: np.ndarray, stops: Sequence[int]) -> list[int]:
    """Return the rows of poses, (n, 3), that become nodes: both ends, the stops, and in between."""
    if not len(poses):
        return []
    picked, stop, end = [0], set(stops), len(poses) - 1
    for i, pose in enumerate(poses):
        last = poses[picked[-1]]
        step, turn = np.hypot(*(pose - last)[:2]), abs(wrap(pose[2] - last[2]))
        if i in stop or step > SPACING or (turn > TURN and step > LEAST_STEP):
            picked.append(i)
    near = np.hypot(*(poses[end] - poses[picked[-1]])[:2]) < LEAST_STEP
    if near and (len(picked) == 1 or picked[-1] in stop):
        return picked
    return [*(picked[:-1] if near else picked), end]


def stands(t: np.ndarray, poses: np.ndarray) -> list[tuple[int, float]]:
    """Return the last rows of stops on the way, and how long they were [s].

    `t` (n,) [s] and poses (n, 3) are those of the drive. Where the robot stood before it set out,
    and at its end, nobody made it wait.
    """
    later = np.minimum(np.searchsorted(t, t + STILL_S), t.size - 1)
    moved = np.hypot(*(poses[later] - poses)[:, :2].T)
    still = (moved < STILL_M) & (np.abs(wrap(poses[later, 2] - poses[:, 2])) < STILL_TURN)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], still, [0]])))
    spells = [(a, b) for a, b in edges.reshape(-1, 2).tolist() if a > 0 and b < t.size]
    long = [(b - 1, float(t[later[b - 1]] - t[a])) for a, b in spells]
    return [(row, dwell) for row, dwell in long if dwell >= LEAST_DWELL]
