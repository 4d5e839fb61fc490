"""Bearing-only EKF-SLAM with inverse depth, and home by resection. No start is needed.

A landmark is the point (x, y) from which it was first sighted, the direction from there, and the
inverse of its distance (Civera, Davison and Montiel, "Inverse depth parametrization for monocular
SLAM", IEEE Transactions on Robotics 2008), so it is in the state from its first sighting on.
"""

import math
from collections.abc import Mapping

import numpy as np

from benchmarks.peers.online import GATE, Baseline
from homeward.drives.drive import Drive
from homeward.geometry.frames import Pose, Twist, compose

NEAREST_S = 3.0  # distance of the nearest landmarks, in driving time at the usual speed [s]
MAX_SPREAD = 0.3  # relative error of the distance of a landmark that home is computed from
LOST = 10  # sightings in a row beyond the gate after which a landmark is another one


class EkfSlam(Baseline):
    """EKF-SLAM in the frame of the start, with a gate for each bearing.

    Inverse distances begin at half of that of the nearest landmarks, with a sigma of half of that
    again, so that infinity is within two sigmas. The camera's place on the robot is in the model.
    """

    def __init__(self, drive: Drive) -> None:
        super().__init__(drive)
        speeds = np.abs(drive.odometry.v[np.nonzero(drive.odometry.v)])
        self.nearest = NEAREST_S * float(np.median(speeds)) if speeds.size else 1.0
        self.x, self.P = np.zeros(3), np.zeros((3, 3))
        self.rows: dict[str, int] = {}
        self.misses: dict[str, int] = {}

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
                self._add(name, seen[name])
        self._locate()

    def _add(self, name: str, bearing: float) -> None:
        """Add a landmark at its first sighting."""
        eye = compose(Pose(*self.x[:3].tolist()), self.mount)
        dx, dy = eye.x - self.x[0], eye.y - self.x[1]
        by_pose = np.array([[1, 0, -dy], [0, 1, dx], [0, 0, 1], [0, 0, 0]])
        half = 0.5 / self.nearest
        own = np.diag([0.0, 0.0, self.noise.bearing**2, (0.5 * half) ** 2])
        n, cross = self.x.size, by_pose @ self.P[:3]
        P = np.zeros((n + 4, n + 4))
        P[:n, :n], P[n:, :n], P[:n, n:] = self.P, cross, cross.T
        P[n:, n:] = by_pose @ self.P[:3, :3] @ by_pose.T + own
        row = [eye.x, eye.y, math.remainder(eye.heading + bearing, math.tau), half]
        self.x, self.P, self.rows[name] = np.concatenate([self.x, row]), P, n
        self.misses[name] = 0

    def _remove(self, name: str) -> None:
        """Remove a landmark, which has moved if it was in the map."""
        row = self.rows.pop(name)
        kept = np.r_[0:row, row + 4 : self.x.size]
        self.x, self.P = self.x[kept], self.P[np.ix_(kept, kept)]
        self.rows = {n: r - 4 * (r > row) for n, r in self.rows.items()}

    def _update(self, name: str, bearing: float) -> None:
        row = self.rows[name]
        x, y, heading = self.x[:3]
        x0, y0, direction, inverse = self.x[row : row + 4]
        c, s = math.cos(heading), math.sin(heading)
        ox, oy = c * self.mount.x - s * self.mount.y, s * self.mount.x + c * self.mount.y
        ahead = np.array([math.cos(direction), math.sin(direction)])
        base = np.array([x0 - x - ox, y0 - y - oy])
        u, v = inverse * base + ahead  # towards the landmark, over its first distance
        expected = math.atan2(v, u) - heading - self.mount.heading
        off = math.remainder(bearing - expected, math.tau)
        across = np.array([-v, u]) / max(u * u + v * v, 1e-12)
        turned = across @ np.array([oy, -ox]) * inverse - 1.0
        h = np.zeros(self.x.size)
        h[:3] = [*(-inverse * across), turned]
        h[row : row + 4] = [*(inverse * across), across @ [-ahead[1], ahead[0]], across @ base]
        Ph = self.P @ h
        S = float(h @ Ph) + self.noise.bearing**2
        if off * off > GATE * S:
            self.misses[name] += 1
            if self.misses[name] >= LOST:
                self._remove(name)
                self.replaced.add(name)
            return
        self.misses[name] = 0
        self.x += Ph * (off / S)
        self.x[2] = math.remainder(self.x[2], math.tau)
        self.P -= np.outer(Ph, Ph) / S

    def _locate(self) -> None:
        """Compute home from the landmarks whose distance is known."""
        names = [n for n, row in self.rows.items() if self._is_known(row)]
        if not names:
            return
        places, J = {}, np.zeros((3 + 2 * len(names), self.x.size))
        J[:3, :3] = np.eye(3)
        for k, name in enumerate(names):
            row = self.rows[name]
            x0, y0, direction, inverse = self.x[row : row + 4]
            c, s, r = math.cos(direction), math.sin(direction), 1.0 / inverse
            places[name] = np.array([x0 + r * c, y0 + r * s])
            J[3 + 2 * k : 5 + 2 * k, row : row + 4] = [
                [1, 0, -r * s, -r * r * c],
                [0, 1, r * c, -r * r * s],
            ]
        self.locate(Pose(*self.x[:3].tolist()), places, J @ self.P @ J.T)

    def _is_known(self, row: int) -> bool:
        inverse = self.x[row + 3]
        return bool(inverse > 0 and self.P[row + 3, row + 3] < (MAX_SPREAD * inverse) ** 2)


def ekf(drive: Drive) -> EkfSlam:
    return EkfSlam(drive)
