"""The multi-rate extended Kalman filter, its relatives, and their steps as CasADi functions."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from typing import ClassVar, TypeVar

import casadi as ca

from homeward.geometry.angles import wrap
from homeward.geometry.frames import Integration
from homeward.lab.model import INPUTS, POLAR, PolarModel, Step, discretise


@dataclass(frozen=True)
class Belief:
    """Variables that a filter carries from step to step."""

    state: ca.SX
    """(n,), state of `homeward.lab.model.PolarModel`."""
    covariance: ca.SX
    """(n, n), exactly symmetric."""
    active: ca.SX
    """(q,), 1 once a landmark has been seen, otherwise 0."""
    integral: ca.SX
    """(n,), kappa of the PI-EKF; empty in the other filters."""


@dataclass(frozen=True)
class Prediction:
    """Parameters of a prediction."""

    control: ca.SX
    """(2,), v [m/s] and omega [rad/s] over the step."""
    dt: ca.SX
    """(1,) [s]"""
    stored: ca.SX
    """(q,), beta* [rad]."""
    input_covariance: ca.SX
    """(2, 2), Q of the input over this step."""
    state_variance: ca.SX
    """(n,), added to the diagonal over this step, for example Qd of the A-EKF's parameters."""
    proportional: ca.SX
    """(n, n), Pi of the PI-EKF over this step; empty in the other filters."""


@dataclass(frozen=True)
class Measurement:
    """Parameters of an update."""

    bearings: ca.SX
    """(q,) [rad]; any finite number for a landmark out of view."""
    mask: ca.SX
    """(q,), 1 where a landmark is seen, otherwise 0."""
    variance: ca.SX
    """(q,) [rad^2]"""
    gate: ca.SX
    """(1,), largest accepted innovation^2 / variance; infinity accepts everything."""
    minimum_visible: ca.SX
    """(1,), with fewer landmarks in view the step does nothing (the paper's p)."""
    integral_gain: ca.SX
    """(n, q), M of the PI-EKF; empty in the other filters."""


@dataclass(frozen=True)
class Updated:
    """Result of an update."""

    belief: Belief
    innovation: ca.SX
    """(q,), measured minus predicted before the update [rad], wrapped; 0 where not compared."""
    innovation_variance: ca.SX
    """(q,) [rad^2]"""
    accepted: ca.SX
    """(q,), 1 where the innovation passed the gate and was used, otherwise 0."""


Part = TypeVar("Part", Belief, Prediction, Measurement)


def shapes(model: PolarModel, integral: bool) -> dict[str, tuple[int, ...]]:
    """Return the shape of each input of a step by the name of its field."""
    n, q, k = model.n, model.q, model.n if integral else 0
    sizes: dict[str, tuple[int, ...]] = {"covariance": (n, n), "input_covariance": (INPUTS, INPUTS)}
    sizes |= {"integral": (k,), "proportional": (k, k), "integral_gain": (k, q if integral else 0)}
    sizes |= {"state": (n,), "state_variance": (n,), "control": (INPUTS,)}
    sizes |= dict.fromkeys(("active", "stored", "bearings", "mask", "variance"), (q,))
    return sizes | dict.fromkeys(("dt", "gate", "minimum_visible"), (1,))


def symbols(part: type[Part], model: PolarModel, integral: bool) -> Part:
    """Return new symbols for some inputs of a step."""
    sizes = shapes(model, integral)
    return part(*(ca.SX.sym(f.name, *sizes[f.name]) for f in fields(part)))


@dataclass(frozen=True)
class ExtendedKalmanFilter:
    """The paper's EKF as two symbolic steps.

    The augmented filter is the same filter on a model with home bearings as states. The
    proportional-integral filter adds its correction to both steps.
    """

    model: PolarModel
    integration: Integration = "rk4"
    integral: ClassVar[bool] = False
    """Whether the belief has an integral of innovations."""
    separable: ClassVar[bool] = True
    """Whether loops over single landmarks can replace the symbols of all."""

    @property
    def considered(self) -> slice:
        """States that are uncertain but never updated; none here."""
        return slice(self.model.n, self.model.n)

    def propagate(self, belief: Belief, prediction: Prediction) -> Step:
        """Return the state after a step and its Jacobians: F, G and Gu."""

        def rates(state: ca.SX, control: ca.SX) -> ca.SX:
            return self.model.rates(state, control, prediction.stored, belief.active)

        return discretise(rates, belief.state, prediction.control, prediction.dt, self.integration)

    def predict(self, belief: Belief, prediction: Prediction) -> Belief:
        """Predict over one step: P <- G P G' + Gu Q Gu' + diag(state_variance)."""
        step = self.propagate(belief, prediction)
        # Reading one triangle of the symmetric matrix halves the loads of compiled code.
        covariance = (
            step.by_state @ mirror(belief.covariance) @ step.by_state.T
            + step.by_input @ prediction.input_covariance @ step.by_input.T
            + ca.diag(prediction.state_variance)
        )
        return replace(belief, state=step.state, covariance=mirror(covariance))

    def update(self, belief: Belief, seen: Measurement) -> Updated:
        """Update with the visible bearings, one after the other.

        Innovations and gate use the belief before any update of this stamp. A landmark seen for the
        first time enters with beta = y and the variance of y.
        """
        q = self.model.q
        state, covariance = belief.state, mirror(belief.covariance)
        visible = seen.mask * (ca.sum1(seen.mask) >= seen.minimum_visible)
        entering = visible * (1 - belief.active)
        compared = visible * belief.active

        innovation = compared * wrap(seen.bearings - state[self.model.bearing_slice])
        variance = ca.diag(covariance)[self.model.bearing_slice] + seen.variance
        accepted = compared * (innovation**2 <= seen.gate * variance)

        state, covariance = self._enter(state, covariance, entering, seen)
        before = state
        for i in range(q):
            j = POLAR + i
            # H only selects rows, so this is the remainder of the joint innovation.
            remainder = innovation[i] - (state[j] - before[j])
            gain = covariance[:, j] * (accepted[i] / (covariance[j, j] + seen.variance[i]))
            loss = gain @ covariance[j, :]
            gain[self.considered], loss[self.considered, self.considered] = 0, 0
            state = state + gain * remainder
            covariance = mirror(covariance - loss)
        after = replace(belief, state=state, covariance=covariance, active=belief.active + entering)
        return Updated(after, innovation, variance, accepted)

    def _enter(
        self, state: ca.SX, covariance: ca.SX, entering: ca.SX, seen: Measurement
    ) -> tuple[ca.SX, ca.SX]:
        """Insert landmarks seen for the first time, uncorrelated with the other states."""
        rest = self.model.n - POLAR - self.model.q
        keep = 1 - ca.vertcat(ca.SX.zeros(POLAR), entering, ca.SX.zeros(rest))
        fresh = ca.vertcat(ca.SX.zeros(POLAR), entering * seen.bearings, ca.SX.zeros(rest))
        noise = ca.vertcat(ca.SX.zeros(POLAR), entering * seen.variance, ca.SX.zeros(rest))
        return keep * state + fresh, covariance * (keep @ keep.T) + ca.diag(noise)


def mirror(matrix: ca.SX) -> ca.SX:
    """Return the matrix with its lower triangle mirrored: symmetric to the last bit."""
    return ca.tril2symm(ca.tril(matrix))


def augmented_ekf(
    q: int,
    estimated: Iterable[int] | None = None,
    integration: Integration = "rk4",
    guard: float = PolarModel.guard,
) -> ExtendedKalmanFilter:
    """Return the paper's A-EKF: an EKF whose state ends with the parameters theta_p.

    These are the home bearings beta* of the landmarks `estimated`, by default of all q. They follow
    a random walk with covariance Qd, which is the end of `state_variance` in each step. P is
    block-diagonal at the start. Raises `ValueError` if an index is repeated or is no landmark.
    """
    chosen = tuple(range(q)) if estimated is None else tuple(estimated)
    if len(set(chosen)) != len(chosen) or not all(0 <= i < q for i in chosen):
        raise ValueError(f"parameters {chosen} must be distinct landmarks out of 0 .. {q - 1}")
    return ExtendedKalmanFilter(PolarModel(q, chosen, guard), integration)


@dataclass(frozen=True)
class ProportionalIntegralFilter(ExtendedKalmanFilter):
    """The paper's PI-EKF: predict with F(X, U) + Pi kappa, kappa <- kappa + M e.

    e is the innovation of this stamp: zero in rows that are not visible, rejected or seen for the
    first time. It corrects the following predictions.
    """

    integral: ClassVar[bool] = True

    def propagate(self, belief: Belief, prediction: Prediction) -> Step:
        """Return the state after a step, corrected by Pi kappa, and its Jacobians."""
        step = super().propagate(belief, prediction)
        return step._replace(state=step.state + prediction.proportional @ belief.integral)

    def update(self, belief: Belief, seen: Measurement) -> Updated:
        """Update as the EKF does, and add M e to the integral."""
        updated = super().update(belief, seen)
        used = updated.innovation * updated.accepted
        integral = belief.integral + seen.integral_gain @ used
        return replace(updated, belief=replace(updated.belief, integral=integral))


@dataclass(frozen=True)
class SchmidtFilter(ExtendedKalmanFilter):
    """The EKF with uncertain home bearings as "consider" parameters.

    They are states of the augmented model with a gain of zero: their values and variances never
    change, but their correlations with the other states are propagated. Gate and pose covariance
    thus include the effect of wrong home bearings.

    References
    ----------
    Schmidt, "Application of State-Space Methods to Navigation Problems", 1966; Jazwinski,
    "Stochastic Processes and Filtering Theory", 1970, section 8.4.
    """

    separable: ClassVar[bool] = False

    @property
    def considered(self) -> slice:
        """The home bearings in the state."""
        return slice(self.model.n - len(self.model.estimated), self.model.n)


UPDATE_OUTPUTS = ("innovation", "innovation_variance", "accepted")


@lru_cache(maxsize=64)
def predict_function(kind: ExtendedKalmanFilter) -> ca.Function:
    """Return belief x prediction -> belief, with the field names as names."""
    belief = symbols(Belief, kind.model, kind.integral)
    prediction = symbols(Prediction, kind.model, kind.integral)
    after = vars(kind.predict(belief, prediction))
    return named_function("predict", vars(belief) | vars(prediction), after)


@lru_cache(maxsize=64)
def update_function(kind: ExtendedKalmanFilter) -> ca.Function:
    """Return belief x measurement -> belief, innovation, innovation_variance, accepted."""
    belief = symbols(Belief, kind.model, kind.integral)
    seen = symbols(Measurement, kind.model, kind.integral)
    updated = kind.update(belief, seen)
    outputs = vars(updated.belief) | {k: getattr(updated, k) for k in UPDATE_OUTPUTS}
    return named_function("update", vars(belief) | vars(seen), outputs)


@lru_cache(maxsize=64)
def propagate_function(kind: ExtendedKalmanFilter) -> ca.Function:
    """Return belief x prediction -> state, by_state, by_input; its size is linear in q."""
    belief = symbols(Belief, kind.model, kind.integral)
    prediction = symbols(Prediction, kind.model, kind.integral)
    step = kind.propagate(belief, prediction)
    return named_function("propagate", vars(belief) | vars(prediction), step._asdict())


def named_function(name: str, inputs: dict[str, ca.SX], outputs: dict[str, ca.SX]) -> ca.Function:
    """Return a dense function of named symbols; its outputs' names get the suffix ``_out``."""
    dense = [ca.densify(v) for v in outputs.values()]
    # An output may have the name of an input, which CasADi does not allow.
    named = [f"{k}_out" for k in outputs]
    return ca.Function(name, list(inputs.values()), dense, list(inputs), named)


MIN_PIVOT = 1e-18
"""A conditional variance below this counts as zero and has no sigma points."""


@dataclass(frozen=True)
class UnscentedFilter(ExtendedKalmanFilter):
    """The UKF on the paper's model. Its measurements are states, so its update is Kalman's.

    State and input together, N numbers, have 2 N sigma points of equal weight, at sqrt(N) standard
    deviations along the columns of the root of their covariance. This is kappa = 0, the narrowest
    spread without negative weights, so that no covariance can become indefinite.

    References
    ----------
    Julier, Uhlmann, "Unscented Filtering and Nonlinear Estimation", Proc. IEEE 92(3), 2004.
    """

    separable: ClassVar[bool] = False

    def predict(self, belief: Belief, prediction: Prediction) -> Belief:
        """Propagate the sigma points over one step, and add state_variance to their covariance."""
        n = self.model.n
        size = n + INPUTS
        spread = ca.sqrt(size) * ca.diagcat(
            cholesky(belief.covariance), cholesky(prediction.input_covariance)
        )
        step, points = self.step(), []
        for shift in ca.horzsplit(ca.horzcat(spread, -spread)):
            state, control = belief.state + shift[:n], prediction.control + shift[n:]
            points.append(step(state, control, prediction.dt, prediction.stored, belief.active))
        mean = sum(points, ca.SX(n, 1)) / (2 * size)
        off = ca.horzcat(*(point - mean for point in points))
        covariance = off @ off.T / (2 * size) + ca.diag(prediction.state_variance)
        return replace(belief, state=mean, covariance=mirror(covariance))

    def step(self) -> ca.Function:
        """Return state, control, dt, stored, active -> state after a step."""
        belief = symbols(Belief, self.model, self.integral)
        prediction = symbols(Prediction, self.model, self.integral)
        state = self.propagate(belief, prediction).state
        by = prediction.control, prediction.dt, prediction.stored, belief.active
        return ca.Function("step", [belief.state, *by], [state])


def cholesky(matrix: ca.SX) -> ca.SX:
    """Return the lower triangular L with L L' = matrix, zero in directions without variance.

    The matrix (n, n) is symmetric and positive semidefinite.
    """
    n = matrix.shape[0]
    root = ca.SX.zeros(n, n)
    for j in range(n):
        pivot = matrix[j, j] - ca.sumsqr(root[j, :j])
        there = pivot > MIN_PIVOT
        root[j, j] = ca.sqrt(there * pivot)
        inverse = there / ca.sqrt(ca.fmax(pivot, MIN_PIVOT))
        for i in range(j + 1, n):
            root[i, j] = inverse * (matrix[i, j] - ca.dot(root[i, :j], root[j, :j]))
    return root
