"""Measurement noise of bearings: as given, or estimated from second differences and residuals.

At once by their second differences, which need no map: between a sighting of a landmark and the
next but one its direction, the odometry's turns taken out, is all but linear in time. Later by what
the map leaves of them. Whichever is larger is believed: the first knows nothing of slow errors, and
the second nothing of what was rejected.

What was given is doubted where the map leaves far more of the bearings than it allows: a number in
a file is easily wrong by a factor of ten, and who takes it at its word is then sure of a wrong
pose.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from homeward.angles import wrap
from homeward.localizer.inputs.lasting_errors import LastingErrors
from homeward.localizer.inputs.reorder import BearingFrame
from homeward.localizer.tunables import GATE, MAX_NOISE_RATIO

RESIDUALS = 40
"""So many residuals are needed to judge it by the map ..."""
DIFFERENCES = 20, 200
"""... or so many second differences, and the last so many are looked at."""
SPAN_S = 1.05
"""Three sightings that take longer are not linear in time [s]."""
NO_CAMERA = 1e-6
"""No camera is better [rad]; a smaller deviation is as good as none given."""
MAD_TO_SIGMA, QUARTER_TO_SIGMA = 1.4826, 3.138
KEPT, KEPT_OF_LASTING = 0.9, 0.97
"""So much of what was believed is kept from keyframe to keyframe [1]; more of what lasts, since a
camera elsewhere than thought makes such errors, too, until that is found out."""
CLEAR = 1.1
"""Of sightings whose way from the keyframe blurs them no more the noise is their own [1]."""
LATEST = 300
"""So many of the latest are looked at: a camera may become worse on the way."""


class WeighedFrame(NamedTuple):
    """Weighed frame: what the camera saw at one stamp, each bearing with its noise."""

    t: float
    """[s]"""
    names: list[str]
    """Of m landmarks."""
    bearings: np.ndarray
    """(m,) [rad]"""
    sigmas: np.ndarray
    """(m,): their standard deviations [rad]."""


class BearingNoise:
    """Measurement noise: the standard deviations of bearings, estimated where nobody gave them.

    Parameters
    ----------
    given : float or None
        What the drive says of those that come without one [rad].
    default : float
        What is believed at first if it says nothing [rad].
    """

    def __init__(self, given: float | None, default: float) -> None:
        self._given, self._default = given, default
        self._by_map = default
        self._by_differences = 0.0
        self._told = given is not None
        """Whether the newest bearings came with deviations, or the drive gave one."""
        self._typical = math.nan
        self.settled = False
        """Whether residuals have been looked at, and bear out what is believed."""
        self.scale = 1.0
        """Noise scale: how many times larger than given the deviations are estimated to be [1]."""
        self.lasting = LastingErrors()
        """What lasts in their errors."""
        self._differences: deque[float] = deque(maxlen=DIFFERENCES[1])
        self._last: dict[str, deque[tuple[float, float]]] = {}

    @property
    def sigma(self) -> float:
        """Of a bearing that comes without one, as believed now [rad]."""
        if self._given is not None:
            return self.scale * self._given
        return max(self._by_map, self._by_differences)

    @property
    def typical(self) -> float:
        """Of most of the newest bearings [rad]."""
        return self.sigma if math.isnan(self._typical) else self._typical

    def sigmas(self, names: list[str], told: Mapping[str, float]) -> np.ndarray:
        """Return the deviations of new bearings, of which some came with one [rad]."""
        untold = self.sigma
        sigmas = [self.scale * told[n] if n in told else untold for n in names]
        if sigmas:
            self._typical = sorted(sigmas)[len(sigmas) // 2]
        return np.array(sigmas)

    def weigh(self, frame: BearingFrame, heading: float) -> WeighedFrame:
        """Give each bearing of a frame, seen at a `heading` [rad], its noise; learn from them."""
        t, sightings, told = frame
        self.add_bearings(frame, heading)
        names = list(sightings)
        bearings = np.array([sightings[n] for n in names])
        return WeighedFrame(t, names, bearings, self.sigmas(names, told))

    def add_bearings(self, frame: BearingFrame, heading: float) -> None:
        """Take the bearings of a frame, the heading being what odometry alone has [rad]."""
        t, sightings, told = frame
        self._told = self._given is not None or bool(told)
        if self._given is not None:
            return
        for name, bearing in sightings.items():
            if name in told:
                continue
            last = self._last.setdefault(name, deque(maxlen=2))
            if len(last) == 2 and last[0][0] < last[1][0] < t <= last[0][0] + SPAN_S:
                first, middle = last
                self._differences.append(_second_difference(first, middle, (t, heading + bearing)))
            last.append((t, heading + bearing))
        if len(self._differences) >= DIFFERENCES[0]:
            self._by_differences = _scale(np.array(self._differences))

    def update(
        self,
        residuals: np.ndarray,
        own: np.ndarray,
        whole: np.ndarray,
        gaps: np.ndarray,
        landmarks: np.ndarray,
        keyframes: int,
    ) -> float:
        """Follow what the map leaves of bearings, after so many keyframes more.

        Parameters
        ----------
        residuals : ndarray, shape (m,)
            Measured minus expected [rad].
        own, whole : ndarray, shape (m,)
            Standard deviations without, and with, what the way from the keyframe adds [rad].
        gaps, landmarks : ndarray, shape (m,)
            See `LastingErrors.update`.
        keyframes : int
            Since the last time.

        Returns
        -------
        float
            By how much deviations that were given, in what is kept, are to be widened [1].
        """
        if len(residuals) < RESIDUALS:
            return 1.0
        off, clear = np.abs(residuals), whole <= CLEAR * own
        if clear.sum() >= RESIDUALS:
            errors = np.where(clear, residuals / own, np.nan)
            self.lasting.update(errors, gaps, landmarks, 1.0 - KEPT_OF_LASTING**keyframes)
        if self._told:
            return self._rescale(off, own, whole)
        self.settled = True
        now = MAD_TO_SIGMA * float(np.median(off))
        now = max(now, self._default)
        self._by_map += (1.0 - KEPT**keyframes) * (now - self._by_map)
        return 1.0

    def _rescale(self, off: np.ndarray, own: np.ndarray, whole: np.ndarray) -> float:
        """Doubt what was given as much as the sizes of residuals, (m,) [rad], tell."""
        clear = whole <= CLEAR * own
        if clear.sum() < RESIDUALS:
            return 1.0
        latest = (off / own)[clear][-LATEST:]
        before, excess = self.scale, MAD_TO_SIGMA * float(np.median(latest))
        self.settled = excess <= MAX_NOISE_RATIO
        if before > 1.0 or excess > MAX_NOISE_RATIO:
            self.scale = max(1.0, before * excess)
        return self.scale / before


def deviation(sigma: float) -> float:
    """Return the standard deviation of a bearing [rad] as far as it can be one, else NaN."""
    return min(float(sigma), math.pi) if NO_CAMERA <= sigma < math.inf else math.nan


def _scale(off: np.ndarray) -> float:
    """Return the standard deviation of errors, given by size, of which up to half may be wild.

    A wrong id spoils three differences, so the median of all may be one of the wild.
    """
    off = np.sort(off)
    rough = QUARTER_TO_SIGMA * float(np.quantile(off, 0.25))
    for _ in range(2):
        tame = off[: off.searchsorted(GATE * rough, side="right")]
        rough = MAD_TO_SIGMA * 0.5 * float(tame[(tame.size - 1) // 2] + tame[tame.size // 2])
    return rough


def _second_difference(
    first: tuple[float, float], middle: tuple[float, float], last: tuple[float, float]
) -> float:
    """Return how far a direction is off the line through two others, in their own deviations.

    Each is a time [s] and a direction [rad]; all three err alike and independently.
    """
    (a, at), (b, now), (c, then) = first, middle, last
    share = (b - a) / (c - a)
    off = wrap(now - at) - share * wrap(then - at)
    return float(abs(off) / np.sqrt(1.0 + share**2 + (1.0 - share) ** 2))
