"""Check of camera settings by two panoramas: whether one is mirrored, or the horizon elsewhere.

Each other setting is tried, and told where its number of false alarms is far smaller.
"""

from __future__ import annotations

import math

import numpy as np

from homeward.vision.cameras.panoramic import Panorama
from homeward.vision.cameras.ring import Ring
from homeward.vision.comparison import Comparison, compare
from homeward.vision.features.detection import View, look
from homeward.vision.geometry.a_contrario import LARGEST_LOG_FALSE_ALARMS

HORIZONS = np.linspace(0.1, 0.9, 9)
"""Shares of the height at which the horizon is tried."""
LEAST_OFF = 0.15
"""Horizons that differ from the given one by less than this share of the height are not tried."""


def better_settings(
    seen: Comparison,
    pictures: tuple[np.ndarray, np.ndarray],
    views: tuple[View, View],
    camera: Panorama,
) -> str | None:
    """Return in words which other setting suits two panoramas far better.

    Parameters
    ----------
    seen : Comparison
        What came out.
    pictures : tuple of ndarray
        The panoramas at home and now, as `Panorama.panorama` gives them.
    views : tuple of View
        What `look` made of them.
    camera : Panorama
        As it was told.

    Returns
    -------
    str or None
        None where none does.
    """
    if not seen.accepted:
        flipped = look(np.ascontiguousarray(pictures[1][:, ::-1]), camera, finder=views[0].finder)
        if compare(views[0], flipped, camera).accepted:
            return "the pictures agree only if one of them is mirrored: mirror it back"
    if isinstance(camera, Ring):
        return None
    told = seen.acceptance.log_false_alarms if seen.motion else 0.0
    best, most = None, told + LARGEST_LOG_FALSE_ALARMS - math.log10(HORIZONS.size)
    for horizon in HORIZONS[np.abs(HORIZONS - camera.horizon) > LEAST_OFF].tolist():
        other = camera.model_copy(update={"horizon": horizon})
        home, now = (look(p, other, v.mask, v.finder) for p, v in zip(pictures, views, strict=True))
        found = compare(home, now, other)
        if found.accepted and found.acceptance.log_false_alarms < most:
            best, most = horizon, found.acceptance.log_false_alarms
    if best is None:
        return None
    return (
        f"the pictures agree far better with the horizon at {best:.1f} of the height than at "
        f"{camera.horizon:g}: set it in images.yaml (camera: horizon)"
    )
