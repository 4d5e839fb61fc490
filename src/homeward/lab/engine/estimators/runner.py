"""A filter's belief carried through time by its kernels, compiled or not: numbers, no answers."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from homeward.geometry.angles import wrap
from homeward.geometry.frames import Polar, Pose, from_polar, polar_covariance_to_pose
from homeward.lab.engine.batch.job import LARGEST
from homeward.lab.engine.native.source import NativeProgram, Source, choose, source_of
from homeward.lab.engine.program.stages import (
    BELIEF,
    COMPILES_UP_TO,
    Kernel,
    filter_parts,
    filter_program,
)
from homeward.lab.filters.carrier import LOST_SIGMA, Angles, Held, LandmarkBelief, Outputs
from homeward.lab.filters.ekf import ExtendedKalmanFilter
from homeward.lab.filters.settings import Engine
from homeward.lab.model import POLAR, PolarModel, landmark_distance

LONGEST_STEP_S = 0.1
"""A longer interval is predicted in several steps."""
MOST_STEPS = 1000
"""But in no more than these, however long the gap."""


UNROLLED_UP_TO = 48
"""States: up to here an unrolled step is built within half a second and runs faster."""
SAVED_S = 20e-6
"""What compiled code saves in each step [s]."""
WRITING_S = 60.0
"""For more states than that, `auto` wants to save as much [s]: writing the C alone takes long."""
SLOWER = "which takes up to twice as long"


class FilterKernels(NamedTuple):
    """A filter's two steps, ready to run."""

    predict: Kernel
    update: Kernel
    engine: Engine
    """What executes them: native or interpreter."""
    notes: tuple[str, ...]
    """What the user must know of that, each a sentence."""


def filter_kernels(
    kind: ExtendedKalmanFilter, engine: Engine = "auto", steps: int = 0
) -> FilterKernels:
    """Return the kernels of a filter; `steps` is the number to come, as far as it is known."""

    def native() -> NativeProgram:
        return NativeProgram(filter_program(kind))

    def source() -> Source:
        return source_of(filter_program(kind), single=True)

    saved = SAVED_S * steps
    if not kind.separable and kind.model.n > COMPILES_UP_TO:
        engine = "interpreter"  # there are no loops in C for it
    if engine == "auto" and kind.model.n > UNROLLED_UP_TO and saved < WRITING_S:
        engine = "interpreter"
    program, notes = choose(engine, saved, source, native, SLOWER)
    if program is not None:
        notes = program.library.notes
        return FilterKernels(program.part("predict"), program.part("update"), "native", notes)
    predict, update = (part[0].kernel() for part in filter_parts(kind, UNROLLED_UP_TO).values())
    return FilterKernels(predict, update, "interpreter", notes)


class Numbers:
    """A belief in numbers: views of one piece of memory; see `homeward.lab.filters.ekf`.

    `memory` has the entries in that order, matrices column-major, of n states and q landmarks.
    """

    __slots__ = ("active", "covariance", "integral", "memory", "state")

    def __init__(self, n: int, q: int, memory: np.ndarray) -> None:
        middle = n + n * n
        self.memory, self.state = memory, memory[:n]
        self.covariance = memory[n:middle].reshape((n, n), order="F")
        self.active, self.integral = memory[middle : middle + q], memory[middle + q :]


@dataclass(frozen=True)
class Tuning:
    """The numbers of a filter, as arrays in its own order of states (n) and landmarks (q)."""

    polar: Polar
    """Start prior: R [m], theta, alpha [rad]."""
    variance: np.ndarray
    """(n,), of the start prior: R, theta, alpha, bearings (any), parameters."""
    stored: np.ndarray
    """(q,), beta* in the robot's home frame [rad]."""
    bearing_sigma: float
    """Of a bearing that comes without one [rad]."""
    input_density: np.ndarray
    """(2,), variance density of speed [(m/s)^2/Hz] and turn rate [(rad/s)^2/Hz]."""
    state_density: np.ndarray
    """(n,), variance per second added to the states."""
    gate: float
    """Largest innovation^2 / variance accepted."""
    minimum_visible: int
    """Fewer landmarks in sight, and a stamp is not used."""
    proportional: np.ndarray
    """Pi per second, (n, n); empty unless the filter has an integral."""
    integral_gain: np.ndarray
    """M, (n, q); empty unless the filter has an integral."""


def in_steps(interval: float) -> list[float]:
    """Return the equal steps [s] in which an interval is predicted; none unless it is positive."""
    if interval <= 0.0:
        return []
    steps = min(math.ceil(interval / LONGEST_STEP_S), MOST_STEPS)
    return [interval / steps] * steps


class FilterRunner:
    """A `homeward.lab.filters.carrier.FilterBackend` of beliefs in the paper's state, kept finite.

    So many `steps` are coming, as far as that is known.
    """

    def __init__(
        self, kind: ExtendedKalmanFilter, tuning: Tuning, engine: Engine = "auto", steps: int = 0
    ) -> None:
        self.kind, self.tuning = kind, tuning
        self.stored, self.minimum_visible = tuning.stored, tuning.minimum_visible
        self.diverged = 0
        """Steps that were left out because their result had diverged."""
        self._predict, self._update, self.engine, self.notes = filter_kernels(kind, engine, steps)
        self._size = sum(self._predict.inputs[name].size for name in BELIEF)
        self._step: tuple[float, bool] | None = None
        self._predict.inputs["stored"][:] = tuning.stored
        self._update.inputs["gate"][:] = tuning.gate
        self._update.inputs["minimum_visible"][:] = tuning.minimum_visible
        gain = self._update.inputs["integral_gain"]
        # Of one landmark, CasADi's column is a flat vector.
        gain[...] = tuning.integral_gain.reshape(gain.shape)

    def retune(self, tuning: Tuning) -> None:
        """Believe other sigmas from now on; the rest of the tuning must be the same."""
        self.tuning, self._step = tuning, None

    def start(self) -> Numbers:
        """Return the belief of the start prior, before any landmark is seen."""
        model, tuning = self.kind.model, self.tuning
        belief = Numbers(model.n, model.q, np.zeros(self._size))
        belief.state[:POLAR] = tuning.polar
        belief.state[POLAR + model.q :] = tuning.stored[list(model.estimated)]
        np.fill_diagonal(belief.covariance, tuning.variance)
        return belief

    def predict(self, belief: Numbers, interval: float, twist: Held) -> Numbers:
        """Return the belief `interval` [s] later; the same unless that is positive."""
        for step in in_steps(interval):
            self._set_step(step, twist)
            self._predict.given[: self._size] = belief.memory
            self._predict()
            belief = self._sane(self._predict.found, belief)
        return belief

    def pose(self, belief: Numbers) -> tuple[Pose, np.ndarray]:
        """Return the pose in the home frame and its covariance (3, 3)."""
        polar = Polar(*belief.state[:POLAR].tolist())
        covariance = polar_covariance_to_pose(polar, belief.covariance[:POLAR, :POLAR])
        return from_polar(polar), covariance

    def landmarks(self, belief: Numbers) -> LandmarkBelief:
        """Return where each landmark must stand, by the paper's relation for D*_i.

        Where that comes out negative, as it can for bearings nearly in line with home, it says
        nothing of place and distance.
        """
        model, state, stored = self.kind.model, belief.state, self.stored
        jacobian = _distance_jacobian(model, state, stored)
        variances = np.einsum("ij,jk,ik->i", jacobian, belief.covariance, jacobian)
        return LandmarkBelief(
            wrap(_home_bearings(model, state, stored)),
            _distances(model, state, stored),
            np.sqrt(np.maximum(variances, 0.0)),
        )

    def _set_step(self, dt: float, twist: Held) -> None:
        """Set what a prediction depends on besides the belief."""
        given, tuning = self._predict.inputs, self.tuning
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
        """Return the belief after the sightings of one stamp, and what the step said of them."""
        given = self._update.inputs
        self._update.given[: self._size] = belief.memory
        given["mask"][:] = given["bearings"][:] = 0.0
        given["variance"][:] = self.tuning.bearing_sigma**2
        for i, beta in seen.items():
            given["mask"][i], given["bearings"][i] = 1.0, beta
        for i, sigma in sigmas.items():
            given["variance"][i] = sigma * sigma  # infinite where ** would raise
        self._update()
        return self._sane(self._update.found, belief), self._update.outputs

    def _sane(self, found: np.ndarray, before: Numbers) -> Numbers:
        """Return a copy of the new belief, or the old one where the new one has diverged."""
        memory = found[: self._size].copy()
        if np.abs(memory).max() < LARGEST:  # else, with such a number in it, it has diverged
            return Numbers(self.kind.model.n, self.kind.model.q, memory)
        self.diverged += 1
        return before


def _home_bearings(model: PolarModel, state: np.ndarray, stored: np.ndarray) -> np.ndarray:
    """Return beta* of all landmarks, from the state where they are estimated: (q,) [rad]."""
    home = stored.astype(state.dtype)
    home[list(model.estimated)] = state[POLAR + model.q :]
    return home


def _distances(model: PolarModel, state: np.ndarray, stored: np.ndarray) -> np.ndarray:
    home = _home_bearings(model, state, stored)
    # The guard is far below any angle that a camera could resolve.
    return np.asarray(landmark_distance(state[:POLAR], state[model.bearing_slice], home, 1e-6))


def _distance_jacobian(model: PolarModel, state: np.ndarray, stored: np.ndarray) -> np.ndarray:
    """Differentiate D*_i by the state with complex steps: (q, n)."""
    step = 1e-30
    columns = []
    for j in range(model.n):
        shifted = state.astype(complex)
        shifted[j] += 1j * step
        columns.append(np.imag(_distances(model, shifted, stored)) / step)
    return np.stack(columns, axis=1)
