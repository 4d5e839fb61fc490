"""A place and its visits in words."""

from __future__ import annotations

import math
from datetime import UTC, datetime

from homeward.places.persistence import GONE
from homeward.places.place import DAY_S, Place
from homeward.runs.report.words import count, listing, name, percent


def date(when: float) -> str:
    """Return a day since 1970 as a date."""
    return datetime.fromtimestamp(when * DAY_S, UTC).date().isoformat()


def visit_words(place: Place) -> str:
    """Say what the last visit told of a place."""
    visit = place.visits[-1]
    if visit.verdict == "first":
        return f"{place.name}: a new place, with {count(visit.of, 'landmark')}."
    if visit.verdict == "apart":
        return (
            f"{place.name}: this is not the place, or most of it was rearranged: nothing of this "
            "drive was merged into it."
        )
    parts = [f"{visit.stayed:,} stayed"]
    for what in ("moved", "gone", "returned", "new"):
        mine = (e for e in place.events if e.visit == visit.number and e.what == what)
        names = [name(e.landmark) for e in mine]
        if names:
            parts.append(f"{len(names):,} {what} ({listing(names, 8)})")
    return f"{place.name}: of its landmarks {listing(parts)}; it has {visit.of:,} now."


def route_words(place: Place, route: str) -> str:
    """Say what is known of a route."""
    way = place.route(route)
    points = [name(n.waypoint) for n in way.waypoints]
    by = f" by {count(len(points), 'way point')} ({listing(points, 8)})" if points else ""
    return (
        f"Route {name(route)}, taught {date(way.taught)}: {way.length:.1f} m{by}; its poses were"
        f" known to {max(n.sigma for n in way.nodes):.3f} m."
    )


def forget_words(place: Place) -> str:
    """Say what is left of a place."""
    left = [count(len(place.standings), "landmark"), count(len(place.homes), "home")]
    left += [count(len(place.routes), "route")] if place.routes else []
    return f"{place.name}: {listing(left)} are left."


def info_lines(place: Place) -> list[str]:
    """Describe a place as it was at the last visit: what changes in it, and its homes."""
    first, when = place.visits[0], place.visits[-1].when
    stays = place.stays(when)
    standing = sum(p >= GONE for p in stays.values())
    begun, now = date(first.when), date(when)
    days = f"on {now}" if begun == now else f"from {begun} to {now}"
    lines = [
        f"{place.name}: {count(len(stays), 'landmark')}, {standing:,} of which probably stand where"
        f" they are mapped; {count(len(place.visits), 'visit')} {days}.",
        f"In a day a landmark changes its place with probability {percent(place.usual_rate)}.",
    ]
    for home, stored in place.homes.items():
        pose, sigma = place.home_pose(home), place.home_sigma(home, when)
        where = f"known to {sigma:.3f} m" if sigma < math.inf else "found by nobody any more"
        known = {n: place.standings[n] for n in stored.seen if n in place.standings}
        stand = sum(stays[n] for n, s in known.items() if s.since <= stored.stored)
        lines.append(
            f"Home {name(home)}, stored {date(stored.stored)}, at ({pose.x:.2f}, {pose.y:.2f}) m,"
            f" is {where}; of the"
            f" {len(stored.seen):,} landmarks that it saw about {stand:.0f} still stand where they"
            " did."
        )
    lines += [route_words(place, route) for route in place.routes]
    restless = sorted(
        (n for n, s in place.standings.items() if s.moved + s.returned),
        key=lambda n: -place.standings[n].rate(place.usual_rate),
    )
    if restless:
        often = [f"{name(n)} ({place.standings[n].moved})" for n in restless[:8]]
        lines.append(f"Moved most often: {listing(often)}.")
    apart = [v for v in place.visits if v.verdict == "apart"]
    if apart:
        lines.append(f"Kept apart, since they contradicted it: {count(len(apart), 'visit')}.")
    return lines
