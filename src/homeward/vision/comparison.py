"""Comparison of two panoramas: relative heading and direction, with covariance."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from homeward.geometry.angles import wrap
from homeward.io.blas_threads import single_threaded_blas
from homeward.vision.cameras.grey import require_like_home
from homeward.vision.cameras.panoramic import Panorama
from homeward.vision.features.detection import Features
from homeward.vision.features.matching import (
    RATIO,
    match,
    moved_groups,
    propagate_matches,
    self_similar,
    thinned,
)
from homeward.vision.features.patch_alignment import Alignment, align_patches, similarity
from homeward.vision.geometry.a_contrario import (
    WITHIN,
    Acceptance,
    assess,
    assess_unrepeated,
    covariance_factor,
    dominant_object,
    explain,
)
from homeward.vision.geometry.epipolar import INLIER, Motion, Pairs, Tilt
from homeward.vision.geometry.ransac import APART, estimate_motion
from homeward.vision.geometry.refinement import Fit, irls, jackknife_covariance, refine

MAX_DIRECTION_SIGMA = np.radians(30.0)
"""The direction is known where its standard deviation is smaller than this [rad]."""
MIN_PARALLAX = 5.0
"""Two images are from different positions if their squared parallax is larger than this, as a
multiple of that from noise: images from the same position have up to 3."""
MATCH_ONLY_WEIGHT = 0.1
"""Weight of the covariance from matches only; that from all measurements has the rest. Measured on
rendered rooms: the first is too large, the second sometimes far too small."""
FINAL_SCALE = 1.0
"""Scale of the robust loss in the last fit, which has many measurements [standard deviations]."""
GUIDED_RATIO = 0.9
"""Lowe's ratio where only a part of the panorama is searched."""


@dataclass(frozen=True)
class Comparison:
    """Relative pose, without the distance, of two panoramas, the first of which is home's.

    Angles refer to the level cameras: azimuths anti-clockwise from the camera's axis.
    """

    acceptance: Acceptance
    pairs: Pairs
    """All matches: directions at home, and of the aligned patches now."""
    home_row: np.ndarray
    """(n,): index of each match's feature at home."""
    now_row: np.ndarray
    """(n,): index of each match's feature now."""
    place: np.ndarray
    """(n, 2): column and row now of home's patches [px]."""
    agrees: np.ndarray
    """(n,) bool: inliers."""
    moved: np.ndarray
    """(n,) bool: outliers that agree with each other, on objects that were moved."""
    motion: Motion | None
    """None if none was found; a guess unless `accepted`."""
    covariance: np.ndarray
    """(2, 2): of (theta, alpha) [rad^2]; infinite where not accepted."""
    tilt_covariance: np.ndarray
    """(2, 2): of the motion's (roll, pitch) [rad^2]; infinite where not accepted."""
    parallax: float
    """See `Fit`; zero if there is no motion."""

    @property
    def accepted(self) -> bool:
        """Whether the motion was accepted."""
        return self.acceptance.accepted

    @property
    def tilt(self) -> Tilt:
        """Tilt of the camera relative to home's; level if no motion was found."""
        return Tilt.of(self.motion or Motion(0.0, 0.0), self.tilt_covariance)

    @property
    def heading(self) -> float:
        """Heading now in the home frame, alpha [rad]; NaN when not accepted."""
        return self.motion.alpha if self.accepted and self.motion else np.nan

    @property
    def heading_sigma(self) -> float:
        """Its standard deviation [rad]."""
        return float(np.sqrt(self.covariance[1, 1]))

    @property
    def direction(self) -> float:
        """Direction now seen from home, theta [rad]; NaN when not accepted."""
        return self.motion.theta if self.accepted and self.motion else np.nan

    @property
    def direction_sigma(self) -> float:
        """Its standard deviation [rad]."""
        return float(np.sqrt(self.covariance[0, 0]))

    @property
    def has_direction(self) -> bool:
        """Whether the direction is estimated, and not only the heading, as near home."""
        return self.shows_parallax and self.home_direction_sigma < MAX_DIRECTION_SIGMA

    @property
    def shows_parallax(self) -> bool:
        """Whether the two positions differ; the direction may still be unknown."""
        return self.accepted and self.parallax > MIN_PARALLAX

    @property
    def home_direction(self) -> float:
        """Direction of home from the camera's axis now [rad]; NaN when not accepted."""
        return float(wrap(self.direction + np.pi - self.heading))

    @property
    def home_direction_sigma(self) -> float:
        """Its standard deviation [rad]."""
        away = np.array([1.0, -1.0])
        return float(np.sqrt(away @ self.covariance @ away)) if self.accepted else math.inf


@single_threaded_blas()
def compare(home: Features, now: Features, camera: Panorama) -> Comparison:
    """Compare the `Features` of two panoramas of one camera, with a second pass if necessary.

    If the first pass is undecided, the second matches each feature only where it can be according
    to the heading of the first, so that fewer others look like it. Raises `InputError` if their
    sizes differ.
    """
    require_like_home(now.shape, home.shape)
    seen = compare_once(home, now, camera)
    answered = seen.accepted and (seen.has_direction or not seen.shows_parallax)
    if answered or seen.motion is None:
        return seen
    again = compare_once(home, now, camera, seen.motion.alpha)
    confirmed = again.accepted and abs(wrap(again.heading - seen.motion.alpha)) < APART
    return again if confirmed and again.home_direction_sigma < seen.home_direction_sigma else seen


def compare_once(
    home: Features, now: Features, camera: Panorama, heading: float | None = None
) -> Comparison:
    """Compare two panoramas in one pass; `heading` [rad] is the heading now, if known."""
    rows, pairs, alignment, quality = _aligned_matches(home, now, camera, heading)
    i, j = rows.T
    fit = estimate_motion(pairs, quality, camera.tilt_sigma)

    def unrepeated(accepted: Acceptance, fit: Fit) -> Acceptance:
        """Test some of the inliers for self-similarity."""
        if not accepted.accepted:
            return accepted
        tested = thinned(np.flatnonzero(fit.inlier), 100)
        recurs = self_similar(home, i[tested], camera)
        return assess_unrepeated(accepted, fit, pairs, tested, recurs, heading)

    acceptance = assess(fit, pairs, heading)
    agrees, moved = np.zeros((2, len(pairs)), bool)
    covariance = np.full((4, 4), np.inf)
    if fit is not None:
        acceptance = unrepeated(acceptance, fit)
        if acceptance.accepted:
            fits = fit.inlier
            (column, row), there = propagate_matches(home, now, i[fits], alignment.rows(fits))
            at_home = np.column_stack(camera.directions(column, row, home.shape))
            propagated = _pairs(at_home, now, there, np.log(there.area) / 2, camera)
            fit, covariance = _refined(fit, pairs, propagated, camera)
            # Propagated matches may have changed the motion, and left fewer inliers.
            fit = replace(fit, inlier=fit.inlier[: len(pairs)])
            acceptance = unrepeated(acceptance.reassessed(fit.inlier, pairs), fit)
            on_object = dominant_object(fit, pairs, heading)
            covariance = covariance_factor(on_object, fit) * covariance
            acceptance = replace(acceptance, reason=explain(acceptance, on_object, pairs))
        agrees = fit.inlier
    if acceptance.accepted:
        moved = moved_groups(home, now, rows, ~agrees)
    else:
        covariance = np.full((4, 4), np.inf)
    return Comparison(
        acceptance=acceptance,
        pairs=pairs,
        home_row=i,
        now_row=j,
        place=alignment.place,
        agrees=agrees,
        moved=moved,
        motion=None if fit is None else fit.motion,
        covariance=covariance[:2, :2],
        tilt_covariance=covariance[2:, 2:],
        parallax=0.0 if fit is None else fit.parallax,
    )


def _aligned_matches(
    home: Features, now: Features, camera: Panorama, heading: float | None
) -> tuple[np.ndarray, Pairs, Alignment, np.ndarray]:
    """Match features: return rows, (n, 2), directions, aligned patches and qualities.

    Features that turned in the image, duplicates at the same two positions, and features whose
    patches do not align are left out.
    """
    possible, ratio = None, RATIO
    if heading is not None:
        possible, ratio = _near(home.angle, now.angle, WITHIN), GUIDED_RATIO
        possible &= _near(home.azimuth, now.azimuth + heading, WITHIN)
    rows, quality = match(home.descriptor, now.descriptor, ratio, possible)
    i, j = rows.T
    upright = np.abs(wrap(now.angle[j] - home.angle[i])) < WITHIN
    places = np.column_stack([home.column[i], home.row[i], now.column[j], now.row[j]])
    order = np.flatnonzero(upright)[np.argsort(quality[upright], kind="stable")]
    _, first = np.unique(places[order].round(), axis=0, return_index=True)
    kept = np.sort(order[first])
    i, j = rows[kept].T
    growth = now.size[j] / home.size[i]
    turn = wrap(now.angle[j] - home.angle[i])
    at_home, at_now = np.hsplit(places[kept], 2)
    begun = similarity(at_now, growth, turn)
    alignment = align_patches(home.pyramid, now.pyramid, at_home, home.size[i], begun)
    directions = np.column_stack([home.azimuth[i], home.elevation[i]])
    pairs = _pairs(directions, now, alignment, np.log(growth), camera)
    found = alignment.found
    return rows[kept][found], pairs[found], alignment.rows(found), quality[kept][found]


def _near(a: np.ndarray, b: np.ndarray, max_angle: float) -> np.ndarray:
    """Return which angles a, (n,), and b, (m,), differ by less than `max_angle` [rad]: (n, m)."""
    one, other = (np.column_stack([np.cos(x), np.sin(x)]).astype(np.float32) for x in (a, b))
    return np.asarray(one @ other.T > math.cos(max_angle))


def _pairs(
    at_home: np.ndarray, now: Features, alignment: Alignment, growth: np.ndarray, camera: Panorama
) -> Pairs:
    """Return directions at home, (n, 2) [rad], paired with those of their patches now."""
    directions, slope = camera.directions_and_slope(alignment.column, alignment.row, now.shape)
    return Pairs.of(
        at_home, directions, slope @ alignment.covariance @ slope.swapaxes(1, 2), growth
    )


def _refined(fit: Fit, pairs: Pairs, propagated: Pairs, camera: Panorama) -> tuple[Fit, np.ndarray]:
    """Fit the motion to matches and propagated ones; return it with its covariance, (4, 4).

    Errors of propagated matches are correlated with those of their origins. So the covariance from
    matches only is blended in, and the parallax is theirs. If matches alone do not determine the
    direction, another motion may be correct, and only the covariance from matches is used.
    """
    match_only = jackknife_covariance(fit, pairs, camera.tilt_sigma)
    everything = pairs + propagated
    coarse = irls(np.vstack([fit.motion, fit.others]), everything, camera.tilt_sigma, INLIER)
    found = refine(coarse, everything, camera.tilt_sigma, FINAL_SCALE)
    together = jackknife_covariance(found, everything, camera.tilt_sigma)
    is_determined = math.sqrt(match_only[0, 0]) < MAX_DIRECTION_SIGMA
    share = MATCH_ONLY_WEIGHT if is_determined else 1.0
    covariance = share * match_only + (1.0 - share) * together
    return replace(found, parallax=fit.parallax), covariance[:4, :4]
