"""The Schmidt-Kalman filter: doubt about home bearings is counted, and never resolved."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from homeward.lab.filters.ekf import ExtendedKalmanFilter


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
