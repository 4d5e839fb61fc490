"""A-contrario acceptance: whether matches that agree on a motion may agree by chance.

The number of false alarms (Moisan and Stival, "A probabilistic criterion to detect rigid point
matches between two images", IJCV 2004) is the expected number of agreements as good among random
matches. Their distribution is learnt from the pair of images itself: each direction at home is
paired with the directions now of other matches.

Errors of matches on one object are correlated: if it was moved, or moves with the robot, they agree
on a motion. So a motion that depends on one object is reported with a larger covariance.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from homeward.geometry.angles import wrap
from homeward.vision.cameras.panoramic import SECTORS, WINDOW, sector_of
from homeward.vision.geometry.epipolar import INLIER, Motion, Pairs, residuals
from homeward.vision.geometry.refinement import Fit, squares

OBJECT_RADIUS = WINDOW * math.pi / SECTORS
"""Angular radius of a large object [rad]."""
MAX_LOG_FALSE_ALARMS = -4.0
"""Maximum accepted number of false alarms (logarithm to base 10)."""
MAX_PER_SECTOR = 4
"""Maximum number of matches that count in one sector: errors on one object are correlated."""
MIN_SECTORS = 4
"""Minimum number of sectors with inliers."""
STEEP = math.radians(25.0)
"""Inliers steeper than this, up or down, may be on another room's ceiling or on other floor tiles
[rad]."""
MIN_LEVEL_SECTORS = 3
"""Minimum number of sectors with inliers that are not steep."""
MIN_LEVEL_SHARE = 0.25
"""Minimum share of inliers that are not steep: floor tiles look the same a few tiles away."""
WITHIN = 0.6
"""Maximum rotation of a feature in the image, since cameras are nearly upright; and, if the heading
is given, maximum distance of a feature from the direction predicted by it [rad]."""


@dataclass(frozen=True)
class Acceptance:
    """Whether a motion is accepted, and why."""

    accepted: bool
    reason: str
    """For the user."""
    log_false_alarms: float
    """Logarithm to base 10."""

    def reassessed(self, agrees: np.ndarray, pairs: Pairs) -> Acceptance:
        """Return the acceptance if other matches, (n,) bool, are the inliers."""
        words = _agreement(agrees, pairs)
        home, now = pairs.home[agrees], pairs.now[agrees]
        if lack := too_narrow(home[:, 0], now[:, 0], elevation=home[:, 1]):
            return replace(self, accepted=False, reason=f"not enough in common: {words}{lack}")
        return replace(self, reason=words)


def assess(fit: Fit | None, pairs: Pairs, heading: float | None = None) -> Acceptance:
    """Accept or refuse a fit, from its number of false alarms and the spread of its inliers.

    No fit: no motion was found. The heading now [rad] is given if matches were searched `WITHIN`
    their predicted directions.
    """
    if fit is None or fit.inlier.sum() < 3:
        return Acceptance(
            False, f"not enough in common: {len(pairs)} matches, no common motion", 0.0
        )
    alarms = _log_false_alarms(fit, pairs, heading)
    if alarms > MAX_LOG_FALSE_ALARMS:
        words = _agreement(fit.inlier, pairs)
        return Acceptance(False, f"not enough in common: {words}, possibly by chance", alarms)
    return Acceptance(True, "", alarms).reassessed(fit.inlier, pairs)


def assess_unrepeated(
    acceptance: Acceptance,
    fit: Fit,
    pairs: Pairs,
    tested: np.ndarray,
    recurs: np.ndarray,
    heading: float | None = None,
) -> Acceptance:
    """Accept or refuse a fit whose inliers were tested for self-similarity.

    The tiles of a floor match those of another room. So if most inliers are self-similar, the
    others must be accepted on their own. `acceptance` is without this test, `tested` (k,) are rows
    of inliers, and `recurs` (k,) bool is whether these are self-similar in home's picture.
    """
    unique = np.zeros(len(pairs), bool)
    unique[tested[~recurs]] = True
    if 2 * unique.sum() >= len(tested):
        return acceptance
    if assess(replace(fit, inlier=unique), pairs, heading).accepted:
        return acceptance
    words = f"{_agreement(fit.inlier, pairs)}, most of them on repeating patterns"
    return replace(acceptance, accepted=False, reason=f"not enough in common: {words}")


def too_narrow(*azimuths: np.ndarray, elevation: np.ndarray) -> str:
    """Return why directions of inliers, (n,), are spread too narrowly; empty if they are not.

    `azimuths` are those in one panorama or more, `elevation` is of the same matches [rad].
    """
    sectors = [sector_of(azimuth) for azimuth in azimuths]
    level = np.abs(elevation) < STEEP
    if _occupied(sectors) < MIN_SECTORS:
        return " only"
    if _occupied([s[level] for s in sectors]) < MIN_LEVEL_SECTORS or level.mean() < MIN_LEVEL_SHARE:
        return ", most of them overhead or on the floor"
    return ""


def _agreement(good: np.ndarray, pairs: Pairs) -> str:
    """Return a message about the number of matches that agree: `good` (n,), bool."""
    sectors = [sector_of(side[good, 0]) for side in (pairs.home, pairs.now)]
    return f"{int(good.sum())} of {len(good)} matches agree, in {_occupied(sectors)} directions"


def _occupied(sectors: list[np.ndarray]) -> int:
    """Return the number of sectors that are not empty, in each panorama."""
    return min(np.unique(s).size for s in sectors)


def _log_false_alarms(fit: Fit, pairs: Pairs, heading: float | None) -> float:
    """Return the logarithm (base 10) of the number of false alarms."""
    sectors = [sector_of(side[:, 0]) for side in (pairs.home, pairs.now)]
    n = min(_capped(s) for s in sectors)
    k = min(_capped(s[fit.inlier]) for s in sectors)
    if k <= 2:
        return 0.0
    chance = random_fit_probability(fit.motion, pairs, heading)
    choices = math.lgamma(n + 1) - math.lgamma(k + 1) - math.lgamma(n - k + 1)
    models = math.log(max(n - 2, 1)) + math.log(k * (k - 1) / 2)
    if heading is not None:
        models += math.log(math.pi / WITHIN)  # the number of possible headings
    return (models + choices + (k - 2) * math.log(chance)) / math.log(10)


def random_fit_probability(motion: Motion, pairs: Pairs, heading: float | None = None) -> float:
    """Return the probability that a random match fits a motion; parameters as in `assess`."""
    n, searched = len(pairs), math.pi if heading is None else WITHIN
    shifts = np.unique(np.linspace(1, n - 1, round(8 * math.pi / searched)).astype(int))
    order = np.argsort(pairs.now[:, 0], kind="stable")
    other = np.empty((shifts.size, n), int)
    for row, shift in zip(other, shifts, strict=True):
        row[order] = np.roll(order, shift)
    shuffled = pairs.mixed(np.tile(np.arange(n), shifts.size), other.ravel())
    if heading is not None:
        turned = wrap(shuffled.home[:, 0] - shuffled.now[:, 0] - heading)
        shuffled = shuffled[np.abs(turned) < WITHIN]
    found = residuals(np.array([motion]), shuffled)
    fits = int((squares(found) <= INLIER**2).sum())
    return (fits + 1) / (len(shuffled) + 2)


def _capped(sectors: np.ndarray) -> int:
    return int(np.minimum(np.bincount(sectors, minlength=SECTORS), MAX_PER_SECTOR).sum())


def dominant_object(fit: Fit, pairs: Pairs, heading: float | None = None) -> np.ndarray:
    """Return which inliers, (n,) bool, are on one object that the motion depends on.

    None of them if no object has most of them, or the others are accepted on their own. Parameters
    are those of `assess`.
    """
    rows = np.flatnonzero(fit.inlier)
    on_object = np.zeros(len(pairs), bool)
    if not rows.size:
        return on_object
    near = pairs.home_vectors[rows] @ pairs.home_vectors[rows].T > math.cos(OBJECT_RADIUS)
    on_object[rows[near[near.sum(axis=1).argmax()]]] = True
    if 2 * on_object.sum() <= rows.size:
        return np.zeros(len(pairs), bool)
    others = Fit(fit.motion, fit.inlier & ~on_object, fit.information, fit.parallax, fit.scale)
    return np.zeros(len(pairs), bool) if assess(others, pairs, heading).accepted else on_object


def covariance_factor(on_object: np.ndarray, fit: Fit) -> float:
    """Return the factor of the covariance if all inliers on one object, (n,), count once."""
    agree, on_it = int(fit.inlier.sum()), int(on_object.sum())
    return agree / (agree - on_it + 1) if on_it else 1.0


def explain(acceptance: Acceptance, on_object: np.ndarray, pairs: Pairs) -> str:
    """Return the reason of an acceptance, with the direction of an object it depends on."""
    if not on_object.any():
        return acceptance.reason
    x, y, z = pairs.home_vectors[on_object].mean(axis=0)
    up = math.degrees(math.atan2(z, math.hypot(x, y)))
    where = "overhead" if up > 45.0 else f"{math.degrees(math.atan2(y, x)):.0f} deg from its axis"
    return (
        f"{acceptance.reason}; {int(on_object.sum())} of them lie on one object ({where} at home): "
        "if it was moved, or moves with the robot, this result is wrong"
    )
