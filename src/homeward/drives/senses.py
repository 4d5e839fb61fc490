"""The sense of rotation, unit and frame of bearings, from the odometry's yaw rate.

While the robot turns by d, the bearing of a static landmark changes by -d and by parallax. Other
slopes show a fault: +1 clockwise bearings or yaw rates, 0 bearings in a fixed frame, and factors of
57.3 a rate or an angle in degrees. Each short interval has one vote, the median over its landmarks,
with limited weight: one interval with a wrong yaw rate decides nothing. Parallax is noise
here, in proportion to the path. So a fault must show in rotation to both sides, or on the spot.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from itertools import product

import numpy as np

from homeward.drives.drive import Drive, Odometry
from homeward.errors import InputError
from homeward.geometry.angles import wrap
from homeward.odometry.history import dead_reckoning_unwrapped
from homeward.sighting_keys import is_followed

DEG = math.degrees(1.0)
ABSURD = 1e6
"""No robot drives or turns so fast, in any unit: nothing is decided by such numbers."""
MIN_INTERVAL_S, MAX_INTERVAL_S, NUM_FRAMES = 1.0, 5.0, 4.0
"""Limits of the length of an interval [s], and its number of frames between them."""
BAD_INTERVAL = 0.1
"""Prior probability that an interval fits no slope: slip, or wrong ids."""
GAIN_ERROR = 0.15
"""Standard deviation of the scale of the odometry's rotation [1]."""
NOISES = 0.003, 0.01, 0.03, 0.1, 0.3
"""Standard deviations of an interval's vote that are tried [rad]."""
PARALLAXES = 0.0, 0.03, 0.1, 0.3, 1.0
"""Standard deviations of parallax that are tried [rad/m]."""
BIASES = 0.0, 0.5, -0.5, 1.0, -1.0
"""Means of parallax in rotation to either side that are tried, over its standard deviation [1]:
landmarks are seldom equally near on both sides of the path, and the mean is no rotation."""
MIN_EVIDENCE, MIN_EVIDENCE_OF_SIDE, INFORMATIVE = 12.0, 4.0, 0.5
"""Minimum log-likelihood ratio of a decision, in all, in rotation to either side, and of an
interval that counts."""
MIN_GAIN = 3.0
"""Minimum log-likelihood ratio of the decided sense to each other fault."""
MIN_INTERVALS, MIN_INTERVALS_OF_SIDE = 12, 3
"""Minimum number of intervals that count, in all and to either side."""
MIN_TURNING = 0.2
"""Minimum share of the intervals that count against bearings that turn much less than the odometry:
wheels that slip for a part of a straight drive look the same."""
SPOT_RADIUS = 0.5
"""Maximum radius of arcs on which rotation to one side is enough, since no landmark is nearer [m].
"""
MIN_SHARE = 0.75
"""Minimum share of them on the side of the decision, to either side."""
MAX_MISFIT = 0.4
"""Maximum median deviation from the decided slope, as a share of that from the required one."""
MIN_ROTATION = 3.0
"""Minimum rotation of an interval, as a multiple of its noise."""
MIN_SPEED, MIN_AHEAD = 0.05, 0.7
"""Speed from which the odometry has a direction of motion [m/s]; minimum length of the mean of
exp(2i direction) over the path of a robot that drives ahead and back."""
USUAL_RATE = 0.3, 0.9
"""Median of robots' usual yaw rates while they turn [rad/s], and deviation of its logarithm."""


class Sense(Enum):
    """The change of bearings for each rad of the odometry's rotation."""

    RIGHT = -1.0
    REVERSED = 1.0
    FIXED_FRAME = 0.0
    RATE_TOO_LARGE = -1.0 / DEG
    """The yaw rate is 57.3 times too large: it is in deg/s."""
    RATE_TOO_LARGE_REVERSED = 1.0 / DEG
    RATE_TOO_SMALL = -DEG
    """It is 57.3 times too small, or bearings in degrees were read as rad."""
    RATE_TOO_SMALL_REVERSED = DEG

    @property
    def is_reversed(self) -> bool:
        """Whether bearings and odometry rotate in opposite senses."""
        return self.value > 0

    @property
    def rate_factor(self) -> float:
        """Factor by which the yaw rate is too large: 57.3, 1 or 1 / 57.3."""
        return 1.0 / abs(self.value) if self.value else 1.0


NOT_TURNING = {Sense.FIXED_FRAME, Sense.RATE_TOO_LARGE, Sense.RATE_TOO_LARGE_REVERSED}
"""Senses that differ by a small part of the rotation: the mean of parallax may be as large."""
_LARGE = "yaw rates are 57 times too large for the bearings, as in deg/s"
_SMALL = "bearings turn 57 times faster than the yaw rates"
_TO_RAD, _BOTH = "convert them to rad/s", "convert both from degrees to radians, or neither"
REMEDIES = {
    Sense.REVERSED: (
        "bearings and yaw rates rotate in opposite senses",
        "make both anti-clockwise (of wheels, exchange left and right), or give the roll of a "
        "camera that is mounted upside down",
    ),
    Sense.FIXED_FRAME: (
        "the bearings do not turn with the robot: they are in a fixed frame, as of a compass or "
        "with the heading added, fixed anchors measured them, the motion is not planar, or a unit "
        "is wrong",
        "give bearings from the axis of a camera on the robot, and its roll if it is on its side",
    ),
    Sense.RATE_TOO_LARGE: (_LARGE, _TO_RAD),
    Sense.RATE_TOO_LARGE_REVERSED: (_LARGE, f"{_TO_RAD}, and change their sign"),
    Sense.RATE_TOO_SMALL: (_SMALL, _BOTH),
    Sense.RATE_TOO_SMALL_REVERSED: (_SMALL, f"{_BOTH}, and change a sign"),
}
"""The fault and its remedy for each sense."""
FIXED_SPEEDS = (
    "the odometry's speeds are along the axes of a fixed frame, not of the robot",
    "rotate them by minus the heading, give speeds ahead and to the left, or give poses instead",
)
"""The fault and its remedy for speeds that do not turn with the robot."""
SHOWS = "intervals of rotation show that "
OVERRIDE = "check_senses: false in drive.yaml (of a log: under drive: in its topics file)"


@dataclass(frozen=True)
class SenseTest:
    """Result of the test of senses, units and frames."""

    sense: Sense | None
    """None: undecided."""
    intervals: int
    """Number of intervals that count."""

    @property
    def fault(self) -> tuple[str, str]:
        """The fault and its remedy, for the user."""
        assert self.sense is not None
        fault, remedy = REMEDIES[self.sense]
        return f"{fault} ({self.intervals:,} intervals of rotation)", remedy

    @property
    def is_fault(self) -> bool:
        """Whether the bearings do not fit the odometry."""
        return self.sense not in (None, Sense.RIGHT)


UNDECIDED = SenseTest(None, 0)


def compare_senses(
    odometry: Odometry,
    t: np.ndarray,
    landmark: np.ndarray,
    bearing: np.ndarray,
    camera: np.ndarray | None = None,
) -> SenseTest:
    """Compare the changes of bearings with the rotation of the odometry.

    `t` [s], `landmark`, `bearing` [rad] and optionally `camera`, (n,), are sightings in order of
    time. Bearings may be in another unit, and need not be wrapped. Landmarks without ids do not
    count: their keys change from frame to frame.
    """
    twists = np.abs([odometry.v, odometry.omega])
    if odometry.t.size < 3 or (twists > ABSURD).any():
        return UNDECIDED
    usable = (t >= odometry.t[0]) & (t <= odometry.t[-1]) & np.isfinite(bearing)
    names, track = np.unique(landmark.astype(str), return_inverse=True)
    usable &= np.array([is_followed(name) for name in names.tolist()], bool)[track]
    t, track, bearing = t[usable], track[usable], bearing[usable]
    if camera is not None:
        number = np.unique(camera[usable].astype(str), return_inverse=True)[1]
        track = track * (number.max(initial=0) + 1) + number
    stamps = np.unique(t)
    if stamps.size < MIN_INTERVALS:
        return UNDECIDED
    length = float(np.clip(NUM_FRAMES * np.median(np.diff(stamps)), MIN_INTERVAL_S, MAX_INTERVAL_S))
    interval = ((t - t[0]) / length).astype(int)
    # The first and the last sighting of each landmark in each interval.
    order = np.lexsort((t, track, interval))
    group = np.stack([interval, track])[:, order]
    is_first = np.append(True, (np.diff(group) != 0).any(axis=0))
    first, last = order[is_first], order[np.append(is_first[1:], True)]
    long_enough = t[last] - t[first] >= length / 4
    first, last = first[long_enough], last[long_enough]
    pose = dead_reckoning_unwrapped(odometry, t)
    turn = pose.heading[last] - pose.heading[first]
    path = np.hypot(pose.x[last] - pose.x[first], pose.y[last] - pose.y[first])
    change = bearing[last] - bearing[first]
    moved = change != 0.0  # repeated to the bit: no measurement
    if not moved.any():
        return UNDECIDED
    turn, path, change, interval = (v[moved] for v in (turn, path, change, interval[first]))
    rotation, noise = _medians(interval, turn), _rate_noise(odometry) * math.sqrt(length)
    used = np.abs(rotation) > MIN_ROTATION * noise
    if not used.any():
        return UNDECIDED
    rate = float(np.quantile(np.abs(rotation[used]), 0.8)) / length
    votes = _Votes(rotation[used], _medians(interval, path)[used], noise, rate, used.size)
    residuals = {s: _medians(interval, _misfit(change, s.value * turn, s))[used] for s in Sense}
    return votes.decision(residuals)


def _misfit(change: np.ndarray, expected: np.ndarray, sense: Sense) -> np.ndarray:
    """Return the deviation of changes of bearings from the expected ones [their unit]."""
    scale = DEG if abs(sense.value) > 1.0 else 1.0
    return scale * np.asarray(wrap((change - expected) / scale))


def _medians(group: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return the median of the values of each group; groups are whole numbers."""
    order = np.lexsort((values, group))
    begin = np.flatnonzero(np.diff(group[order], prepend=-1))
    num = np.diff(np.append(begin, group.size))
    low, high = (values[order][begin + k] for k in ((num - 1) // 2, num // 2))
    return np.asarray((low + high) / 2)


def _rate_noise(odometry: Odometry) -> float:
    """Return the density of white noise of the yaw rate [rad/sqrt(s)]."""
    omega = odometry.bridged.omega
    deviation = 1.4826 * float(np.median(np.abs(np.diff(omega, 2)))) / math.sqrt(6.0)
    return deviation * math.sqrt(float(np.median(np.diff(odometry.t))))


class _Votes:
    """The votes of intervals: their rotation (n,) [rad] and path (n,) [m] according to odometry."""

    def __init__(
        self, turn: np.ndarray, path: np.ndarray, noise: float, rate: float, num: int
    ) -> None:
        """`noise` is the white noise of the rotation [rad], `rate` the usual yaw rate [rad/s].

        `num` is the number of all intervals, also those without rotation.
        """
        self._turn, self._path, self._noise, self._rate = turn, path, noise, rate
        self._num = num

    def log_likelihood(
        self, sense: Sense, residual: np.ndarray, biases: Sequence[float] = (0.0,)
    ) -> np.ndarray:
        """Return the log-likelihood (n,) of each interval, with the noise that fits best.

        `biases` are means of parallax to either side that are tried, as `BIASES`.
        """
        scale = DEG if abs(sense.value) > 1.0 else 1.0
        slope, error = sense.value / scale, residual / scale
        of_turn = slope**2 * (np.square(GAIN_ERROR * self._turn) + self._noise**2)
        best = np.full(error.size, -np.inf)
        for noise, parallax in product(NOISES, PARALLAXES):
            variance = noise**2 + np.square(parallax * self._path) + of_turn
            logs = np.full(error.size, -np.inf)
            for bias, side in product(biases, (self._turn > 0, self._turn < 0)):
                off = (error - bias * parallax * self._path)[side]
                spread = variance[side]
                density = np.exp(-0.5 * off**2 / spread) / np.sqrt(math.tau * spread)
                mine = np.log((1.0 - BAD_INTERVAL) * density + BAD_INTERVAL / math.tau)
                mine -= 0.5 * bias**2 / max(mine.size, 1)
                if mine.sum() > logs[side].sum():
                    logs[side] = mine
            best = logs if logs.sum() > best.sum() else best
        return best - math.log(scale)

    def log_prior(self, sense: Sense) -> float:
        """Return the logarithm of the prior density of the usual yaw rate."""
        usual, deviation = USUAL_RATE
        return -0.5 * (math.log(self._rate / sense.rate_factor / usual) / deviation) ** 2

    def decision(self, residuals: dict[Sense, np.ndarray]) -> SenseTest:
        """Return the likeliest sense if it is much likelier than the others.

        A fault must be likelier than the required sense in rotation to both sides.
        """
        logs = {sense: self.log_likelihood(sense, e) for sense, e in residuals.items()}
        total = {sense: float(log.sum()) + self.log_prior(sense) for sense, log in logs.items()}
        sense = max(total, key=total.__getitem__)
        if sense in NOT_TURNING:
            sense = self._not_turning(residuals)
        others = [s for s in Sense if s is not sense and {s, sense} - NOT_TURNING]
        gain = logs[sense] - logs[Sense.REVERSED if sense is Sense.RIGHT else Sense.RIGHT]
        counts = np.abs(gain) > INFORMATIVE
        found = SenseTest(None, int(counts.sum()))
        if any(total[sense] - total[other] < MIN_GAIN for other in others):
            return found
        if found.intervals < MIN_INTERVALS or gain.sum() < MIN_EVIDENCE:
            return found
        if abs(sense.value) < 1.0 and found.intervals < MIN_TURNING * self._num:
            return found
        if sense is Sense.RIGHT:
            return dataclasses.replace(found, sense=sense)
        on_the_spot = counts & (self._path < SPOT_RADIUS * np.abs(self._turn))
        one_side = sense is not Sense.FIXED_FRAME and on_the_spot.sum() >= MIN_INTERVALS
        for side in (self._turn > 0, self._turn < 0):
            mine = gain[counts & side]
            if one_side and not mine.size:
                continue
            if mine.size < MIN_INTERVALS_OF_SIDE or mine.sum() < MIN_EVIDENCE_OF_SIDE:
                return found
            if (mine > 0).mean() < MIN_SHARE:
                return found
        misfit, usual = (
            float(np.median(np.abs(residuals[s][counts]))) for s in (sense, Sense.RIGHT)
        )
        return found if misfit > MAX_MISFIT * usual else dataclasses.replace(found, sense=sense)

    def _not_turning(self, residuals: dict[Sense, np.ndarray]) -> Sense:
        """Return the sense of bearings that hardly turn: a unit only if it fits much better."""
        total = {
            s: float(self.log_likelihood(s, residuals[s], BIASES).sum()) + self.log_prior(s)
            for s in NOT_TURNING
        }
        best = max(total, key=total.__getitem__)
        is_unit = total[best] - total[Sense.FIXED_FRAME] >= MIN_GAIN
        return best if is_unit else Sense.FIXED_FRAME


def num_fixed_speeds(odometry: Odometry) -> int:
    """Return the number of intervals that show speeds along fixed axes; 0 for those of a robot.

    The direction of a robot that drives ahead then turns with the odometry, and is constant after
    that rotation is removed.
    """
    speed = odometry.v + 1j * odometry.vy
    moves = np.abs(speed) > MIN_SPEED
    if not (odometry.strafes and moves.any()):
        return 0
    t, speed = odometry.t[moves], speed[moves]
    ahead = speed * np.exp(-1j * dead_reckoning_unwrapped(odometry, t).heading)
    if np.abs((ahead**2 / np.abs(ahead)).sum()) < MIN_AHEAD * np.abs(ahead).sum():
        return 0
    found = compare_senses(odometry, t, np.full(t.size, "motion"), np.angle(speed))
    return found.intervals if found.sense is Sense.REVERSED else 0


def senses_of(drive: Drive) -> SenseTest:
    """Return the test of the senses of a drive."""
    s = drive.sightings
    return compare_senses(drive.odometry, s.t, s.landmark, s.bearing, s.camera)


def with_sense_remark(drive: Drive) -> Drive:
    """Return a drive with a remark if its bearings do not fit the rotation of its odometry."""
    if not drive.settings.check_senses:
        return drive
    if number := num_fixed_speeds(drive.odometry):
        fault = FIXED_SPEEDS
    else:
        found = senses_of(drive)
        if not found.is_fault or found.sense is None:
            return drive
        fault, number = REMEDIES[found.sense], found.intervals
    remark = {SHOWS + "; ".join(fault): number}
    return dataclasses.replace(drive, remarks={**drive.remarks, **remark})


def require_senses(drive: Drive) -> None:
    """Raise InputError for a drive with which no pose is possible, by its remark."""
    for fault, remedy in (*REMEDIES.values(), FIXED_SPEEDS):
        if f"{SHOWS}{fault}; {remedy}" in drive.remarks:
            raise InputError(fault, advice=f"{remedy}, or set {OVERRIDE} to run it all the same")
