"""Home bearings from a rotation on the spot, for a camera with a limited field of view.

Landmarks that are seen again close the loop. A camera that is not at the robot's centre moves on a
circle, so its parallax gives ranges. Where the parallax is too small, the sigmas contain the prior
of the ranges.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import NamedTuple, Unpack

import numpy as np

from homeward.drives.drive import Drive, HomeBearing, Odometry, Samples, Sightings
from homeward.drives.home.turn import GATE, MIN_SIGMA_RAD, TurnProblem
from homeward.drives.known import known_robot
from homeward.drives.settings import DriveSettings, HomeWhen, Robot
from homeward.errors import InputError
from homeward.geometry.frames import Pose
from homeward.geometry.robust import GNC_SCHEDULE, robust_weight
from homeward.io.table import quoted
from homeward.odometry.validity import validities

HARD_STEPS = 4
"""Steps with weights of 0 or 1, after those of graduated non-convexity."""
MIN_AGREEMENT = 0.6
"""Minimum share of a landmark's sightings that agree: a clear majority."""
DATUM_STEPS = 10
"""Iterations of the weights that define home's heading."""


class Spin(NamedTuple):
    """Home bearings from a rotation; home is the robot's pose at its beginning."""

    names: tuple[str, ...]
    """Ids of n landmarks."""
    bearings: np.ndarray
    """(n,), from the camera's axis at the beginning [rad]."""
    covariance: np.ndarray
    """(n, n), relative to the robot's heading at the beginning [rad^2]."""
    left_out: tuple[str, ...]
    """Landmarks whose sightings disagree: moved meanwhile, or duplicate ids."""
    turned: float
    """Corrected rotation [rad]; positive anti-clockwise."""
    seen: float
    """Angle that was in view, at most a full turn [rad]."""
    end: Pose
    """Pose of the robot at the last sighting, in the home frame."""

    @property
    def home(self) -> dict[str, HomeBearing]:
        """The home bearings, with their standard deviations relative to each other.

        Their common error does not count, since home bearings define home's heading.
        """
        variances, weights = self.covariance.diagonal(), self.datum
        if len(self.names) > 1:
            variances = self._against(weights) / (1.0 - weights)  # each is part of the mean
        sigmas = np.sqrt(np.maximum(variances, MIN_SIGMA_RAD**2)).tolist()
        rows = zip(self.names, self.bearings.tolist(), sigmas, strict=True)
        return {name: HomeBearing(b, s) for name, b, s in rows}

    @property
    def heading_sigma(self) -> float:
        """Standard deviation of home's heading from the robot's heading at the beginning [rad]."""
        return float(np.sqrt(self.datum @ self.covariance @ self.datum))

    @property
    def datum(self) -> np.ndarray:
        """Weights (n,) of the mean that defines home's heading; largest for the best bearings."""
        weights = np.full(len(self.names), 1.0 / len(self.names))
        for _ in range(DATUM_STEPS):
            own = self._against(weights)
            weights = 1.0 / (own + np.median(own) + MIN_SIGMA_RAD**2)
            weights /= weights.sum()
        return weights

    def _against(self, weights: np.ndarray) -> np.ndarray:
        """Return the variances (n,) of the bearings relative to their weighted mean [rad^2]."""
        common = self.covariance @ weights
        return np.asarray(self.covariance.diagonal() - 2.0 * common + weights @ common)


def spin(
    interval: tuple[float, float], odometry: Odometry, sightings: Sightings, settings: DriveSettings
) -> Spin:
    """Return home from a rotation on the spot in an interval [s]: the pose at its beginning.

    The rotation may be incomplete and may have pauses. `InputError` where there are no sightings,
    odometry has a gap, the robot drives away, or most sightings disagree with the rotation.
    """
    turn = TurnProblem.within(interval, odometry, sightings, settings)
    x, drift = turn.first_guess(), turn.drift()
    for share_of_drift in GNC_SCHEDULE:
        gate = np.hypot(GATE * turn.sigmas, share_of_drift * drift)
        x, covariance = turn.step(x, robust_weight((turn.residuals(x) / gate) ** 2), turn.sigmas)
    for _ in range(HARD_STEPS):
        residuals = np.abs(turn.residuals(x))
        sigmas = turn.estimated_sigmas(residuals)
        agree = residuals < GATE * sigmas
        x, covariance = turn.step(x, agree.astype(float), sigmas)
    share = np.bincount(turn.landmark, agree) / np.bincount(turn.landmark)
    if agree.mean() < MIN_AGREEMENT or not (share >= MIN_AGREEMENT).any():
        raise InputError(
            f"{1.0 - agree.mean():.0%} of the sightings disagree with the rotation of odometry at "
            "home: bearings and yaw rates must both be positive anti-clockwise"
        )
    kept = np.flatnonzero(share >= MIN_AGREEMENT)
    headings = turn.headings(x)
    return Spin(
        tuple(turn.names[i] for i in kept),
        turn.home_bearings(x)[kept],
        covariance[np.ix_(kept, kept)],
        tuple(turn.names[i] for i in np.flatnonzero(share < MIN_AGREEMENT)),
        float(headings[-1]),
        float(min(np.ptp(turn.bearing) + np.ptp(headings), math.tau)),
        turn.end(x),
    )


MAX_SCAN_S = 600.0
"""Maximum duration of a scan, which limits memory [s]."""


class HomeScan:
    """Home bearings from observations at one place, while the robot turns on the spot or pauses.

    Home is the pose of the robot at the first twist. The keyword arguments describe the robot, as
    for a `Localizer`.

    >>> scan = HomeScan(sensor={"x": 0.2})
    >>> scan.odometry(0.0, 0.0, 0.5)  # and so on, as for a Localizer
    >>> scan.bearings(0.1, {"door": 0.31})
    >>> localizer = Localizer(scan.home(), sensor={"x": 0.2})
    """

    def __init__(self, **robot: Unpack[Robot]) -> None:
        self._robot = known_robot(robot)
        self._samples = Samples()
        self._begin: float | None = None
        self._too_long = False

    def odometry(self, t: float, v: float, omega: float) -> None:
        """Add a twist that is valid from `t` [s] on: `v` [m/s] forward, `omega` [rad/s]."""
        if self._accepts(t):
            self._samples.add_twist(t, v, omega)

    def bearings(
        self, t: float, sightings: Mapping[str, float], sigmas: Mapping[str, float] | None = None
    ) -> None:
        """Add all sightings of stamp `t` [s], as `Localizer.bearings`."""
        if self._accepts(t):
            self._samples.add_bearings(t, sightings, sigmas)

    def spin(self) -> Spin:
        """Return the complete result; errors as `home`."""
        if self._too_long:
            raise InputError(f"the scan of home took more than {MAX_SCAN_S:g} s; start a new one")
        odometry, seen = self._samples.odometry(), self._samples.sightings()
        if not odometry.t.size or not seen.t.size:
            raise InputError("no bearings or no odometry at home; send both during the scan")
        span = float(odometry.t[0]), max(float(odometry.t[-1]), float(seen.t[-1]))
        return spin(span, odometry, seen, self._robot)

    def home(self) -> dict[str, HomeBearing]:
        """Return the home bearings, with their standard deviations.

        `InputError` without sightings, after too long a scan, or as
        `homeward.drives.home.spin.spin`.
        """
        return self.spin().home

    def _accepts(self, t: float) -> bool:
        if not math.isfinite(t):
            return False
        if self._begin is None:
            self._begin = t
        self._too_long |= not t - self._begin <= MAX_SCAN_S
        return not self._too_long


MAX_STILL_M, MAX_STILL_RAD = 0.05, 0.05
"""Maximum motion of a stationary robot [m, rad]."""
FOUND = (
    "home bearings from a rotation of {:.0f} degrees, with a median sigma of {:.2g} degrees; sigma "
    "of home's heading: {:.2g} degrees"
)
PARTIAL_VIEW = "degrees in view at home, not 360; home has no bearings in the rest"
OTHER_HOME = "{} relative to another home, ignored"
INCONSISTENT = "landmarks without a home bearing, since their sightings at home disagree: {}"


def with_home(drive: Drive, when: HomeWhen) -> Drive:
    """Return a drive with home bearings from its own sightings, which replace any that it has.

    `InputError` where the robot moved at that time, or had no sightings; see `spin`.
    """
    span = when.during or when.spin
    if span is None:
        return drive
    first, last = (drive.span[0] + t for t in span)
    if drive.settings.home_sensor is not None:
        raise InputError(
            "home_sensor does not apply if home comes from this drive; remove it from drive.yaml"
        )
    if drive.known.surveyed_from_home:
        raise InputError(
            "landmarks.yaml already defines home (frame: home); remove the time at home"
        )
    if drive.home:
        drive = _seen_from(drive, first)
    settings = drive.settings.model_copy(update={"home": None})
    if when.during is not None:
        _require_still(first, last, drive.odometry)
        home = _mean_directions(drive, first, last)
        if not home:
            raise InputError(f"no sightings at home from {span[0]:g} to {span[1]:g} s")
        return dataclasses.replace(drive, home=home, settings=settings)
    found = spin((first, last), drive.odometry, drive.sightings, settings)
    remarks = {**drive.remarks, **_remarks(found)}
    return dataclasses.replace(drive, home=found.home, settings=settings, remarks=remarks)


def _require_still(first: float, last: float, odometry: Odometry) -> None:
    """Refuse an interval [s] in which the odometry moves."""
    ends = np.minimum(odometry.t + validities(odometry.t), last)
    within = np.clip(ends - np.maximum(odometry.t, first), 0.0, None)
    odometry = odometry.bridged
    path, turn = np.abs(odometry.v) @ within, np.abs(odometry.omega) @ within
    if path > MAX_STILL_M or turn > MAX_STILL_RAD:
        raise InputError(
            f"the robot moves at home: it drives {path:.2f} m and turns {turn:.2f} rad; give an "
            "interval without motion"
        )


def _mean_directions(drive: Drive, first: float, last: float) -> dict[str, HomeBearing]:
    """Return the mean bearing of each landmark in view in an interval [s]."""
    seen, home = drive.sightings, dict[str, HomeBearing]()
    at_home = seen.rows((seen.t >= first) & (seen.t <= last))
    for landmark in dict.fromkeys(at_home.landmark.tolist()):
        mine = at_home.bearing[at_home.landmark == landmark]
        home[landmark] = HomeBearing(float(np.arctan2(np.sin(mine).sum(), np.cos(mine).sum())))
    return home


def _seen_from(drive: Drive, t: float) -> Drive:
    """Return a drive without its home, and its ground truth relative to the pose at `t` [s]."""
    settings, truth = drive.settings.model_copy(update={"start": None}), drive.truth
    remarks = dict(drive.remarks)
    if drive.settings.start is not None:
        remarks[OTHER_HOME.format("start prior")] = 1
    if truth is not None and truth.t[0] <= t <= truth.t[-1]:
        home = Pose(*(float(part[0]) for part in truth.at(np.array([t]))))
        truth = truth.seen_from(home)
    elif truth is not None:
        truth, remarks[OTHER_HOME.format("ground truth")] = None, 1
    return dataclasses.replace(drive, home={}, settings=settings, truth=truth, remarks=remarks)


def spin_summary(found: Spin) -> str:
    """Return a summary of a rotation in one line."""
    return "; ".join(f"{number} {text}" for text, number in _remarks(found).items())


def _remarks(found: Spin) -> dict[str, int]:
    """Return the remarks about a rotation."""
    turned, seen = abs(math.degrees(found.turned)), math.degrees(found.seen)
    sigma = math.degrees(np.median([seen.sigma for seen in found.home.values()]))
    heading = math.degrees(found.heading_sigma)
    remarks = {FOUND.format(turned, sigma, heading): len(found.names)}
    if seen < 359.5:
        remarks[PARTIAL_VIEW] = round(seen)
    if found.left_out:
        remarks[INCONSISTENT.format(", ".join(map(quoted, found.left_out)))] = len(found.left_out)
    return remarks
