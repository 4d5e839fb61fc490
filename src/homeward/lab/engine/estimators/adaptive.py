"""The adaptive EKF: estimates the noise of odometry, bearings and model from the innovations."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from homeward.geometry.angles import wrap
from homeward.lab.engine.estimators.runner import FilterRunner, Numbers, Tuning
from homeward.lab.filters.backend import Angles, MaybeTwist, Outputs
from homeward.lab.filters.ekf import UPDATE_OUTPUTS, ExtendedKalmanFilter
from homeward.lab.filters.settings import Engine
from homeward.lab.model import POLAR

FIRST_S, LAST_S = 4.0, 64.0
"""Times of the first and last identification after the start [s]; the time doubles in between."""
MAX_FACTOR = math.log(10.0)
"""Largest factor between identified and assumed standard deviation, in both directions [log]."""
COARSE, FINE = math.log(2.0), math.log(1.15)
"""First step of the search [log], and the step at which it ends: 15 % is accurate enough."""
MIN_GAIN = 1.92
"""Smallest significant gain of log-likelihood: half the 95 % quantile of chi-square(1)."""


class Past(NamedTuple):
    """One past input and its predecessor: an interval with its twist, or a stamp's sightings."""

    before: Past | None
    interval: float
    twist: MaybeTwist
    seen: Angles | None
    sigmas: Angles


class Adapted(Numbers):
    """A belief of the EKF, and the inputs that led to it in `age` [s]."""

    __slots__ = ("age", "past")

    def __init__(self, numbers: Numbers, past: Past | None, age: float) -> None:
        super().__init__(numbers.state.size, numbers.active.size, numbers.memory)
        self.past, self.age = past, age


class AdaptiveRunner(FilterRunner):
    """The EKF with Q and R identified.

    Maximum likelihood: it searches the sigmas of bearings, speed, turn rate and bearing states for
    which the innovations of the drive up to now, replayed through the EKF, are most probable. The
    belief is then the result of that replay. A sighting outside the gate counts as one at its edge,
    so that rejecting sightings does not raise the likelihood.

    References
    ----------
    Bavdekar, Deshpande, Patwardhan, "Identification of process and measurement noise covariance for
    state and parameter estimation using extended Kalman filter", J. Process Control 21(4), 2011:
    the idea, from its abstract; the likelihood of innovations is Schweppe's, 1965.
    """

    def __init__(
        self, kind: ExtendedKalmanFilter, tuning: Tuning, engine: Engine = "auto", steps: int = 0
    ) -> None:
        super().__init__(kind, tuning, engine, steps)
        self._assumed = tuning
        self.factors = np.zeros(4)
        """Log of identified over assumed sigma of bearings, speed, turn rate, bearing states."""
        self._next = FIRST_S

    def start(self) -> Adapted:
        """Return the belief of the start prior."""
        return Adapted(super().start(), None, 0.0)

    def predict(self, belief: Any, interval: float, twist: MaybeTwist) -> Adapted:
        """Return the belief `interval` [s] later."""
        if interval <= 0.0:
            return Adapted(belief, belief.past, belief.age)
        past = Past(belief.past, interval, twist, None, {}) if self._next <= LAST_S else None
        return Adapted(super().predict(belief, interval, twist), past, belief.age + interval)

    def update(self, belief: Any, seen: Angles, sigmas: Angles) -> tuple[Adapted, Outputs]:
        """Return the belief after one stamp; at certain times, identify all noise first."""
        numbers, found = super().update(belief, seen, sigmas)
        if self._next > LAST_S:
            return Adapted(numbers, None, belief.age), found
        out = {name: found[name].copy() for name in UPDATE_OUTPUTS}
        past = Past(belief.past, 0.0, None, dict(seen), dict(sigmas))
        if belief.age >= self._next:
            numbers = self._identify(list(_in_order(past)))
            self._next *= 2.0 ** (1 + math.floor(math.log2(belief.age / self._next)))
        return Adapted(numbers, past, belief.age), out

    def _identify(self, steps: list[Past]) -> Numbers:
        """Search along the axes for the most probable noise; return the belief under it."""
        diverged, step = self.diverged, COARSE
        best, numbers = self._replay(self.factors, steps)
        while step > FINE:
            improved = False
            for change in step * np.vstack([np.eye(4), -np.eye(4)]):
                tried = self.factors + change
                if np.abs(tried).max() > MAX_FACTOR:
                    continue
                likelihood, belief = self._replay(tried, steps)
                if likelihood > best + MIN_GAIN:
                    best, numbers, self.factors, improved = likelihood, belief, tried, True
            step = step if improved else step / 2
        self.retune(self._tuning(self.factors))
        self.diverged = diverged
        return numbers

    def _replay(self, factors: np.ndarray, steps: list[Past]) -> tuple[float, Numbers]:
        """Return the log-likelihood of the innovations under some noise, and the last belief."""
        self.retune(self._tuning(factors))
        belief, total = super().start(), 0.0
        for step in steps:
            if step.seen is None:
                belief = super().predict(belief, step.interval, step.twist)
            else:
                total += log_likelihood(belief, step.seen, step.sigmas, self.tuning)
                belief, _ = super().update(belief, step.seen, step.sigmas)
        return total, belief

    def _tuning(self, factors: np.ndarray) -> Tuning:
        bearing, speed, turn, walk = np.exp(factors).tolist()
        assumed, density = self._assumed, self._assumed.state_density.copy()
        density[self.kind.model.bearing_slice] *= walk**2
        return replace(
            assumed,
            bearing_sigma=assumed.bearing_sigma * bearing,
            input_density=assumed.input_density * np.square([speed, turn]),
            state_density=density,
        )


def _in_order(past: Past | None) -> Iterator[Past]:
    """Return past inputs, oldest first."""
    inputs = []
    while past is not None:
        inputs.append(past)
        past = past.before
    return reversed(inputs)


def log_likelihood(belief: Numbers, seen: Angles, sigmas: Angles, tuning: Tuning) -> float:
    """Return the log-likelihood of the innovations of one stamp, up to a constant."""
    rows = np.array([i for i in seen if belief.active[i]], int)
    if len(seen) < tuning.minimum_visible or not rows.size:
        return 0.0
    own = np.array([sigmas.get(i, tuning.bearing_sigma) for i in rows.tolist()])
    innovation = wrap(np.array([seen[i] for i in rows.tolist()]) - belief.state[POLAR + rows])
    S = belief.covariance[np.ix_(POLAR + rows, POLAR + rows)] + np.diag(own**2)
    inside = innovation**2 <= tuning.gate * np.diag(S)
    out = np.sum(np.log(np.diag(S)[~inside]) + tuning.gate) if not inside.all() else 0.0
    e, S = innovation[inside], S[np.ix_(inside, inside)]
    return float(-0.5 * (out + np.linalg.slogdet(S)[1] + e @ np.linalg.solve(S, e)))
