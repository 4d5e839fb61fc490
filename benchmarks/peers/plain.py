"""The EKF in idiomatic plain NumPy: manual Jacobians, stage by stage, full matrices.

FilterPy uses `step`, too, so that only its own work differs.
"""

import numpy as np

from benchmarks.peers.scene import BEARING_VARIANCE, DT, GUARD, INPUT_VARIANCE, WALK, Scene


def rates(
    x: np.ndarray, u: np.ndarray, stored: np.ndarray, parameters: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return dX/dt and its Jacobians by state and input; with `parameters`, beta* are states."""
    q, n = stored.size, x.size
    (R, theta, alpha), (v, omega), beta = x[:3], u, x[3 : 3 + q]
    home = x[3 + q :] if parameters else stored
    c, s = np.cos(alpha - theta), np.sin(alpha - theta)
    square = R * R + GUARD**2
    inverse, inverse_R = R / square, (GUARD**2 - R * R) / square**2
    sb, cb = np.sin(beta), np.cos(beta)
    sp, cp = np.sin(home - beta - alpha), np.cos(home - beta - alpha)
    st, ct = np.sin(home - theta), np.cos(home - theta)
    w = R * st
    below = w * w + GUARD**2
    near, near_w = w / below, (GUARD**2 - w * w) / below**2
    f, J, B = np.zeros(n), np.zeros((n, n)), np.zeros((n, 2))
    f[:3] = v * c, v * s * inverse, omega
    f[3 : 3 + q] = -v * sb * sp * near - omega
    J[0, 1], J[0, 2] = v * s, -v * s
    J[1, :3] = v * s * inverse_R, -v * c * inverse, v * c * inverse
    rows = np.arange(3, 3 + q)
    J[rows, 0] = -v * sb * sp * near_w * st
    J[rows, 1] = v * sb * sp * near_w * R * ct
    J[rows, 2] = v * sb * cp * near
    J[rows, rows] = -v * (cb * sp - sb * cp) * near
    if parameters:
        J[rows, rows + q] = -v * sb * (cp * near + sp * near_w * R * ct)
    B[0, 0], B[1, 0], B[2, 1] = c, s * inverse, 1.0
    B[rows, 0], B[rows, 1] = -sb * sp * near, -1.0
    return f, J, B


def step(
    x: np.ndarray, u: np.ndarray, stored: np.ndarray, parameters: bool = False
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the state after a sample (RK4), G and Gu."""
    n = x.size
    eye, f, S, T = np.eye(n), np.zeros(n), np.zeros((n, n)), np.zeros((n, 2))
    mean, by_x, by_u = np.zeros(n), np.zeros((n, n)), np.zeros((n, 2))
    for reach, weight in ((0.0, 1 / 6), (0.5, 1 / 3), (0.5, 1 / 3), (1.0, 1 / 6)):
        h = reach * DT
        f, J, B = rates(x + h * f, u, stored, parameters)
        S, T = J @ (eye + h * S), J @ (h * T) + B
        mean, by_x, by_u = mean + weight * f, by_x + weight * S, by_u + weight * T
    return x + DT * mean, eye + DT * by_x, DT * by_u


class PlainFilter:
    """The filter, one `step` per sample."""

    def __init__(self, scene: Scene, parameters: bool = False) -> None:
        self.stored, self.parameters, n = scene.stored, parameters, scene.state.size
        self.x, self.P = scene.state.copy(), scene.covariance.copy()
        if parameters:
            self.x = np.concatenate([self.x, scene.stored])
            n = self.x.size
            self.P = np.diag(np.r_[np.diag(self.P), np.full(scene.q, 0.1**2)])
        self.Q, self.walk, self.eye = np.diag(INPUT_VARIANCE), WALK * np.eye(n), np.eye(n)

    def step(self, u: np.ndarray, y: np.ndarray, mask: np.ndarray) -> None:
        self.x, G, B = step(self.x, u, self.stored, self.parameters)
        self.P = G @ self.P @ G.T + B @ self.Q @ B.T + self.walk
        rows = 3 + np.flatnonzero(mask)
        S = self.P[np.ix_(rows, rows)] + BEARING_VARIANCE * np.eye(rows.size)
        K = np.linalg.solve(S, self.P[rows]).T
        self.x = self.x + K @ (y[rows - 3] - self.x[rows])
        self.P = self.P - K @ self.P[rows]
        self.P = (self.P + self.P.T) / 2
