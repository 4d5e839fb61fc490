"""Joint Gaussian on landmarks and homes, and the fusion of two such maps.

The position of a place in the world is unobservable, and a joint rotation about a distant point is
linear for small angles only. The map is therefore a free network (Baarda's S-transformation): its
covariance describes its shape only, and homes are poses in it.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace

import numpy as np

from homeward.drives.drive import HomeBearing
from homeward.geometry.angles import wrap
from homeward.geometry.frames import position_sigma
from homeward.geometry.se2 import between, compose, lever, rotation, sight
from homeward.localizer.output.faces import Datum, align, rotated

DATUM_DOF = 3
"""Degrees of freedom of a rigid motion."""
RESECTION_STEPS = 8
"""Number of Gauss-Newton steps of a resection; its initial value is close to the solution."""
VAGUE_SHARE, VAGUE_TURN = 0.1, 0.3
"""Prior standard deviation of the datum when two maps are fused [share of their size; rad]: small
enough to be linear, and large enough to be uninformative next to the landmarks."""


@dataclass(frozen=True)
class JointMap:
    """Gaussian on n landmarks and h homes, in any frame."""

    names: tuple[str, ...]
    """Names of the landmarks."""
    homes: tuple[str, ...]
    mean: np.ndarray
    """(2 n + 3 h,): x, y [m] of landmarks, then x, y, heading [m, m, rad] of homes."""
    covariance: np.ndarray
    """(2 n + 3 h, 2 n + 3 h)"""

    @staticmethod
    def empty() -> JointMap:
        """Return a map without landmarks and homes."""
        return JointMap((), (), np.zeros(0), np.zeros((0, 0)))

    @property
    def positions(self) -> np.ndarray:
        """(n, 2): positions of the landmarks [m]."""
        return self.mean[: 2 * len(self.names)].reshape(-1, 2)

    @property
    def poses(self) -> np.ndarray:
        """(h, 3): poses of the homes."""
        return self.mean[2 * len(self.names) :].reshape(-1, 3)

    @property
    def size(self) -> float:
        """Longer side of the bounding box of the landmarks [m]."""
        return float(np.ptp(self.positions, axis=0).max()) if self.names else 0.0

    @property
    def sigmas(self) -> np.ndarray:
        """(n,): position uncertainty of each landmark, along its worst direction [m]."""
        at = 2 * np.arange(len(self.names))[:, None] + np.arange(2)
        return np.asarray(position_sigma(self.covariance[at[:, :, None], at[:, None, :]]))

    def columns(self, names: Collection[str]) -> np.ndarray:
        """Return the indices of the coordinates of landmarks, (2 k,), in the order of `names`."""
        index = {name: i for i, name in enumerate(self.names)}
        first = 2 * np.array([index[n] for n in names], int)
        return np.asarray((first[:, None] + np.arange(2)).ravel())

    def home_columns(self, home: str) -> np.ndarray:
        """Return the indices of the pose of a home, (3,)."""
        return 2 * len(self.names) + 3 * self.homes.index(home) + np.arange(3)

    def marginal(self, names: Collection[str], homes: Collection[str] | None = None) -> JointMap:
        """Return the marginal of some landmarks, in the map's order, and of some or all homes."""
        kept = tuple(n for n in self.names if n in names)
        stay = tuple(h for h in self.homes if homes is None or h in homes)
        at = np.concatenate([self.columns(kept), *(self.home_columns(h) for h in stay)]).astype(int)
        return JointMap(kept, stay, self.mean[at], self.covariance[np.ix_(at, at)])

    def aged(self, variance: float) -> JointMap:
        """Return the map with a variance [m^2] added to each coordinate of the landmarks."""
        covariance = self.covariance.copy()
        at = np.arange(2 * len(self.names))
        covariance[at, at] += variance
        return replace(self, covariance=covariance)

    def in_frame_of(
        self, pose: np.ndarray, covariance: np.ndarray, shared: np.ndarray | None = None
    ) -> JointMap:
        """Return the map in the frame of a pose (3,) with an error, (3, 3).

        `shared` is the covariance of the map and the pose, (2 n + 3 h, 3); None: independent.
        """
        mean, by_pose = self._transform(pose)
        spread = self._turned(pose[2], self._turned(pose[2], self.covariance).T)
        spread += by_pose @ covariance @ by_pose.T
        if shared is not None:
            of_pose = self._turned(pose[2], shared) @ by_pose.T
            spread += of_pose + of_pose.T
        return replace(self, mean=mean, covariance=0.5 * (spread + spread.T))

    def in_home_frame(self, home: str) -> JointMap:
        """Return the map in the frame of one of its homes, and without that home."""
        at = self.home_columns(home)
        own = self.covariance[np.ix_(at, at)]
        there = self.in_frame_of(self.mean[at], own, self.covariance[:, at])
        return there.marginal(self.names, [h for h in self.homes if h != home])

    def at_home(self, home: str) -> JointMap:
        """Return the map as a free network, moved so that one of its homes is the origin.

        Its datum is the mean of the landmarks, weighted by their information. The covariance
        includes only errors relative to that datum, so the covariance of the home is not zero.
        """
        there = self.in_frame_of(self.mean[self.home_columns(home)], np.zeros((3, 3)))
        n, weights = 2 * len(there.names), np.repeat(np.maximum(there.sigmas, 1e-4) ** -2.0, 2)
        by_motion = there._by_rigid_motion()
        weighted = by_motion[:n].T * weights
        datum = np.linalg.solve(weighted @ by_motion[:n], weighted)
        of_datum = there.covariance[:, :n] @ datum.T
        removed = (of_datum - 0.5 * by_motion @ (datum @ of_datum[:n])) @ by_motion.T
        return replace(there, covariance=there.covariance - removed - removed.T)

    def with_vague_datum(self) -> JointMap:
        """Return the map with an uncertain datum, which makes its covariance invertible."""
        by_motion, size = self._by_rigid_motion(), max(self.size, 1e-3)
        vague = np.square([VAGUE_SHARE * size, VAGUE_SHARE * size, VAGUE_SHARE])
        return replace(self, covariance=self.covariance + (by_motion * vague) @ by_motion.T)

    def with_vague_scale(self, sigma: float, known: JointMap | None = None) -> JointMap:
        """Return a map without homes with an additional error of its scale.

        Its direction is that of the positions in a `known` map in the same frame, where it has
        them: the errors of own positions are correlated with their innovations, which would then
        shrink the known map at each fusion.
        """
        if not (sigma and self.names):
            return self
        off = self.positions.copy()
        if known is not None:
            both = [n for n in self.names if n in known.names]
            off.ravel()[self.columns(both)] = known.mean[known.columns(both)]
        off -= off.mean(axis=0)
        return replace(self, covariance=self.covariance + sigma**2 * np.outer(off, off))

    def _by_rigid_motion(self) -> np.ndarray:
        """Return the derivative of the mean by a rigid motion about the map's centre, (m, 3)."""
        middle = np.append(self.positions.mean(axis=0), 0.0)
        return -self._transform(middle)[1]

    def _turned(self, heading: float, rows: np.ndarray) -> np.ndarray:
        """Return rows by coordinate, (2 n + 3 h, m), in a frame with a heading [rad]."""
        n, (c, s) = len(self.names), (np.cos(heading), np.sin(heading))
        first = np.concatenate([2 * np.arange(n), 2 * n + 3 * np.arange(len(self.homes))])
        turned, x, y = np.array(rows, order="C"), rows[first], rows[first + 1]
        turned[first], turned[first + 1] = c * x + s * y, c * y - s * x
        return turned

    def _transform(self, pose: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the mean in the frame of a pose, and its derivative by the pose."""
        n, h = len(self.names), len(self.homes)
        points = np.zeros((n + h, 3))
        points[:n, :2], points[n:] = self.positions, self.poses
        rows = np.concatenate(
            [np.repeat(3 * np.arange(n), 2) + np.tile([0, 1], n), np.arange(3 * n, 3 * (n + h))]
        ).astype(int)
        back = rotation(pose[2]).T
        mean = between(pose, points).ravel()[rows]
        by_pose = (-back @ lever(points - pose)).reshape(-1, 3)[rows]
        return mean, by_pose

    def with_home(
        self,
        home: str,
        seen: Mapping[str, HomeBearing],
        mounts: np.ndarray,
        pose: np.ndarray,
        covariance: np.ndarray,
    ) -> JointMap:
        """Return the map with a new home, from a resection of the bearings `seen` there.

        All k of `seen` have a sigma and are of static landmarks of the map. `mounts` (k, 3) are the
        poses of their cameras on the robot; `pose` (3,) and `covariance` (3, 3) are the prior of
        the home.
        """
        size = self.mean.size
        prior = np.concatenate([self.mean, pose])
        spread = np.zeros((size + 3, size + 3))
        spread[:size, :size], spread[size:, size:] = self.covariance, covariance
        at = np.concatenate([self.columns(list(seen)), size + np.arange(3)])
        bearings = np.array([b.bearing for b in seen.values()])
        noise = np.diag([b.sigma**2 for b in seen.values()])
        mean, k = prior, len(seen)
        jacobian = np.zeros((k, at.size))
        for _ in range(RESECTION_STEPS if k else 0):  # an iterated Kalman update
            places, robot = mean[at[:-3]].reshape(-1, 2), mean[-3:]
            eyes = compose(np.broadcast_to(robot, (k, 3)), mounts)
            now = sight(eyes, places)
            jacobian[np.arange(k), 2 * np.arange(k)] = now.by_place[:, 0]
            jacobian[np.arange(k), 2 * np.arange(k) + 1] = now.by_place[:, 1]
            by_eye = np.column_stack([-now.by_place, -np.ones(k)])
            jacobian[:, -3:] = (by_eye[:, None] @ lever(eyes - robot))[:, 0]
            residual = wrap(bearings - now.bearing) - jacobian @ (prior - mean)[at]
            correlated = spread[:, at] @ jacobian.T
            gain = np.linalg.solve(jacobian @ correlated[at] + noise, correlated.T).T
            mean = prior + gain @ residual
        if k:
            spread = spread - gain @ correlated.T
        # Homes come last, with the new one at the end.
        return JointMap(self.names, (*self.homes, home), mean, 0.5 * (spread + spread.T))


def aligned(place: JointMap, visit: JointMap) -> Datum:
    """Return the datum of a place in a visit's frame, from two or more landmarks, all in both."""
    order, positions = visit.columns(place.names), place.positions
    there, own = visit.mean[order].reshape(-1, 2), visit.covariance[np.ix_(order, order)]
    turn = rotation(align(there, positions, place.covariance + own).pose[2])[:2, :2]
    return align(there, positions, place.covariance + rotated(own, turn.T))


def datum(place: JointMap, visit: JointMap, names: Collection[str]) -> np.ndarray:
    """Return the pose (3,) of a place's frame in a visit's, from two or more common landmarks."""
    return aligned(place.marginal(names, ()).with_vague_datum(), visit).pose


def fused(
    place: JointMap, visit: JointMap, same: Collection[str], scale_sigma: float = 0.0
) -> tuple[JointMap, float]:
    """Return the fusion of two independent maps in the frame of the first, and their disagreement.

    The pose of the second map is unknown, and estimated from the landmarks at the `same` place in
    both (two or more). Landmarks and homes of only one map are kept and corrected through their
    correlations. Landmarks that moved get their position from the visit. The scale of the visit has
    an additional error, of standard deviation `scale_sigma` [1]. The disagreement is the mean
    normalised innovation squared: 1 if the maps are consistent.
    """
    pose = datum(place, visit, same)
    size = VAGUE_SHARE * max(place.size, visit.size)
    there = visit.in_frame_of(pose, np.diag(np.square([size, size, VAGUE_TURN])))
    there = there.with_vague_scale(scale_sigma, place.marginal(same, ()))
    kept = place.marginal([n for n in place.names if n in same or n not in visit.names])
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
    disagreement = float(off @ np.linalg.solve(innovation, off)) / max(off.size - DATUM_DOF, 1)
    mean, covariance = mean + gain @ off, covariance - gain @ correlated.T
    new = [name for name in there.names if name not in same]
    at = [2 * len(kept.names), n, n + 2 * len(there.names)]
    order = np.concatenate(
        [np.arange(at[0]), n + there.columns(new), np.arange(at[0], n), np.arange(at[2], n + m)]
    ).astype(int)
    covariance = covariance[np.ix_(order, order)]
    joint = JointMap(
        (*kept.names, *new),
        (*kept.homes, *there.homes),
        mean[order],
        0.5 * (covariance + covariance.T),
    )
    return joint, disagreement
