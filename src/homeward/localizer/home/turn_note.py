"""Note for robots that saw home with a narrow camera: what a turn at home would gain."""

from __future__ import annotations

import math

import numpy as np

from homeward.geometry.se2 import compose, sight
from homeward.localizer.home.estimate import HomeFit
from homeward.localizer.map.all_landmarks import AllLandmarks
from homeward.localizer.motions import HEAD
from homeward.localizer.tunables import MAX_NARROW, NOTABLE_HEADING, NOTABLE_RATIO

NOTE = (
    "The home bearings span only {:.0f} deg: home has standard deviations of {:.2g} m and {:.2g}"
    " deg. If the robot turns on the spot at home and sees the {} other landmarks from there, they"
    " become about {:.2g} m and {:.2g} deg (--home spin:FROM,TO)."
)


def span(bearings: np.ndarray) -> float:
    """Return the smallest angle that contains some bearings (q,) [rad]."""
    around = np.sort(np.mod(bearings, math.tau))
    return float(math.tau - np.diff(around, append=around[0] + math.tau).max())


def turn_notes(fit: HomeFit, others: np.ndarray, known: AllLandmarks) -> tuple[str, ...]:
    """Return a note if bearings of other mapped landmarks would halve a notable error of home.

    `others` (k,) are their ids. Their errors are assumed to be independent of those of home, and
    their home bearings as noisy as the others.
    """
    problem = fit.problem
    if not (others.size and problem.bearings.size and problem.offsets is None):
        return ()
    angle = span(problem.bearings)
    if angle > MAX_NARROW:
        return ()
    landmarks = known.joint(others)
    at = HEAD + np.arange(2 * others.size).reshape(-1, 2)
    spread = landmarks.covariance[at[:, :, None], at[:, None]]
    by_place = sight(compose(fit.home, problem.mount), landmarks.positions).by_place
    variance = np.einsum("ki,kij,kj->k", by_place, spread, by_place)
    variance += float(np.median(problem.sigmas)) ** 2
    by_home = np.column_stack([-by_place, -np.ones(others.size)])
    gained = (by_home / variance[:, None]).T @ by_home
    now = _deviations(fit.covariance)
    turned = _deviations(np.linalg.inv(np.linalg.inv(fit.covariance) + gained))
    if now[1] < max(math.degrees(NOTABLE_HEADING), NOTABLE_RATIO * turned[1]):
        return ()
    return (NOTE.format(math.degrees(angle), *now, others.size, *turned),)


def _deviations(covariance: np.ndarray) -> tuple[float, float]:
    """Return the standard deviations of position [m] and heading [deg] of a covariance (3, 3)."""
    return math.sqrt(np.trace(covariance[:2, :2])), math.degrees(math.sqrt(covariance[2, 2]))
