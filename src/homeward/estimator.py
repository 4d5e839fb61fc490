"""The protocol of estimators: odometry and bearings in, an `Estimate` out.

A running robot and a replayed log feed the same object in the same way. Estimates are causal: a
later sample never changes an earlier estimate.
"""

from __future__ import annotations

import enum
import functools
import inspect
import math
import numbers
import threading
from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass, field, fields
from typing import Any, Protocol, TypeVar, cast, runtime_checkable

import numpy as np

from homeward.errors import InputError
from homeward.geometry.frames import Polar, Pose, to_polar
from homeward.geometry.statistics import PoseAccuracy
from homeward.reasons import Rejection
from homeward.sighting_keys import keyed


class Status(enum.Enum):
    """Quality of an estimate; `Estimate.reason` explains it."""

    WAITING = "waiting"
    """Nothing usable yet."""
    MAPPING = "mapping"
    """Landmarks are mapped; home is not found yet."""
    UNVERIFIED = "unverified"
    """A pose, but fewer than four home bearings agree, or another hypothesis fits as well."""
    LOCALISED = "localised"
    """A verified pose."""
    COASTING = "coasting"
    """Localised, but without bearings now: the pose is dead-reckoned."""

    def __str__(self) -> str:
        """Return its word, as `estimate.csv` has it."""
        return self.value


class ByValue:
    """Base of a frozen dataclass (with ``eq=False``) that compares by value; NaN equals NaN."""

    def _key(self) -> Hashable:
        return tuple(_comparable(getattr(self, f.name)) for f in fields(self))  # type: ignore[arg-type]

    def __eq__(self, other: object) -> bool:
        return type(other) is type(self) and self._key() == other._key()

    def __hash__(self) -> int:
        return hash(self._key())


def _comparable(value: Any) -> Hashable:
    if isinstance(value, np.ndarray):
        return value.shape, tuple(_comparable(v) for v in value.ravel().tolist())
    return "NaN" if value != value else value


@dataclass(frozen=True, eq=False)
class Innovation(ByValue):
    """The innovation of one sighting, before any update at its stamp."""

    landmark: str
    value: float
    """Measured minus predicted bearing [rad], wrapped."""
    sigma: float
    """Its predicted standard deviation [rad]."""
    accepted: bool
    """False when a gate rejected the sighting."""


@dataclass(frozen=True, eq=False)
class Estimate(ByValue):
    """State of an estimator at one time; `pose` and `covariance` are both given or both None."""

    t: float
    """Time [s], on the clock of the drive."""
    status: Status
    reason: str
    """Explanation of the status, in words."""
    pose: Pose | None = None
    """Robot's centre in the home frame: x [m], y [m], heading [rad]; floats."""
    covariance: np.ndarray | None = None
    """(3, 3), of (x [m], y [m], heading [rad]); read-only."""
    innovations: tuple[Innovation, ...] = ()
    """Innovations of the sightings at this stamp."""

    def __post_init__(self) -> None:
        if self.pose is not None:
            object.__setattr__(self, "pose", Pose(*map(float, self.pose)))
        if self.covariance is not None:
            covariance = np.array(self.covariance)
            covariance.flags.writeable = False
            object.__setattr__(self, "covariance", covariance)

    @property
    def polar(self) -> Polar | None:
        """The pose as (R [m], theta [rad], alpha [rad])."""
        return None if self.pose is None else Polar(*map(float, to_polar(self.pose)))

    @property
    def sigmas(self) -> np.ndarray:
        """Standard deviations of (x [m], y [m], heading [rad]), shape (3,); NaN without a pose."""
        if self.covariance is None:
            return np.full(3, np.nan)
        return np.sqrt(np.diag(self.covariance))

    @property
    def accuracy(self) -> PoseAccuracy | None:
        """Standard deviations of position [m] and heading [rad], and protection level [m].

        By the covariance; None without a pose. The status states that a pose is verified, not that
        it is accurate enough for a use: that is an `AccuracyLimit`.
        """
        if self.covariance is None:
            return None
        return PoseAccuracy(*map(float, PoseAccuracy.of(self.covariance)))


@dataclass(frozen=True, eq=False)
class LandmarkEstimate(ByValue):
    """Estimate of one landmark; NaN where the estimator does not compute a value."""

    landmark: str
    x: float = np.nan
    """In the home frame [m]."""
    y: float = np.nan
    """In the home frame [m]."""
    distance: float = np.nan
    """From home [m]."""
    sigma_distance: float = np.nan
    """[m]"""
    home_bearing_stored: float = np.nan
    """beta* as stored at home [rad], in the robot's home frame."""
    home_bearing_estimated: float = np.nan
    """beta* of its present position [rad]."""
    moved_probability: float = np.nan
    """Probability that it has moved since home was stored; NaN where this is not tested."""
    moved: bool | None = None
    """Whether it has moved; None where this is not tested."""
    moved_at: float = np.nan
    """Time during the drive at which it moved [s]; NaN when it did not."""
    sightings: int = 0
    exchanged_with: str = ""
    """The landmark in whose place it is, and which is in its place; empty if there is none."""


@dataclass
class Counts:
    """Numbers of samples that an estimator used and rejected."""

    used: int = 0
    """Sightings used."""
    rejected: dict[Rejection, int] = field(default_factory=dict)
    """Samples and sightings not used, by reason."""
    ranges: int = 0
    """Ranges used."""

    def reject(self, reason: Rejection, number: int = 1) -> None:
        """Count samples that were not used."""
        if number:
            self.rejected[reason] = self.rejected.get(reason, 0) + number


MAX_TIME_S = 1e75
"""A larger time counts as not finite, since its powers would overflow [s]."""
Method = TypeVar("Method", bound=Callable[..., Any])


class CopyableLock:
    """A lock of an object that may be copied or pickled: the copy has a lock of its own."""

    def __init__(self) -> None:
        self._lock = threading.RLock()

    def __enter__(self) -> None:
        self._lock.acquire()

    def __exit__(self, *_: object) -> None:
        self._lock.release()

    def __reduce__(self) -> tuple[type[CopyableLock], tuple[()]]:
        return CopyableLock, ()


def synchronised(method: Method) -> Method:
    """Decorate a method of an object with a lock ``_turn``: one thread at a time calls it."""

    @functools.wraps(method)
    def inside(self: Any, *values: Any, **named: Any) -> Any:
        with self._turn:
            return method(self, *values, **named)

    return cast(Method, inside)


def guarded(method: Method) -> Method:
    """Decorate a method as `synchronised`, with arguments that must be real numbers or mappings.

    Any other argument raises `InputError` before the method is called.
    """
    parameters = inspect.signature(method).parameters
    converters = {
        name: _CONVERTERS[p.annotation] for name, p in parameters.items() if name != "self"
    }
    if "t" in converters:
        converters["t"] = _time
    in_order = tuple(converters.values())

    @functools.wraps(method)
    def inside(self: Any, *values: Any, **named: Any) -> Any:
        checked = [convert(value) for convert, value in zip(in_order, values, strict=False)]
        named = {n: converters[n](v) if n in converters else v for n, v in named.items()}
        with self._turn:
            return method(self, *checked, *values[len(checked) :], **named)

    return cast(Method, inside)


def real(value: Any) -> float:
    """Return a real number of any type as a float; anything else raises `InputError`."""
    if type(value) is not float:
        if isinstance(value, np.ndarray) and value.size == 1:
            value = value.reshape(())[()]
        if not isinstance(value, numbers.Real):
            raise InputError(f"{str(value)[:40]!r} is a {type(value).__name__}, not a real number")
    try:
        return float(value)
    except OverflowError:
        return math.inf


def _time(value: Any) -> float:
    if hasattr(value, "isoformat") or isinstance(value, np.datetime64):
        raise InputError(f"t is a {type(value).__name__}, not a time [s]", advice="count seconds")
    t = real(value)
    return t if abs(t) < MAX_TIME_S else math.nan


def _reals(values: Any) -> dict[str, float]:
    if not isinstance(values, Mapping):
        raise InputError(f"a {type(values).__name__} instead of bearings or sigmas by landmark id")
    if other := [name for name in values if not isinstance(name, str)]:
        advice = "give str(id)"
        raise InputError(f"a landmark id must be text, not {str(other[0])[:40]}", advice=advice)
    return {n: value if type(value) is float else real(value) for n, value in values.items()}


_CONVERTERS: dict[str, Callable[[Any], Any]] = {
    "float": real,
    "Mapping[str, float]": _reals,
    "Mapping[str, float] | Sequence[Any]": lambda values: _reals(keyed(values)),
    "str": str,
    "Mapping[str, float] | None": lambda values: None if values is None else _reals(keyed(values)),
}
"""By annotation of the argument."""


class Estimator(Protocol):
    """The interface of every estimator of homeward, online and offline.

    Samples come in the order of their stamps. A sample that is too late or not finite is counted in
    `counts` and otherwise ignored; the estimator sets the maximum delay. A twist is valid until the
    stamp of the next one, at most for `homeward.odometry.validity.twist_validity`. A twist whose v
    or omega is NaN means that the motion is unknown until the next twist.

    An argument that is no real number raises `InputError` and changes nothing. Samples have an
    order, so one thread should call an estimator. Calls from several threads run one at a time;
    samples that arrive out of order this way count as late.
    """

    name: str
    """Its name in commands and files."""

    @property
    def counts(self) -> Counts:
        """Current numbers of used and rejected samples; read it again instead of keeping it."""

    @property
    def notes(self) -> tuple[str, ...]:
        """Assumptions and findings that the user must read; each a sentence."""

    def odometry(self, t: float, v: float, omega: float) -> None:
        """Add a twist that is valid from `t` [s] on: `v` [m/s] forward, `omega` [rad/s]."""

    def bearings(
        self, t: float, sightings: Mapping[str, float], sigmas: Mapping[str, float] | None = None
    ) -> Estimate:
        """Add all sightings of stamp `t` [s] (id to bearing [rad] from the camera's axis).

        `sigmas` [rad] are standard deviations by id; they may be given for some sightings only.
        """

    def estimate(self, t: float) -> Estimate:
        """Predict to `t` [s], not before the last sample, without changing the state."""

    def landmarks(self) -> list[LandmarkEstimate]:
        """Return the estimates of all landmarks, in a fixed order."""


@runtime_checkable
class UsesCameras(Protocol):
    """An estimator whose method `bearings` takes ranges and the name of the camera, too."""

    uses_cameras: bool

    def bearings(
        self,
        t: float,
        sightings: Mapping[str, float],
        sigmas: Mapping[str, float] | None = None,
        ranges: Mapping[str, float] | None = None,
        range_sigmas: Mapping[str, float] | None = None,
        camera: str = "",
    ) -> Estimate:
        """Add all sightings of one stamp and camera.

        `ranges` and their standard deviations `range_sigmas` are by id [m].
        """


def add_frame(
    estimator: Estimator,
    t: float,
    sightings: Mapping[str, float],
    sigmas: Mapping[str, float] | None,
    ranges: Mapping[str, float] | None = None,
    range_sigmas: Mapping[str, float] | None = None,
    camera: str = "",
) -> Estimate:
    """Add all sightings of one stamp and camera to any estimator; arguments as for `UsesCameras`.

    An estimator that takes no ranges gets none. `InputError` if it takes one camera only.
    """
    if isinstance(estimator, UsesCameras):
        return estimator.bearings(t, sightings, sigmas, ranges, range_sigmas, camera)
    if camera:
        raise InputError(f"the estimator {estimator.name} takes one camera; robust takes several")
    return estimator.bearings(t, sightings, sigmas)


def takes_sideways(estimator: Estimator) -> bool:
    """Return whether the method `odometry` of an estimator takes a sideways speed `vy`, too."""
    return bool(getattr(estimator, "uses_sideways", False))


def add_twist(estimator: Estimator, t: float, v: float, omega: float, vy: float = 0.0) -> None:
    """Add a twist to any estimator; one that takes no sideways speed gets none."""
    if takes_sideways(estimator):
        estimator.odometry(t, v, omega, vy)  # type: ignore[call-arg]
    else:
        estimator.odometry(t, v, omega)


@runtime_checkable
class EstimatesExtrinsics(Protocol):
    """An estimator that may estimate the camera extrinsics."""

    @property
    def mount(self) -> Pose | None:
        """Estimated extrinsics, where they differ from the given ones; else None."""


NO_BEARINGS_S = 2.0
"""Without an accepted bearing for this time, the robot is coasting [s]."""
MIN_AGREEING = 4
"""Minimum number of agreeing home bearings for a verified pose: with 3 or fewer, no bearing can
contradict the others."""
