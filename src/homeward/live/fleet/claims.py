"""Claims of a visit: where it differs from a place; and bounds of the sightings of a robot.

A robot has one position at a time, and a limited speed.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from homeward.geometry.angles import wrap
from homeward.geometry.frames import position_sigma
from homeward.live.fleet.changes import part, placed, spread
from homeward.live.fleet.messages import Placed, VisitMessage
from homeward.localizer.tunables import INLIER, MIN_SIGHTINGS
from homeward.places.joint_map import JointMap, datum
from homeward.places.place import Place
from homeward.places.views import SECTORS, Views
from homeward.places.visit_data import VisitData
from homeward.places.visiting import MIN_STAYED_SHARE, kept_apart, merged

MIN_GROUP = 3
"""Minimum number of landmarks of a group that moves rigidly."""
SAME_M = 0.02
"""Positions this close agree, however certain they are [m]."""
MAX_CHANCE = 0.05
"""Maximum probability that sightings in any direction agree with a position: close to an uncertain
one, all of them do."""
MAX_APART_M = 0.3
"""Positions farther apart are different claims, however uncertain they are [m]."""
MAX_SPEED = 3.0
"""Maximum speed of a robot [m/s]."""
SLACK_M = 2.0
"""Distance that a robot may have driven before its first message [m]."""


@dataclass(frozen=True)
class Claim:
    """Difference of a landmark between a visit and the place."""

    what: str
    """new, moved, gone or returned."""
    at: Placed | None
    """Its position in the frame of the place, if it is certain."""
    since: float
    """When the visit first found this [s]."""
    is_grouped: bool = False
    """Whether it moved rigidly with others: one wrong map explains that, too."""


def claims_of(place: Place, data: VisitData, now: float) -> dict[str, Claim] | None:
    """Return the claims of a visit by landmark; None if it contradicts the place."""
    viewed = data.frames.passed if isinstance(data.frames, Views) else {}
    local = part(place, {*data.map.names, *viewed})
    after = with_visit(local, replace(data, homes={}, routes={}))
    if after.visits[-1].verdict == "apart":
        return None
    events = (e for e in after.events if e.visit >= local.next_visit)
    what = {e.landmark: "gone" if e.what == "forgotten" else e.what for e in events}
    stayed = [n for n in local.map.names if n in after.persistence and n not in what]
    mapped = [n for n in what if n in data.map.names and n in after.persistence]
    pose = datum(local.map.marginal(stayed, ()), after.map.marginal(stayed, ()), stayed)
    there = after.map.marginal(mapped, ()).in_frame_of(pose, np.zeros((3, 3)))
    found = placed(there)
    at = {n: p for n, p in found.items() if what[n] == "new" or _is_certain(p)}
    was = placed(local.map.marginal([n for n in mapped if what[n] == "moved"], ()))
    grouped = _moved_rigidly(was, found, place.together)  # not by its own groups
    return {
        n: Claim(w, at.get(n) if w != "gone" else None, now, n in grouped) for n, w in what.items()
    }


def _moved_rigidly(
    was: Mapping[str, Placed], now: Mapping[str, Placed], together: Sequence[Sequence[str]]
) -> set[str]:
    """Return landmarks that moved rigidly with two others which are not known to move with them.

    The distances of such landmarks are the same before and after.
    """
    names = list(was)
    if len(names) < MIN_GROUP:
        return set()
    before, after = (np.array([some[n][:2] for n in names]) for some in (was, now))
    sigmas = np.array([position_sigma(spread(was[n]) + spread(now[n])) for n in names])
    distances = [np.hypot(*(p[:, None] - p[None]).transpose(2, 0, 1)) for p in (before, after)]
    limit = SAME_M + INLIER * np.hypot(sigmas[:, None], sigmas[None])
    same = np.abs(distances[1] - distances[0]) < limit
    body = {n: k for k, group in enumerate(together) for n in group}
    bodies = np.array([body.get(n, -1 - k) for k, n in enumerate(names)])
    same &= bodies[:, None] != bodies[None]
    triangles = np.einsum("ij,jk,ki->i", *3 * [same.astype(float)], optimize=True)
    return {n for n, number in zip(names, triangles.tolist(), strict=True) if number > 0}


def supports(one: Claim, other: Claim) -> bool:
    """Return whether a claim supports another one: one without a position supports any move."""
    if one.at is None or other.at is None:
        return one.what == other.what or {one.what, other.what} == {"gone", "moved"}
    is_near = math.dist(one.at[:2], other.at[:2]) < MAX_APART_M
    return one.what == other.what and is_near and _agree(one.at, other.at)


def is_doubt_of(message: VisitMessage, name: str, at: Placed | None, was: np.ndarray) -> bool:
    """Return whether sightings that do not fit the place `was` (2,) of a landmark support a claim.

    Most of them must agree with its position, if it has one, and be nearer to it than to the place,
    which outliers do by chance with a probability of at most `MAX_CHANCE`.
    """
    rays = message.rays.get(name, ())
    if at is None or not rays:
        return name in message.doubted or len(rays) == MIN_SIGHTINGS
    cameras, directions, sigmas = np.split(np.array(rays), [2, 3], axis=1)
    ways = np.array([at[:2], was])[:, None] - cameras
    off, off_place = np.abs(wrap(np.arctan2(*ways.T[::-1]).T - directions.T))
    dx, dy = ways[0].T
    across = np.column_stack([-dy, dx]) / np.maximum(dx**2 + dy**2, SAME_M**2)[:, None]
    spreads = np.hypot(sigmas.T[0], np.sqrt(np.einsum("ki,ij,kj->k", across, spread(at), across)))
    agree = off <= np.minimum(INLIER * spreads, off_place)
    chance = np.prod(INLIER * spreads[agree] / np.pi)
    return bool(2 * np.count_nonzero(agree) > len(rays) and chance <= MAX_CHANCE)


def _is_certain(at: Placed) -> bool:
    """Return whether a position distinguishes claims."""
    return float(position_sigma(spread(at))) <= MAX_APART_M


def _agree(one: Placed, other: Placed) -> bool:
    """Return whether two positions agree."""
    limit = INLIER * float(position_sigma(spread(one) + spread(other)))
    return math.dist(one[:2], other[:2]) <= max(limit, SAME_M)


def without(data: VisitData, names: Collection[str]) -> VisitData:
    """Return a visit without all that it found about some landmarks."""
    kept = data.map.marginal([n for n in data.map.names if n not in names])
    if isinstance(data.frames, Views):
        passed, seen = (
            {n: at for n, at in views.items() if n not in names}
            for views in (data.frames.passed, data.frames.seen)
        )
        data = replace(data, frames=Views(passed, seen))
    return replace(data, map=kept)


def with_visit(place: Place, data: VisitData) -> Place:
    """Return a place with a visit, without its homes and routes whose names are taken.

    A visit that distorts the place is kept apart: it moves most of the landmarks that stayed by
    more than their standard deviation explains. A robot's own map may be distorted for a moment.
    """
    homes = {n: home for n, home in data.homes.items() if n not in place.homes}
    routes = {n: route for n, route in data.routes.items() if n not in place.routes}
    after = merged(place, replace(data, homes=homes, routes=routes))
    changed = {e.landmark for e in after.events if e.visit >= place.next_visit}
    was, now = placed(place.map), placed(after.map)
    agree = [_agree(was[n], now[n]) for n in was.keys() & now.keys() - changed]
    return after if sum(agree) >= MIN_STAYED_SHARE * len(agree) else kept_apart(place, data)


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
