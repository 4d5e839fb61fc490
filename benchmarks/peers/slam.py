"""Bearing-only EKF-SLAM in Cartesian coordinates, with home by resection. No start is needed."""

import math
from collections.abc import Mapping

import numpy as np

from benchmarks.peers.online import GATE, Baseline, crossing, parallax, sight
from benchmarks.peers.surveyed import INLIER_SIGMAS, STEPS, residuals
from homeward.drives.drive import Drive
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose, Twist, between, compose, inverse
from homeward.localizer.resection import poses_from_triples

PARALLAX = 0.15  # angle between two sightings from which a landmark enters the map [rad]
MIN_AGREEING = 5  # home bearings that must agree with one pose of home, and half of those mapped
BUFFER = 60  # sightings of a landmark that is not in the map yet


class EkfSlam(Baseline):
    """EKF-SLAM in the frame of the start, landmarks from triangulation, a gate for each bearing.

    Home is the camera's pose from which most home bearings fit the map, by RANSAC and least
    squares; its covariance contains the landmarks' and their correlation with the robot.
    """

    def __init__(self, drive: Drive) -> None:
        super().__init__(drive)
        self.home = {i: b.bearing for i, b in drive.home.items()}
        self.x, self.P = np.zeros(3), np.zeros((3, 3))
        self.rows: dict[str, int] = {}
        self.waiting: dict[str, list[tuple[float, float, float]]] = {}

    def move(self, twist: Twist, dt: float) -> None:
        pose = Pose(*self.x[:3].tolist())
        after, block = self.noise.predicted((pose, self.P[:3, :3]), twist, dt)
        F = np.array([[1, 0, pose.y - after.y], [0, 1, after.x - pose.x], [0, 0, 1]])
        self.x[:3] = after
        self.P[:3, 3:] = F @ self.P[:3, 3:]
        self.P[3:, :3] = self.P[:3, 3:].T
        self.P[:3, :3] = block
        super().move(twist, dt)

    def frame(self, t: float, seen: Mapping[str, float]) -> None:
        for name in sorted(seen):
            if name in self.rows:
                self._update(name, seen[name])
            else:
                self._wait(name, seen[name])
        self._locate()

    def _update(self, name: str, bearing: float) -> None:
        row = self.rows[name]
        pose = Pose(*self.x[:3].tolist())
        expected, by_pose, by_place = sight(pose, self.mount, *self.x[row : row + 2])
        PH = self.P[:, :3] @ by_pose + self.P[:, row : row + 2] @ by_place
        S = float(by_pose @ PH[:3] + by_place @ PH[row : row + 2]) + self.noise.bearing**2
        off = math.remainder(bearing - expected, math.tau)
        if off * off > GATE * S:
            return
        self.x += PH * (off / S)
        self.x[2] = math.remainder(self.x[2], math.tau)
        self.P -= np.outer(PH, PH) / S

    def _wait(self, name: str, bearing: float) -> None:
        """Keep the line of a sighting; with enough parallax, add the landmark."""
        eye = compose(Pose(*self.x[:3].tolist()), self.mount)
        lines = self.waiting.setdefault(name, [])
        lines.append((float(eye.x), float(eye.y), float(eye.heading) + bearing))
        del lines[:-BUFFER]
        table = np.array(lines)
        wide = parallax(table[:, 2])
        if wide < max(PARALLAX, 5 * self.noise.bearing):
            return
        point = crossing(table[:, :2], table[:, 2])
        if point is None:
            return
        del self.waiting[name]
        d = point - [eye.x, eye.y]
        r = float(np.hypot(*d))
        sigma_r = r * 2 * self.noise.bearing / math.sin(min(wide, math.pi / 2))
        # x = eye + r (cos, sin)(heading + bearing): the range is that of the triangulation.
        by_pose = np.array([[1, 0, -(point[1] - self.x[1])], [0, 1, point[0] - self.x[0]]])
        u, across = d / r, np.array([-d[1], d[0]])
        own = sigma_r**2 * np.outer(u, u) + self.noise.bearing**2 * np.outer(across, across)
        n, cross = self.x.size, by_pose @ self.P[:3]
        P = np.zeros((n + 2, n + 2))
        P[:n, :n], P[n:, :n], P[:n, n:] = self.P, cross, cross.T
        P[n:, n:] = by_pose @ self.P[:3, :3] @ by_pose.T + own
        self.x, self.P, self.rows[name] = np.concatenate([self.x, point]), P, n

    def _locate(self) -> None:
        """Compute home from the map, and the robot's pose from home."""
        names = [n for n in self.rows if n in self.home]
        if len(names) < MIN_AGREEING:
            return
        at = np.array([self.rows[n] for n in names])
        places = self.x[at[:, None] + [0, 1]]
        bearings = np.array([self.home[n] for n in names])
        poses = poses_from_triples(places, bearings)
        if not len(poses):
            return
        spread = [self.P[k : k + 2, k : k + 2].trace() for k in at]
        near = np.hypot(*(poses[:, None, :2] - places).T).T
        sigma = np.sqrt(self.noise.bearing**2 + np.array(spread) / np.maximum(near, 1e-6) ** 2)
        close = np.abs(residuals(poses[:, None], places, bearings)) < INLIER_SIGMAS * np.minimum(
            sigma, 0.1
        )
        best = int(np.argmax(close.sum(axis=1)))
        use = close[best]
        if use.sum() < max(MIN_AGREEING, len(use) / 2):
            return
        camera, none = Pose(*poses[best].tolist()), Pose(0.0, 0.0, 0.0)
        rows, R = at[use], np.eye(int(use.sum())) * self.noise.bearing**2
        for _ in range(STEPS):
            parts = [sight(camera, none, *p) for p in places[use].tolist()]
            H, L = np.array([p[1] for p in parts]), np.zeros((len(rows), self.x.size))
            for i, (row, part) in enumerate(zip(rows, parts, strict=True)):
                L[i, row : row + 2] = part[2]
            off = wrap(bearings[use] - [p[0] for p in parts])
            W = np.linalg.inv(R + L @ self.P @ L.T)
            gain = np.linalg.pinv(H.T @ W @ H) @ H.T @ W
            camera = Pose(*(np.array(camera) + gain @ off).tolist())
        # The robot in home's frame, with gradients by the camera at home and by the state.
        robot = Pose(*self.x[:3].tolist())
        home = compose(camera, inverse(self.home_mount))
        c, s = math.cos(home.heading), math.sin(home.heading)
        turn = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
        lever = np.eye(3)
        lever[0, 2], lever[1, 2] = -(robot.y - camera.y), robot.x - camera.x
        by_home = -turn @ lever @ gain
        by_state = np.zeros((3, self.x.size))
        by_state[:, :3] = turn
        by_state -= by_home @ L
        P = by_state @ self.P @ by_state.T + by_home @ R @ by_home.T
        self.belief = Pose(*map(float, between(home, robot))), P


def ekf(drive: Drive) -> EkfSlam:
    return EkfSlam(drive)
