"""Check of camera settings with two panoramas, for a mirrored image or a wrong horizon.

Other settings are tried, and reported if they fit far more of the same matches.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.stats import binom

from homeward.vision.cameras.panoramic import Panorama
from homeward.vision.cameras.ring import Ring
from homeward.vision.comparison import Comparison, compare
from homeward.vision.features.detection import Features, extract
from homeward.vision.geometry.a_contrario import (
    MAX_LOG_FALSE_ALARMS,
    random_fit_probability,
)

HORIZONS = np.linspace(0.1, 0.9, 9)
"""Horizons to try, as shares of the height."""
MIN_OFF = 0.15
"""Horizons that differ from the given one by less than this share of the height are not tried."""
MIN_SIGMAS = 2.0
"""Matches gained minus matches lost, in standard deviations of a difference by chance."""
MIN_PARALLAX = 80.0
"""Squared parallax over that of noise. A horizon error of 0.3 rad shifts a ray off its epipolar
plane by about 0.3 of the parallax: by 3 standard deviations for a parallax of 9."""


def better_settings(
    seen: Comparison,
    pictures: tuple[np.ndarray, np.ndarray],
    views: tuple[Features, Features],
    camera: Panorama,
) -> str | None:
    """Return a message about another setting that fits two panoramas far better, or None.

    `seen` is the comparison of the panoramas (home's first, as `Panorama.panorama` returns them)
    with the camera as specified.
    """
    if not seen.accepted:
        flipped = extract(np.ascontiguousarray(pictures[1][:, ::-1]), camera)
        if compare(views[0], flipped, camera).accepted:
            return "the pictures agree only if one of them is mirrored: mirror that one"
    if isinstance(camera, Ring):
        return None
    fits, best, most = _matches(seen), None, 0
    for horizon in HORIZONS[np.abs(HORIZONS - camera.horizon) > MIN_OFF].tolist():
        other = camera.model_copy(update={"horizon": horizon})
        home, now = (extract(p, other, v.mask) for p, v in zip(pictures, views, strict=True))
        found = compare(home, now, other)
        gain = _gain(fits, found)
        if gain > most:
            best, most = horizon, gain
    if best is None:
        return None
    return (
        f"the pictures agree far better with the horizon at {best:.1f} of the height than at "
        f"{camera.horizon:g} ({most} more matches fit): set it in images.yaml (camera: horizon)"
    )


def _matches(seen: Comparison) -> dict[tuple[int, int], bool]:
    """Return whether each match, keyed by its rows at home and now, is an inlier."""
    rows = zip(seen.home_row.tolist(), seen.now_row.tolist(), strict=True)
    return dict(zip(rows, seen.agrees.tolist(), strict=True))


def _gain(fits: dict[tuple[int, int], bool], found: Comparison) -> int:
    """Return how many more of the same matches another horizon fits; 0 if that may be chance.

    With the correct horizon, outliers are wrong matches, which fit the motion of another horizon
    only at random. The numbers of false alarms of whole comparisons are not compared: near home
    every horizon fits, and they differ by chance.
    """
    if not found.accepted or found.motion is None or found.parallax < MIN_PARALLAX:
        return 0
    both = [(fits[match], fit) for match, fit in _matches(found).items() if match in fits]
    unfit = sum(not before for before, _ in both)
    gained = sum(fit and not before for before, fit in both)
    lost = sum(before and not fit for before, fit in both)
    # A moved object may fit another horizon by chance, but then as many static matches do not.
    if gained - lost <= MIN_SIGMAS * math.sqrt(gained + lost):
        return 0
    chance = random_fit_probability(found.motion, found.pairs)
    tests = math.log10(HORIZONS.size)
    log_chance = binom.logsf(gained - 1, unfit, chance) / math.log(10.0)
    return gained - lost if log_chance < MAX_LOG_FALSE_ALARMS - tests else 0
