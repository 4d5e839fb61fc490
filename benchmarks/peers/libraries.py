"""The filter with FilterPy and dynamax, and in hand-written C++ (limit.cpp)."""

import ctypes
import os
import shlex
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks.peers import plain
from benchmarks.peers.scene import BEARING_VARIANCE, DT, GUARD, INPUT_VARIANCE, WALK, Scene

Q = np.diag(INPUT_VARIANCE)


class FilterPyFilter:
    """`filterpy.kalman.ExtendedKalmanFilter`, given F and Q of each sample."""

    def __init__(self, scene: Scene) -> None:
        from filterpy.kalman import ExtendedKalmanFilter

        n, self.stored = scene.state.size, scene.stored

        class Filter(ExtendedKalmanFilter):
            def predict_x(self, u: np.ndarray) -> None:
                self.x, self.F, by_input = plain.step(self.x, u, scene.stored)
                self.Q = by_input @ Q @ by_input.T + WALK * np.eye(n)

        self.filter = Filter(dim_x=n, dim_z=scene.q)
        self.filter.x, self.filter.P = scene.state.copy(), scene.covariance.copy()
        self.eye = np.eye(n)

    def step(self, u: np.ndarray, y: np.ndarray, mask: np.ndarray) -> None:
        rows = 3 + np.flatnonzero(mask)
        self.filter.predict(u)
        self.filter.update(
            y[rows - 3],
            lambda _: self.eye[rows],
            lambda x: x[rows],
            R=BEARING_VARIANCE * np.eye(rows.size),
        )

    @property
    def x(self) -> np.ndarray:
        return np.asarray(self.filter.x)


def dynamax_batch(scene: Scene, process: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    """Return dynamax's extended Kalman filter over many runs, compiled.

    It maps bearings (runs, steps, q) to estimates (runs, steps, n). Its process noise cannot depend
    on the state, so it is homeward's Gu Q Gu' of each sample, (steps, n, n). An unseen landmark is
    a zero row of H.
    """
    import jax
    import jax.numpy as jnp
    from dynamax.nonlinear_gaussian_ssm import ParamsNLGSSM, extended_kalman_filter

    jax.config.update("jax_enable_x64", True)
    q, stored = scene.q, jnp.asarray(scene.stored)

    def rates(x, u):
        R, theta, alpha, beta = x[0], x[1], x[2], x[3:]
        w = R * jnp.sin(stored - theta)
        near = jnp.sin(stored - beta - alpha) * w / (w * w + GUARD**2)
        off = alpha - theta
        first = [u[0] * jnp.cos(off), u[0] * jnp.sin(off) * R / (R * R + GUARD**2), u[1]]
        return jnp.concatenate([jnp.array(first), -u[0] * jnp.sin(beta) * near - u[1]])

    def motion(x, u):
        k1 = rates(x, u)
        k2 = rates(x + DT / 2 * k1, u)
        k3 = rates(x + DT / 2 * k2, u)
        k4 = rates(x + DT * k3, u)
        return x + DT / 6 * (k1 + 2 * k2 + 2 * k3 + k4)

    # dynamax updates before it predicts: it starts with a sample without sightings. It predicts
    # with input and noise of the next sample.
    blind = jnp.zeros((1, q))
    mask = jnp.concatenate([blind, jnp.asarray(scene.mask)])
    noise = jnp.where(mask > 0, BEARING_VARIANCE, 1.0)
    inputs = jnp.concatenate([jnp.asarray(np.vstack([np.zeros(2), scene.control])), mask], axis=1)
    params = ParamsNLGSSM(
        initial_mean=jnp.asarray(scene.state),
        initial_covariance=jnp.asarray(scene.covariance),
        dynamics_function=lambda x, u: motion(x, u[:2]),
        dynamics_covariance=jnp.asarray(np.concatenate([process[:1], process])),
        emission_function=lambda x, u: u[2:] * x[3:],
        emission_covariance=jax.vmap(jnp.diag)(noise),
    )

    def run(bearings):
        seen = jnp.concatenate([blind, bearings]) * mask
        wanted = ["filtered_means"]
        return extended_kalman_filter(
            params, seen, inputs=inputs, output_fields=wanted
        ).filtered_means[1:]

    batch = jax.jit(jax.vmap(run))
    return lambda bearings: np.asarray(batch(jnp.asarray(bearings)))


FLAGS = ("-O3", "-march=native", "-ffast-math", "-fPIC", "-shared", "-std=c++17")


class Limit:
    """The filter, a whole run in one call."""

    def __init__(self) -> None:
        source = Path(__file__).with_name("limit.cpp")
        compiler = shlex.split(os.environ.get("CXX", "c++"))
        with tempfile.TemporaryDirectory() as folder:
            library = Path(folder) / "limit.so"
            subprocess.run([*compiler, *FLAGS, "-o", str(library), str(source)], check=True)
            self.function = ctypes.CDLL(str(library)).limit

    def run(self, scene: Scene) -> np.ndarray:
        numbers = np.array(
            [DT, GUARD**2, *INPUT_VARIANCE, WALK, BEARING_VARIANCE, *scene.stored], float
        )
        x, P = scene.state.copy(), scene.covariance.copy()
        track = np.zeros((scene.steps, x.size))
        arrays = [numbers, scene.control, scene.bearings, scene.mask, x, P, track]
        first, *rest = (ctypes.c_void_p(a.ctypes.data) for a in arrays)
        self.function(first, ctypes.c_int64(scene.steps), *rest)
        return track
