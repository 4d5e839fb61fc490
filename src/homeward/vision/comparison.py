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
from homeward.vision.features.match_propagation import propagate_matches, thinned
from homeward.vision.features.matching import RATIO, match
from homeward.vision.features.moved_groups import moved_groups
from homeward.vision.features.patch_alignment import Alignment, align_patches, similarity
from homeward.vision.features.self_similarity import self_similar
from homeward.vision.geometry.a_contrario import (
    WITHIN,
    Acceptance,
    assess,
    assess_unrepeated,
    covariance_factor,
    dominant_object,
    explain,
)
from homeward.vision.geometry.epipolar import INLIER, Motion, Pairs
from homeward.vision.geometry.jackknife import jackknife_covariance
from homeward.vision.geometry.ransac import APART, estimate_motion
from homeward.vision.geometry.refinement import Fit, irls, refine
from homeward.vision.geometry.tilt import Tilt

MAX_DIRECTION_SIGMA = np.radians(30.0)
"""The direction is known where its standard deviation is smaller than this [rad]."""
MIN_PARALLAX = 5.0
"""Two places differ where the squared parallax is larger than this, in multiples of what noise
gives: two images from one place have up to 3."""
ALONE = 0.1
"""Weight of the covariance of matches alone, beside that of all measurements. Measured on rendered
rooms: the first is too large, the second at times far too small."""
SHARP = 1.0
"""Scale of the robust loss in the last fit, to many measurements [standard deviations]."""
FORGIVING_RATIO = 0.9
"""Lowe's ratio where only a part of the panorama is searched."""


@dataclass(frozen=True)
class Comparison:
    """Relative pose of two panoramas but for the distance, the first being home's.

    Angles are those of the level cameras: azimuths anti-clockwise from the camera's axis.
    """

    acceptance: Acceptance
    pairs: Pairs
    """All matches: directions at home, and of their patches now."""
    home_row: np.ndarray
    """(n,): the feature of the home view of each match."""
    now_row: np.ndarray
    """(n,): and that of the view now."""
    place: np.ndarray
    """(n, 2): column and row of home's patches now [px]."""
    agrees: np.ndarray
    """(n,) bool: inliers."""
    moved: np.ndarray
    """(n,) bool: outliers that agree with each other, on objects that were moved."""
    motion: Motion | None
    """None where none was found; a guess unless `accepted`."""
    covariance: np.ndarray
    """(2, 2): of (theta, alpha) [rad^2]; infinite where not accepted."""
    tilt_covariance: np.ndarray
    """(2, 2): of the motion's (roll, pitch) [rad^2]; infinite where not accepted."""
    parallax: float
    """See `Fit`; zero where there is none."""

    @property
    def accepted(self) -> bool:
        """Whether the motion was accepted."""
        return self.acceptance.accepted

    @property
    def tilt(self) -> Tilt:
        """Tilt of the camera against home's; none where no motion was found."""
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
    def knows_direction(self) -> bool:
        """Whether the direction is known, and not only the heading, as near home."""
        return self.shows_parallax and self.home_direction_sigma < MAX_DIRECTION_SIGMA

    @property
    def shows_parallax(self) -> bool:
        """Whether the two places differ; in which direction may be unknown all the same."""
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
    """Compare two views; in a second pass, where the first leaves the answer open.

    The second pass matches each feature only where it can lie by the heading of the first, so that
    fewer others look like it.

    Parameters
    ----------
    home, now : Features
        From `extract`.
    camera : Panorama
        That took both.

    Raises
    ------
    InputError
        When they are not of one size.
    """
    require_like_home(now.shape, home.shape)
    seen = compare_once(home, now, camera)
    answered = seen.accepted and (seen.knows_direction or not seen.shows_parallax)
    if answered or seen.motion is None:
        return seen
    again = compare_once(home, now, camera, seen.motion.alpha)
    confirmed = again.accepted and abs(wrap(again.heading - seen.motion.alpha)) < APART
    return again if confirmed and again.home_direction_sigma < seen.home_direction_sigma else seen


def compare_once(
    home: Features, now: Features, camera: Panorama, heading: float | None = None
) -> Comparison:
    """Compare two views in one pass; `heading` [rad] is that of now, where one is given."""
    rows, pairs, alignment, quality = _aligned_matches(home, now, camera, heading)
    i, j = rows.T
    fit = estimate_motion(pairs, quality, camera.tilt_sigma)
    acceptance = _test_self_similarity(
        assess(fit, pairs, heading), fit, pairs, home, i, camera, heading
    )
    agrees, moved = np.zeros((2, len(pairs)), bool)
    covariance = np.full((4, 4), np.inf)
    if fit is not None:
        if acceptance.accepted:
            fits = fit.inlier
            (column, row), there = propagate_matches(home, now, i[fits], alignment.rows(fits))
            at_home = np.column_stack(camera.directions(column, row, home.shape))
            propagated = _pairs(at_home, now, there, np.log(there.area) / 2, camera)
            fit, covariance = _refined(fit, pairs, propagated, camera)
            # Propagated matches may have led to another motion, with fewer inliers.
            fit = replace(fit, inlier=fit.inlier[: len(pairs)])
            acceptance = acceptance.reassessed(fit.inlier, pairs)
            acceptance = _test_self_similarity(acceptance, fit, pairs, home, i, camera, heading)
            thing = dominant_object(fit, pairs, heading)
            covariance = covariance_factor(thing, fit) * covariance
            acceptance = replace(acceptance, reason=explain(acceptance, thing, pairs))
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


def _test_self_similarity(
    acceptance: Acceptance,
    fit: Fit | None,
    pairs: Pairs,
    home: Features,
    rows: np.ndarray,
    camera: Panorama,
    heading: float | None,
) -> Acceptance:
    """Return the acceptance of a fit after some of its inliers were tested for self-similarity.

    `rows`, (n,), are the features of home that were matched.
    """
    if fit is None or not acceptance.accepted:
        return acceptance
    asked = thinned(np.flatnonzero(fit.inlier), 100)  # they are a sample of all
    recurs = self_similar(home, rows[asked], camera)
    return assess_unrepeated(acceptance, fit, pairs, asked, recurs, heading)


def _aligned_matches(
    home: Features, now: Features, camera: Panorama, heading: float | None
) -> tuple[np.ndarray, Pairs, Alignment, np.ndarray]:
    """Match features: return rows, (n, 2), directions, aligned patches and qualities.

    Left out are features that turned in the image, further ones at the same two places, and those
    whose patches do not align.
    """
    possible, ratio = None, RATIO
    if heading is not None:
        possible, ratio = _near(home.angle, now.angle, WITHIN), FORGIVING_RATIO
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


def _near(a: np.ndarray, b: np.ndarray, most: float) -> np.ndarray:
    """Return which angles a, (n,), and b, (m,), differ by less: (n, m) bool [rad]."""
    one, other = (np.column_stack([np.cos(x), np.sin(x)]).astype(np.float32) for x in (a, b))
    return np.asarray(one @ other.T > math.cos(most))


def _pairs(
    at_home: np.ndarray, now: Features, alignment: Alignment, growth: np.ndarray, camera: Panorama
) -> Pairs:
    """Return directions at home, (n, 2) [rad], with those of where their patches lie now."""
    directions, slope = camera.directions_and_slope(alignment.column, alignment.row, now.shape)
    return Pairs.of(at_home, directions, slope @ alignment.spread @ slope.swapaxes(1, 2), growth)


def _refined(fit: Fit, pairs: Pairs, propagated: Pairs, camera: Panorama) -> tuple[Fit, np.ndarray]:
    """Fit the motion to matches and propagated ones; return it with its covariance, (4, 4).

    Propagated matches err with those they came from: so the covariance of matches alone is blended
    in, and the parallax is theirs. Where matches alone do not know the direction, another motion
    may be right, of which the propagated ones know nothing: then the covariance is that of matches.
    """
    match_only_covariance, everything = (
        jackknife_covariance(fit, pairs, camera.tilt_sigma),
        pairs + propagated,
    )
    forgiving = irls(np.vstack([fit.motion, fit.others]), everything, camera.tilt_sigma, INLIER)
    found = refine(forgiving, everything, camera.tilt_sigma, SHARP)
    together = jackknife_covariance(found, everything, camera.tilt_sigma)
    share = ALONE if math.sqrt(match_only_covariance[0, 0]) < MAX_DIRECTION_SIGMA else 1.0
    covariance = share * match_only_covariance + (1.0 - share) * together
    return replace(found, parallax=fit.parallax), covariance[:4, :4]
