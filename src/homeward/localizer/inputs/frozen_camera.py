"""Frozen-camera detector: bearings that repeat to the last bit while odometry moves.

A camera driver may go on sending its last frame with new stamps. A camera that works may repeat a
bearing, too: while the robot is stationary, if bearings are rounded (to whole degrees), straight
ahead, and at the centre of a circle. So a repeated bearing is rejected only if the motion since its
first occurrence would have changed it for any position of the landmark: no rotation within the
error of odometry, common to all repeated bearings, agrees with any distance of each landmark.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

from homeward.localizer.tunables import (
    BEARING_ROUNDING,
    FROZEN_S,
    HEADING_RATE,
    MAX_DISTANCE_M,
    MAX_RESOLUTION,
    MIN_DISTANCE_M,
    REPEAT_MEMORY_S,
    TURN_ERROR,
)
from homeward.odometry.history import STEADY_S, Reckoned


class _First(NamedTuple):
    """First occurrence of a bearing, or the last while the robot was stationary."""

    bearing: float
    t: float
    x: float
    y: float
    heading: float
    seen: float
    """Newest stamp with this bearing [s]."""
    is_frozen: bool = False
    """Whether it has been frozen for `FROZEN_S`: then it stays so, also if the robot stops."""


class FrozenCamera:
    """Frozen-camera detector, by landmark; `yaw` is that of the camera's axis [rad]."""

    def __init__(self, yaw: float = 0.0) -> None:
        self._yaw = yaw
        self._first: dict[str, _First] = {}
        self._resolution = MAX_RESOLUTION
        """Smallest step between two bearings of a landmark [rad]."""
        self.is_frozen = False
        """Whether all bearings of the newest frame have repeated for `FROZEN_S`."""

    def add_bearings(
        self, t: float, sightings: Mapping[str, float], reckoned: Reckoned
    ) -> set[str]:
        """Add a frame of stamp `t` [s]; return the landmarks whose bearings are frozen.

        `reckoned` is dead reckoning at `t`.
        """
        here = t, *reckoned.pose
        repeated = []
        for name, bearing in sightings.items():
            first = self._first.get(name)
            if (
                first is not None
                and first.bearing == bearing
                and (reckoned.moves or (first.is_frozen and reckoned.age <= STEADY_S))
            ):
                self._first[name] = first._replace(seen=t)
                repeated.append(name)
                continue
            if first is not None and (step := abs(first.bearing - bearing)) > BEARING_ROUNDING:
                self._resolution = min(self._resolution, step)
            self._first[name] = _First(bearing, *here, t)
        firsts = [self._first[n] for n in repeated]
        if any(f.is_frozen for f in firsts) or not self._is_possible(firsts, here):
            lasts = t - min(f.t for f in firsts) >= FROZEN_S
            self.is_frozen = lasts and len(repeated) == len(sightings)
            for name, first in zip(repeated, firsts, strict=True):
                self._first[name] = first._replace(is_frozen=lasts)
            return set(repeated)
        self.is_frozen = False
        if len(self._first) > len(sightings):
            self._first = {n: f for n, f in self._first.items() if t - f.seen < REPEAT_MEMORY_S}
        return set()

    def _is_possible(self, repeated: list[_First], here: tuple[float, float, float, float]) -> bool:
        """Return whether a working camera may see all these bearings again from here."""
        # Errors of odometry's rotation that agree with all bearings; pixels are wider in angle at
        # the centre of an image than at its edge.
        low, high, tolerance = -math.inf, math.inf, 2.0 * self._resolution
        t, x, y, heading = here
        for first in repeated:
            turned = heading - first.heading
            error = TURN_ERROR * abs(turned) + HEADING_RATE * math.sqrt(t - first.t)
            sight = first.heading + self._yaw + first.bearing
            ends = [
                math.remainder(
                    math.atan2(
                        distance * math.sin(sight) - (y - first.y),
                        distance * math.cos(sight) - (x - first.x),
                    )
                    - sight,
                    math.tau,
                )
                for distance in (MIN_DISTANCE_M, MAX_DISTANCE_M)
            ]
            low = max(low, min(ends) - tolerance - turned, -error)
            high = min(high, max(ends) + tolerance - turned, error)
        return low <= high
