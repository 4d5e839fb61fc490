"""The proportional-integral EKF: the integral of the innovations steers the prediction."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

from homeward.lab.filters.belief import Belief, Measurement, Prediction, Updated
from homeward.lab.filters.ekf import ExtendedKalmanFilter
from homeward.lab.model import Step


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
