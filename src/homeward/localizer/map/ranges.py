"""Range factors: the logarithm of a range, with an unknown scale that all ranges have in common.

The printed size of a tag may be wrong, or a detector biased, so ranges have a common scale b. The
scale s of odometry's speed is unknown, too. Bearings and ranges observe only the sum of both,
d = s + b; how it is shared follows from their priors, of standard deviations S and B: the mean of s
is d S^2 / (S^2 + B^2), and b = s B^2 / S^2. So the state needs no further unknown: it contains that
mean of s. What remains of s, of standard deviation S B / hypot(S, B), is not observable: the map
may have any size within it, as it may without ranges within S. Where B is unknown, that is all of
S, and s stays fixed.

Errors of ranges last: of an edge, a viewing angle, a tag's size. Their correlation falls with the
logarithm of the time, so ranges of a landmark count less the longer it has been in view.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from homeward.drives.landmarks import KnownLandmarks
from homeward.drives.settings import DriveSettings
from homeward.geometry.angles import wrap
from homeward.geometry.se2 import MIN_SQUARED_DISTANCE, Sight, sight
from homeward.localizer import kernels
from homeward.localizer.map.sightings import (
    AGE,
    FRAME,
    GAP,
    KEYFRAME,
    LOG_RANGE,
    OWN,
    RANGE_SIGMA,
    SIGMA,
    Frames,
)
from homeward.localizer.map.triangulation import spaced, unit_vectors
from homeward.localizer.motions import HEAD, NC, SPEED_SCALE
from homeward.localizer.reference.factors import (
    NormalEquations,
    WeighedSightings,
    cameras,
    weigh_sightings,
)
from homeward.localizer.settings import LocalizerSettings
from homeward.localizer.tunables import (
    CLOSE,
    FIXED_SPEED_SCALE,
    INLIER,
    LINEAR,
    MAJORITY,
    MAX_RANGE_SIGMA,
    MIN_GAP_S,
    MIN_LINES,
    MIN_RANGE_SIGMA,
    MIN_SPEED_SCALE,
    RANGE_CORRELATION_S,
    RANGE_ERROR,
    RANGE_ERROR_M,
    UNKNOWN_RANGE_SCALE,
)


class ScaleErrors(NamedTuple):
    """Standard deviations of the scale of speeds and of ranges, and how they share a deviation."""

    state: float
    """Prior standard deviation of the speed scale in the state, its observable part [1]."""
    rest: float | None
    """Standard deviation of the map's scale that is not observable, and in no state [1]; None: a
    survey observes all of it."""
    ratio: float = 0.0
    """Logarithm of the scale of ranges, over the speed scale [1]; 0: ranges are not used."""

    @staticmethod
    def of(drive: DriveSettings, settings: LocalizerSettings, known: KnownLandmarks) -> ScaleErrors:
        """Return those of a drive; a survey observes the scale by itself, and ranges are unused."""
        given = drive.odometry.speed_scale_sigma
        speed = settings.odometry.speed_scale if given is None else given
        if known.is_given:
            return ScaleErrors(speed, None)
        ranges = drive.sensor.range_scale_sigma
        if ranges is None:
            return ScaleErrors(FIXED_SPEED_SCALE, speed, UNKNOWN_RANGE_SCALE / FIXED_SPEED_SCALE)
        speed = max(speed, MIN_SPEED_SCALE)
        both = math.hypot(speed, ranges)
        return ScaleErrors(speed**2 / both, speed * ranges / both, (ranges / speed) ** 2)


@dataclass(frozen=True)
class RangeFactors:
    """Ranges of m sightings, as factors of keyframes, calibration and landmarks."""

    rows: np.ndarray
    """(m, COLUMNS): rows of the table of sightings."""
    frames: Frames
    """The frames of the window, ..."""
    first: int
    """... and the number of its oldest keyframe."""
    landmark: np.ndarray
    """(m,): indices of the landmarks in the state."""
    p_static: np.ndarray
    """(m,): probability that each is static [1]."""
    ratio: float
    """Logarithm of the scale of ranges, over the speed scale [1] (`ScaleErrors`)."""

    def residuals(self, poses: np.ndarray, shared: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the residuals (m,), and the Jacobian of the expected values (m, 15).

        `poses` (w, 3) are of the keyframes, `shared` (10 + 2 n,) calibration and landmarks. A
        residual is the logarithm of the measured over the expected range; the Jacobian is by
        keyframe's pose, calibration and landmark.
        """
        rows, frames = self.rows, self.frames
        numbers, frame = np.unique(rows[:, FRAME].astype(int), return_inverse=True)
        some = numbers - frames.first
        keyframes = poses[frames.keyframes[some] - self.first]
        eyes, by_head = cameras(frames.free[some], frames.jacobians[some], keyframes, shared[:NC])
        seen = sight(eyes[frame], shared[NC:].reshape(-1, 2)[self.landmark])
        by_place = np.stack([seen.by_place[:, 1], -seen.by_place[:, 0]], axis=1)
        jacobian = np.empty((len(rows), 5 + NC))
        jacobian[:, :HEAD] = -(by_place[:, None, :] @ by_head[frame, :2])[:, 0]
        jacobian[:, 3 + SPEED_SCALE] += self.ratio
        jacobian[:, HEAD:] = by_place
        scale = self.ratio * float(shared[SPEED_SCALE])
        return rows[:, LOG_RANGE] - _log_distances(seen) - scale, jacobian

    def deviations(self, poses: np.ndarray, shared: np.ndarray) -> np.ndarray:
        """Return the residuals over their standard deviations, (m,) [1]."""
        return np.asarray(self.residuals(poses, shared)[0] / _sigmas(self.rows))

    def weighed(self, poses: np.ndarray, shared: np.ndarray) -> WeighedSightings:
        """Return them normalised, with the M-estimator of bearings for large residuals."""
        rows = self.rows
        gaps = np.maximum(rows[:, GAP], MIN_GAP_S)
        times = np.maximum(rows[:, AGE], RANGE_CORRELATION_S)
        correlated = rows[:, RANGE_SIGMA] ** 2 / np.tanh(gaps / (2.0 * times))
        effective = np.sqrt((correlated + _odometry_variance(rows)) / self.p_static)
        at = rows[:, KEYFRAME].astype(int) - self.first, self.landmark
        return weigh_sightings(*self.residuals(poses, shared), _sigmas(rows), effective, *at)

    def add_to(self, e: NormalEquations, poses: np.ndarray, shared: np.ndarray) -> None:
        """Add them to normal equations."""
        kernels.add_sightings(e, self.weighed(poses, shared))


def _log_distances(seen: Sight) -> np.ndarray:
    """Return the logarithms of distances [m]."""
    squares = (seen.offset**2).sum(axis=-1)
    return np.asarray(0.5 * np.log(np.maximum(squares, MIN_SQUARED_DISTANCE)))


def _sigmas(rows: np.ndarray) -> np.ndarray:
    """Return the standard deviations of single ranges (m,), with the odometry noise [1]."""
    return np.asarray(np.sqrt(rows[:, RANGE_SIGMA] ** 2 + _odometry_variance(rows)))


def _odometry_variance(rows: np.ndarray) -> np.ndarray:
    """Return the variance (m,) by a shift since the keyframe, over the distance [1]."""
    return np.asarray(rows[:, SIGMA] ** 2 - rows[:, OWN] ** 2)


def place_by_ranges(
    cameras: np.ndarray, bearings: np.ndarray, sigmas: np.ndarray, ranges: np.ndarray
) -> tuple[np.ndarray, np.ndarray] | None:
    """Return the position on which most sightings of a landmark agree (2,) [m], and which do (m,).

    Arguments as for `triangulate`; `ranges` (m, 2) are logarithms of ranges [m] and their standard
    deviations, NaN where there is none. None instead of both if too few have a range, or too few
    agree.
    """
    (known,) = (ranges[:, 1] < LINEAR).nonzero()
    if known.size < MIN_LINES:
        return None
    chosen = known[spaced(known.size)]
    along = unit_vectors(cameras[chosen, 2] + bearings[chosen])
    places = cameras[chosen, :2] + np.exp(ranges[chosen, :1]) * along
    seen = sight(cameras, places[:, None])
    off = np.abs(wrap(bearings - seen.bearing)) / sigmas
    far = np.abs(ranges[:, 0] - _log_distances(seen)) / ranges[:, 1]
    agree = (off < INLIER) & ~(far > INLIER)
    with_range = (agree[:, known]).sum(axis=1)
    best = int((with_range + agree.sum(axis=1)).argmax())
    if with_range[best] < max(MIN_LINES, MAJORITY * known.size):
        return None
    if agree[best].sum() < MAJORITY * len(bearings):
        return None
    members = agree[best, chosen]
    return np.median(places[members], axis=0), agree[best]


NOTE = "Ranges: {:,} used, {:,} rejected. They are {:.3f} +- {:.3f} x the distances from odometry."
OTHER_SCALE = " Check the size of the tags, or the wheels: one of the two has another scale."
NOISY_RANGES = (
    " Give their noise, as a share of a range: `range_sigma` under `sensor:` in drive.yaml."
)
SURVEYED_NOTE = (
    "Bearings came with {:,} ranges, which are not used: landmarks.yaml gives the scale."
)


class RangeInput:
    """Validation of ranges.

    `sigma` is the relative standard deviation of a range without its own; None: 0.05, and 0.05 m.
    If it is infinite, or landmarks or distances are `surveyed`, ranges are not used.
    """

    def __init__(self, sigma: float | None, surveyed: bool) -> None:
        self._sigma, self._surveyed, self._unused = sigma, surveyed, 0

    def usable(
        self,
        names: Mapping[str, float],
        ranges: Mapping[str, float],
        sigmas: Mapping[str, float] | None,
    ) -> tuple[dict[str, tuple[float, float]], int]:
        """Return the valid ranges of landmarks `names`, and the number of those not valid.

        Ranges and standard deviations are in metres, NaN where there is none. Returned are the
        logarithm of each, and the relative standard deviation.
        """
        given = {n: r for n, r in ranges.items() if n in names and not math.isnan(r)}
        if self._sigma == math.inf or self._surveyed:
            self._unused += len(given)
            return {}, 0
        usable = {}
        for name, distance in given.items():
            if 0.0 < distance < math.inf:
                own = (sigmas or {}).get(name, math.nan) / distance
                sigma = own if 0.0 < own < math.inf else self._sigma
                if sigma is None:
                    sigma = RANGE_ERROR + RANGE_ERROR_M / distance
                bounded = min(max(sigma, MIN_RANGE_SIGMA), MAX_RANGE_SIGMA)
                usable[name] = math.log(distance), bounded
        return usable, len(given) - len(usable)

    def notes(self, used: int, rejected: int, scale: float, sigma: float) -> tuple[str, ...]:
        """Return a note for the user if any ranges came, with what to do where they do not fit.

        `scale` is that of ranges over distances from odometry, `sigma` its standard deviation [1].
        """
        if self._unused:
            return (SURVEYED_NOTE.format(self._unused),) if self._surveyed else ()
        if not used + rejected:
            return ()
        note = NOTE.format(used, rejected, scale, sigma)
        if abs(scale - 1.0) > max(INLIER * sigma, CLOSE):
            note += OTHER_SCALE
        return (note + NOISY_RANGES * (rejected > used),)
