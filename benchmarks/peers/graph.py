"""GTSAM: a factor graph of BearingFactor2D with home as one more pose.

Variables are the camera's pose at each frame, at home, and the landmarks. Odometry is Gaussian;
bearings, also those of home, have a robust kernel. With a start prior the graph is in the home
frame. Without, it is in the frame of the start, and home enters by RANSAC resection in the map.
`lag` (fixed-lag smoother) is causal, `batch` solves the graph of the whole drive.
"""

import math
from collections.abc import Mapping

import gtsam
import numpy as np

from benchmarks.peers.online import (
    Baseline,
    Belief,
    Solved,
    crossing,
    parallax,
    start_belief,
)
from benchmarks.peers.surveyed import consensus, surveyed
from homeward.drives.drive import Drive
from homeward.geometry.frames import Pose, Twist
from homeward.track import run

H = gtsam.symbol("h", 0)
LAG_S, SOLVE_S = 20.0, 1.0  # length of the smoother, and interval between its solutions [s]
CAUCHY = 1.0  # scale of the kernel [sigmas]
PARALLAX = 0.1  # angle between two sightings from which a landmark enters the graph [rad]
FLOOR = 1e-9  # added to the variances of odometry [m^2, rad^2]
SURVEY_M = 0.01  # of surveyed landmarks
WEAK = 100.0  # priors of landmarks [m] and home, whose sightings may all be outliers of the kernel
MAP_SIGMA = 0.02  # of the directions of mapped landmarks, for the resection of home [rad]
MIN_AGREEING = 5  # home bearings for that, and half of those of mapped landmarks
INLIERS = 0.99  # probability of an inlier's threshold, for GNC


def _pose2(pose: Pose) -> gtsam.Pose2:
    return gtsam.Pose2(*map(float, pose))


class FixedLag(Baseline):
    """`BatchFixedLagSmoother` over the last `LAG_S`; landmarks and home stay in the graph."""

    def __init__(self, drive: Drive, cauchy: float = CAUCHY, lag: float = LAG_S) -> None:
        super().__init__(drive)
        self.begin: Belief = (Pose(0.0, 0.0, 0.0), 1e-12 * np.eye(3))
        self.camera = _pose2(self.mount)
        plain = gtsam.noiseModel.Isotropic.Sigma(1, self.noise.bearing)
        self.plain = plain
        kernel = gtsam.noiseModel.mEstimator.Cauchy.Create(cauchy) if cauchy else None
        self.kernel = gtsam.noiseModel.Robust.Create(kernel, plain) if kernel else plain
        self.smoother = gtsam.BatchFixedLagSmoother(lag, gtsam.LevenbergMarquardtParams())
        self.home = {i: b.bearing for i, b in drive.home.items()}
        self.keys: dict[str, int] = {}
        self.waiting: dict[str, list[tuple[int, float]]] = {}
        self.last: tuple[int, gtsam.Pose2] | None = None
        self.since: Belief = (Pose(0.0, 0.0, 0.0), np.zeros((3, 3)))
        self.graph, self.values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        self.whole, self.first = gtsam.NonlinearFactorGraph(), gtsam.Values()
        self.guess: dict[int, gtsam.Pose2] = {}
        self.stamps: dict[int, float] = {}
        self.times: list[float] = []
        self.solved = -math.inf
        self.has_home = drive.settings.start is not None
        if self.has_home:
            self.begin = self.belief = start_belief(drive)
            home = _pose2(self.home_mount)
            self._add(gtsam.PriorFactorPose2(H, home, gtsam.noiseModel.Isotropic.Sigma(3, 1e-6)))
            self._value(H, home)

    def _add(self, factor: gtsam.NonlinearFactor) -> None:
        self.graph.push_back(factor)
        self.whole.push_back(factor)

    def _value(self, key: int, value: gtsam.Pose2 | np.ndarray) -> None:
        self.values.insert(key, value)
        self.first.insert(key, value)

    def move(self, twist: Twist, dt: float) -> None:
        super().move(twist, dt)
        self.since = self.noise.predicted(self.since, twist, dt)

    def _odometry(self) -> tuple[gtsam.Pose2, gtsam.noiseModel.Base]:
        """Return the camera's motion since the last frame, and its noise."""
        delta, P = _pose2(self.since[0]), self.since[1]
        turn = np.eye(3)
        turn[:2, :2] = delta.rotation().matrix().T
        motion = self.camera.inverse().compose(delta).compose(self.camera)
        adjoint = self.camera.inverse().AdjointMap() @ turn
        noise = adjoint @ P @ adjoint.T + FLOOR * np.eye(3)
        return motion, gtsam.noiseModel.Gaussian.Covariance(noise)

    def frame(self, t: float, seen: Mapping[str, float]) -> None:
        key = gtsam.symbol("x", len(self.times))
        if self.last is None:
            pose, P = self.begin
            if self.belief is not None:
                pose, P = self.belief
            here = _pose2(pose).compose(self.camera)
            turn = np.eye(3)
            turn[:2, :2] = _pose2(pose).rotation().matrix().T
            adjoint = self.camera.inverse().AdjointMap() @ turn
            noise = gtsam.noiseModel.Gaussian.Covariance(adjoint @ P @ adjoint.T)
            self._add(gtsam.PriorFactorPose2(key, here, noise))
        else:
            motion, noise = self._odometry()
            here = self.last[1].compose(motion)
            self._add(gtsam.BetweenFactorPose2(self.last[0], key, motion, noise))
        self._value(key, here)
        self.guess[key], self.stamps[key] = here, t
        self.times.append(t)
        self.last = key, here
        self.since = (Pose(0.0, 0.0, 0.0), np.zeros((3, 3)))
        for name in sorted(seen):
            if name in self.keys:
                self._sighting(key, name, seen[name])
            else:
                self._wait(t, key, name, seen[name])
        if t - self.solved >= SOLVE_S:
            self._solve(t)

    def _sighting(self, key: int, name: str, bearing: float) -> None:
        measured = gtsam.Rot2(bearing)
        self._add(gtsam.BearingFactor2D(key, self.keys[name], measured, self.kernel))

    def _wait(self, t: float, key: int, name: str, bearing: float) -> None:
        """Keep a sighting; with enough parallax, add the landmark with all of them."""
        lines = [*self.waiting.get(name, []), (key, bearing)]
        lines = [(k, b) for k, b in lines if self.stamps[k] > t - self.smoother.smootherLag() / 2]
        self.waiting[name] = lines
        eyes = [self.guess[k] for k, _ in lines]
        angles = np.array([eye.theta() + b for eye, (_, b) in zip(eyes, lines, strict=True)])
        if parallax(angles) < max(PARALLAX, 5 * self.noise.bearing):
            return
        point = crossing(np.array([eye.translation() for eye in eyes]), angles)
        if point is None:
            return
        self.keys[name] = gtsam.symbol("l", len(self.keys))
        self._value(self.keys[name], point)
        weak = gtsam.noiseModel.Isotropic.Sigma(2, WEAK)
        self._add(gtsam.PriorFactorPoint2(self.keys[name], point, weak))
        for k, b in self.waiting.pop(name):
            self._sighting(k, name, b)
        if self.has_home and name in self.home:
            self._sighting(H, name, self.home[name])

    def _solve(self, t: float) -> None:
        stay = dict.fromkeys(self.keys.values(), t) | ({H: t} if self.has_home else {})
        new = {k: s for k, s in self.stamps.items() if self.values.exists(k)}
        self.smoother.update(self.graph, self.values, stay | new)
        self.graph, self.values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        self.solved = t
        estimate = self.smoother.calculateEstimate()
        oldest = t - self.smoother.smootherLag()
        for key in [k for k, s in self.stamps.items() if s < oldest]:
            del self.stamps[key], self.guess[key]
        for name, lines in self.waiting.items():
            self.waiting[name] = [line for line in lines if line[0] in self.stamps]
        for key in self.guess:
            if estimate.exists(key):
                self.guess[key] = estimate.atPose2(key)
        key, here = self.last[0], estimate.atPose2(self.last[0])
        self.last = key, here
        if self.has_home:
            marginals = gtsam.Marginals(self.smoother.getFactors(), estimate)
            self.belief = self.robot(key, estimate, marginals)
        else:
            self._find_home(estimate)

    def _find_home(self, estimate: gtsam.Values) -> None:
        """Add home to the graph, if enough home bearings agree with one pose (RANSAC)."""
        there = {n: tuple(estimate.atPoint2(k)) for n, k in self.keys.items()}
        sigma = math.hypot(self.noise.bearing, MAP_SIGMA)
        found = consensus(there, self.home, sigma, Pose(0.0, 0.0, 0.0), None, MIN_AGREEING)
        if found is not None:
            self.has_home = True
            home, weak = _pose2(found[0]), gtsam.noiseModel.Isotropic.Sigma(3, WEAK)
            self._value(H, home)
            self._add(gtsam.PriorFactorPose2(H, home, weak))
            for name in self.keys.keys() & self.home.keys():
                self._sighting(H, name, self.home[name])

    def robot(self, key: int, solution: gtsam.Values, marginals: gtsam.Marginals) -> Belief:
        """Return the robot's pose in the home frame, and its covariance."""
        camera = solution.atPose2(H).between(solution.atPose2(key))
        joint = marginals.jointMarginalCovariance([H, key])
        back = -camera.inverse().AdjointMap()
        P = joint.at(key, key) + back @ joint.at(H, H) @ back.T
        P = P + back @ joint.at(H, key) + (back @ joint.at(H, key)).T
        pose = _pose2(self.home_mount).compose(camera).compose(self.camera.inverse())
        adjoint = self.camera.AdjointMap()
        turn = np.eye(3)
        turn[:2, :2] = pose.rotation().matrix()
        return Pose(pose.x(), pose.y(), pose.theta()), turn @ adjoint @ P @ adjoint.T @ turn.T


class SurveyedLag(FixedLag):
    """The smoother from the true start, with landmarks that are surveyed; the others are mapped."""

    def __init__(self, drive: Drive, cauchy: float = CAUCHY, lag: float = LAG_S) -> None:
        super().__init__(drive, cauchy, lag)
        self.survey = surveyed(drive)

    def _wait(self, t: float, key: int, name: str, bearing: float) -> None:
        if name not in self.survey:
            super()._wait(t, key, name, bearing)
            return
        landmark = self.keys[name] = gtsam.symbol("l", len(self.keys))
        there = np.array(self.survey[name])
        noise = gtsam.noiseModel.Isotropic.Sigma(2, SURVEY_M)
        self._add(gtsam.PriorFactorPoint2(landmark, there, noise))
        self._value(landmark, there)
        self._sighting(key, name, bearing)


class Batch(Solved):
    """The graph of a whole drive, optimised from the fixed-lag solution."""

    def __init__(self, drive: Drive, cauchy: float = CAUCHY, gnc: bool = False) -> None:
        super().__init__(drive)
        online = follow_lag(drive, 0.0 if gnc else cauchy)
        graph, first = online.whole, online.first
        if gnc:
            parameters = gtsam.GncLMParams(gtsam.LevenbergMarquardtParams())
            bearings = [isinstance(graph.at(i), gtsam.BearingFactor2D) for i in range(graph.size())]
            parameters.setKnownInliers([i for i, is_one in enumerate(bearings) if not is_one])
            optimiser = gtsam.GncLMOptimizer(graph, first, parameters)
            optimiser.setInlierCostThresholdsAtProbability(INLIERS)
            solution, weights = optimiser.optimize(), optimiser.getWeights()
            kept = gtsam.NonlinearFactorGraph()
            for i in np.flatnonzero(np.asarray(weights) > 0.5):
                kept.push_back(graph.at(int(i)))
            graph = kept
        else:
            solution = gtsam.LevenbergMarquardtOptimizer(graph, first).optimize()
        if not online.has_home:
            return
        marginals = gtsam.Marginals(graph, solution)
        for k, t in enumerate(online.times):
            key = gtsam.symbol("x", k)
            self.solved[t] = online.robot(key, solution, marginals)


def follow_lag(drive: Drive, cauchy: float) -> FixedLag:
    """Return a fixed-lag smoother after a drive; its first values are those of that time."""
    estimator = FixedLag(drive, cauchy)
    run(drive, estimator)
    return estimator


def lag(drive: Drive) -> FixedLag:
    return FixedLag(drive)


def lag_started(drive: Drive) -> FixedLag:
    return FixedLag(drive)


def batch(drive: Drive) -> Batch:
    return Batch(drive)


def batch_gaussian(drive: Drive) -> Batch:
    return Batch(drive, 0.0)


def batch_gnc(drive: Drive) -> Batch:
    return Batch(drive, gnc=True)


lag_started.needs_start = True
