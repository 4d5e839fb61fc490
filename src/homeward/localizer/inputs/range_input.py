"""Ranges that come with bearings: validation, and the note for the user."""

from __future__ import annotations

import math
from collections.abc import Mapping

from homeward.localizer.tunables import MAX_RANGE_SIGMA, MIN_RANGE_SIGMA

NOTE = "Ranges: {:,} used, {:,} rejected. They are {:.3f} +- {:.3f} x the distances from odometry."
UNUSED_NOTE = (
    "Bearings came with {:,} ranges, which are not used. To use them, add `range_sigma: 0.1` (10 %)"
    " under `sensor:` in drive.yaml."
)
SURVEYED_NOTE = (
    "Bearings came with {:,} ranges, which are not used: landmarks.yaml gives the scale."
)


class RangeInput:
    """Validation of ranges.

    `sigma` is the relative standard deviation of a range without its own. With None, or if
    landmarks or distances are `surveyed`, ranges are not used.
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
        if self._sigma is None or self._surveyed:
            self._unused += len(given)
            return {}, 0
        usable = {}
        for name, distance in given.items():
            if 0.0 < distance < math.inf:
                own = (sigmas or {}).get(name, math.nan) / distance
                sigma = own if 0.0 < own < math.inf else self._sigma
                bounded = min(max(sigma, MIN_RANGE_SIGMA), MAX_RANGE_SIGMA)
                usable[name] = math.log(distance), bounded
        return usable, len(given) - len(usable)

    def notes(self, used: int, rejected: int, scale: float, sigma: float) -> tuple[str, ...]:
        """Return a note for the user if any ranges came.

        `scale` is that of ranges over distances from odometry, `sigma` its standard deviation [1].
        """
        if self._unused:
            note = SURVEYED_NOTE if self._surveyed else UNUSED_NOTE
            return (note.format(self._unused),)
        return (NOTE.format(used, rejected, scale, sigma),) if used + rejected else ()
