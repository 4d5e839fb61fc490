"""The hand-written C++ filter: compiled by the system's C++ compiler, called once a run."""

from __future__ import annotations

import ctypes
import os
import shlex
import subprocess
import tempfile
from pathlib import Path

import numpy as np

from benchmarks.peers.scene import BEARING_VARIANCE, DT, GUARD, INPUT_VARIANCE, WALK, Scene

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
        """Return the estimates at every sample, (steps, 10)."""
        numbers = np.array(
            [DT, GUARD**2, *INPUT_VARIANCE, WALK, BEARING_VARIANCE, *scene.stored], float
        )
        x, P = scene.state.copy(), scene.covariance.copy()
        track = np.zeros((scene.steps, x.size))
        arrays = [numbers, scene.control, scene.bearings, scene.mask, x, P, track]
        first, *rest = (ctypes.c_void_p(a.ctypes.data) for a in arrays)
        self.function(first, ctypes.c_int64(scene.steps), *rest)
        return track
