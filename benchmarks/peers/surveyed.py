"""Baselines with a surveyed map: a gated EKF from the true start, and RANSAC resection.

Both are given the true positions of all landmarks when home was stored; the EKF also the start.
"""

import math
from collections.abc import Mapping

import numpy as np

from benchmarks.peers.online import GATE, Baseline, Belief, sight, start_belief
from homeward.drives.drive import Drive
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose, compose, inverse
from homeward.localizer.resection import poses_from_triples

INLIER_SIGMAS = 4.0  # maximum residual of a bearing in a consensus
JUMP_SIGMAS = 5.0  # maximum jump to a consensus of three, which any three bearings have
STEPS = 6


def surveyed(drive: Drive) -> dict[str, tuple[float, float]]:
    return {n: (at.x, at.y) for n, at in drive.known.landmarks.items()}


class SurveyedEkf(Baseline):
    """EKF localisation in a surveyed map, from the true start, with a gate for each bearing."""

    gate = GATE

    def __init__(self, drive: Drive) -> None:
        super().__init__(drive)
        self.survey, self.belief = surveyed(drive), start_belief(drive)

    def frame(self, t: float, seen: Mapping[str, float]) -> None:
        assert self.belief is not None
        pose, P = self.belief
        for name in sorted(seen.keys() & self.survey.keys()):
            expected, h, _ = sight(pose, self.mount, *self.survey[name])
            off = math.remainder(seen[name] - expected, math.tau)
            S = float(h @ P @ h) + self.noise.bearing**2
            if off * off > self.gate * S:
                continue
            gain = P @ h / S
            x, y, heading = np.array(pose) + gain * off
            pose = Pose(float(x), float(y), math.remainder(float(heading), math.tau))
            P = P - np.outer(gain, gain) * S
        self.belief = pose, P


class Resection(Baseline):
    """RANSAC resection of each frame in a surveyed map; odometry from the last pose otherwise.

    The pose of most inliers counts; of equals the one nearest to the predicted pose.
    """

    def __init__(self, drive: Drive) -> None:
        super().__init__(drive)
        self.survey = surveyed(drive)

    def frame(self, t: float, seen: Mapping[str, float]) -> None:
        found = consensus(self.survey, seen, self.noise.bearing, self.mount, self.belief)
        if found is not None:
            self.belief = found


def consensus(
    survey: Mapping[str, tuple[float, float]],
    seen: Mapping[str, float],
    sigma: float,
    mount: Pose,
    predicted: Belief | None,
    min_inliers: int = 4,
) -> Belief | None:
    """Return the robot's pose from the bearings of a frame; None without a consensus.

    Without a prediction, it needs `min_inliers`, and half of the bearings.
    """
    names = [n for n in seen if n in survey]
    if len(names) < 3:
        return None
    places, bearings = np.array([survey[n] for n in names]), np.array([seen[n] for n in names])
    poses = poses_from_triples(places, bearings)
    if not len(poses):
        return None
    robots = np.array(compose(Pose(*poses.T), inverse(mount))).T
    close = np.abs(residuals(poses[:, None], places, bearings)) < INLIER_SIGMAS * sigma
    far = np.zeros(len(poses))
    if predicted is not None:
        far = np.hypot(*(robots[:, :2] - np.array(predicted[0][:2])).T)
    best = np.lexsort([far, -close.sum(axis=1)])[0]
    use, pose = close[best], Pose(*robots[best].tolist())
    least = 3 if predicted is not None else max(min_inliers, len(use) / 2)
    if use.sum() < least:
        return None
    for _ in range(STEPS):
        rows = [sight(pose, mount, *p)[:2] for p in places[use].tolist()]
        H = np.array([h for _, h in rows])
        off = wrap(bearings[use] - [a for a, _ in rows])
        step = np.linalg.lstsq(H, off, rcond=None)[0]
        pose = Pose(*(np.array(pose) + step).tolist())
    pose = Pose(pose.x, pose.y, math.remainder(pose.heading, math.tau))
    P = np.linalg.pinv(H.T @ H) * sigma**2
    if use.sum() == 3 and predicted is not None:
        d = np.array(pose) - np.array(predicted[0])
        d[2] = math.remainder(d[2], math.tau)
        if d @ np.linalg.solve(P + predicted[1], d) > 3 * JUMP_SIGMAS**2:
            return None
    return pose, P


def residuals(poses: np.ndarray, places: np.ndarray, bearings: np.ndarray) -> np.ndarray:
    off = places - poses[..., :2]
    return np.asarray(wrap(bearings - np.arctan2(off[..., 1], off[..., 0]) + poses[..., 2]))


def ekf(drive: Drive) -> SurveyedEkf:
    return SurveyedEkf(drive)


def ekf_no_gate(drive: Drive) -> SurveyedEkf:
    estimator = SurveyedEkf(drive)
    estimator.gate = math.inf
    return estimator


def ransac(drive: Drive) -> Resection:
    return Resection(drive)


for make in (ekf, ekf_no_gate, ransac):
    make.needs_survey = True  # type: ignore[attr-defined]
for make in (ekf, ekf_no_gate):
    make.needs_start = True  # type: ignore[attr-defined]
