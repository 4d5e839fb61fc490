"""The filter with FilterPy, and in hand-written C++ (limit.cpp)."""

import ctypes
import os
import shlex
import subprocess
import tempfile
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
