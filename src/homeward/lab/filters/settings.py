"""Settings of the paper's filters on real logs, validated, with units."""

from __future__ import annotations

from statistics import NormalDist
from typing import Annotated, Literal

from pydantic import Field

from homeward.drives.settings import Finite, NonNegative, Positive
from homeward.geometry.frames import Integration
from homeward.io.keys import Strict

Engine = Literal["auto", "interpreter", "native"]
"""What executes a filter. auto: compiled code where that is at hand, or where there is a compiler
and the run pays for using it; else the interpreter."""
DEFAULT_BEARING_SIGMA = 0.02
DEFAULT_SPEED_SIGMA = 0.05
DEFAULT_TURN_SIGMA = 0.05
"""Where neither settings nor drive say one; units as in `FilterSettings`."""
Matrix = tuple[tuple[Finite, ...], ...]


class NoiseSettings(Strict):
    """What all filters take; None where the drive's own figure (or a default) counts."""

    bearing_sigma: Positive | None = None
    """Of a bearing without a sigma of its own [rad]; None: the drive's, else 0.02."""
    speed_sigma: Positive | None = None
    """White noise of the speed [m/s/sqrt(Hz)]; None: the drive's, else 0.05."""
    turn_sigma: Positive | None = None
    """White noise of the turn rate [rad/s/sqrt(Hz)]; None: the drive's, else 0.05."""
    gate: Annotated[float, Field(gt=0, lt=1)] | None = 0.999
    """Share of right sightings that the chi-square gate lets pass; None: no gate."""
    minimum_visible: Annotated[int, Field(ge=1)] = 1
    """Fewer landmarks in sight than this, and a stamp is not used (the paper's p >= 2)."""

    @property
    def gate_threshold(self) -> float:
        """The gate as a quantile of chi-square with one degree of freedom."""
        return float("inf") if self.gate is None else NormalDist().inv_cdf((1 + self.gate) / 2) ** 2


class FilterSettings(NoiseSettings):
    """What the filters in the paper's state take besides."""

    bearing_walk: NonNegative = 0.05
    """White noise of the bearing states [rad/sqrt(s)], for what their covariance leaves out: the
    rates divide by distances that are themselves estimated, and a landmark's distance is good for
    little when it enters. The default stands for rates wrong by 0.05 rad/s for a second."""
    integration: Integration = "rk4"
    guard: NonNegative = 0.01
    """Keeps the model finite at home and in line with a landmark [m]."""
    engine: Engine = "auto"
    """See `Engine`; results agree to about 1e-9."""


class CartesianSettings(NoiseSettings):
    """What the filters in Cartesian form take besides."""

    home_sigma: Positive | None = None
    """Of a home bearing without a sigma of its own [rad]; None: as a bearing."""
    nearest: Positive = 1.0
    """Landmarks are mostly farther from home [m]: the inverse of their distance is expected at half
    its inverse, give or take as much."""


class AugmentedSettings(FilterSettings):
    """What the A-EKF takes besides."""

    parameters: Literal["all"] | tuple[str, ...] = "all"
    """Landmarks whose home bearings are estimated."""
    parameter_sigma: Positive = 0.2
    """Their standard deviation at the start [rad]."""
    parameter_walk: NonNegative = 0.002
    """Their random walk, sqrt(Qd) per second [rad/sqrt(s)]."""


class SchmidtSettings(FilterSettings):
    """What the consider filter takes besides."""

    doubtful: Literal["all"] | tuple[str, ...] = "all"
    """Landmarks whose home bearings may be wrong."""
    doubt_sigma: Positive = 0.2
    """How wrong, one standard deviation [rad]."""


class ProportionalIntegralSettings(FilterSettings):
    """What the PI-EKF takes besides; its state is (R, theta, alpha, beta_1 .. beta_q)."""

    proportional: Finite | Matrix = 0.05
    """Pi: a number times the identity (with R counted in cm, as printed), or n x n in SI."""
    integral_gain: Finite | Matrix = 1.0
    """M: every entry, or n x q."""
    sample_time: Positive = 0.05
    """The step that Pi is meant for [s]; a longer or shorter one scales it."""


class ParticleSettings(CartesianSettings):
    """What the particle filter takes besides."""

    particles: Annotated[int, Field(ge=10, le=1_000_000)] = 1000
    outliers: Annotated[float, Field(gt=0, lt=1)] = 0.01
    """Share of sightings that may be anything."""
    seed: Annotated[int, Field(ge=0)] = 0
