"""The mechanisms of the localiser, and the patches that switch each one off.

A patch replaces one name where the localiser looks it up: a function, method or property. A patch
whose name does not exist any more raises `PatchError`; then adapt it, or remove the mechanism.
"""

import importlib
import inspect
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

PACKAGE = "homeward.localizer"
Change = Callable[[Any], Any]  # returns the replacement of an original


class PatchError(Exception):
    """A name that a patch replaces does not exist."""


@dataclass(frozen=True)
class Mechanism:
    """A part of the localiser that can be switched off."""

    about: str
    patches: dict[str, Change]
    """By place: `module:name` or `module:Class.name`, in the localiser's package."""


def returns(value: Any) -> Change:
    """Return a change to a function or property that only returns a value."""

    def change(original: Any) -> Any:
        if isinstance(original, property | cached_property):
            return property(lambda self: value)
        return lambda *given, **named: value

    return change


def by_result(of: Callable[[Any], Any]) -> Change:
    """Return a change of the result of a function or property."""

    def change(original: Any) -> Any:
        if isinstance(original, property | cached_property):
            get: Any = original.fget if isinstance(original, property) else original.func
            return property(lambda self: of(get(self)))
        return lambda *given, **named: of(original(*given, **named))

    return change


def without_prior(*columns: int) -> Change:
    """Return a change of prior standard deviations: zero in some columns."""

    def fixed(sigmas: np.ndarray) -> np.ndarray:
        sigmas[list(columns)] = 0.0
        return sigmas

    return by_result(fixed)


def _keeps_slip(original: Any) -> Any:
    def scale(self: Any, smoother: Any) -> None:
        sigma = smoother.slip_sigma
        original(self, smoother)
        smoother.slip_sigma = sigma

    return scale


def _no_bodies(original: Any) -> Any:
    from homeward.localizer.map.bodies import Bodies

    return lambda names, *given: Bodies.none(len(names))


def off(about: str, place: str, value: Any = None) -> Mechanism:
    """Return a mechanism of one function that returns `value` when it is off."""
    return Mechanism(about, {place: returns(value)})


def changed(about: str, place: str, change: Change) -> Mechanism:
    """Return a mechanism with one other patch."""
    return Mechanism(about, {place: change})


_PRIORS = "map.map:calibration_sigmas"
_TURN_SLIP, _DELAY = 2, 3  # columns of the prior standard deviations
_NO_SET: frozenset[str] = frozenset()

MECHANISMS = {
    # Inputs
    "sign-check": off("wrong sense or yaw of bearings", "inputs.sign_check:SignChecks.bearings"),
    "frozen-camera": off(
        "repeated bearings of a camera", "inputs.agreement:FrozenCamera.add_bearings", _NO_SET
    ),
    "dead-odometry": off("odometry that repeats zero", "inputs.agreement:DeadOdometry.bearings"),
    "plausibility": changed(
        "implausible twists",
        "inputs.agreement:Plausibility.accepts",
        lambda _: lambda self, t, v, omega, vy: bool(np.isfinite([v, omega, vy]).all()),
    ),
    "contradiction": off(
        "bearings that contradict odometry for long",
        "output.contradiction:Contradiction.add_bearings",
    ),
    "correlated-errors": off(
        "time-correlated bearing errors", "inputs.bearing_noise:CorrelatedErrors.update"
    ),
    # Calibration
    "slip-in-bends": Mechanism(
        "slip in bends as a state",
        {
            _PRIORS: without_prior(_TURN_SLIP),
            "map.learning.learner:Learner.scale_noise_prior": _keeps_slip,
        },
    ),
    "delay": changed("delay of odometry as a state", _PRIORS, without_prior(_DELAY)),
    "time-constant": off("time constant of odometry", "map.learning.learner:shows_lag", False),
    "re-integration": off(
        "motions again with a new delay", "map.smoother:Smoother.is_stale", False
    ),
    "extrinsics-test": off("free extrinsics", "motion.extrinsics:Extrinsics.test", False),
    "extrinsics-error": off(
        "covariance of assumed extrinsics",
        "motion.extrinsics:Extrinsics.assumed_covariance",
        np.zeros((2, 2)),
    ),
    "odometry-change": off("wheels that spin", "map.learning.changes:scale_change"),
    "camera-jump": off("knocked camera", "map.learning.changes:yaw_change"),
    # Noise
    "variance-components": off(
        "noise of odometry from residuals", "map.learning.learner:Learner.learn_odometry"
    ),
    "bearing-component": off(
        "share of bearings in residuals of odometry",
        "map.learning.learner:bearing_variance",
        1.0,
    ),
    "noise-prior-scale": off(
        "prior of odometry noise by the scene", "map.learning.learner:Learner.scale_noise_prior"
    ),
    "common-slip": off(
        "slip common to motions", "motion.odometry:ProcessNoise.common_slip_variance", 0.0
    ),
    "motion-tails": changed(
        "heavy tails of motions", "reference.factors:cauchy_weights", lambda _: np.ones_like
    ),
    # Gating
    "data-snooping": off("gate of each bearing by the others", "reference.frame:_data_snooping"),
    "contradicts-motion": off(
        "joint test of bearings against a motion", "map.gating:contradicts_motion", False
    ),
    "vague-frames": changed(
        "frames after uncertain motions",
        "map.map:Map.inflate",
        lambda inflate: lambda self, gated: inflate(self, gated) and not gated.result.is_vague,
    ),
    # Landmarks
    "mid-drive-moves": off(
        "landmarks that move in mid-drive", "map.landmarks:Landmarks.update_rejections", ()
    ),
    "walking": off("walking landmarks", "map.learning.learner:update_walking"),
    "range-mixture": off(
        "landmarks of unknown distance", "map.landmarks:Landmarks._fit_range_mixture"
    ),
    "swap-guard": off("swapped ids", "map.landmarks:Landmarks._is_swapped", False),
    "undecided": off("doubtful moves wait", "map.landmarks:Landmarks._is_undecided", False),
    "returned": off("landmarks that return", "map.landmarks:Landmarks._has_returned", False),
    "passive-landmarks": off("landmarks out of the window", "map.smoother:Smoother.deactivate"),
    # Home
    "bodies": changed("landmarks on one body", "home.observation:find_bodies", _no_bodies),
    "exchanged-pairs": off("exchanged home bearings", "home.hypotheses:_exchange"),
    "neighbours": off("sets of inliers one flip away", "home.hypotheses:_neighbours", ()),
    "noise-scales": changed(
        "noisier home bearings",
        "home.problem:HomeProblem.assumptions",
        by_result(lambda found: [a for a in found if a.noise_scale == 1.0]),
    ),
    "spurious-information": off(
        "inflation on the circle", "home.estimate:HomeFit.inflation", np.zeros((3, 3))
    ),
    "next-seeds": changed(
        "search of home in the background",
        "home.tracker:HomeTracker._try_next_seed",
        lambda _: lambda self, problem, now, known: now,
    ),
    "propagated-home": off("home between solutions", "home.tracker:propagate"),
    # Output
    "mixture-centre": changed(
        "robust centre of hypotheses",
        "output.pose:centre",
        lambda _: lambda points, weights, covariance: weights @ points,
    ),
    "tails": off("tails of the mixture", "output.pose:missing_tails"),
    "uncheckable": off("outliers that nothing can check", "output.status:uncheckable_outliers"),
    # Recovery
    "second-chart": off("second map of a lost robot", "localizer:Localizer._begin_candidate"),
    "relocalisation": off("relocalisation in the map", "chart:Chart._relocalise", False),
    "single-frame": off("relocalisation from a single frame", "chart:find_by_frame"),
    "slip-detector": off("slip", "recovery.monitor:SlipDetector.suspects", False),
    "scene-change": off(
        "change of scene", "recovery.monitor:SceneChangeDetector.has_changed", False
    ),
    "common-motion": off("common motion of landmarks", "chart:carried_since"),
}


def switch_off(name: str) -> None:
    """Switch a mechanism off in this process, before any localiser is made."""
    for owner, last, original, change in patches(name):
        setattr(owner, last, change(original))


def patches(name: str) -> list[tuple[Any, str, Any, Change]]:
    """Return owner, name, original and change of each patch of a mechanism."""
    return [(*_named(place, name), change) for place, change in MECHANISMS[name].patches.items()]


def _named(place: str, mechanism: str) -> tuple[Any, str, Any]:
    """Return the owner of a place, its name there, and its value; errors name the mechanism."""
    module, path = place.split(":")
    *owners, last = path.split(".")
    try:
        owner: Any = importlib.import_module(f"{PACKAGE}.{module}")
        for each in owners:
            owner = getattr(owner, each)
        return owner, last, inspect.getattr_static(owner, last)
    except (ImportError, AttributeError) as error:
        raise PatchError(
            f"{mechanism}: the patch of {PACKAGE}.{place} does not apply ({error}). Adapt it in "
            "benchmarks/mechanisms.py, or remove the mechanism there if the localiser lost it."
        ) from error
