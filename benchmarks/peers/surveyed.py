"""Peers with a surveyed map: an iterated EKF from the true start, and multi-tag resection.

Both are given the true positions of all landmarks when home was stored; the EKF also the start.
"""

import math
from collections.abc import Mapping

import numpy as np

from benchmarks.peers.online import (
    GATE,
    INLIER_SIGMAS,
    STEPS,
    Baseline,
    Belief,
    residuals,
    sight,
    start_belief,
)
from homeward.drives.drive import Drive
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose, compose, inverse
from homeward.localizer.resection import poses_from_triples

GATE_3 = 16.27  # 99.9 % quantile of chi-square with three degrees of freedom
RESET_FRAMES = 5  # frames in a row beyond this gate after which their pose is assumed
MIN_INLIERS = 4  # without a prediction: any three bearings fit some pose


def surveyed(drive: Drive) -> dict[str, tuple[float, float]]:
    return {n: (at.x, at.y) for n, at in drive.known.landmarks.items()}


def _pose(values: np.ndarray) -> Pose:
    x, y, heading = map(float, values)
    return Pose(x, y, math.remainder(heading, math.tau))


def _difference(a: Pose, b: Pose) -> np.ndarray:
    d = np.array(a) - np.array(b)
    d[2] = math.remainder(d[2], math.tau)
    return d


class IteratedEkf(Baseline):
    """Iterated EKF localisation in a surveyed map (Bell and Cathey, 1993), from the true start.

    Each bearing is gated at the prediction; those of a frame are one update.
    """

    def __init__(self, drive: Drive) -> None:
        super().__init__(drive)
        self.survey, self.belief = surveyed(drive), start_belief(drive)

    def frame(self, t: float, seen: Mapping[str, float]) -> None:
        assert self.belief is not None
        first, P = self.belief
        use, sigma = [], self.noise.bearing
        for name in sorted(seen.keys() & self.survey.keys()):
            expected, h, _ = sight(first, self.mount, *self.survey[name])
            off = math.remainder(seen[name] - expected, math.tau)
            if off * off <= GATE * (float(h @ P @ h) + sigma**2):
                use.append(name)
        if not use:
            return
        pose, R = first, sigma**2 * np.eye(len(use))
        for _ in range(STEPS):
            rows = [sight(pose, self.mount, *self.survey[name])[:2] for name in use]
            H = np.array([h for _, h in rows])
            off = wrap(np.array([seen[name] for name in use]) - [a for a, _ in rows])
            gain = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
            back = _difference(first, pose)
            pose = _pose(np.array(first) + gain @ (off - H @ back))
        I_KH = np.eye(3) - gain @ H
        self.belief = pose, I_KH @ P @ I_KH.T + gain @ R @ gain.T


class MultiTag(Baseline):
    """RANSAC resection of each frame in a surveyed map, fused with odometry.

    As the pose estimators of robot contests: the pose of a frame is a measurement with its
    covariance, within a gate. Frames that stay beyond the gate are a robot that was carried.
    """

    def __init__(self, drive: Drive) -> None:
        super().__init__(drive)
        self.survey, self.misses = surveyed(drive), 0

    def frame(self, t: float, seen: Mapping[str, float]) -> None:
        found = self.consensus(seen)
        if found is None:
            return
        if self.belief is None:
            self.belief = found
            return
        (pose, P), (measured, R) = self.belief, found
        off, S = _difference(measured, pose), P + R
        if off @ np.linalg.solve(S, off) > GATE_3:
            self.misses += 1
            if self.misses < RESET_FRAMES:
                return
            self.belief = found
        else:
            gain = P @ np.linalg.inv(S)
            I_K = np.eye(3) - gain
            pose = _pose(np.array(pose) + gain @ off)
            self.belief = pose, I_K @ P @ I_K.T + gain @ R @ gain.T
        self.misses = 0

    def consensus(self, seen: Mapping[str, float]) -> Belief | None:
        """Return the robot's pose that most bearings of a frame agree with; None without one.

        Of equally many, the one nearest to the predicted pose. Without a prediction, half of the
        bearings must agree.
        """
        names = [n for n in seen if n in self.survey]
        if len(names) < 3:
            return None
        places = np.array([self.survey[n] for n in names])
        bearings, sigma = np.array([seen[n] for n in names]), self.noise.bearing
        poses = poses_from_triples(places, bearings)
        if not len(poses):
            return None
        robots = np.array(compose(Pose(*poses.T), inverse(self.mount))).T
        close = np.abs(residuals(poses[:, None], places, bearings)) < INLIER_SIGMAS * sigma
        far, least = np.zeros(len(poses)), max(MIN_INLIERS, len(names) / 2)
        if self.belief is not None:
            far = np.hypot(*(robots[:, :2] - np.array(self.belief[0][:2])).T)
            least = 3
        best = np.lexsort([far, -close.sum(axis=1)])[0]
        use, pose = close[best], _pose(robots[best])
        if use.sum() < least:
            return None
        for _ in range(STEPS):
            rows = [sight(pose, self.mount, *p)[:2] for p in places[use].tolist()]
            H = np.array([h for _, h in rows])
            off = wrap(bearings[use] - [a for a, _ in rows])
            pose = _pose(np.array(pose) + np.linalg.lstsq(H, off, rcond=None)[0])
        return pose, np.linalg.pinv(H.T @ H) * sigma**2


def ekf(drive: Drive) -> IteratedEkf:
    return IteratedEkf(drive)


def multi_tag(drive: Drive) -> MultiTag:
    return MultiTag(drive)


for make in (ekf, multi_tag):
    make.needs_survey = True  # type: ignore[attr-defined]
ekf.needs_start = True  # type: ignore[attr-defined]
