"""Settings of the paper's filters on real logs, validated, with units."""

from __future__ import annotations

from statistics import NormalDist
from typing import Annotated, Literal

from homeward.drives.settings import Finite, NonNegative, Positive
from homeward.geometry.frames import Integration
from homeward.io.checks import Field
from homeward.io.models import Strict

Engine = Literal["auto", "interpreter", "native"]
"""Executor of a filter. auto: compiled code where it is cached, or where a compiler exists and the
run is long enough to pay for compiling; otherwise the interpreter."""
DEFAULT_BEARING_SIGMA = 0.02
DEFAULT_SPEED_SIGMA = 0.05
DEFAULT_TURN_SIGMA = 0.05
"""Used where neither settings nor drive specify one; units as in `FilterSettings`."""
BEARING_WALK = 0.05
"""White noise of the bearing states of the paper's filters [rad/sqrt(s)], for an error that their
covariance does not contain: the rates divide by estimated distances, which are poor for a new
landmark. It covers an error of the rates of 0.05 rad/s for one second."""
Matrix = tuple[tuple[Finite, ...], ...]


class NoiseSettings(Strict):
    """Settings of all filters."""

    bearing_sigma: Positive | None = None
    """Standard deviation of a bearing without its own [rad]; None: the drive's, otherwise 0.02."""
    speed_sigma: Positive | None = None
    """White noise of the speed [m/s/sqrt(Hz)]; None: the drive's, otherwise 0.05."""
    turn_sigma: Positive | None = None
    """White noise of the turn rate [rad/s/sqrt(Hz)]; None: the drive's, otherwise 0.05."""
    gate: Annotated[float, Field(gt=0, lt=1)] | None = 0.999
    """Fraction of correct sightings that pass the chi-square gate; None: no gate."""
    minimum_visible: Annotated[int, Field(ge=1)] = 1
    """A stamp with fewer landmarks in view is not used (the paper's p >= 2)."""

    @property
    def gate_threshold(self) -> float:
        """The gate as a quantile of chi-square with one degree of freedom."""
        return float("inf") if self.gate is None else NormalDist().inv_cdf((1 + self.gate) / 2) ** 2


class FilterSettings(NoiseSettings):
    """Settings of the filters in the paper's state."""

    integration: Integration = "rk4"
    guard: NonNegative = 0.01
    """Keeps the model finite at home and where robot, home and a landmark are in line [m]."""
    engine: Engine = "auto"
    """See `Engine`; results of the engines agree to about 1e-9."""


class CartesianSettings(NoiseSettings):
    """Settings of the filters in Cartesian form."""

    home_sigma: Positive | None = None
    """Standard deviation of a home bearing without its own [rad]; None: as for a bearing."""
    nearest: Positive = 1.0
    """Distance from home beyond which most landmarks are [m]. The prior of the inverse distance has
    mean and standard deviation 1 / (2 nearest)."""


class AugmentedSettings(FilterSettings):
    """Settings of the A-EKF."""

    parameters: Literal["all"] | tuple[str, ...] = "all"
    """Landmarks whose home bearings are estimated."""
    parameter_sigma: Positive = 0.2
    """Standard deviation of the estimated home bearings at the start [rad]."""
    parameter_walk: NonNegative = 0.002
    """Random walk of the estimated home bearings, sqrt(Qd) per second [rad/sqrt(s)]."""


class SchmidtSettings(FilterSettings):
    """Settings of the consider filter."""

    doubtful: Literal["all"] | tuple[str, ...] = "all"
    """Landmarks whose home bearings may be wrong."""
    doubt_sigma: Positive = 0.2
    """Standard deviation of their error [rad]."""


class ProportionalIntegralSettings(FilterSettings):
    """Settings of the PI-EKF; its state is (R, theta, alpha, beta_1 .. beta_q)."""

    proportional: Finite | Matrix = 0.05
    """Pi: a number times the identity (with R in cm, as printed), or n x n in SI units."""
    integral_gain: Finite | Matrix = 1.0
    """M: one number for every entry, or n x q."""
    sample_time: Positive = 0.05
    """Step to which Pi refers [s]; it is scaled to the actual step."""


class ParticleSettings(CartesianSettings):
    """Settings of the particle filter."""

    particles: Annotated[int, Field(ge=10, le=1_000_000)] = 1000
    outliers: Annotated[float, Field(gt=0, lt=1)] = 0.01
    """Fraction of sightings that are outliers."""
    seed: Annotated[int, Field(ge=0)] = 0
