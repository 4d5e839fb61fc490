"""The paper's filters in plain NumPy, with full matrices and no tricks: the oracle of the steps."""

from dataclasses import dataclass

import numpy as np
from lab.model_by_hand import complex_jacobian, rates, rk4


@dataclass
class Oracle:
    """EKF, A-EKF or PI-EKF, by the model's parameters and by Pi and M."""

    model: object
    stored: np.ndarray
    x: np.ndarray
    P: np.ndarray
    Pi: np.ndarray | None = None
    M: np.ndarray | None = None
    method: str = "rk4"

    def __post_init__(self):
        self.active = np.zeros(self.model.q)
        self.kappa = np.zeros(self.x.size)

    def predict(self, u, dt, Q, state_variance):
        def f(x, u):
            return rates(self.model, x, u, self.stored, self.active)

        def step(x, u):
            return rk4(f, x, u, dt) if self.method == "rk4" else x + dt * f(x, u)

        G = complex_jacobian(lambda x: step(x, u), self.x)
        Gu = complex_jacobian(lambda u: step(np.tile(self.x + 0j, (2, 1)).T, u), u)
        self.x = step(self.x, u)
        if self.Pi is not None:
            self.x = self.x + self.Pi @ self.kappa
        self.P = G @ self.P @ G.T + Gu @ Q @ Gu.T + np.diag(state_variance)

    def update(self, y, mask, r, gate=np.inf, minimum=1):
        q, n = self.model.q, self.x.size
        visible = np.flatnonzero(mask)
        if visible.size < minimum:
            return
        old = [i for i in visible if self.active[i]]
        new = [i for i in visible if not self.active[i]]
        e = {i: np.angle(np.exp(1j * (y[i] - self.x[3 + i]))) for i in old}
        passed = [i for i in old if e[i] ** 2 <= gate * (self.P[3 + i, 3 + i] + r[i])]
        for i in new:
            self.x[3 + i] = y[i]
            self.P[3 + i, :] = self.P[:, 3 + i] = 0
            self.P[3 + i, 3 + i] = r[i]
            self.active[i] = 1
        if passed:
            H = np.zeros((len(passed), n))
            H[np.arange(len(passed)), [3 + i for i in passed]] = 1
            R = np.diag(r[passed])
            residual = np.array([e[i] for i in passed])
            K = np.linalg.solve(H @ self.P @ H.T + R, H @ self.P).T
            self.x = self.x + K @ residual
            A = np.eye(n) - K @ H
            self.P = A @ self.P @ A.T + K @ R @ K.T
            if self.M is not None:
                full = np.zeros(q)
                full[passed] = residual
                self.kappa = self.kappa + self.M @ full
