"""The adaptive EKF: how noisy odometry, bearings and model are, from the innovations themselves."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose
from homeward.lab.engine.estimators.runner import FilterRunner, Numbers, Tuning
from homeward.lab.filters.carrier import Angles, Held, LandmarkBelief, Outputs
from homeward.lab.filters.ekf import UPDATE_OUTPUTS
from homeward.lab.filters.settings import Engine
from homeward.lab.model import POLAR

FIRST_S, LAST_S = 4.0, 64.0
"""Noise is identified so long after the start, then whenever that time has doubled, until here."""
FARTHEST = math.log(10.0)
"""A standard deviation is sought within this factor, either way, of what was believed [log]."""
COARSE, FINE = math.log(2.0), math.log(1.15)
"""Steps of the search [log]: a standard deviation need not be known to better than 15 %."""

BY_CHANCE = 1.92
"""A log-likelihood that is higher by less than half the 95 % quantile of chi-square(1) says nothing
for another noise."""


class Past(NamedTuple):
    """Past input, the last first: an interval and its twist, or a stamp and its sigmas."""

    before: Past | None
    interval: float
    twist: Held
    seen: Angles | None
    sigmas: Angles


class Adapted(NamedTuple):
    """A belief of the EKF, and how it came about."""

    numbers: Numbers
    past: Past | None
    age: float
    """Since the start [s]."""

    @property
    def active(self) -> np.ndarray:
        """Landmarks that were seen, (q,)."""
        return self.numbers.active


class AdaptiveRunner:
    """The EKF with Q and R identified, as a `homeward.lab.filters.carrier.FilterBackend`.

    Maximum likelihood: of all sigmas of bearings, speed, turn rate and bearing states, those under
    which the innovations of the drive so far, run through the EKF again, are the most probable. The
    belief is then the one which that run ends with. A sighting outside the gate counts as one at
    its edge, so that rejecting does not pay. The `runner` given is the EKF with the noise assumed
    at first; it is used up.

    References
    ----------
    Bavdekar, Deshpande, Patwardhan, "Identification of process and measurement noise covariance for
    state and parameter estimation using extended Kalman filter", J. Process Control 21(4), 2011:
    the idea, by its abstract; the likelihood of innovations is Schweppe's, 1965.
    """

    def __init__(self, runner: FilterRunner) -> None:
        self._runner, self._believed = runner, runner.tuning
        self.stored, self.minimum_visible = runner.stored, runner.minimum_visible
        self.engine: Engine = runner.engine
        self.notes = runner.notes
        self.factors = np.zeros(4)
        """Of bearings, speed, turn rate, bearing states: log of identified over believed sigma."""
        self._next = FIRST_S

    @property
    def diverged(self) -> int:
        """Steps that were left out because their result had diverged."""
        return self._runner.diverged

    def start(self) -> Adapted:
        """Return the belief of the start prior."""
        return Adapted(self._runner.start(), None, 0.0)

    def predict(self, belief: Adapted, interval: float, twist: Held) -> Adapted:
        """Return the belief `interval` [s] later."""
        if interval <= 0.0:
            return belief
        numbers = self._runner.predict(belief.numbers, interval, twist)
        age = belief.age + interval
        if self._next > LAST_S:
            return Adapted(numbers, None, age)
        return Adapted(numbers, Past(belief.past, interval, twist, None, {}), age)

    def update(self, belief: Adapted, seen: Angles, sigmas: Angles) -> tuple[Adapted, Outputs]:
        """Return the belief after one stamp; when it is time, all noise is identified anew."""
        numbers, found = self._runner.update(belief.numbers, seen, sigmas)
        if self._next > LAST_S:
            return Adapted(numbers, None, belief.age), found
        out = {name: found[name].copy() for name in UPDATE_OUTPUTS}
        past = Past(belief.past, 0.0, None, dict(seen), dict(sigmas))
        if belief.age >= self._next:
            numbers = self._identify(list(_in_order(past)))
            self._next *= 2.0 ** (1 + math.floor(math.log2(belief.age / self._next)))
        return Adapted(numbers, past, belief.age), out

    def pose(self, belief: Adapted) -> tuple[Pose, np.ndarray]:
        """Return the pose and its covariance (3, 3)."""
        return self._runner.pose(belief.numbers)

    def landmarks(self, belief: Adapted) -> LandmarkBelief:
        """Return what is known of the landmarks."""
        return self._runner.landmarks(belief.numbers)

    def _identify(self, steps: list[Past]) -> Numbers:
        """Search along the axes for the most probable noise; return the belief that it leads to."""
        diverged, step = self._runner.diverged, COARSE
        best, numbers = self._replay(self.factors, steps)
        while step > FINE:
            improved = False
            for change in step * np.vstack([np.eye(4), -np.eye(4)]):
                tried = self.factors + change
                if np.abs(tried).max() > FARTHEST:
                    continue
                likelihood, belief = self._replay(tried, steps)
                if likelihood > best + BY_CHANCE:
                    best, numbers, self.factors, improved = likelihood, belief, tried, True
            step = step if improved else step / 2
        self._runner.retune(self._tuning(self.factors))
        self._runner.diverged = diverged
        return numbers

    def _replay(self, factors: np.ndarray, steps: list[Past]) -> tuple[float, Numbers]:
        """Return the log-likelihood of the innovations under some noise, and the last belief."""
        runner, total = self._runner, 0.0
        runner.retune(self._tuning(factors))
        belief = runner.start()
        for step in steps:
            if step.seen is None:
                belief = runner.predict(belief, step.interval, step.twist)
            else:
                total += log_likelihood(belief, step.seen, step.sigmas, runner.tuning)
                belief, _ = runner.update(belief, step.seen, step.sigmas)
        return total, belief

    def _tuning(self, factors: np.ndarray) -> Tuning:
        bearing, speed, turn, walk = np.exp(factors).tolist()
        told, density = self._believed, self._believed.state_density.copy()
        density[self._runner.kind.model.bearing_slice] *= walk**2
        return replace(
            told,
            bearing_sigma=told.bearing_sigma * bearing,
            input_density=told.input_density * np.square([speed, turn]),
            state_density=density,
        )


def _in_order(past: Past | None) -> Iterator[Past]:
    """Yield past input, the first first."""
    told = []
    while past is not None:
        told.append(past)
        past = past.before
    return reversed(told)


def log_likelihood(belief: Numbers, seen: Angles, sigmas: Angles, tuning: Tuning) -> float:
    """Return the log-likelihood of the innovations of one stamp, less a constant."""
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
