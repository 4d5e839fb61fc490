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
    """All that a filter carries from step to step."""

    state: ca.SX
    """(n,), of `homeward.lab.model.PolarModel`."""
    covariance: ca.SX
    """(n, n), exactly symmetric."""
    active: ca.SX
    """(q,), 1 once a landmark has been seen, else 0."""
    integral: ca.SX
    """(n,), kappa of the PI-EKF; empty in the other filters."""


@dataclass(frozen=True)
class Prediction:
    """Parameters of a predicting step."""

    control: ca.SX
    """(2,), v [m/s] and omega [rad/s] over the step."""
    dt: ca.SX
    """(1,) [s]"""
    stored: ca.SX
    """(q,), beta* [rad]."""
    input_covariance: ca.SX
    """(2, 2), Q of the input over this step."""
    state_variance: ca.SX
    """(n,), added to the diagonal over this step: Qd of an A-EKF's parameters, for one."""
    proportional: ca.SX
    """(n, n), Pi of the PI-EKF over this step; empty in the other filters."""


@dataclass(frozen=True)
class Measurement:
    """Parameters of an updating step."""

    bearings: ca.SX
    """(q,) [rad]; any finite number where nothing was seen."""
    mask: ca.SX
    """(q,), 1 where a landmark is seen, else 0."""
    variance: ca.SX
    """(q,) [rad^2]"""
    gate: ca.SX
    """(1,), the largest innovation^2 / variance accepted; infinity accepts everything."""
    minimum_visible: ca.SX
    """(1,), with fewer landmarks in sight the step does nothing (the paper's p)."""
    integral_gain: ca.SX
    """(n, q), M of the PI-EKF; empty in the other filters."""


@dataclass(frozen=True)
class Updated:
    """What an updating step returns."""

    belief: Belief
    innovation: ca.SX
    """(q,), measured minus predicted before the update [rad], wrapped; 0 where not compared."""
    innovation_variance: ca.SX
    """(q,) [rad^2]"""
    accepted: ca.SX
    """(q,), 1 where the innovation passed the gate and was used."""


Part = TypeVar("Part", Belief, Prediction, Measurement)


def shapes(model: PolarModel, integral: bool) -> dict[str, tuple[int, ...]]:
    """Return the shape of each variable that goes into a step, by the name of its field."""
    n, q, k = model.n, model.q, model.n if integral else 0
    sizes: dict[str, tuple[int, ...]] = {"covariance": (n, n), "input_covariance": (INPUTS, INPUTS)}
    sizes |= {"integral": (k,), "proportional": (k, k), "integral_gain": (k, q if integral else 0)}
    sizes |= {"state": (n,), "state_variance": (n,), "control": (INPUTS,)}
    sizes |= dict.fromkeys(("active", "stored", "bearings", "mask", "variance"), (q,))
    return sizes | dict.fromkeys(("dt", "gate", "minimum_visible"), (1,))


def symbols(part: type[Part], model: PolarModel, integral: bool) -> Part:
    """Return fresh symbols for a part of what goes into a step."""
    sizes = shapes(model, integral)
    return part(*(ca.SX.sym(f.name, *sizes[f.name]) for f in fields(part)))


@dataclass(frozen=True)
class ExtendedKalmanFilter:
    """The paper's EKF as two symbolic steps.

    The augmented filter is the same on a model some of whose home bearings are states; the
    proportional-integral filter adds its correction to both steps.
    """

    model: PolarModel
    integration: Integration = "rk4"
    integral: ClassVar[bool] = False
    """Whether the belief carries an integral of innovations."""
    separable: ClassVar[bool] = True
    """Whether it takes landmarks one by one, as loops in place of symbols do."""

    @property
    def considered(self) -> slice:
        """States that are uncertain, and never updated; none."""
        return slice(self.model.n, self.model.n)

    def propagate(self, belief: Belief, prediction: Prediction) -> Step:
        """Return the mean after a step and its Jacobians: F, G and Gu."""

        def rates(state: ca.SX, control: ca.SX) -> ca.SX:
            return self.model.rates(state, control, prediction.stored, belief.active)

        return discretise(rates, belief.state, prediction.control, prediction.dt, self.integration)

    def predict(self, belief: Belief, prediction: Prediction) -> Belief:
        """Carry the belief over one step: P <- G P G' + Gu Q Gu' + diag(state_variance)."""
        step = self.propagate(belief, prediction)
        # Of a symmetric matrix one triangle is read: half of what compiled code loads.
        covariance = (
            step.by_state @ mirror(belief.covariance) @ step.by_state.T
            + step.by_input @ prediction.input_covariance @ step.by_input.T
            + ca.diag(prediction.state_variance)
        )
        return replace(belief, state=step.state, covariance=mirror(covariance))

    def update(self, belief: Belief, seen: Measurement) -> Updated:
        """Update with the visible bearings, one after the other.

        Innovations and the gate are taken from the belief before any update of this stamp. A
        landmark seen for the first time enters with beta = y and the variance of y.
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
            # H only picks rows, so this is the remainder of the joint innovation.
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
        """Put landmarks seen for the first time into the state, uncorrelated with the rest."""
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
    """Return the paper's A-EKF: an EKF whose state carries the parameters theta_p behind it.

    They are the home bearings beta* of the landmarks `estimated` out of q, None: of all. They walk
    at random with covariance Qd, which is given to each step in the last entries of
    `state_variance`; P is block-diagonal at the start. Raises `ValueError` if an index is repeated
    or is no landmark.
    """
    chosen = tuple(range(q)) if estimated is None else tuple(estimated)
    if len(set(chosen)) != len(chosen) or not all(0 <= i < q for i in chosen):
        raise ValueError(f"parameters {chosen} must be distinct landmarks out of 0 .. {q - 1}")
    return ExtendedKalmanFilter(PolarModel(q, chosen, guard), integration)


@dataclass(frozen=True)
class ProportionalIntegralFilter(ExtendedKalmanFilter):
    """The paper's PI-EKF: predict with F(X, U) + Pi kappa, kappa <- kappa + M e.

    e is the innovation of this stamp, zero in the rows that are not visible, that were rejected,
    or that have just entered; it steers the predictions that follow.
    """

    integral: ClassVar[bool] = True

    def propagate(self, belief: Belief, prediction: Prediction) -> Step:
        """Return the step of the mean, corrected by Pi kappa, and its Jacobians."""
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
    """The EKF with doubtful home bearings as "consider" parameters.

    They stand in the state of the augmented model with a gain of zero: what is stored of them is
    never changed, nor is their variance, but their correlation with the rest is carried along. So
    the gate opens and the pose widens by as much as a wrong home bearing could do.

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
    """Return belief x prediction -> state, by_state, by_input: what grows linearly with q."""
    belief = symbols(Belief, kind.model, kind.integral)
    prediction = symbols(Prediction, kind.model, kind.integral)
    step = kind.propagate(belief, prediction)
    return named_function("propagate", vars(belief) | vars(prediction), step._asdict())


def named_function(name: str, inputs: dict[str, ca.SX], outputs: dict[str, ca.SX]) -> ca.Function:
    """Return a dense function of named symbols; its outputs' names get the suffix ``_out``."""
    dense = [ca.densify(v) for v in outputs.values()]
    # An output may carry the name of an input: CasADi wants the two apart.
    named = [f"{k}_out" for k in outputs]
    return ca.Function(name, list(inputs.values()), dense, list(inputs), named)


LEAST_PIVOT = 1e-18
"""A smaller variance, given the rest, counts as none: it has no sigma points of its own."""


@dataclass(frozen=True)
class UnscentedFilter(ExtendedKalmanFilter):
    """The UKF on the paper's model; its update is Kalman's, since that model measures states.

    State and input together, N numbers, are spread over 2 N points of equal weight, at sqrt(N)
    standard deviations along the columns of the root of their covariance. That is kappa = 0, the
    narrowest spread at which no weight is negative, and no covariance can become indefinite.

    References
    ----------
    Julier, Uhlmann, "Unscented Filtering and Nonlinear Estimation", Proc. IEEE 92(3), 2004.
    """

    separable: ClassVar[bool] = False

    def predict(self, belief: Belief, prediction: Prediction) -> Belief:
        """Carry the sigma points over one step; state_variance is added to what they become."""
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
    """Return L, lower triangular, with L L' the matrix; a direction without variance is left out.

    The matrix (n, n) is symmetric and at least positive semidefinite.
    """
    n = matrix.shape[0]
    root = ca.SX.zeros(n, n)
    for j in range(n):
        pivot = matrix[j, j] - ca.sumsqr(root[j, :j])
        there = pivot > LEAST_PIVOT
        root[j, j] = ca.sqrt(there * pivot)
        inverse = there / ca.sqrt(ca.fmax(pivot, LEAST_PIVOT))
        for i in range(j + 1, n):
            root[i, j] = inverse * (matrix[i, j] - ca.dot(root[i, :j], root[j, :j]))
    return root
