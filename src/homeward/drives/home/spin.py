"""Home bearings from a rotation on the spot, for a camera with a limited field of view.

Landmarks that are seen again close the loop. A camera that is not at the robot's centre moves on a
circle, so its parallax gives ranges. Where the parallax is too small, the sigmas contain the prior
of the ranges.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Unpack

import numpy as np

from homeward.drives.drive import HomeBearing, Odometry, Samples, Sightings
from homeward.drives.home.turn import GATE, MIN_SIGMA_RAD, TurnProblem
from homeward.drives.robot import known_robot
from homeward.drives.settings import DriveSettings, Robot
from homeward.errors import InputError
from homeward.geometry.frames import Pose
from homeward.geometry.statistics import GNC_SCHEDULE, robust_weight
from homeward.io.table import quoted

HARD_STEPS = 4
"""Steps with weights of 0 or 1, after those of graduated non-convexity."""
MIN_AGREEMENT = 0.6
"""Minimum share of a landmark's sightings that agree: a clear majority."""
DATUM_STEPS = 10
"""Iterations of the weights that define home's heading."""


@dataclass(frozen=True)
class JointHome:
    """Home bearings with their joint covariance."""

    names: tuple[str, ...]
    """Ids of n landmarks."""
    bearings: np.ndarray
    """(n,), from the camera's axis at home [rad]."""
    covariance: np.ndarray
    """(n, n), relative to the robot's heading at home [rad^2]."""

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
        """Standard deviation of home's heading from the robot's heading at home [rad]."""
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


@dataclass(frozen=True)
class Spin(JointHome):
    """Home bearings from a rotation; home is the robot's pose at its beginning."""

    left_out: tuple[str, ...]
    """Landmarks whose sightings disagree: moved meanwhile, or duplicate ids."""
    turned: float
    """Corrected rotation until the last sighting [rad]; positive anti-clockwise."""
    seen: float
    """Angle that was in view, at most a full turn [rad]."""
    end: Pose
    """Pose of the robot at the last sighting or twist, in the home frame."""


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
    headings = turn.headings(x)[: turn.pose[-1] + 1]
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
        self.robot = known_robot(robot)
        self._samples = Samples()
        self._begin: float | None = None
        self._too_long = False

    def odometry(self, t: float, v: float, omega: float, vy: float = 0.0) -> None:
        """Add a twist that is valid from `t` [s] on, as `Localizer.odometry`."""
        if self._accepts(t):
            self._samples.add_twist(t, v, omega, vy)

    def bearings(
        self,
        t: float,
        sightings: Mapping[str, float],
        sigmas: Mapping[str, float] | None = None,
        camera: str = "",
    ) -> None:
        """Add all sightings of stamp `t` [s], as `Localizer.bearings`."""
        if self._accepts(t):
            self._samples.add_bearings(t, sightings, sigmas, camera=camera)

    def spin(self) -> Spin:
        """Return the complete result; errors as `home`."""
        if self._too_long:
            advice = "start a new one"
            raise InputError(f"the scan of home took more than {MAX_SCAN_S:g} s", advice=advice)
        odometry, seen = self._samples.odometry(), self._samples.sightings()
        if not odometry.t.size or not seen.t.size:
            advice = "send both during the scan"
            raise InputError("no bearings or no odometry at home", advice=advice)
        span = float(odometry.t[0]), max(float(odometry.t[-1]), float(seen.t[-1]))
        return spin(span, odometry, seen, self.robot)

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


FOUND = (
    "home bearings from {}, with a median sigma of {:.2g} degrees; sigma of home's heading: {:.2g} "
    "degrees"
)
PARTIAL_VIEW = "degrees in view at home, not 360; home has no bearings in the rest"
INCONSISTENT = "landmarks without a home bearing, since their sightings at home disagree: {}"


def spin_summary(found: Spin) -> str:
    """Return a summary of a rotation in one line."""
    return "; ".join(f"{number} {text}" for text, number in spin_remarks(found).items())


def spin_remarks(found: Spin) -> dict[str, int]:
    """Return the remarks about a rotation."""
    turned, seen = abs(math.degrees(found.turned)), math.degrees(found.seen)
    remarks = home_remark(found, f"a rotation of {turned:.0f} degrees")
    if seen < 359.5:
        remarks[PARTIAL_VIEW] = round(seen)
    if found.left_out:
        remarks[INCONSISTENT.format(", ".join(map(quoted, found.left_out)))] = len(found.left_out)
    return remarks


def home_remark(found: JointHome, source: str) -> dict[str, int]:
    """Return the remark about the number and the precision of home bearings from a source."""
    sigma = math.degrees(np.median([seen.sigma for seen in found.home.values()]))
    words = FOUND.format(source, sigma, math.degrees(found.heading_sigma))
    return {words: len(found.names)}
