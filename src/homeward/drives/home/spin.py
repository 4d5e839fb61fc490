"""Home by turning on the spot: home bearings all round from a camera that sees a part of it.

Landmarks that are seen again close the turn. A camera that is not at the robot's centre moves on a
circle: ranges are found by its parallax, and where there is too little of that, their prior is in
the sigmas.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import NamedTuple, Unpack

import numpy as np

from homeward.drives.drive import Drive, HomeBearing, Odometry, Samples, Sightings
from homeward.drives.home.turn import GATE, LEAST_RAD, TurnProblem
from homeward.drives.known import known_robot
from homeward.drives.settings import DriveSettings, HomeWhen, Robot
from homeward.errors import InputError
from homeward.geometry.frames import Pose
from homeward.geometry.robust import GNC_SCHEDULE, robust_weight
from homeward.io.table import quoted
from homeward.odometry.validity import validities

HARD_STEPS = 4
"""Afterwards sightings count fully or not at all, for so many steps."""
MAJORITY = 0.6
"""So large a share of the sightings of a landmark must agree: most, with some to spare."""
DATUM_STEPS = 10
"""Until it is settled whose mean defines home's heading."""


class Spin(NamedTuple):
    """What a turn tells of home, where the robot was when it began."""

    names: tuple[str, ...]
    """Of n landmarks."""
    bearings: np.ndarray
    """(n,), from the camera's axis as it was when the turn began [rad]."""
    covariance: np.ndarray
    """(n, n), home's heading being that of the robot when the turn began [rad^2]."""
    left_out: tuple[str, ...]
    """Landmarks whose sightings disagree: moved meanwhile, or there twice."""
    turned: float
    """[rad], as corrected; positive anti-clockwise."""
    seen: float
    """Angle that came into view, at most a full turn [rad]."""
    end: Pose
    """Of the robot at the last sighting, from home."""

    @property
    def home(self) -> dict[str, HomeBearing]:
        """The home bearings, each as uncertain as it is against the others.

        What most have in common is an error of home's heading, which home bearings define.
        """
        variances, weights = self.covariance.diagonal(), self.datum
        if len(self.names) > 1:
            variances = self._against(weights) / (1.0 - weights)  # each is part of the mean itself
        sigmas = np.sqrt(np.maximum(variances, LEAST_RAD**2)).tolist()
        each = zip(self.names, self.bearings.tolist(), sigmas, strict=True)
        return {name: HomeBearing(b, s) for name, b, s in each}

    @property
    def heading_sigma(self) -> float:
        """How well home's heading is that of the robot when the turn began [rad]."""
        return float(np.sqrt(self.datum @ self.covariance @ self.datum))

    @property
    def datum(self) -> np.ndarray:
        """The weights (n,) of the mean that defines home's heading: of those that agree best."""
        weights = np.full(len(self.names), 1.0 / len(self.names))
        for _ in range(DATUM_STEPS):
            own = self._against(weights)
            weights = 1.0 / (own + np.median(own) + LEAST_RAD**2)
            weights /= weights.sum()
        return weights

    def _against(self, weights: np.ndarray) -> np.ndarray:
        """Return the variances (n,) of the bearings against a weighted mean of them [rad^2]."""
        common = self.covariance @ weights
        return np.asarray(self.covariance.diagonal() - 2.0 * common + weights @ common)


def spin(
    interval: tuple[float, float], odometry: Odometry, sightings: Sightings, settings: DriveSettings
) -> Spin:
    """Return home from a turn on the spot in an interval [s]: the robot's pose when it begins.

    The turn need not be complete, and may have rests: several looks from one place are one, too.
    `InputError` where nothing was seen meanwhile, odometry has a gap, the robot drives away, or
    most sightings disagree with its turn.
    """
    turn = TurnProblem.within(interval, odometry, sightings, settings)
    x, drift = turn.first_guess(), turn.drift()
    for share_of_drift in GNC_SCHEDULE:
        gate = np.hypot(GATE * turn.sigmas, share_of_drift * drift)
        x, covariance = turn.step(x, robust_weight((turn.residuals(x) / gate) ** 2), turn.sigmas)
    for _ in range(HARD_STEPS):
        off = np.abs(turn.residuals(x))
        sigmas = turn.believed_sigmas(off)
        agree = off < GATE * sigmas
        x, covariance = turn.step(x, agree.astype(float), sigmas)
    share = np.bincount(turn.landmark, agree) / np.bincount(turn.landmark)
    if agree.mean() < MAJORITY or not (share >= MAJORITY).any():
        raise InputError(
            f"{1.0 - agree.mean():.0%} of the sightings disagree with how odometry turned during "
            "home's spin: do bearings and turns both run anti-clockwise?"
        )
    kept = np.flatnonzero(share >= MAJORITY)
    headings = turn.headings(x)
    return Spin(
        tuple(turn.names[i] for i in kept),
        turn.home_bearings(x)[kept],
        covariance[np.ix_(kept, kept)],
        tuple(turn.names[i] for i in np.flatnonzero(share < MAJORITY)),
        float(headings[-1]),
        float(min(np.ptp(turn.bearing) + np.ptp(headings), math.tau)),
        turn.end(x),
    )


LONGEST_S = 600.0
"""Looks that nobody ended would fill the memory [s]."""


class HomeScan:
    """Looks from one place: while the robot turns on the spot, or several short ones.

    Home is where the robot was at the first twist.

    >>> looks = HomeScan(sensor={"x": 0.2})
    >>> looks.odometry(0.0, 0.0, 0.5)  # and so on, as for a Localizer
    >>> looks.bearings(0.1, {"door": 0.31})
    >>> localizer = Localizer(looks.home(), sensor={"x": 0.2})

    Parameters
    ----------
    **robot : Robot
        What is known of the robot, as for a `Localizer`.
    """

    def __init__(self, **robot: Unpack[Robot]) -> None:
        self._robot = known_robot(robot)
        self._samples = Samples()
        self._begun: float | None = None
        self._too_long = False

    def odometry(self, t: float, v: float, omega: float) -> None:
        """Take a twist that holds from `t` [s] on: `v` [m/s] forward, `omega` [rad/s]."""
        if self._takes(t):
            self._samples.add_twist(t, v, omega)

    def bearings(
        self, t: float, sightings: Mapping[str, float], sigmas: Mapping[str, float] | None = None
    ) -> None:
        """Take all sightings of stamp `t` [s], as `Localizer.bearings`."""
        if self._takes(t):
            self._samples.add_bearings(t, sightings, sigmas)

    def spin(self) -> Spin:
        """Return what the looks tell of home; errors as `home`."""
        if self._too_long:
            raise InputError(f"home was looked at for more than {LONGEST_S:g} s")
        odometry, seen = self._samples.odometry(), self._samples.sightings()
        if not odometry.t.size or not seen.t.size:
            raise InputError("of home nothing was seen, or there was no odometry")
        span = float(odometry.t[0]), max(float(odometry.t[-1]), float(seen.t[-1]))
        return spin(span, odometry, seen, self._robot)

    def home(self) -> dict[str, HomeBearing]:
        """Return the home bearings, with their deviations.

        Raises
        ------
        InputError
            When nothing was seen, or that took too long, or as `homeward.drives.home.spin.spin`.
        """
        return self.spin().home

    def _takes(self, t: float) -> bool:
        if not math.isfinite(t):
            return False
        if self._begun is None:
            self._begun = t
        self._too_long |= not t - self._begun <= LONGEST_S
        return not self._too_long


STILL_M = 0.05
"""A robot that goes further does not stand [m]."""
STILL_RAD = 0.05
"""Nor one that turns by more [rad]."""
FOUND = (
    "home bearings by a turn of {:.0f} degrees, good to {:.2g} degrees in the median; home's "
    "heading is that at its beginning to {:.2g} degrees"
)
LOOKED = "degrees came into view during home's turn, not all round: home knows nothing of the rest"
OF_OTHER_HOME = "{} of a home that was not chosen, left out"
LEFT_OUT = "landmarks that home leaves out, as their sightings during its turn disagree: {}"


def with_home(drive: Drive, when: HomeWhen) -> Drive:
    """Return a drive with home bearings from its own sightings, instead of any that it has.

    `InputError` where the robot was not at home then, or saw nothing; see `spin`.
    """
    span = when.during or when.spin
    if span is None:
        return drive
    first, last = (drive.span[0] + t for t in span)
    if drive.settings.home_sensor is not None:
        raise InputError("home_sensor: what the drive itself saw of home is by its own camera")
    if drive.known.surveyed_from_home:
        raise InputError("landmarks.yaml is surveyed from home; another home cannot be chosen")
    if drive.home:
        drive = _seen_from(drive, first)
    told = drive.settings.model_copy(update={"home": None})
    if when.during is not None:
        _require_still(first, last, drive.odometry)
        home = _mean_directions(drive, first, last)
        if not home:
            raise InputError(f"nothing was seen during home's {span[0]:g} to {span[1]:g} s")
        return dataclasses.replace(drive, home=home, settings=told)
    found = spin((first, last), drive.odometry, drive.sightings, told)
    remarks = {**drive.remarks, **_remarks(found)}
    return dataclasses.replace(drive, home=found.home, settings=told, remarks=remarks)


def _require_still(first: float, last: float, odometry: Odometry) -> None:
    """Refuse an interval [s] in which the odometry moves."""
    ends = np.minimum(odometry.t + validities(odometry.t), last)
    within = np.clip(ends - np.maximum(odometry.t, first), 0.0, None)
    odometry = odometry.bridged
    way, turn = np.abs(odometry.v) @ within, np.abs(odometry.omega) @ within
    if way > STILL_M or turn > STILL_RAD:
        raise InputError(
            f"the robot does not stand at home: meanwhile it drives {way:.2f} m and turns "
            f"{turn:.2f} rad"
        )


def _mean_directions(drive: Drive, first: float, last: float) -> dict[str, HomeBearing]:
    """Return the mean direction of each landmark that was seen in an interval [s]."""
    seen, home = drive.sightings, dict[str, HomeBearing]()
    at_home = seen.rows((seen.t >= first) & (seen.t <= last))
    for landmark in dict.fromkeys(at_home.landmark.tolist()):
        mine = at_home.bearing[at_home.landmark == landmark]
        home[landmark] = HomeBearing(float(np.arctan2(np.sin(mine).sum(), np.cos(mine).sum())))
    return home


def _seen_from(drive: Drive, t: float) -> Drive:
    """Return a drive without its own home: its truth as seen from where it truly was at `t` [s]."""
    settings, truth = drive.settings.model_copy(update={"start": None}), drive.truth
    remarks = dict(drive.remarks)
    if drive.settings.start is not None:
        remarks[OF_OTHER_HOME.format("start prior")] = 1
    if truth is not None and truth.t[0] <= t <= truth.t[-1]:
        home = Pose(*(float(part[0]) for part in truth.at(np.array([t]))))
        truth = truth.seen_from(home)
    elif truth is not None:
        truth, remarks[OF_OTHER_HOME.format("truth")] = None, 1
    return dataclasses.replace(drive, home={}, settings=settings, truth=truth, remarks=remarks)


def spin_summary(found: Spin) -> str:
    """Say what a spin told."""
    return "; ".join(f"{number} {why}" for why, number in _remarks(found).items())


def _remarks(found: Spin) -> dict[str, int]:
    """Return what is to be said of a spin."""
    turned, seen = abs(math.degrees(found.turned)), math.degrees(found.seen)
    good = math.degrees(np.median([seen.sigma for seen in found.home.values()]))
    heading = math.degrees(found.heading_sigma)
    remarks = {FOUND.format(turned, good, heading): len(found.names)}
    if seen < 359.5:
        remarks[LOOKED] = round(seen)
    if found.left_out:
        remarks[LEFT_OUT.format(", ".join(map(quoted, found.left_out)))] = len(found.left_out)
    return remarks
