"""Measurement noise of bearings: as given, or estimated from second differences and residuals.

Second differences are available at once and need no map: over two successive intervals the
direction of a landmark, less the turns of odometry, is nearly linear in time. Residuals follow once
there is a map. The larger of the two estimates is used, since differences are blind to slow errors,
and residuals to rejected sightings.

Given values are overruled when the residuals are far larger: a number in a file may have an error
of a factor of ten, and would make a wrong pose look certain.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping
from typing import NamedTuple, TypeVar

import numpy as np

from homeward.geometry.angles import wrap
from homeward.geometry.statistics import MAD_TO_SIGMA
from homeward.localizer.inputs.reorder import BearingFrame
from homeward.localizer.tunables import (
    CORRELATION_KEPT,
    CORRELATION_TIMES_S,
    DISTINGUISHED,
    GATE,
    LAG_BOUNDS_S,
    MAX_IDS,
    MAX_INFLATION,
    MAX_NOISE_RATIO,
    MAX_RESIDUALS,
    MAX_SPAN_S,
    MIN_BEARING_SIGMA,
    MIN_GAP_S,
    MIN_RESIDUALS,
    NOISE_KEPT,
    NOTABLE_GAP_S,
    NUM_DIFFERENCES,
    PAIR_STEPS,
)
from homeward.odometry.history import Driven, Reckoned

QUARTER_TO_SIGMA = 3.138


class WeighedFrame(NamedTuple):
    """Bearings of one frame with their measurement noise."""

    t: float
    """[s]"""
    names: list[str]
    """Of m landmarks."""
    bearings: np.ndarray
    """(m,) [rad]"""
    sigmas: np.ndarray
    """(m,): their standard deviations [rad]."""
    driven: Driven = Driven()
    """Wheel motion up to then."""
    ranges: np.ndarray | None = None
    """(m, 2): logarithms of ranges [m], and standard deviations; NaN where there is none. None: no
    ranges at all."""
    offset: np.ndarray | None = None
    """(3,): pose of their camera in the frame of the first one; None for the first."""


class BearingNoise:
    """Measurement noise: the standard deviations of bearings, estimated where none were given.

    `given` is the drive's for bearings without their own [rad]; if None, the estimate begins at
    `default`.
    """

    def __init__(self, given: float | None, default: float) -> None:
        # A smaller noise than `valid_sigma` accepts would be lost in the rounding of the map.
        self._given = None if given is None else max(given, MIN_BEARING_SIGMA)
        self._from_map = self._default = max(default, MIN_BEARING_SIGMA)
        self._from_residuals, self._from_differences = 0.0, 0.0
        self._is_given = given is not None
        """Whether the newest bearings came with standard deviations, or the drive gave one."""
        self._typical = math.nan
        self.confirmed = False
        """Whether residuals confirm the present noise level."""
        self.scale = 1.0
        """Noise scale: estimated over given standard deviation [1]."""
        self.correlated = CorrelatedErrors()
        """Their time-correlated part."""
        self._differences: deque[float] = deque(maxlen=NUM_DIFFERENCES[1])
        self._last = ById[deque[tuple[float, float]]]()

    @property
    def sigma(self) -> float:
        """Present standard deviation of a bearing that comes without one [rad]."""
        if self._given is not None:
            return self.scale * self._given
        return max(self._from_map, self._from_differences)

    @property
    def learnt(self) -> float | None:
        """Estimate without a minimum [rad]; None: it was given, or there are too few bearings."""
        if self._is_given or not self.confirmed or not self._from_differences:
            return None
        return max(self._from_residuals, self._from_differences)

    @property
    def to_distinguish(self) -> float:
        """The same, to distinguish landmarks without ids: without a minimum [rad].

        A standard deviation that is too large mixes neighbours, which makes it larger.
        """
        if self._given is not None:
            return self.sigma
        return float(np.clip(self.learnt or 0.0, *DISTINGUISHED))

    @property
    def typical(self) -> float:
        """Median standard deviation of the newest bearings [rad]."""
        return self.sigma if math.isnan(self._typical) else self._typical

    def sigmas(self, names: list[str], given: Mapping[str, float]) -> np.ndarray:
        """Return the standard deviations of new bearings, some of which came with one [rad]."""
        default = self.sigma
        sigmas = [self.scale * given[n] if n in given else default for n in names]
        if sigmas:
            self._typical = sorted(sigmas)[len(sigmas) // 2]
        return np.array(sigmas)

    def weigh(self, frame: BearingFrame, reckoned: Reckoned) -> WeighedFrame:
        """Assign noise to the bearings of a frame, and learn from them; see `add_bearings`."""
        t, sightings, given, ranges, _, offset = frame
        self.add_bearings(frame, reckoned.pose.heading)
        names = list(sightings)
        bearings = np.array([sightings[n] for n in names])
        sigmas = self.sigmas(names, given)
        seen = WeighedFrame(t, names, bearings, sigmas, reckoned.driven, None, offset)
        if not ranges:
            return seen
        none = math.nan, math.nan
        return seen._replace(ranges=np.array([ranges.get(n, none) for n in names]))

    def add_bearings(self, frame: BearingFrame, heading: float) -> None:
        """Update the second differences by a frame; `heading` is that of odometry alone [rad]."""
        t, sightings, given = frame.t, *map(frame.by_camera, (frame.sightings, frame.sigmas))
        self._is_given = self._given is not None or bool(given)
        if self._given is not None:
            return
        for name, bearing in sightings.items():
            if name in given:
                continue
            last = self._last.setdefault(name, deque(maxlen=2))
            if len(last) == 2 and last[0][0] < last[1][0] < t <= last[0][0] + MAX_SPAN_S:
                first, middle = last
                self._differences.append(_second_difference(first, middle, (t, heading + bearing)))
            last.append((t, heading + bearing))
        self._last.prune(lambda last: last[-1][0] < t - MAX_SPAN_S)  # in no second difference
        if len(self._differences) >= NUM_DIFFERENCES[0]:
            self._from_differences = _robust_sigma(np.array(self._differences))

    def update(
        self,
        residuals: np.ndarray,
        own: np.ndarray,
        total: np.ndarray,
        gaps: np.ndarray,
        landmarks: np.ndarray,
        keyframes: int,
    ) -> float:
        """Update the noise by the residuals (m,) of a solved map, measured minus expected [rad].

        `own` and `total` (m,) are standard deviations without, and with, the odometry noise since
        the keyframe [rad]; `gaps` and `landmarks` (m,) are those of `CorrelatedErrors.update`, and
        `keyframes` the number since the last update. Return the factor by which the stored standard
        deviations must be inflated.
        """
        if len(residuals) < MIN_RESIDUALS:
            return 1.0
        off, clear = np.abs(residuals), total <= MAX_INFLATION * own
        if clear.sum() >= MIN_RESIDUALS:
            errors = np.where(clear, residuals / own, np.nan)
            self.correlated.update(errors, gaps, landmarks, 1.0 - CORRELATION_KEPT**keyframes)
        if self._is_given:
            return self._rescale(off, own, total)
        self.confirmed = True
        now = MAD_TO_SIGMA * float(np.median(off))
        new = 1.0 - NOISE_KEPT**keyframes
        begin = 0.0 if self._from_residuals else 1.0
        self._from_residuals += max(new, begin) * (now - self._from_residuals)
        self._from_map += new * (max(now, self._default) - self._from_map)
        return 1.0

    def _rescale(self, off: np.ndarray, own: np.ndarray, total: np.ndarray) -> float:
        """Update the noise scale by the sizes of residuals, (m,) [rad]."""
        clear = total <= MAX_INFLATION * own
        if clear.sum() < MIN_RESIDUALS:
            return 1.0
        latest = (off / own)[clear][-MAX_RESIDUALS:]
        before, excess = self.scale, MAD_TO_SIGMA * float(np.median(latest))
        self.confirmed = excess <= MAX_NOISE_RATIO
        if before > 1.0 or excess > MAX_NOISE_RATIO:
            self.scale = max(1.0, before * excess)
        return self.scale / before


def valid_sigma(sigma: float) -> float:
    """Return a given standard deviation of a bearing [rad], NaN where it is implausible."""
    return min(float(sigma), math.pi) if MIN_BEARING_SIGMA <= sigma < math.inf else math.nan


def _robust_sigma(off: np.ndarray) -> float:
    """Return the standard deviation of errors, given by size, of which half may be outliers.

    A wrong id spoils three differences, so the median of all may be an outlier; a lower quantile
    finds those to leave out before the median absolute deviation is taken.
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
    """Return the second difference of directions, over its factor of the noise of one.

    Each argument is a time [s] and a direction [rad], with independent errors of equal variance.
    """
    (a, at), (b, now), (c, then) = first, middle, last
    share = (b - a) / (c - a)
    off = wrap(now - at) - share * wrap(then - at)
    return float(abs(off) / np.sqrt(1.0 + share**2 + (1.0 - share) ** 2))


class CorrelatedErrors:
    """Time-correlated bearing errors: a first-order Gauss-Markov process plus white noise.

    A detector misses a landmark's axis alike from one place and the next. Treating each sighting as
    independent overweights bearings: the map shrinks until odometry gives way, and poses are too
    certain. So the autocorrelation of the residuals is estimated, the same for all landmarks, and a
    sighting counts less the sooner it follows the previous one of its landmark.
    """

    def __init__(self) -> None:
        self.share = 0.0
        """Its variance over that of a single bearing [1]."""
        self.correlation_time = 1.0
        """Time after which the autocorrelation is down to 1 / e [s]."""
        self._correlations = np.full(len(LAG_BOUNDS_S) - 1, np.nan)

    def excess(self, gaps: np.ndarray) -> np.ndarray:
        """Return the excess variance of correlated sightings, over that of a single one [1].

        The mean of n samples, a gap apart, of a process of variance s has the variance s / n
        coth(gap / 2 time): so each counts as one of white noise with n times that. `gaps` (m,) are
        times since the last sighting of the same landmark [s], infinite for the first.
        """
        gaps = np.maximum(gaps, MIN_GAP_S)
        return np.asarray(self.share * (1.0 / np.tanh(gaps / (2.0 * self.correlation_time)) - 1.0))

    def notes(self, sigma: float) -> tuple[str, ...]:
        """Return a note for the user where correlation is notable; `sigma` is a bearing's [rad]."""
        if self.excess(np.array([NOTABLE_GAP_S]))[0] < 1.0:
            return ()
        slow, time = math.degrees(sigma * math.sqrt(self.share)), self.correlation_time
        return (
            f"Bearing errors of {slow:.2g} deg are correlated over {time:.1f} s, and the covariance"
            " is larger for that. Check the calibration and the stamps of bearings.",
        )

    def update(
        self, errors: np.ndarray, gaps: np.ndarray, landmarks: np.ndarray, weight: float
    ) -> None:
        """Update the autocorrelation of the errors (m,), normalised residuals in order of time.

        NaN: unknown. `gaps` (m,) are those of `excess`, since the one before it in `errors`;
        `landmarks` (m,) the landmark of each; `weight` is that of these against the present
        estimate.
        """
        order = np.argsort(landmarks, kind="stable")
        errors, landmarks = np.clip(errors, -GATE, GATE)[order], landmarks[order]
        t = np.cumsum(np.where(np.isfinite(gaps[order]), gaps[order], LAG_BOUNDS_S[-1]))
        lags, products = [], []
        for step in PAIR_STEPS:
            same = landmarks[step:] == landmarks[:-step]
            lags.append((t[step:] - t[:-step])[same])
            products.append((errors[step:] * errors[:-step])[same])
        of_class = np.searchsorted(LAG_BOUNDS_S, np.concatenate(lags), side="right") - 1
        product = np.concatenate(products)
        use = (of_class >= 0) & (of_class < len(LAG_BOUNDS_S) - 1) & np.isfinite(product)
        of_class, product = of_class[use], product[use]
        pairs = np.bincount(of_class, minlength=len(LAG_BOUNDS_S) - 1)
        sums = np.bincount(of_class, product, minlength=len(LAG_BOUNDS_S) - 1)
        enough = pairs >= MIN_RESIDUALS
        before = np.nan_to_num(self._correlations[enough])
        self._correlations[enough] = before + weight * (sums[enough] / pairs[enough] - before)
        self._fit()

    def _fit(self) -> None:
        """Fit an exponential to the correlations by least squares."""
        known = np.isfinite(self._correlations)
        if not known.any():
            return
        middle = np.sqrt(LAG_BOUNDS_S[:-1] * LAG_BOUNDS_S[1:])[known]
        shapes = np.exp(-middle / CORRELATION_TIMES_S[:, None])
        shares = np.clip(shapes @ self._correlations[known] / (shapes**2).sum(axis=1), 0.0, 1.0)
        off = ((shares[:, None] * shapes - self._correlations[known]) ** 2).sum(axis=1)
        best = int(off.argmin())
        self.share, self.correlation_time = float(shares[best]), float(CORRELATION_TIMES_S[best])


Value = TypeVar("Value")


class ById(dict[str, Value]):
    """Values by landmark id; old ones are dropped where ids come without end."""

    _limit = MAX_IDS

    def prune(self, is_old: Callable[[Value], bool]) -> bool:
        """Drop old values whenever the number of ids has doubled; return whether that was now."""
        if len(self) <= self._limit:
            return False
        for name in [name for name, value in self.items() if is_old(value)]:
            del self[name]
        self._limit = max(MAX_IDS, 2 * len(self))
        return True
