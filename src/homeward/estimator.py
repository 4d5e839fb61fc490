"""What every estimator is: odometry and bearings in, an `Estimate` out.

The same object serves a robot that runs and a log that is replayed: nothing else is ever fed to an
estimator, and nothing it answers is rewritten later.
"""

from __future__ import annotations

import enum
import functools
import inspect
import math
import numbers
from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass, field, fields
from typing import Any, Protocol, TypeVar, cast, runtime_checkable

import numpy as np

from homeward.errors import InputError
from homeward.geometry.frames import Polar, Pose, to_polar
from homeward.reasons import Rejection


class Status(enum.Enum):
    """How far an answer can be trusted; a reason in words goes with it."""

    WAITING = "waiting"
    """Nothing usable yet."""
    MAPPING = "mapping"
    """Landmarks are being mapped, home is not found."""
    UNVERIFIED = "unverified"
    """A pose, but fewer than four home bearings agree, or another hypothesis fits as well."""
    LOCALISED = "localised"
    """A pose to rely on."""
    COASTING = "coasting"
    """Localised, but no bearings now: odometry alone."""


class ByValue:
    """Base of a frozen dataclass (with ``eq=False``): equal where all fields are, NaN to NaN."""

    def _key(self) -> Hashable:
        """Return what it is compared and hashed by."""
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
    """What one sighting said against what was expected, before any update of its stamp."""

    landmark: str
    value: float
    """Measured minus predicted bearing [rad], wrapped."""
    sigma: float
    """Its predicted standard deviation [rad]."""
    accepted: bool
    """False when a gate rejected the sighting."""


@dataclass(frozen=True, eq=False)
class Estimate(ByValue):
    """What an estimator knows at one time.

    `pose` and `covariance` are both there or both None. Estimates compare and hash by value.
    """

    t: float
    """Time [s], on the clock of the drive."""
    status: Status
    reason: str
    """Why the status is what it is, in words."""
    pose: Pose | None = None
    """Robot's centre in the home frame: x [m], y [m], heading [rad]; plain floats."""
    covariance: np.ndarray | None = None
    """(3, 3), of (x [m], y [m], heading [rad]); read-only."""
    innovations: tuple[Innovation, ...] = ()
    """Those of the sightings at this stamp."""

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


@dataclass(frozen=True, eq=False)
class LandmarkEstimate(ByValue):
    """What an estimator knows of one landmark at the end; NaN where it does not say."""

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
    """beta* as home stored it [rad], in the robot's home frame."""
    home_bearing_estimated: float = np.nan
    """beta* as it must be now [rad]."""
    moved_probability: float = np.nan
    """That it stands elsewhere than when home was stored; NaN when the estimator does not judge."""
    moved: bool | None = None
    """The verdict, or None when the estimator does not judge."""
    moved_at: float = np.nan
    """When it moved during the drive [s]; NaN when it did not."""
    sightings: int = 0


@dataclass
class Counts:
    """What an estimator did with its input."""

    used: int = 0
    """Sightings used."""
    rejected: dict[Rejection, int] = field(default_factory=dict)
    """Samples and sightings not used; `Rejection.words` says why to a user."""

    def reject(self, why: Rejection, number: int = 1) -> None:
        """Count samples that were not used."""
        if number:
            self.rejected[why] = self.rejected.get(why, 0) + number


NO_TIME_S = 1e75
"""No clock says that; it counts as not finite, as what is computed of its powers would be [s]."""


Method = TypeVar("Method", bound=Callable[..., Any])


def in_turn(method: Method) -> Method:
    """Let one thread at a time into a method of an estimator, which has a lock ``_turn``."""

    @functools.wraps(method)
    def inside(self: Any, *values: Any, **named: Any) -> Any:
        with self._turn:
            return method(self, *values, **named)

    return cast(Method, inside)


def guarded(method: Method) -> Method:
    """Let real numbers alone, and mappings to such, into a method, and one thread at a time.

    Anything else raises `InputError` before anything is changed.
    """
    parameters = inspect.signature(method).parameters
    doors = {name: _DOORS[p.annotation] for name, p in parameters.items() if name != "self"}
    if "t" in doors:
        doors["t"] = _time
    in_order = tuple(doors.values())

    @functools.wraps(method)
    def inside(self: Any, *values: Any, **named: Any) -> Any:
        checked = [door(value) for door, value in zip(in_order, values, strict=False)]
        named = {name: doors[name](v) if name in doors else v for name, v in named.items()}
        with self._turn:
            return method(self, *checked, *values[len(checked) :], **named)

    return cast(Method, inside)


def real(value: Any) -> float:
    """Return a real number of any kind as a float; anything else raises `InputError`."""
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
    t = real(value)
    return t if abs(t) < NO_TIME_S else math.nan


def _reals(values: Any) -> dict[str, float]:
    if not isinstance(values, Mapping):
        raise InputError(f"a {type(values).__name__}, where ids to bearings or sigmas are due")
    if other := [name for name in values if not isinstance(name, str)]:
        raise InputError(f"a landmark's id is text, not {str(other[0])[:40]!r}")
    return {n: value if type(value) is float else real(value) for n, value in values.items()}


_DOORS: dict[str, Callable[[Any], Any]] = {
    "float": real,
    "Mapping[str, float]": _reals,
    "Mapping[str, float] | None": lambda values: None if values is None else _reals(values),
}
"""By annotation."""


class Estimator(Protocol):
    """What every estimator of homeward offers, online and offline.

    Samples come in the order of their stamps; one that comes too late, or holds a number that is
    not finite, is counted and otherwise ignored, never an error. How late is too late is up to
    the estimator. A twist is valid from its stamp until the next one's, at most for
    `homeward.odometry.validity.twist_validity`. A twist of which v or omega is NaN means that the
    motion is unknown until the next twist.

    What is no real number at all raises `InputError`, and changes nothing. Samples are of one
    robot and have an order, so an estimator belongs to one thread; where several call it, each
    waits for its turn, and what then comes out of order counts as late.
    """

    name: str
    """The word for it in commands and files."""

    @property
    def counts(self) -> Counts:
        """What was done with the samples so far; ask anew, rather than keep it."""

    @property
    def notes(self) -> tuple[str, ...]:
        """Assumptions, and what was found out, that the user must know of; each a sentence."""

    def odometry(self, t: float, v: float, omega: float) -> None:
        """Take a twist that holds from `t` [s] on: `v` [m/s] forward, `omega` [rad/s]."""

    def bearings(
        self, t: float, sightings: Mapping[str, float], sigmas: Mapping[str, float] | None = None
    ) -> Estimate:
        """Take all sightings of stamp `t` [s] (id to bearing [rad] from the camera's axis).

        `sigmas` [rad] may give the standard deviation of some of them.
        """

    def estimate(self, t: float) -> Estimate:
        """Predict to `t` [s], not before the last sample, and change nothing."""

    def landmarks(self) -> list[LandmarkEstimate]:
        """Everything known of each landmark, in a fixed order."""


@runtime_checkable
class FindsMount(Protocol):
    """An estimator that may find out where the camera sits on the robot."""

    @property
    def mount(self) -> Pose | None:
        """The camera on the robot, if it was found to sit elsewhere than was expected."""


NO_BEARINGS_S = 2.0
"""Without an accepted bearing for so long, the robot is coasting [s]."""
CHECKED = 4
"""Home bearings that must agree before one of them could have been contradicted by the others."""
