"""Parameters that the paper prints, and assumptions where it prints none."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from homeward.control.laws import STOP_RADIUS
from homeward.drives.settings import Finite, NonNegative, Positive
from homeward.geometry.frames import Integration
from homeward.io.checks import AfterValidator, Field
from homeward.io.models import Strict, model_validator
from homeward.lab.model import Inverse
from homeward.lab.simulation.scenario import ascending

Interval = Annotated[tuple[Positive, Positive], AfterValidator(ascending)]
"""Minimum and maximum."""
MAX_BEARINGS = 100_000
"""Samples times landmarks of a run, so that a block fits into memory."""


class Printed(Strict):
    """The parameters that the paper prints, in its units: R in cm, angles in rad."""

    sample_time: Positive = 0.05
    """[s]"""
    start_cm: tuple[Finite, Finite, Finite] = (75.0, -0.872, 0.349)
    """The robot's pose at the start: R [cm], theta, alpha [rad]."""
    speed_cm: Positive = 12.5
    """v [cm/s]"""
    landmarks: Annotated[int, Field(ge=1)] = 7
    """q"""
    P0: Positive = 1.0
    """P(0|0), times the identity [cm^2, rad^2]."""
    Q: Positive = 0.01
    """Times the identity."""
    R: Positive = 0.05
    """Times the identity."""
    Qd: NonNegative = 0.0025
    """Process noise of each parameter of the A-EKF, per sample [rad^2]."""
    Pi: Finite | tuple[Finite, Finite, Finite, Finite] = 0.05
    """Times the identity; or the diagonal: for R, theta, alpha, and all bearings."""
    M: Finite | Literal["HT", "own"] = 1.0
    """Value of all entries; or "HT": H', where each innovation acts on its own bearing only; or
    "own": the same for the bearings, and ones for the pose."""


class Assumed(Strict):
    """Parameters that the paper does not print, or prints ambiguously."""

    layout_jitter: NonNegative = 0.3
    """Landmarks are at angles 2 pi i / q with errors of at most this [rad] ..."""
    layout_distance: Interval = (1.0, 2.0)
    """... and at distances from home drawn from this interval [m]."""
    faults: Annotated[int, Field(ge=0)] = 2
    """Number of wrong home bearings in Case 2."""
    fault: Interval = (0.2, 0.5)
    """Size of their errors, with random sign [rad]."""
    single_fault: Finite = 0.3
    """Of beta*_1 in Case 3, printed as 30 % of an angle that is not printed [rad]."""
    several_faults: tuple[Finite, ...] = (0.3, -0.3, 0.3)
    """Of beta*_1, beta*_2 and so on in the second part of Case 3 [rad]."""
    visibility: Annotated[float, Field(gt=0, le=1)] = 0.7
    """Share of landmarks in view at each sample of Cases 2 and 3; all are in 1 and 4."""
    minimum_visible: Annotated[int, Field(ge=1)] = 2
    """The paper's p: with fewer landmarks in view, a sample only predicts."""
    bearing_sigma: NonNegative = 0.01
    """Of the measured bearings [rad]."""
    disturbance: tuple[NonNegative, NonNegative] = (0.0, 0.0)
    """Standard deviations of the true twist, per sample: [m/s] and [rad/s]."""
    initial_error: tuple[NonNegative, NonNegative, NonNegative] = (0.0, 0.0, 0.0)
    """Standard deviations of the first estimate's error: R [m], theta, alpha [rad]. The printed
    X_r(0) is the robot's pose; no first estimate is printed. Zero: it equals the pose."""
    meaning_of_Q: Literal["input", "state"] = "input"
    """The covariance of (v [cm/s], omega [rad/s]), as in the equations, or of the n states (R in
    cm), as its printed size suggests."""
    meaning_of_R: Literal["variance", "deviation"] = "variance"
    """Whether the printed R is a variance [rad^2] or a standard deviation [rad]."""
    stop_radius: Positive = STOP_RADIUS
    """Homing ends where the estimated R is below this [m] ..."""
    longest: Positive = 20.0
    """... or after this time [s]."""
    circle_turn_rate: Finite = 0.5
    """omega of Case 4 [rad/s], for a circle of 0.25 m next to home ..."""
    circle_time: Positive = 20.0
    """... driven for this time [s]."""
    circle_faults: Annotated[int, Field(ge=0)] = 0
    """Number of wrong home bearings in Case 4, with errors as in Case 2."""
    guard: NonNegative = 0.01
    """Keeps the model finite at home and on the line through home and a landmark [m]."""
    inverse: Inverse = "smooth"
    """Form of 1/x there: x / (x^2 + guard^2), or 1/x with the size of x at least the guard."""
    integration: Integration = "rk4"


class Imaged(Strict):
    """Panoramic images, where measurements come from them."""

    width: Annotated[int, Field(ge=128, le=2048)] = 768
    """Columns; a quarter as many rows."""
    rate: Annotated[float, Field(gt=0, le=1000)] = 5.0
    """Rate of images [Hz], at whole samples; other samples only predict."""


class PaperSettings(Strict):
    """Settings of `homeward study paper`."""

    printed: Printed = Printed()
    assumed: Assumed = Assumed()
    measurements: Literal["model", "images"] = "model"
    """Source of bearings: the model's equations or rendered panoramas."""
    images: Imaged = Imaged()
    runs: Annotated[int, Field(ge=1, le=100_000)] = 100
    """Number of random layouts, faults and noises per case."""
    seed: Annotated[int, Field(ge=0)] = 0
    """Seed of the first run."""

    @model_validator(mode="after")
    def _as_many_samples_as_fit(self) -> Self:
        times, dt, q = self.assumed, self.printed.sample_time, self.printed.landmarks
        if min(times.longest, times.circle_time) < dt:
            raise ValueError(
                "assumed.longest and assumed.circle_time: shorter than printed.sample_time"
            )
        if max(times.longest, times.circle_time) / dt * q > MAX_BEARINGS:
            raise ValueError(
                f"printed.sample_time and landmarks, assumed.longest and circle_time: more than"
                f" {MAX_BEARINGS:,} bearings in a run; use fewer samples or landmarks"
            )
        return self
