"""The multi-rate extended Kalman filter: predict at every sample, update with what is visible."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import casadi as ca

from homeward.geometry.angles import wrap
from homeward.geometry.frames import Integration
from homeward.lab.filters.belief import Belief, Measurement, Prediction, Updated
from homeward.lab.model import POLAR, PolarModel, Step, discretise


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
