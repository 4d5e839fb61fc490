"""FilterPy's extended Kalman filter with the paper's model: manual Jacobians, stage by stage."""

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter

from benchmarks.peers.scene import BEARING_VARIANCE, DT, GUARD, INPUT_VARIANCE, WALK, Scene

Q = np.diag(INPUT_VARIANCE)


def rates(
    x: np.ndarray, u: np.ndarray, stored: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return dX/dt and its Jacobians by state and input."""
    q, n = stored.size, x.size
    (R, theta, alpha), (v, omega), beta = x[:3], u, x[3:]
    c, s = np.cos(alpha - theta), np.sin(alpha - theta)
    square = R * R + GUARD**2
    inverse, inverse_R = R / square, (GUARD**2 - R * R) / square**2
    sb, cb = np.sin(beta), np.cos(beta)
    sp, cp = np.sin(stored - beta - alpha), np.cos(stored - beta - alpha)
    st, ct = np.sin(stored - theta), np.cos(stored - theta)
    w = R * st
    below = w * w + GUARD**2
    near, near_w = w / below, (GUARD**2 - w * w) / below**2
    f, J, B = np.zeros(n), np.zeros((n, n)), np.zeros((n, 2))
    f[:3] = v * c, v * s * inverse, omega
    f[3:] = -v * sb * sp * near - omega
    J[0, 1], J[0, 2] = v * s, -v * s
    J[1, :3] = v * s * inverse_R, -v * c * inverse, v * c * inverse
    rows = np.arange(3, 3 + q)
    J[rows, 0] = -v * sb * sp * near_w * st
    J[rows, 1] = v * sb * sp * near_w * R * ct
    J[rows, 2] = v * sb * cp * near
    J[rows, rows] = -v * (cb * sp - sb * cp) * near
    B[0, 0], B[1, 0], B[2, 1] = c, s * inverse, 1.0
    B[rows, 0], B[rows, 1] = -sb * sp * near, -1.0
    return f, J, B


def step(
    x: np.ndarray, u: np.ndarray, stored: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the state after a sample (RK4), G and Gu."""
    n = x.size
    eye, f, S, T = np.eye(n), np.zeros(n), np.zeros((n, n)), np.zeros((n, 2))
    mean, by_x, by_u = np.zeros(n), np.zeros((n, n)), np.zeros((n, 2))
    for reach, weight in ((0.0, 1 / 6), (0.5, 1 / 3), (0.5, 1 / 3), (1.0, 1 / 6)):
        h = reach * DT
        f, J, B = rates(x + h * f, u, stored)
        S, T = J @ (eye + h * S), J @ (h * T) + B
        mean, by_x, by_u = mean + weight * f, by_x + weight * S, by_u + weight * T
    return x + DT * mean, eye + DT * by_x, DT * by_u


class FilterPyFilter:
    """`filterpy.kalman.ExtendedKalmanFilter`, given F and Q of each sample."""

    def __init__(self, scene: Scene) -> None:
        n = scene.state.size

        class Filter(ExtendedKalmanFilter):
            def predict_x(self, u: np.ndarray) -> None:
                self.x, self.F, by_input = step(self.x, u, scene.stored)
                self.Q = by_input @ Q @ by_input.T + WALK * np.eye(n)

        self.filter = Filter(dim_x=n, dim_z=scene.q)
        self.filter.x, self.filter.P = scene.state.copy(), scene.covariance.copy()
        self.scene, self.eye = scene, np.eye(n)

    def step(self, k: int) -> np.ndarray:
        """Take sample k of the scene, and return the estimate."""
        rows = 3 + np.flatnonzero(self.scene.mask[k])
        self.filter.predict(self.scene.control[k])
        self.filter.update(
            self.scene.bearings[k, rows - 3],
            lambda _: self.eye[rows],
            lambda x: x[rows],
            R=BEARING_VARIANCE * np.eye(rows.size),
        )
        return np.asarray(self.filter.x)
