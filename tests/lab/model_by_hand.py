"""The paper's model in NumPy, its derivatives by complex steps, and a scene."""

import numpy as np

from homeward.geometry.frames import Polar, bearing, from_polar

STEP = 1e-30


def rates(model, state, control, stored, active):
    """The same rates in NumPy, on real or complex numbers: nothing shared with the model.

    State and control may be matrices, a column each.
    """
    R, theta, alpha = state[:3]
    v, omega = control
    beta = state[3 : 3 + model.q]
    columns = state.shape[1:]
    home = np.broadcast_to(stored.reshape(-1, *(1 for _ in columns)), beta.shape)
    home = home.astype(state.dtype)
    home[list(model.estimated)] = state[3 + model.q :]
    active = active.reshape(-1, *(1 for _ in columns))
    phi = beta + alpha
    e2 = model.guard**2
    line = R * np.sin(home - theta)
    inverse = np.sin(home - phi) * line / (line**2 + e2)
    return np.concatenate(
        [
            [v * np.cos(alpha - theta)],
            [v * np.sin(alpha - theta) * R / (R**2 + e2)],
            [omega + 0 * R],
            active * (-v * np.sin(beta) * inverse - omega),
            np.zeros((len(model.estimated), *columns)),
        ]
    )


def rk4(f, x, u, dt):
    k1 = f(x, u)
    k2 = f(x + dt / 2 * k1, u)
    k3 = f(x + dt / 2 * k2, u)
    k4 = f(x + dt * k3, u)
    return x + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


def complex_jacobian(f, x):
    """Differentiate by complex steps, all columns at once."""
    return np.imag(f(x[:, None] + 1j * STEP * np.eye(x.size))) / STEP


def scene(q, seed):
    rng = np.random.default_rng(seed)
    angles = 2 * np.pi * np.arange(q) / q + rng.uniform(-0.3, 0.3, q)
    landmarks = rng.uniform(1, 2, q)[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
    polar = Polar(0.75, -0.872, 0.349)
    pose = from_polar(polar)
    beta = np.array([bearing(pose, *mark) for mark in landmarks])
    stored = np.arctan2(landmarks[:, 1], landmarks[:, 0])
    return landmarks, polar, beta, stored
