"""The multi-rate extended Kalman filter, its relatives, and their steps as CasADi functions."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from typing import Any, ClassVar, TypeVar

import casadi as ca

from homeward.geometry.angles import wrap
from homeward.geometry.frames import Integration
from homeward.lab.model import INPUTS, POLAR, PolarModel, Step, discretise


@dataclass(frozen=True)
class Belief:
    """Variables that a filter carries from step to step."""

    state: ca.MX
    """(n,), state of `homeward.lab.model.PolarModel`."""
    covariance: ca.MX
    """(n, n), exactly symmetric."""
    active: ca.MX
    """(q,), 1 once a landmark has been seen, otherwise 0."""
    integral: ca.MX
    """(n,), kappa of the PI-EKF; empty in the other filters."""


@dataclass(frozen=True)
class Prediction:
    """Parameters of a prediction."""

    control: ca.MX
    """(2,), v [m/s] and omega [rad/s] over the step."""
    dt: ca.MX
    """(1,) [s]"""
    stored: ca.MX
    """(q,), beta* [rad]."""
    input_covariance: ca.MX
    """(2, 2), Q of the input over this step."""
    state_variance: ca.MX
    """(n,), added to the diagonal over this step, for example Qd of the A-EKF's parameters."""
    proportional: ca.MX
    """(n, n), Pi of the PI-EKF over this step; empty in the other filters."""


@dataclass(frozen=True)
class Measurement:
    """Parameters of an update."""

    bearings: ca.MX
    """(q,) [rad]; any finite number for a landmark out of view."""
    mask: ca.MX
    """(q,), 1 where a landmark is seen, otherwise 0."""
    variance: ca.MX
    """(q,) [rad^2]"""
    gate: ca.MX
    """(1,), largest accepted innovation^2 / variance; infinity accepts everything."""
    minimum_visible: ca.MX
    """(1,), with fewer landmarks in view the step does nothing (the paper's p)."""
    integral_gain: ca.MX
    """(n, q), M of the PI-EKF; empty in the other filters."""


@dataclass(frozen=True)
class Updated:
    """Result of an update."""

    belief: Belief
    innovation: ca.MX
    """(q,), measured minus predicted before the update [rad], wrapped; 0 where not compared."""
    innovation_variance: ca.MX
    """(q,) [rad^2]"""
    accepted: ca.MX
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
    return part(*(ca.MX.sym(f.name, *sizes[f.name]) for f in fields(part)))


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

    @property
    def considered(self) -> slice:
        """States that are uncertain but never updated; none here."""
        return slice(self.model.n, self.model.n)

    def predict(self, belief: Belief, prediction: Prediction) -> Belief:
        """Predict over one step: P <- G P G' + Gu Q Gu' + diag(state_variance)."""
        propagate = propagate_function(self.model, self.integration)
        given = belief.state, prediction.control, prediction.dt, prediction.stored, belief.active
        state, by_state, by_input = propagate(*given)
        # Reading one triangle of the symmetric matrix halves the loads of compiled code.
        covariance = (
            by_state @ mirror(belief.covariance) @ by_state.T
            + by_input @ prediction.input_covariance @ by_input.T
            + ca.diag(prediction.state_variance)
        )
        return replace(belief, state=state, covariance=mirror(covariance))

    def update(self, belief: Belief, seen: Measurement, lazy: bool) -> Updated:
        """Update with the visible bearings, one after the other; `lazy` skips those not accepted.

        Innovations and gate use the belief before any update of this stamp. A landmark seen for the
        first time enters with beta = y and the variance of y.
        """
        n, rows = self.model.n, self.model.bearing_slice
        unit = ca.densify(ca.DM.eye(n)[:, rows])
        state, covariance = belief.state, mirror(belief.covariance)
        visible = seen.mask * (ca.sum1(seen.mask) >= seen.minimum_visible)
        entering = visible * (1 - belief.active)
        compared = visible * belief.active

        innovation = compared * wrap(seen.bearings - state[rows])
        variance = ca.diag(covariance)[rows] + seen.variance
        accepted = compared * (innovation**2 <= seen.gate * variance)

        state, covariance = self._enter(state, covariance, entering, seen)
        before, found = state[rows], ca.horzcat(state, covariance)
        correct = self._correction(lazy)
        for i in range(self.model.q):
            each = ca.vertcat(innovation[i], before[i], accepted[i], seen.variance[i])
            found = correct(found, unit[:, i], each)
        after = Belief(found[:, 0], found[:, 1:], belief.active + entering, belief.integral)
        return Updated(after, innovation, variance, accepted)

    def _correction(self, lazy: bool) -> ca.Function:
        """Return the update with one bearing, of state and covariance side by side (n, 1 + n).

        Further inputs are the unit vector of the bearing's state (n,) and, of this bearing,
        innovation, state before the stamp, whether it is accepted, and variance: (4,).
        """
        n = self.model.n
        belief, unit, each = (
            ca.MX.sym("belief", n, 1 + n),
            ca.MX.sym("unit", n),
            ca.MX.sym("each", 4),
        )
        innovation, before, accepted, variance = ca.vertsplit(each)
        state, covariance = belief[:, 0], belief[:, 1:]
        # H only selects rows, so this is the remainder of the joint innovation.
        remainder = innovation - (ca.dot(unit, state) - before)
        column = covariance @ unit
        gain = column * (accepted / (ca.dot(unit, column) + variance))
        loss = gain @ column.T
        gain[self.considered], loss[self.considered, self.considered] = 0, 0
        after = ca.horzcat(state + gain * remainder, mirror(covariance - loss))
        given = [belief, unit, each]
        correct = ca.Function("correct", given, [after])
        if not lazy:
            return correct
        chosen = ca.Function.if_else("chosen", correct, ca.Function("kept", given, [belief]))
        return ca.Function("perhaps", given, [chosen(accepted, *given)])

    def _enter(
        self, state: ca.MX, covariance: ca.MX, entering: ca.MX, seen: Measurement
    ) -> tuple[ca.MX, ca.MX]:
        """Insert landmarks seen for the first time, uncorrelated with the other states."""

        def spread(values: ca.MX) -> ca.MX:
            rest = self.model.n - POLAR - self.model.q
            return ca.vertcat(ca.MX.zeros(POLAR), values, ca.MX.zeros(rest))

        keep = 1 - spread(entering)
        noise = ca.diag(spread(entering * seen.variance))
        return (
            keep * state + spread(entering * seen.bearings),
            covariance * (keep @ keep.T) + noise,
        )


def mirror(matrix: ca.MX) -> ca.MX:
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

    def predict(self, belief: Belief, prediction: Prediction) -> Belief:
        """Predict as the EKF does, and correct the state by Pi kappa."""
        after = super().predict(belief, prediction)
        return replace(after, state=after.state + prediction.proportional @ belief.integral)

    def update(self, belief: Belief, seen: Measurement, lazy: bool) -> Updated:
        """Update as the EKF does, and add M e to the integral."""
        updated = super().update(belief, seen, lazy)
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

    @property
    def considered(self) -> slice:
        """The home bearings in the state."""
        return slice(self.model.n - len(self.model.estimated), self.model.n)


UPDATE_OUTPUTS = ("innovation", "innovation_variance", "accepted")


MAX_UNROLLED_STATES = 20
"""Up to here unrolled code compiles within seconds; with 23 states it takes 20 s."""


@lru_cache(maxsize=64)
def steps(kind: ExtendedKalmanFilter, max_unrolled: int | None = None) -> dict[str, ca.Function]:
    """Return ``predict`` and ``update`` as functions of the fields of their arguments, by name.

    Up to a number of states (`MAX_UNROLLED_STATES`) they are unrolled: SX functions, whose size
    grows with n^3. Those of larger filters have loops and products of matrices.
    """
    limit = MAX_UNROLLED_STATES if max_unrolled is None else max_unrolled
    unrolled = kind.model.n <= limit
    belief = symbols(Belief, kind.model, kind.integral)
    prediction = symbols(Prediction, kind.model, kind.integral)
    seen = symbols(Measurement, kind.model, kind.integral)
    updated = kind.update(belief, seen, lazy=not unrolled)
    after = vars(updated.belief) | {k: getattr(updated, k) for k in UPDATE_OUTPUTS}
    predicted = vars(kind.predict(belief, prediction))
    found = {
        "predict": named_function("predict", vars(belief) | vars(prediction), predicted),
        "update": named_function("update", vars(belief) | vars(seen), after),
    }
    return {k: f.expand() if unrolled else f for k, f in found.items()}


@lru_cache(maxsize=64)
def propagate_function(model: PolarModel, integration: Integration) -> ca.Function:
    """Return state, control, dt, stored, active -> state after a step, by_state, by_input."""
    sizes = shapes(model, False)
    names = ["state", "control", "dt", "stored", "active"]
    given = [ca.SX.sym(name, *sizes[name]) for name in names]
    state, control, dt, stored, active = given

    def rates(x: ca.SX, u: ca.SX) -> ca.SX:
        return model.rates(x, u, stored, active)

    step = discretise(rates, state, control, dt, integration)
    return ca.Function("propagate", given, list(step), names, [f"{k}_out" for k in Step._fields])


def named_function(name: str, inputs: Mapping[str, Any], outputs: Mapping[str, Any]) -> ca.Function:
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

    def predict(self, belief: Belief, prediction: Prediction) -> Belief:
        """Propagate the sigma points over one step, and add state_variance to their covariance."""
        n = self.model.n
        size, points = n + INPUTS, 2 * (n + INPUTS)
        spread = ca.diagcat(*map(_root, (belief.covariance, prediction.input_covariance)))
        shifts = ca.sqrt(size) * ca.densify(ca.horzcat(spread, -spread))
        every = propagate_function(self.model, self.integration)
        given = every.sx_in()
        step = ca.Function("step", given, [every(*given)[0]])  # without Jacobians
        # dt, stored and active are the same for all points.
        moved = step.map("points", "serial", points, [2, 3, 4], [])(
            ca.repmat(belief.state, 1, points) + shifts[:n, :],
            ca.repmat(prediction.control, 1, points) + shifts[n:, :],
            *(prediction.dt, prediction.stored, belief.active),
        )
        mean = ca.sum2(moved) / points
        off = moved - ca.repmat(mean, 1, points)
        covariance = off @ off.T / points + ca.diag(prediction.state_variance)
        return replace(belief, state=mean, covariance=mirror(covariance))


def _root(matrix: ca.MX) -> ca.MX:
    symbol = ca.SX.sym("matrix", *matrix.shape)
    return ca.Function("root", [symbol], [cholesky(symbol)])(matrix)


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
