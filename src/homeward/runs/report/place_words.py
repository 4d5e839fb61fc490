"""Wording of places and visits in sentences."""

from __future__ import annotations

import math

from homeward.places.alignment import Alignment
from homeward.places.persistence import GONE
from homeward.places.place import Place, date
from homeward.places.visiting import ELSEWHERE
from homeward.runs.report.words import count, listing, name, percent


def visit_words(place: Place, why_apart: str = "") -> str:
    """Describe what the last visit found in a place, and why it was not merged, if so."""
    visit = place.visits[-1]
    if visit.verdict == "first":
        return f"{place.name}: a new place, with {count(visit.of, 'landmark')}."
    if visit.verdict == "apart":
        return (
            f"{place.name}: this drive was not merged, because it contradicts the place: "
            f"{why_apart or ELSEWHERE}"
        )
    parts = [f"{visit.stayed:,} stayed"]
    for what in ("moved", "gone", "returned", "new"):
        mine = (e for e in place.events if e.visit == visit.number and e.what == what)
        names = [name(e.landmark) for e in mine]
        if names:
            parts.append(f"{len(names):,} {what} ({listing(names, 8)})")
    return f"{place.name}: {listing(parts)}; now {count(visit.of, 'landmark')}."


def route_words(place: Place, route: str) -> str:
    """Describe a route."""
    way = place.route(route)
    points = [name(n.waypoint) for n in way.waypoints]
    by = f" with {count(len(points), 'way point')} ({listing(points, 8)})" if points else ""
    return (
        f"Route {name(route)}, taught {date(way.taught)}: {way.length:.1f} m{by}, position"
        f" uncertainty up to {max(n.sigma for n in way.nodes):.3f} m."
    )


def alignment_lines(found: Alignment) -> list[str]:
    """Describe an alignment, first as the parameter `home_in_map` of the ROS node."""
    position, heading = found.sigmas
    residuals = ", ".join(f"{name} {size:.2f} m" for name, size in found.residuals.items())
    return [
        f"home_in_map: [{', '.join(f'{value:.4f}' for value in found.home)}]",
        f"Standard deviation {position:.2f} m and {math.degrees(heading):.1f} deg."
        f" Residuals: {residuals}.",
    ]


def forget_words(place: Place) -> str:
    """Return the numbers of landmarks, homes and routes that remain in a place."""
    left = [count(len(place.persistence), "landmark"), count(len(place.homes), "home")]
    left += [count(len(place.routes), "route")] if place.routes else []
    return f"{place.name}: {listing(left)} remain."


def info_lines(place: Place) -> list[str]:
    """Describe a place at its last visit: landmarks, rate of changes, homes and routes."""
    first, when = min(visit.when for visit in place.visits), place.when
    stays = place.stays(when)
    in_place = sum(p >= GONE for p in stays.values())
    changes, watched = place.tally
    begun, now = date(first), date(when)
    days = f"on {now}" if begun == now else f"from {begun} to {now}"
    lines = [
        f"{place.name}: {count(len(stays), 'landmark')}, {in_place:,} probably in place;"
        f" {count(len(place.visits), 'visit')} {days}.",
        f"Probability that a landmark changes its place in a day: {percent(place.usual_rate)}; "
        + (
            f"from a prior and {count(int(changes), 'change')} in {watched:,.1f} landmark-days."
            if watched
            else "this is a prior, as changes are observed from the second visit on."
        ),
    ]
    for home, stored in place.homes.items():
        pose, sigma = place.home_pose(home), place.home_sigma(home, when)
        where = (
            f"position uncertainty {sigma:.3f} m"
            if sigma < math.inf
            else "which cannot be found any more: fewer than 2 landmarks are left"
        )
        known = {n: place.persistence[n] for n in stored.seen if n in place.persistence}
        stay = sum(stays[n] for n, s in known.items() if s.since <= stored.stored)
        since = f", about {stay:.0f} of them not moved since then" if when > stored.stored else ""
        lines.append(
            f"Home {name(home)}, stored {date(stored.stored)}, at ({pose.x:.2f}, {pose.y:.2f}) m,"
            f" {where}; {count(len(stored.seen), 'home bearing')}{since}."
        )
    lines += [route_words(place, route) for route in place.routes]
    movers = sorted(
        (n for n, s in place.persistence.items() if s.moved + s.returned),
        key=lambda n: -place.persistence[n].rate(place.usual_rate),
    )
    if movers:
        often = [f"{name(n)} ({place.persistence[n].moved})" for n in movers[:8]]
        lines.append(f"Moved most often: {listing(often)}.")
    apart = [v for v in place.visits if v.verdict == "apart"]
    if apart:
        lines.append(f"Not merged because of contradictions: {count(len(apart), 'visit')}.")
    return lines
