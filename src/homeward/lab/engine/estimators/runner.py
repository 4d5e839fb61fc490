"""The backend of filters in the paper's state: beliefs as arrays, steps compiled or interpreted."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache, partial

import casadi as ca
import numpy as np

from homeward.geometry.angles import wrap
from homeward.geometry.frames import Polar, Pose, from_polar, polar_covariance_to_pose
from homeward.lab.engine.batch.job import MAX_BELIEF
from homeward.lab.engine.native.source import NativeProgram, choose, source_of
from homeward.lab.engine.program import BELIEF, Machine, filter_program
from homeward.lab.filters.backend import (
    LOST_SIGMA,
    Angles,
    LandmarkBelief,
    MaybeTwist,
    Outputs,
    Setup,
)
from homeward.lab.filters.ekf import ExtendedKalmanFilter
from homeward.lab.filters.settings import Engine
from homeward.lab.model import POLAR, PolarModel, landmark_distance

MAX_STEP_S = 0.1
"""A longer interval is predicted in several steps."""
MAX_STEPS = 1000
"""Largest number of steps, however long the gap."""
SAVED_S = 20e-6
"""What compiled code saves in each step [s]."""
SLOWER = "which takes up to twice as long"


def filter_machine(
    kind: ExtendedKalmanFilter, engine: Engine = "auto", steps: int = 0
) -> Machine | NativeProgram:
    """Return a filter's steps, ready to run; `steps` is the number to come, 0 where unknown."""
    program = filter_program(kind)
    source = partial(source_of, program, single=True)
    library, notes = choose(engine, SAVED_S * steps, source, SLOWER)
    return Machine(program, notes=notes) if library is None else NativeProgram(program)


class Numbers:
    """A numerical `homeward.lab.filters.ekf.Belief`: views of one piece of memory.

    `memory` has its fields in order, matrices column-major, for n states and q landmarks.
    """

    __slots__ = ("active", "covariance", "integral", "memory", "state")

    def __init__(self, n: int, q: int, memory: np.ndarray) -> None:
        middle = n + n * n
        self.memory, self.state = memory, memory[:n]
        self.covariance = memory[n:middle].reshape((n, n), order="F")
        self.active, self.integral = memory[middle : middle + q], memory[middle + q :]


@dataclass(frozen=True)
class Tuning(Setup):
    """Setup of a filter in the paper's state, with n states."""

    variance: np.ndarray
    """(n,), variances of the start prior: R, theta, alpha, bearings (any), parameters."""
    state_density: np.ndarray
    """(n,), variance per second added to the states."""
    proportional: np.ndarray
    """Pi per second, (n, n); empty unless the filter has an integral."""
    integral_gain: np.ndarray
    """M, (n, q); empty unless the filter has an integral."""


def in_steps(interval: float) -> list[float]:
    """Return the equal steps [s] of the prediction of an interval; none if it is not positive."""
    if interval <= 0.0:
        return []
    steps = min(math.ceil(interval / MAX_STEP_S), MAX_STEPS)
    return [interval / steps] * steps


class FilterRunner:
    """A `homeward.lab.filters.backend.FilterBackend` in the paper's state.

    A step whose result diverges is dropped. `steps` is the number to come, 0 where unknown.
    """

    def __init__(
        self, kind: ExtendedKalmanFilter, tuning: Tuning, engine: Engine = "auto", steps: int = 0
    ) -> None:
        self.kind, self.tuning = kind, tuning
        self.stored, self.minimum_visible = tuning.stored, tuning.minimum_visible
        self.diverged = 0
        """Number of steps dropped because their result diverged."""
        self._machine = filter_machine(kind, engine, steps)
        self.engine, self.notes = self._machine.engine, self._machine.notes
        self._variables = variables = self._machine.variables
        self._size = sum(variables[name].size for name in BELIEF)
        """The belief comes first in the machine's memory."""
        self._step: tuple[float, bool] | None = None
        variables["stored"][:] = tuning.stored
        variables["gate"][:] = tuning.gate
        variables["minimum_visible"][:] = tuning.minimum_visible
        gain = variables["integral_gain"]
        # For one landmark, CasADi's column is a flat vector.
        gain[...] = tuning.integral_gain.reshape(gain.shape)

    def retune(self, tuning: Tuning) -> None:
        """Set other sigmas; the rest of the tuning must be the same."""
        self.tuning, self._step = tuning, None

    def start(self) -> Numbers:
        """Return the belief of the start prior, before any landmark is seen."""
        model, tuning = self.kind.model, self.tuning
        belief = Numbers(model.n, model.q, np.zeros(self._size))
        belief.state[:POLAR] = tuning.polar
        belief.state[POLAR + model.q :] = tuning.stored[list(model.estimated)]
        np.fill_diagonal(belief.covariance, tuning.variance)
        return belief

    def predict(self, belief: Numbers, interval: float, twist: MaybeTwist) -> Numbers:
        """Return the belief `interval` [s] later, or the same if that is not positive."""
        for step in in_steps(interval):
            self._set_step(step, twist)
            belief = self._after("predict", belief)
        return belief

    def pose(self, belief: Numbers) -> tuple[Pose, np.ndarray]:
        """Return the pose in the home frame and its covariance (3, 3)."""
        polar = Polar(*belief.state[:POLAR].tolist())
        covariance = polar_covariance_to_pose(polar, belief.covariance[:POLAR, :POLAR])
        return from_polar(polar), covariance

    def landmarks(self, belief: Numbers) -> LandmarkBelief:
        """Return the estimates of the landmarks from the paper's relation for D*_i.

        A negative D*_i, possible where bearings are nearly in line with home, means unknown.
        """
        given = landmark_function(self.kind.model)(belief.state, self.stored)
        home, distances, jacobian = (np.array(part) for part in given)
        variances = np.einsum("ij,jk,ik->i", jacobian, belief.covariance, jacobian)
        return LandmarkBelief(
            wrap(home[:, 0]), distances[:, 0], np.sqrt(np.maximum(variances, 0.0))
        )

    def _set_step(self, dt: float, twist: MaybeTwist) -> None:
        """Set the inputs of a prediction."""
        given, tuning = self._variables, self.tuning
        given["control"][:] = twist or (0.0, 0.0)
        if (dt, twist is None) == self._step:
            return
        self._step = dt, twist is None
        density = np.full(2, LOST_SIGMA**2) if twist is None else tuning.input_density
        given["dt"][:] = dt
        given["input_covariance"][...] = np.diag(density / dt)
        given["state_variance"][:] = tuning.state_density * dt
        given["proportional"][...] = tuning.proportional * dt

    def update(self, belief: Numbers, seen: Angles, sigmas: Angles) -> tuple[Numbers, Outputs]:
        """Return the belief after the sightings of one stamp, and the outputs of the update."""
        given = self._variables
        given["mask"][:] = given["bearings"][:] = 0.0
        given["variance"][:] = self.tuning.bearing_sigma**2
        for i, beta in seen.items():
            given["mask"][i], given["bearings"][i] = 1.0, beta
        for i, sigma in sigmas.items():
            given["variance"][i] = sigma * sigma  # infinite where ** would raise
        return self._after("update", belief), given

    def _after(self, part: str, before: Numbers) -> Numbers:
        """Return a copy of the belief after a step, or the old one where the step diverged."""
        pool = self._machine.pool
        pool[: self._size] = before.memory
        self._machine.do(part)
        memory = pool[: self._size].copy()
        if np.abs(memory).max() < MAX_BELIEF:  # false for NaN, too
            return Numbers(self.kind.model.n, self.kind.model.q, memory)
        self.diverged += 1
        return before


@lru_cache(maxsize=64)
def landmark_function(model: PolarModel) -> ca.Function:
    """Return state, stored -> beta* (q,), D*_i (q,), and the derivatives of these by the state."""
    state, stored = ca.SX.sym("X", model.n), ca.SX.sym("stored", model.q)
    home, polar = model.home_bearings(state, stored), ca.vertsplit(state[:POLAR])
    # The guard is far below any angle that a camera could resolve.
    far = landmark_distance(polar, state[model.bearing_slice], home, 1e-6)
    jacobian = ca.densify(ca.jacobian(far, state))
    return ca.Function("landmarks", [state, stored], [home, far, jacobian])
