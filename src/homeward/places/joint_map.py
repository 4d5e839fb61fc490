"""Joint map: one Gaussian on landmarks and homes, and how two of them become one.

Where a place lies nobody knows, and a Gaussian of places that turn together round a far point is
linear for small turns alone. So the map of a place is that of a free network (Baarda's
S-transformation): its uncertainty is that of its shape, and homes are poses in it.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace

import numpy as np

from homeward.drives.drive import HomeBearing
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose, position_sigma
from homeward.geometry.se2 import between, compose, lever, rotation, sight
from homeward.localizer.output.map_snapshot import align, rotated

DATUM = 3
"""Unknowns of a rigid motion."""
RESECTIONS = 8
"""Gauss-Newton steps of a resection, which begins near its end."""
VAGUE_SHARE, VAGUE_TURN = 0.1, 0.3
"""A datum is taken to be so uncertain before two maps are fused [of their size; rad]: linear as
yet, and so much more than the landmarks leave of it that it tells nothing."""


@dataclass(frozen=True)
class JointMap:
    """A Gaussian on n landmarks and h homes, in any frame."""

    names: tuple[str, ...]
    """Of the landmarks."""
    homes: tuple[str, ...]
    mean: np.ndarray
    """(2 n + 3 h,): x, y [m] of landmarks, then x, y, heading [m, m, rad] of homes."""
    covariance: np.ndarray
    """(2 n + 3 h, 2 n + 3 h)"""

    @staticmethod
    def empty() -> JointMap:
        """Return one of nothing."""
        return JointMap((), (), np.zeros(0), np.zeros((0, 0)))

    @property
    def positions(self) -> np.ndarray:
        """(n, 2), of the landmarks [m]."""
        return self.mean[: 2 * len(self.names)].reshape(-1, 2)

    @property
    def poses(self) -> np.ndarray:
        """(h, 3), of the homes."""
        return self.mean[2 * len(self.names) :].reshape(-1, 3)

    @property
    def size(self) -> float:
        """The longer side of the box round the landmarks [m]."""
        return float(np.ptp(self.positions, axis=0).max()) if self.names else 0.0

    @property
    def sigmas(self) -> np.ndarray:
        """(n,): standard deviation of each landmark's place, along its worst direction [m]."""
        at = 2 * np.arange(len(self.names))[:, None] + np.arange(2)
        return np.asarray(position_sigma(self.covariance[at[:, :, None], at[:, None, :]]))

    def columns(self, names: Collection[str]) -> np.ndarray:
        """Return where the coordinates of landmarks are, (2 k,), in the order of `names`."""
        index = {name: i for i, name in enumerate(self.names)}
        first = 2 * np.array([index[n] for n in names], int)
        return np.asarray((first[:, None] + np.arange(2)).ravel())

    def home_columns(self, home: str) -> np.ndarray:
        """Return where the pose of a home is, (3,)."""
        return 2 * len(self.names) + 3 * self.homes.index(home) + np.arange(3)

    def only(self, names: Collection[str], homes: Collection[str] | None = None) -> JointMap:
        """Return what it says of some landmarks, in its own order, and of some homes, or all."""
        kept = tuple(n for n in self.names if n in names)
        stay = tuple(h for h in self.homes if homes is None or h in homes)
        at = np.concatenate([self.columns(kept), *(self.home_columns(h) for h in stay)]).astype(int)
        return JointMap(kept, stay, self.mean[at], self.covariance[np.ix_(at, at)])

    def aged(self, variance: float) -> JointMap:
        """Return it with each landmark's coordinates less certain, by a variance [m^2]."""
        covariance = self.covariance.copy()
        at = np.arange(2 * len(self.names))
        covariance[at, at] += variance
        return replace(self, covariance=covariance)

    def seen_from(self, pose: np.ndarray, covariance: np.ndarray) -> JointMap:
        """Return it in the frame of a pose (3,) that is uncertain by itself, (3, 3)."""
        mean, by_self, by_pose = self._seen_from(pose)
        spread = by_self @ self.covariance @ by_self.T + by_pose @ covariance @ by_pose.T
        return replace(self, mean=mean, covariance=0.5 * (spread + spread.T))

    def seen_from_home(self, home: str) -> JointMap:
        """Return it in the frame of one of its homes, which is the origin then, and surely so."""
        at = self.home_columns(home)
        mean, jacobian, by_pose = self._seen_from(self.mean[at])
        jacobian[:, at] += by_pose
        spread = jacobian @ self.covariance @ jacobian.T
        there = replace(self, mean=mean, covariance=0.5 * (spread + spread.T))
        return there.only(self.names, [h for h in self.homes if h != home])

    def at_home(self, home: str) -> JointMap:
        """Return it moved as a whole so that one of its homes is the origin, as a free network.

        What is uncertain is what the landmarks, more of them the surer ones, cannot tell of each
        other and of homes; the mean of a home's pose is exact in no other sense.
        """
        there = self.seen_from(self.mean[self.home_columns(home)], np.zeros((3, 3)))
        n, weights = 2 * len(there.names), np.repeat(np.maximum(there.sigmas, 1e-4) ** -2.0, 2)
        swing = there._swing()
        weighted = swing[:n].T * weights
        project = np.eye(there.mean.size)
        project[:, :n] -= swing @ np.linalg.solve(weighted @ swing[:n], weighted)
        return replace(there, covariance=project @ there.covariance @ project.T)

    def loose(self) -> JointMap:
        """Return it anywhere within sight of where it is; then its covariance has an inverse."""
        swing, size = self._swing(), max(self.size, 1e-3)
        vague = np.square([VAGUE_SHARE * size, VAGUE_SHARE * size, VAGUE_SHARE])
        return replace(self, covariance=self.covariance + (swing * vague) @ swing.T)

    def _swing(self) -> np.ndarray:
        """Return how everything moves with a motion of the whole round its middle, (m, 3)."""
        middle = np.append(self.positions.mean(axis=0), 0.0)
        return -self._seen_from(middle)[2]

    def _seen_from(self, pose: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the mean in the frame of a pose, and its derivatives by itself and the pose."""
        n, h = len(self.names), len(self.homes)
        points = np.zeros((n + h, 3))
        points[:n, :2], points[n:] = self.positions, self.poses
        rows = np.concatenate(
            [np.repeat(3 * np.arange(n), 2) + np.tile([0, 1], n), np.arange(3 * n, 3 * (n + h))]
        ).astype(int)
        back = rotation(pose[2]).T
        mean = between(pose, points).ravel()[rows]
        by_pose = (-back @ lever(points - pose)).reshape(-1, 3)[rows]
        by_self = np.kron(np.eye(n + h), back)[np.ix_(rows, rows)]
        return mean, by_self, by_pose

    def with_home(
        self,
        home: str,
        seen: Mapping[str, HomeBearing],
        mount: Pose,
        pose: np.ndarray,
        covariance: np.ndarray,
    ) -> JointMap:
        """Return it with a home: a resection from what was `seen` there, in this map.

        All of `seen` are bearings, with deviations, of landmarks of the map that stand in place.
        `mount` is the camera on the robot; `pose` (3,) and `covariance` (3, 3) are the robot's
        without these bearings.
        """
        size = self.mean.size
        prior = np.concatenate([self.mean, pose])
        spread = np.zeros((size + 3, size + 3))
        spread[:size, :size], spread[size:, size:] = self.covariance, covariance
        at = np.concatenate([self.columns(list(seen)), size + np.arange(3)])
        bearings = np.array([b.bearing for b in seen.values()])
        noise = np.diag([b.sigma**2 for b in seen.values()])
        mean, k, camera = prior, len(seen), np.array(mount)
        jacobian = np.zeros((k, at.size))
        for _ in range(RESECTIONS if k else 0):  # an iterated Kalman update
            places, robot = mean[at[:-3]].reshape(-1, 2), mean[-3:]
            eye = compose(robot, camera)
            now = sight(eye, places)
            jacobian[np.arange(k), 2 * np.arange(k)] = now.by_place[:, 0]
            jacobian[np.arange(k), 2 * np.arange(k) + 1] = now.by_place[:, 1]
            by_eye = np.column_stack([-now.by_place, -np.ones(k)])
            jacobian[:, -3:] = by_eye @ lever(eye - robot)
            residual = wrap(bearings - now.bearing) - jacobian @ (prior - mean)[at]
            correlated = spread[:, at] @ jacobian.T
            gain = np.linalg.solve(jacobian @ correlated[at] + noise, correlated.T).T
            mean = prior + gain @ residual
        if k:
            spread = spread - gain @ correlated.T
        # Homes come last, and this one after all others.
        return JointMap(self.names, (*self.homes, home), mean, 0.5 * (spread + spread.T))


def datum(place: JointMap, visit: JointMap, names: Collection[str]) -> np.ndarray:
    """Return the pose (3,) of a place's frame in that of a visit, by common landmarks (two)."""
    mine, order = place.only(names, ()).loose(), visit.columns(place.only(names).names)
    there, own = visit.mean[order].reshape(-1, 2), visit.covariance[np.ix_(order, order)]
    turn = rotation(align(there, mine.positions, mine.covariance).pose[2])[:2, :2]
    return align(there, mine.positions, mine.covariance + rotated(own, turn.T)).pose


def fused(place: JointMap, visit: JointMap, same: Collection[str]) -> tuple[JointMap, float]:
    """Return the fusion of two independent maps in the frame of the first, and their disagreement.

    The second lies anywhere; where it does follows from the landmarks that are the `same`, two at
    least. What one of them alone knows is kept, corrected by what both know. Landmarks of both that
    are not the same are taken from the visit. The disagreement is the mean square of deviations in
    standard deviations: one if all is right.
    """
    pose = datum(place, visit, same)
    size = VAGUE_SHARE * max(place.size, visit.size)
    there = visit.seen_from(pose, np.diag(np.square([size, size, VAGUE_TURN])))
    kept = place.only([n for n in place.names if n in same or n not in visit.names])
    n, m = kept.mean.size, there.mean.size
    mean = np.concatenate([kept.mean, there.mean])
    covariance = np.zeros((n + m, n + m))
    covariance[:n, :n], covariance[n:, n:] = kept.covariance, there.covariance
    both = [name for name in kept.names if name in same]
    mine, theirs = kept.columns(both), n + there.columns(both)
    off = mean[theirs] - mean[mine]
    correlated = covariance[:, mine] - covariance[:, theirs]
    innovation = correlated[mine] - correlated[theirs]
    gain = np.linalg.solve(innovation, correlated.T).T
    disagreement = float(off @ np.linalg.solve(innovation, off)) / max(off.size - DATUM, 1)
    mean, covariance = mean + gain @ off, covariance - gain @ correlated.T
    new = [name for name in there.names if name not in same]
    at = [2 * len(kept.names), n, n + 2 * len(there.names)]
    order = np.concatenate(
        [np.arange(at[0]), n + there.columns(new), np.arange(at[0], n), np.arange(at[2], n + m)]
    ).astype(int)
    covariance = covariance[np.ix_(order, order)]
    both_say = JointMap(
        (*kept.names, *new),
        (*kept.homes, *there.homes),
        mean[order],
        0.5 * (covariance + covariance.T),
    )
    return both_say, disagreement
