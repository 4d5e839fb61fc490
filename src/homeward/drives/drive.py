"""A drive: odometry, sightings, home bearings and ground truth, from any source."""

from __future__ import annotations

import math
from array import array
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields, replace
from itertools import pairwise
from typing import Any, Self, cast

import numpy as np

from homeward.drives.landmarks import KnownLandmarks
from homeward.drives.settings import DriveSettings
from homeward.errors import InputError, require_kind
from homeward.estimator import ByValue
from homeward.geometry.angles import interpolate, wrap
from homeward.geometry.frames import Pose, between
from homeward.odometry.validity import validities
from homeward.sighting_keys import keyed


class Columns:
    """A table whose fields are columns of the same length."""

    def _to_arrays(self) -> None:
        """Convert lists and series; `InputError` for another length or no numbers."""
        num = -1
        for column in fields(cast(Any, self)):
            name, given = column.name, getattr(self, column.name)
            values = np.asarray(given)
            if name not in ("landmark", "camera") and values.dtype.kind not in "fiub":
                if values.dtype.kind == "M":
                    advice = "count seconds"
                    raise InputError("dates instead of times [s]", part=name, advice=advice)
                try:
                    values = values.astype(float)
                except (TypeError, ValueError) as error:
                    raise InputError("not a list of numbers", part=name) from error
            if column.default_factory is MISSING or values.size:
                num = values.size if num < 0 else num
                if values.shape != (num,):
                    problem = f"a shape of {values.shape} instead of ({num},)"
                    raise InputError(problem, part=name)
            object.__setattr__(self, name, values)

    def rows(self, use: np.ndarray) -> Self:
        """Return the rows of a mask (n,) or of indices."""
        return type(self)(*(getattr(self, f.name)[use] for f in fields(cast(Any, self))))

    @classmethod
    def joined(cls, parts: Sequence[Self]) -> Self:
        """Return the concatenated rows of several tables."""
        names = [f.name for f in fields(cast(Any, cls))]
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


SIDEWAYS_SHARE, SIDEWAYS_WINDOW_S = 0.02, 10.0
"""A robot strafes where its sideways path exceeds this share of its forward path in this time [s].
"""
MIN_SIDEWAYS_M = 0.1
"""Minimum sideways path of a robot that strafes, in this time [m]: noise at standstill is less."""
JITTER_S = 1.0
"""Sideways motion to and fro within this time is jitter [s]."""


@dataclass(frozen=True)
class Odometry(Columns):
    """Twists, each valid from its stamp to the next. All arrays have shape (n,).

    Where both v and omega are NaN, the motion is unknown from that stamp to the next.
    Without `vy`, the robot never moves sideways.
    """

    t: np.ndarray
    """Strictly increasing times [s]."""
    v: np.ndarray
    """Forward speed [m/s]."""
    omega: np.ndarray
    """Yaw rate [rad/s]."""
    vy: np.ndarray = field(default_factory=lambda: np.empty(0))
    """Speed to the left [m/s]."""

    def __post_init__(self) -> None:
        self._to_arrays()
        if self.t.size != self.vy.size or not self.vy.any():  # no -0
            object.__setattr__(self, "vy", np.zeros(self.t.size))

    @property
    def moves_sideways(self) -> bool:
        """Whether a sideways speed differs from 0."""
        return bool(np.nan_to_num(self.vy).any())

    @property
    def strafes(self) -> bool:
        """Whether the sideways path exceeds `SIDEWAYS_SHARE` of the forward path anywhere.

        Motion to and fro within `JITTER_S` is jitter, as that of legs, and does not count.
        """
        if not self.moves_sideways:
            return False
        edges = np.arange(self.t[0], self.t[-1] + 1.5 * JITTER_S, JITTER_S)
        window = np.ones(min(round(SIDEWAYS_WINDOW_S / JITTER_S), edges.size - 1))

        def path(speed: np.ndarray) -> np.ndarray:
            steps = np.nan_to_num(speed * validities(self.t))[:-1]
            passed = np.interp(edges, self.t, np.append(0.0, np.cumsum(steps)))
            return np.asarray(np.convolve(np.abs(np.diff(passed)), window, "valid"))

        limit = np.maximum(SIDEWAYS_SHARE * path(np.abs(self.v)), MIN_SIDEWAYS_M)
        return bool((path(self.vy) > limit).any())

    @property
    def bridged(self) -> Self:
        """The odometry with each unknown twist replaced by the last known one, or else by 0."""
        known = np.isfinite(self.v) & np.isfinite(self.omega) & np.isfinite(self.vy)
        if known.all():
            return self
        last = np.maximum.accumulate(np.where(known, np.arange(known.size), -1))
        twist = self.v, self.omega, self.vy
        return type(self)(self.t, *(np.where(last < 0, 0.0, part[last]) for part in twist))


@dataclass(frozen=True)
class Sightings(Columns):
    """Bearings of landmarks during a drive. All arrays have shape (n,)."""

    t: np.ndarray
    """Non-decreasing times [s]."""
    landmark: np.ndarray
    """Ids (str)."""
    bearing: np.ndarray
    """From the camera's axis [rad], in (-pi, pi]."""
    sigma: np.ndarray = field(default_factory=lambda: np.empty(0))
    """[rad]; NaN where not given."""
    range: np.ndarray = field(default_factory=lambda: np.empty(0))
    """[m]; NaN where not given."""
    range_sigma: np.ndarray = field(default_factory=lambda: np.empty(0))
    """[m]; NaN where not given."""
    camera: np.ndarray = field(default_factory=lambda: np.empty(0, object))
    """Names of cameras (str), as in `RobotSettings.cameras`; empty for the first one."""
    elevation: np.ndarray = field(default_factory=lambda: np.empty(0))
    """Above the horizontal plane of the camera [rad], for `Tilt`; NaN where not given."""

    def __post_init__(self) -> None:
        self._to_arrays()
        for name in ("sigma", "range", "range_sigma", "camera", "elevation"):
            if self.t.size and not getattr(self, name).size:
                value = np.array("" if name == "camera" else np.nan, getattr(self, name).dtype)
                object.__setattr__(self, name, np.broadcast_to(value, self.t.size))

    @classmethod
    def of_rows(cls, rows: Sequence[tuple[float, str, float, float]]) -> Self:
        """Return the sightings of rows (t, landmark, bearing, sigma), in order of time."""
        ids = np.array([landmark for _, landmark, _, _ in rows], object)
        numbers = np.array([(t, b, s) for t, _, b, s in rows], float).reshape(-1, 3)
        return cls(numbers[:, 0], ids, numbers[:, 1], numbers[:, 2])

    def stamps(self) -> Iterator[tuple[float, dict[str, float], dict[str, float]]]:
        """Yield (t, {id: bearing}, {id: sigma}) for each frame; the last of equal ids counts.

        A frame has the sightings of one stamp from one camera.
        """
        for t, seen, sigma in self._by_stamp(self.bearing, self.sigma):
            yield t, seen, {i: s for i, s in sigma.items() if math.isfinite(s)}

    def ranges(self) -> Iterator[tuple[dict[str, float], dict[str, float]]]:
        """Yield ({id: range}, {id: sigma}) for each frame, of those that have a range."""
        for _, seen, sigma in self._by_stamp(self.range, self.range_sigma):
            known = {i: r for i, r in seen.items() if not math.isnan(r)}
            yield known, {i: sigma[i] for i in known if math.isfinite(sigma[i])}

    @property
    def begins(self) -> np.ndarray:
        """Rows at which the frames of `stamps` begin, (k,)."""
        if not self.t.size:
            return np.zeros(0, int)
        changes = (self.t[1:] != self.t[:-1]) | (self.camera[1:] != self.camera[:-1])
        return np.concatenate([[0], np.flatnonzero(changes) + 1])

    def cameras(self) -> Iterator[str]:
        """Yield the name of the camera for each frame."""
        yield from map(str, self.camera[self.begins])

    def _by_stamp(
        self, values: np.ndarray, sigmas: np.ndarray
    ) -> Iterator[tuple[float, dict[str, float], dict[str, float]]]:
        """Yield (t, {id: value}, {id: sigma}) for each frame; the last of equal ids counts."""
        for a, b in pairwise([*self.begins.tolist(), self.t.size]):
            ids = [str(i) for i in self.landmark[a:b]]
            value = dict(zip(ids, values[a:b].tolist(), strict=True))
            yield float(self.t[a]), value, dict(zip(ids, sigmas[a:b].tolist(), strict=True))


@dataclass(frozen=True)
class Tilt(Columns):
    """Roll and pitch of the robot. All arrays have shape (n,)."""

    t: np.ndarray
    """Strictly increasing times [s]."""
    roll: np.ndarray
    """Positive: its left side is raised [rad]."""
    pitch: np.ndarray
    """Positive: its front is lowered [rad]."""

    def __post_init__(self) -> None:
        self._to_arrays()


@dataclass(frozen=True, eq=False)
class HomeBearing(ByValue):
    """The bearing of one landmark at home."""

    bearing: float
    """From the camera's axis at home [rad], in (-pi, pi]."""
    sigma: float = math.nan
    """[rad]; NaN where not given."""
    camera: str = ""
    """Name of its camera, empty for the first one."""


TRUTH_GAP_S = 0.5
"""Ground truth is not interpolated across a longer gap [s]."""


def is_slow(t: np.ndarray) -> bool:
    """Return whether most intervals of ground truth stamps [s] are longer than `TRUTH_GAP_S`."""
    return t.size > 1 and float(np.median(np.diff(t))) > TRUTH_GAP_S


@dataclass(frozen=True)
class Truth(Columns):
    """Ground-truth poses in the home frame, for scoring only. All arrays have shape (n,)."""

    t: np.ndarray
    """Strictly increasing times [s]."""
    x: np.ndarray
    """[m]"""
    y: np.ndarray
    """[m]"""
    heading: np.ndarray
    """[rad]"""

    def __post_init__(self) -> None:
        self._to_arrays()

    def at(self, t: np.ndarray) -> Pose:
        """Interpolate the pose at times `t` [s], shape (m,); constant beyond either end."""
        return Pose(
            np.interp(t, self.t, self.x),
            np.interp(t, self.t, self.y),
            interpolate(t, self.t, self.heading),
        )

    def seen_from(self, home: Pose) -> Truth:
        """Return the poses in the frame of `home`, which is given in the present frame."""
        return Truth(self.t, *between(home, Pose(self.x, self.y, self.heading)))


@dataclass(frozen=True)
class Drive:
    """One drive of a robot, ready for any estimator."""

    name: str
    odometry: Odometry
    sightings: Sightings
    home: dict[str, HomeBearing]
    settings: DriveSettings = field(default_factory=DriveSettings)
    truth: Truth | None = None
    remarks: dict[str, int] = field(default_factory=dict)
    """Numbers of anomalies that the reader found, by description."""
    known: KnownLandmarks = field(default_factory=KnownLandmarks)
    """Surveyed landmarks and measured distances."""
    tilt: Tilt | None = None
    """For which the bearings are not corrected yet; None: a level robot."""
    recorded: Drive | None = field(default=None, repr=False, compare=False)
    """The drive before the corrections in its settings were applied; None: there are none."""

    def __post_init__(self) -> None:
        for name, kind in (
            ("odometry", Odometry),
            ("sightings", Sightings),
            ("settings", DriveSettings),
        ):
            require_kind(getattr(self, name), kind, f"it is the {name} of a drive")
        for name, t in (("odometry", self.odometry.t), ("sightings", self.sightings.t)):
            if (np.diff(t) < 0).any():
                raise InputError("times decrease", part=name, advice="sort the rows by time")
        require_kind(home := keyed(self.home), Mapping, "home has bearings [rad] by landmark id")
        if not all(isinstance(seen, HomeBearing) for seen in home.values()):
            known = {
                n: s if isinstance(s, HomeBearing) else HomeBearing(s) for n, s in home.items()
            }
            object.__setattr__(self, "home", known)

    def home_bearings(self) -> dict[str, float]:
        """Return beta* of each landmark in the robot's home frame [rad].

        This removes the camera's yaw at home, but not its offset from the robot's centre.
        """
        yaw = self.settings.home_mount.yaw
        return {i: float(wrap(b.bearing + yaw)) for i, b in self.home.items()}

    def with_earlier_sightings(self, delay: float) -> Self:
        """Return the drive with the stamps of all sightings reduced by `delay` [s]."""
        return replace(self, sightings=replace(self.sightings, t=self.sightings.t - delay))

    @property
    def remark_lines(self) -> tuple[str, ...]:
        """The remarks as lines of text, each beginning with its number."""
        return tuple(f"{number:,} {reason}" for reason, number in self.remarks.items())

    @property
    def span(self) -> tuple[float, float]:
        """First and last time [s] of odometry and sightings; (nan, nan) without any."""
        ends = [a[i] for a in (self.odometry.t, self.sightings.t) if a.size for i in (0, -1)]
        return (float(min(ends)), float(max(ends))) if ends else (math.nan, math.nan)


class Samples:
    """Compact storage of odometry (32 bytes per twist) and sightings (56 bytes each)."""

    def __init__(self) -> None:
        self._twists, self._seen = array("d"), array("d")
        self._numbers: dict[str, int] = {}
        self._cameras: dict[str, int] = {}

    def add_twist(self, t: float, v: float, omega: float, vy: float = 0.0) -> None:
        """Add a twist."""
        self._twists.extend((t, v, omega, vy))

    def add_bearings(
        self,
        t: float,
        bearings: Mapping[str, float],
        sigmas: Mapping[str, float] | None = None,
        ranges: Mapping[str, float] | None = None,
        range_sigmas: Mapping[str, float] | None = None,
        camera: str = "",
    ) -> None:
        """Add the sightings of one stamp and camera."""
        of_camera = self._cameras.setdefault(camera, len(self._cameras))
        optional = sigmas or {}, ranges or {}, range_sigmas or {}
        for name, bearing in bearings.items():
            number = self._numbers.setdefault(name, len(self._numbers))
            wrapped = math.remainder(bearing, math.tau) if math.isfinite(bearing) else math.nan
            values = (o.get(name, math.nan) for o in optional)
            self._seen.extend((t, number, of_camera, wrapped, *values))

    def odometry(self) -> Odometry:
        """Return the twists; the last of equal stamps counts."""
        return Odometry(*last_of_equal(table(self._twists, 4)).T.copy())

    def sightings(self) -> Sightings:
        """Return the sightings in order of time; those of one stamp stay in order of arrival."""
        rows = table(self._seen, 7)
        t, number, of_camera, *columns = rows[np.argsort(rows[:, 0], kind="stable")].T.copy()
        names, cameras = (np.array([*n, None], object) for n in (self._numbers, self._cameras))
        bearing, sigma, away, away_sigma = columns
        ids, by = names[number.astype(int)], cameras[of_camera.astype(int)]
        return Sightings(t, ids, bearing, sigma, away, away_sigma, by)


def table(numbers: array[float], columns: int) -> np.ndarray:
    """Return numbers as rows with a number of columns."""
    return np.array(numbers).reshape(-1, columns)


def last_of_equal(rows: np.ndarray) -> np.ndarray:
    """Return rows in order of their stamps (first column), with the last of equal stamps."""
    rows = rows[np.argsort(rows[:, 0], kind="stable")]
    return np.asarray(rows[np.diff(rows[:, 0], append=math.inf) != 0.0])
