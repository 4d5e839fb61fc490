"""The unscented Kalman filter: the prediction by sigma points instead of Jacobians."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import casadi as ca

from homeward.lab.filters.belief import Belief, Prediction, belief_symbols, prediction_symbols
from homeward.lab.filters.ekf import ExtendedKalmanFilter, mirror
from homeward.lab.model import INPUTS

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
        belief = belief_symbols(self.model, self.integral)
        prediction = prediction_symbols(self.model, self.integral)
        state = self.propagate(belief, prediction).state
        by = prediction.control, prediction.dt, prediction.stored, belief.active
        return ca.Function("step", [belief.state, *by], [state])


def cholesky(matrix: ca.SX) -> ca.SX:
    """Return L, lower triangular, with L L' the matrix; a direction without variance is left out.

    Parameters
    ----------
    matrix : SX, shape (n, n)
        Symmetric and at least positive semidefinite.
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
