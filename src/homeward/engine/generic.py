"""Kernels for many landmarks: the model stays symbolic, the matrices are NumPy's.

An unrolled step grows with q^2 to q^3 (MATH.md and DESIGN.md give sizes); these grow with memory
alone, and visit only the landmarks in sight. They are tested against the symbolic steps.
"""

from __future__ import annotations

from dataclasses import fields

import numpy as np

from homeward.angles import wrap
from homeward.engine.interpreter import Interpreter
from homeward.filters.belief import Belief
from homeward.filters.ekf import ExtendedKalmanFilter
from homeward.filters.steps import UPDATE_OUTPUTS, propagate_function
from homeward.model import POLAR

BELIEF = tuple(field.name for field in fields(Belief))


def _belief(n: int, q: int, integral: bool) -> dict[str, np.ndarray]:
    return {
        "state": np.zeros(n),
        "covariance": np.zeros((n, n), order="F"),
        "active": np.zeros(q),
        "integral": np.zeros(n if integral else 0),
    }


class GenericPredict:
    """The predicting step of a filter (a `Kernel`)."""

    def __init__(self, kind: ExtendedKalmanFilter) -> None:
        self._propagate = Interpreter(propagate_function(kind))
        self.inputs = self._propagate.inputs
        self.outputs = _belief(kind.model.n, kind.model.q, kind.integral)

    def __call__(self) -> None:
        """Compute the outputs from the inputs."""
        self._propagate()
        given, step, out = self.inputs, self._propagate.outputs, self.outputs
        by_state, by_input = step["by_state"], step["by_input"]
        covariance = by_state @ given["covariance"] @ by_state.T
        covariance += by_input @ given["input_covariance"] @ by_input.T
        covariance[np.diag_indices_from(covariance)] += given["state_variance"]
        out["state"][:] = step["state"]
        out["covariance"][:] = (covariance + covariance.T) / 2
        out["active"][:], out["integral"][:] = given["active"], given["integral"]


class GenericUpdate:
    """The updating step of a filter (a `Kernel`)."""

    def __init__(self, kind: ExtendedKalmanFilter) -> None:
        n, q = kind.model.n, kind.model.q
        size = n if kind.integral else 0
        self.inputs = _belief(n, q, kind.integral) | {
            "bearings": np.zeros(q),
            "mask": np.zeros(q),
            "variance": np.zeros(q),
            "gate": np.zeros(1),
            "minimum_visible": np.zeros(1),
            "integral_gain": np.zeros((size, q if size else 0), order="F"),
        }
        self.outputs = _belief(n, q, kind.integral) | {k: np.zeros(q) for k in UPDATE_OUTPUTS}
        self._bearings = kind.model.bearing_slice

    def __call__(self) -> None:
        """Compute the outputs from the inputs."""
        given, out = self.inputs, self.outputs
        for name in BELIEF:
            out[name][...] = given[name]
        state, covariance, variance = out["state"], out["covariance"], given["variance"]

        enough = given["mask"].sum() >= given["minimum_visible"][0]
        visible = (given["mask"] > 0) & enough
        entering = np.flatnonzero(visible & (given["active"] == 0))
        compared = visible & (given["active"] > 0)
        innovation = np.where(compared, wrap(given["bearings"] - state[self._bearings]), 0.0)
        predicted = np.diag(covariance)[self._bearings] + variance
        accepted = compared & (innovation**2 <= given["gate"][0] * predicted)

        rows = POLAR + entering
        state[rows] = given["bearings"][entering]
        covariance[rows, :] = covariance[:, rows] = 0.0
        covariance[rows, rows] = variance[entering]
        out["active"][entering] = 1.0
        before = state.copy()
        for i in np.flatnonzero(accepted):
            j = POLAR + i
            gain = covariance[:, j] / (covariance[j, j] + variance[i])
            state += gain * (innovation[i] - (state[j] - before[j]))
            covariance -= np.outer(gain, covariance[j, :])
            covariance[:] = (covariance + covariance.T) / 2
        if given["integral"].size:
            out["integral"] += given["integral_gain"] @ (innovation * accepted)
        out["innovation"][:], out["innovation_variance"][:] = innovation, predicted
        out["accepted"][:] = accepted
