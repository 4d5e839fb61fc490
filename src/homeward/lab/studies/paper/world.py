"""Random worlds of the paper's cases: landmarks, faults and noise."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from homeward.geometry.angles import wrap
from homeward.geometry.frames import Polar, Pose, from_polar
from homeward.lab.studies.paper.settings import PaperSettings

if TYPE_CHECKING:
    from homeward.lab.studies.paper.images import Sight

CaseName = Literal["1", "2", "3 (one fault)", "3 (several)", "4"]
CASES: tuple[CaseName, ...] = ("1", "2", "3 (one fault)", "3 (several)", "4")


@dataclass(frozen=True)
class PaperWorld:
    """Random quantities of one run, the same for all filters."""

    landmarks: np.ndarray
    """(q, 2), in the home frame [m]."""
    faults: np.ndarray
    """(q,), stored minus true home bearing [rad]."""
    start: Pose
    """Of the robot."""
    guess: Polar
    """First estimate of the start."""
    visible: np.ndarray
    """(k, q), 1 where a landmark is in view."""
    noise: np.ndarray
    """(k, q), of the bearings [rad]."""
    disturbance: np.ndarray
    """(k, 2), of the twist [m/s, rad/s]."""
    moved: np.ndarray
    """(q,) bool, which landmarks have moved since home was stored."""
    sight: Sight | None = None
    """Source of bearings instead of `visible` and `noise`: images."""

    @property
    def stored(self) -> np.ndarray:
        """beta* as stored at home, (q,) [rad]."""
        return np.asarray(wrap(self.true_home_bearings + self.faults))

    @property
    def true_home_bearings(self) -> np.ndarray:
        """Directions of the landmarks from home, (q,) [rad]."""
        return np.asarray(np.arctan2(self.landmarks[:, 1], self.landmarks[:, 0]))


def fault_count(case: CaseName, settings: PaperSettings) -> int:
    """Return the number of moved landmarks of a case."""
    if case in ("2", "4"):
        assumed = settings.assumed
        wanted = assumed.faults if case == "2" else assumed.circle_faults
        return min(wanted, settings.printed.landmarks)
    return sum(fault != 0 for fault in _given_faults(case, settings))


def _given_faults(case: CaseName, settings: PaperSettings) -> tuple[float, ...]:
    """Return the given (not drawn) faults of the first landmarks [rad]."""
    assumed = settings.assumed
    given: dict[str, tuple[float, ...]] = {"3 (one fault)": (assumed.single_fault,)}
    given["3 (several)"] = assumed.several_faults
    return given.get(case, ())[: settings.printed.landmarks]


def visibility(case: CaseName, settings: PaperSettings) -> float:
    """Return the share of landmarks in view at each sample of a case."""
    return settings.assumed.visibility if case.startswith(("2", "3")) else 1.0


def draw_world(case: CaseName, settings: PaperSettings, run: int) -> PaperWorld:
    """Draw run number `run` (from 0) of a case; its layout and noise do not depend on the case."""
    printed, assumed, q = settings.printed, settings.assumed, settings.printed.landmarks
    longest = assumed.circle_time if case == "4" else assumed.longest
    steps = round(longest / printed.sample_time)
    layout, wrong, sight, noise, prior = (
        np.random.default_rng([settings.seed, run, stream]) for stream in range(5)
    )
    angles = 2 * np.pi * np.arange(q) / q + layout.uniform(-1, 1, q) * assumed.layout_jitter
    distances = layout.uniform(*assumed.layout_distance, q)
    R, theta, alpha = printed.start_cm
    start = Polar(R / 100, theta, alpha)
    guess = np.array(start) + prior.normal(size=3) * assumed.initial_error
    faults = _faults(case, settings, wrong)
    return PaperWorld(
        landmarks=np.column_stack([distances * np.cos(angles), distances * np.sin(angles)]),
        faults=faults,
        moved=faults != 0,
        start=from_polar(start),
        guess=Polar(*guess.tolist()),
        visible=(sight.random((steps, q)) < visibility(case, settings)).astype(float),
        noise=noise.normal(size=(steps, q)) * assumed.bearing_sigma,
        disturbance=noise.normal(size=(steps, 2)) * assumed.disturbance,
    )


def _faults(case: CaseName, settings: PaperSettings, rng: np.random.Generator) -> np.ndarray:
    assumed, q = settings.assumed, settings.printed.landmarks
    faults = np.zeros(q)
    if case in ("2", "4"):
        which = rng.choice(q, size=fault_count(case, settings), replace=False)
        faults[which] = rng.uniform(*assumed.fault, which.size) * rng.choice([-1, 1], which.size)
    given = _given_faults(case, settings)
    faults[: len(given)] = given
    return faults
