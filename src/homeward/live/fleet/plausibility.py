"""Bounds of what a robot can have seen: it has one position at a time, and a limited speed."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from homeward.places.joint_map import JointMap
from homeward.places.place import Place
from homeward.places.views import SECTORS, Views

MAX_SPEED = 3.0
"""Maximum speed of a robot [m/s]."""
SLACK_M = 2.0
"""Distance that a robot may have driven before its first message [m]."""


def plausible_ages(own: JointMap, ages: Mapping[str, float], place: Place) -> dict[str, float]:
    """Return the ages of sightings [s], at least as long as the way from the newest one takes.

    `own` is the map of the robot. A landmark can be seen from as far away as any robot saw it; one
    that nobody saw in place has no bound.
    """
    reach = {n: max(p.seen_from) for n, p in place.persistence.items() if p.seen_from and n in ages}
    names = [n for n in own.names if n in reach]
    if not names:
        return dict(ages)
    newest = min(names, key=lambda n: ages[n])
    positions = dict(zip(own.names, own.positions, strict=True))
    found = dict(ages)
    for name in names:
        apart = float(np.hypot(*(positions[name] - positions[newest])))
        way = apart - reach[name] - reach[newest]
        found[name] = max(ages[name], ages[newest] + way / MAX_SPEED)
    return found


def is_plausible(views: Views, places: JointMap, seconds: float) -> bool:
    """Return whether a robot can have been in all places that its views need, in `seconds`.

    A view of a landmark from a sector, at a distance, gives a position of the camera.
    """
    positions = dict(zip(places.names, places.positions, strict=True))
    cameras, errors = list[np.ndarray](), [0.0]
    middle = (np.arange(SECTORS) + 0.5) * 2.0 * np.pi / SECTORS
    for name, passed in views.passed.items():
        if name not in positions:
            continue
        sectors = np.flatnonzero(np.isfinite(passed))
        way = np.column_stack([np.cos(middle[sectors]), np.sin(middle[sectors])])
        cameras += list(positions[name] + passed[sectors, None] * way)
        errors.append(float(passed[sectors].max(initial=0.0)) * np.pi / SECTORS)
    if not cameras:
        return True
    extent = float(np.ptp(np.array(cameras), axis=0).max())
    return extent <= MAX_SPEED * seconds + 2.0 * max(errors) + SLACK_M
