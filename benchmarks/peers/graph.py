"""GTSAM: a fixed-lag factor graph of BearingFactor2D, with home by resection in its map.

Variables are the camera's pose at each frame and the landmarks, in the frame of the start. Odometry
is Gaussian; bearings have a Cauchy kernel with the usual scale for 95 % efficiency. Home is found
again from all mapped landmarks at each solution, so that a wrong one does not last. A landmark
whose latest sightings all contradict its position has moved, and becomes a new variable.
"""

import math
from collections.abc import Mapping

import gtsam
import numpy as np

from benchmarks.peers.online import Baseline, Belief
from homeward.drives.drive import Drive
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose, Twist

LAG_S, SOLVE_S = 20.0, 1.0  # length of the smoother, and interval between its solutions [s]
CAUCHY = 2.385  # scale of the kernel [sigmas]
PARALLAX = 0.1  # angle between two sightings from which a landmark enters the graph [rad]
FLOOR = 1e-9  # added to the variances of odometry [m^2, rad^2]
WEAK = 100.0  # priors of landmarks, whose sightings may all be outliers of the kernel [m]
LATEST, CONTRADICT = 5, 5.0  # number of sightings of a landmark that moved, and their residual
NOTHING = Pose(0.0, 0.0, 0.0), np.zeros((3, 3))


def _pose2(pose: Pose) -> gtsam.Pose2:
    return gtsam.Pose2(*map(float, pose))


def _turned(pose: gtsam.Pose2) -> np.ndarray:
    """Return the rotation from the frame of a pose to that of the map, for (x, y, heading)."""
    turn = np.eye(3)
    turn[:2, :2] = pose.rotation().matrix()
    return turn


class FixedLag(Baseline):
    """`BatchFixedLagSmoother` over the last `LAG_S`; landmarks stay in the graph."""

    def __init__(self, drive: Drive) -> None:
        super().__init__(drive)
        self.camera = _pose2(self.mount)
        kernel = gtsam.noiseModel.mEstimator.Cauchy.Create(CAUCHY)
        plain = gtsam.noiseModel.Isotropic.Sigma(1, self.noise.bearing)
        self.kernel = gtsam.noiseModel.Robust.Create(kernel, plain)
        self.smoother = gtsam.BatchFixedLagSmoother(LAG_S, gtsam.LevenbergMarquardtParams())
        self.graph, self.values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        self.keys: dict[str, int] = {}  # of the landmarks
        self.waiting: dict[str, list[tuple[int, float]]] = {}
        """Frames and bearings of landmarks that are not in the graph yet."""
        self.latest: dict[str, list[tuple[int, float]]] = {}
        self.last: tuple[int, gtsam.Pose2] | None = None
        self.since: Belief = NOTHING
        self.guess: dict[int, gtsam.Pose2] = {}  # of the camera, by frame
        self.stamps: dict[int, float] = {}
        self.frames = self.landmarks_made = 0
        self.solved = -math.inf

    def move(self, twist: Twist, dt: float) -> None:
        super().move(twist, dt)
        self.since = self.noise.predicted(self.since, twist, dt)

    def frame(self, t: float, seen: Mapping[str, float]) -> None:
        key = gtsam.symbol("x", self.frames)
        self.frames += 1
        if self.last is None:
            here = self.camera
            tight = gtsam.noiseModel.Isotropic.Sigma(3, 1e-6)
            self.graph.push_back(gtsam.PriorFactorPose2(key, here, tight))
        else:
            delta, P = _pose2(self.since[0]), self.since[1]
            motion = self.camera.inverse().compose(delta).compose(self.camera)
            adjoint = self.camera.inverse().AdjointMap() @ _turned(delta).T
            covariance = adjoint @ P @ adjoint.T + FLOOR * np.eye(3)
            noise = gtsam.noiseModel.Gaussian.Covariance(covariance)
            here = self.last[1].compose(motion)
            self.graph.push_back(gtsam.BetweenFactorPose2(self.last[0], key, motion, noise))
        self.values.insert(key, here)
        self.guess[key], self.stamps[key] = here, t
        self.last, self.since = (key, here), NOTHING
        for name in sorted(seen):
            if name in self.keys:
                self._sighting(key, name, seen[name])
            else:
                self._wait(t, key, name, seen[name])
        if t - self.solved >= SOLVE_S:
            self._solve(t)

    def _sighting(self, key: int, name: str, bearing: float) -> None:
        measured, landmark = gtsam.Rot2(bearing), self.keys[name]
        self.graph.push_back(gtsam.BearingFactor2D(key, landmark, measured, self.kernel))
        self.latest[name] = [*self.latest.get(name, []), (key, bearing)][-LATEST:]

    def _wait(self, t: float, key: int, name: str, bearing: float) -> None:
        """Keep a sighting; with enough parallax, add the landmark with all of them."""
        lines = [*self.waiting.get(name, []), (key, bearing)]
        lines = [(k, b) for k, b in lines if self.stamps.get(k, -math.inf) > t - LAG_S / 2]
        self.waiting[name] = lines
        eyes = [self.guess[k] for k, _ in lines]
        angles = np.array([eye.theta() + b for eye, (_, b) in zip(eyes, lines, strict=True)])
        if np.ptp(wrap(angles - angles[0])) < max(PARALLAX, 5 * self.noise.bearing):
            return
        point = _crossing(np.array([eye.translation() for eye in eyes]), angles)
        if point is None:
            return
        self.keys[name] = gtsam.symbol("l", self.landmarks_made)
        self.landmarks_made += 1
        self.values.insert(self.keys[name], point)
        weak = gtsam.noiseModel.Isotropic.Sigma(2, WEAK)
        self.graph.push_back(gtsam.PriorFactorPoint2(self.keys[name], point, weak))
        for k, b in self.waiting.pop(name):
            self._sighting(k, name, b)

    def _solve(self, t: float) -> None:
        stay = dict.fromkeys(self.keys.values(), t)
        new = {k: s for k, s in self.stamps.items() if self.values.exists(k)}
        self.smoother.update(self.graph, self.values, stay | new)
        self.graph, self.values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        self.solved = t
        estimate = self.smoother.calculateEstimate()
        for key in [k for k, s in self.stamps.items() if s < t - LAG_S]:
            del self.stamps[key], self.guess[key]
        for name, lines in self.waiting.items():
            self.waiting[name] = [line for line in lines if line[0] in self.stamps]
        for key in self.guess:
            if estimate.exists(key):
                self.guess[key] = estimate.atPose2(key)
        self.last = self.last[0], estimate.atPose2(self.last[0])
        for name in [n for n in self.keys if self._has_moved(n, estimate)]:
            del self.keys[name]
            self.waiting[name] = self.latest.pop(name)
            self.replaced.add(name)
        if self.keys:
            self._locate(estimate)

    def _has_moved(self, name: str, estimate: gtsam.Values) -> bool:
        """Return whether all latest sightings of a landmark contradict its position."""
        lines = [(k, b) for k, b in self.latest[name] if k in self.guess]
        point = estimate.atPoint2(self.keys[name])
        off = [wrap(self.guess[k].bearing(point).theta() - b) for k, b in lines]
        far = np.abs(off) > CONTRADICT * self.noise.bearing
        return len(lines) == LATEST and bool(far.all())

    def _locate(self, estimate: gtsam.Values) -> None:
        """Find home in the map of a solution."""
        key, here = self.last
        marginals = gtsam.Marginals(self.smoother.getFactors(), estimate)
        joint = marginals.jointMarginalCovariance([key, *self.keys.values()]).fullMatrix()
        robot = here.compose(self.camera.inverse())
        local = np.eye(len(joint))
        local[:3, :3] = _turned(robot) @ self.camera.AdjointMap()
        places = {n: np.asarray(estimate.atPoint2(k)) for n, k in self.keys.items()}
        pose = Pose(robot.x(), robot.y(), robot.theta())
        self.locate(pose, places, local @ joint @ local.T)


def _crossing(eyes: np.ndarray, angles: np.ndarray) -> np.ndarray | None:
    """Return the point nearest to lines from `eyes` (n, 2) at `angles` (n,); None if behind one."""
    across = np.column_stack([-np.sin(angles), np.cos(angles)])
    point = np.linalg.lstsq(across, (across * eyes).sum(axis=1), rcond=None)[0]
    ahead = ((point - eyes) * np.column_stack([np.cos(angles), np.sin(angles)])).sum(axis=1)
    return np.asarray(point) if (ahead > 0).all() else None


def lag(drive: Drive) -> FixedLag:
    return FixedLag(drive)
