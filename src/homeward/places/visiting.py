"""Visiting: a place after a drive, or after another robot's place."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from itertools import chain, count

import numpy as np

from homeward.errors import HomewardError
from homeward.geometry.frames import Pose
from homeward.geometry.se2 import compose, rotation
from homeward.localizer.localizer import Localizer
from homeward.localizer.output.map_snapshot import MAX_TESTED, moved_probabilities
from homeward.localizer.tunables import CLOSE, INLIER, MIN_SIGHTINGS, VERIFIED
from homeward.places.joint_map import JointMap, fused
from homeward.places.persistence import FORGOTTEN, GONE, Standing, missed_probability, tally
from homeward.places.place import Event, Place, StoredHome, Visit
from homeward.places.telling import VisitData, require_name

LEAST_AGREEING = 0.5
"""A visit of which less than this share of what should have stayed did is of another place, or most
was rearranged; nothing of it is merged."""
MOST_EVENTS = 4000
"""So many events are kept, and a tenth as many visits: of a place with ten a day, a year's."""
FIRST_HOME = "home"
"""So the home of a place's first drive is called."""


def first_place(name: str, localizer: Localizer, told: VisitData, home: str = FIRST_HOME) -> Place:
    """Return the place that a first drive makes; its frame is that of the drive's home.

    `HomewardError` where home was not found in the map, or too few landmarks are placed well for
    any later drive to prove that it is of this place.
    """
    own = localizer.map_snapshot()
    found, observed, mount = own.home, own.home_bearings, own.home_mount
    if found is None:
        raise HomewardError("home was not found on this drive, so there is no place to keep")
    stood = {m.landmark for m in localizer.landmarks() if m.moved is False}
    right = {n: b for n, b in observed.items() if n in stood and n in told.map.names}
    vague = np.diag([told.map.size**2, told.map.size**2, np.pi**2])
    there = told.map.with_home(home, right, mount, found, vague).at_home(home)
    there = there.only(_well_placed(there))
    if len(there.names) < VERIFIED:
        raise HomewardError(
            f"{len(there.names)} landmarks are placed well by this drive, and a place takes "
            f"{VERIFIED}: drive further"
        )
    when = told.when
    standings = {n: Standing(since=when, last=when) for n in there.names}
    place = Place(name, there, standings, {home: StoredHome(when, dict(observed))})
    events = tuple(_events(place, place, dict.fromkeys(there.names, "new")))
    number, new = place.next_visit, len(events)
    visit = Visit(number, when, told.drive, told.evidence, "first", new=new, of=new)
    return _with_stored(replace(place, visits=(visit,), events=events), told)


def merged(place: Place, told: VisitData) -> Place:
    """Return a place after a visit: what stayed is fused, what moved follows, what is gone fades.

    A visit that contradicts the place adds only a line that says so. `InputError` where the place
    knows this drive already, or has a home of a name that it stores.
    """
    place.require_new(told.drive, told.evidence)
    judged, stayed = _judged(place, told)
    stays = place.stays(told.when)
    expected = sum(stays[n] for n in judged)
    apart = Visit(place.next_visit, told.when, told.drive, told.evidence, "apart", of=len(stays))
    kept_apart = replace(place, visits=_visits(place, apart))
    if len(stayed) < max(VERIFIED, LEAST_AGREEING * expected):
        return kept_apart
    theirs = told.map
    placed = _well_placed(theirs)
    moved = [n for n, wrong in judged.items() if wrong > 0.5 and n in placed]
    new = [n for n in theirs.names if n in placed and n not in place.standings]
    there = _with_map(place, told.when, theirs.only({*stayed, *moved, *new}), stayed)
    if there is None:
        return kept_apart
    return _with_stored(_followed(place, there, told, judged, moved, new), told)


def merged_places(place: Place, other: Place) -> Place:
    """Return a place with what another robot's place of the same room adds to it.

    Where a landmark stands elsewhere in the two, the one that saw it last is right; what the other
    holds to be gone adds nothing. Homes and routes of the other that have a name of the place get
    the other's name, too. `InputError` where they have a drive in common: what it saw would count
    twice. `HomewardError` where they are not of one room, or most was rearranged between them.
    """
    known = other.evidence
    place.require_new(other.name, known)
    names = _free_names(place.homes, other.homes, other.name)
    when = max(place.visits[-1].when, other.visits[-1].when)
    theirs = replace(other.aged(when), homes=tuple(names[h] for h in other.map.homes))
    theirs = theirs.only({n for n, stays in other.stays(when).items() if stays >= GONE})
    judged, stayed = _judged(place, VisitData(other.name, known, when, theirs))
    differ = HomewardError(
        f"of the {len(judged)} landmarks that both have too few stand alike: "
        "these are two places, or most was rearranged"
    )
    if len(stayed) < max(VERIFIED, LEAST_AGREEING * len(judged)):
        raise differ
    older = {n for n in judged if other.standings[n].last < place.standings[n].last}
    theirs = theirs.only({n for n in theirs.names if n in stayed or n not in older})
    there = _with_map(place, when, theirs, stayed)
    if there is None:
        raise differ
    now = there.map
    both = {**place.standings, **{n: other.standings[n] for n in theirs.names}}
    both |= {n: place.standings[n].joined(other.standings[n]) for n in stayed}
    standings = {n: both[n] for n in now.names}
    homes = {**place.homes, **{names[h]: s for h, s in other.homes.items()}}
    ways = _free_names(there.routes, other.routes, other.name)
    more = {ways[n]: r.carried(other.map, now, stayed) for n, r in other.routes.items()}
    there = replace(there, standings=standings, homes=homes, routes=there.routes | more)
    new = [n for n in now.names if n not in place.standings]
    moved = [n for n in judged if n not in stayed and n not in older]
    what = dict.fromkeys(new, "new") | dict.fromkeys(moved, "moved")
    visit = Visit(
        place.next_visit,
        when,
        other.name,
        known,
        "merged",
        stayed=len(stayed),
        moved=len(moved),
        new=len(new),
        of=len(now.names),
    )
    events = (*place.events, *_events(place, there, what))[-MOST_EVENTS:]
    return replace(there, visits=_visits(place, visit), events=events)


def _with_map(place: Place, when: float, theirs: JointMap, stayed: list[str]) -> Place | None:
    """Return a place whose map is fused with another, and its routes; None where they disagree."""
    both_say, disagreement = fused(place.aged(when), theirs, stayed)
    if disagreement > INLIER**2:
        return None
    now = both_say.at_home(place.origin)
    routes = {n: r.carried(place.map, now, stayed) for n, r in place.routes.items()}
    return replace(place, map=now, routes=routes)


def _free_names(here: Collection[str], theirs: Collection[str], of: str) -> dict[str, str]:
    """Return the names that homes or routes of another place, called `of`, get in a place."""
    names = dict[str, str]()
    for one in theirs:
        longer = f"{one} of {of}"
        tries = chain((one, longer), (f"{longer}, {number}" for number in count(2)))
        taken = {*here, *names.values()}
        names[one] = next(name for name in tries if name not in taken)
    return names


def _visits(before: Place, visit: Visit) -> tuple[Visit, ...]:
    """Return the visits of a place with one more: the first, which made it, and the last ones."""
    first, *others = (*before.visits, visit)
    return first, *others[1 - MOST_EVENTS // 10 :]


def _followed(
    before: Place,
    place: Place,
    told: VisitData,
    judged: dict[str, float],
    moved: list[str],
    new: list[str],
) -> Place:
    """Return a place with what is believed of each landmark's staying after a visit."""
    when, usual = told.when, before.usual_rate
    standings, missed = dict[str, Standing](), _missed(before, told)
    what = dict.fromkeys(moved, "moved") | dict.fromkeys(new, "new")
    for name in place.map.names:
        was = before.standings.get(name)
        if was is None:
            standings[name] = Standing(since=when, last=when)
        elif name in moved:
            standings[name] = was.went(when)
        elif name in judged and judged[name] <= 0.5:
            standings[name] = was.stood(when)
            if was.stands < GONE:
                what[name] = "returned"
        elif name in judged:  # elsewhere, but nobody knows where
            standings[name] = was.doubted(when, 1.0 - judged[name])
        elif name in missed:
            standings[name] = was.was_missed(when, usual, missed[name])
        else:
            standings[name] = was
        if was is not None and standings[name].stands < GONE <= was.stands:
            what[name] = "gone"
    forgotten = [n for n, s in standings.items() if s.stays(when, usual) < FORGOTTEN]
    what |= dict.fromkeys(forgotten, "forgotten")
    kept = [n for n in standings if n not in forgotten]
    events = _events(before, place, what)
    lost = [standings[n] for n in forgotten]
    place = replace(
        place,
        map=place.map.only(kept),
        standings={n: standings[n] for n in kept},
        past=tuple(np.add(before.past, tally(lost)).tolist()),
        events=(*before.events, *events)[-MOST_EVENTS:],
    )
    counts = {k: sum(w == k for w in what.values()) for k in ("moved", "gone", "new", "returned")}
    stayed = sum(wrong <= 0.5 for wrong in judged.values())
    visit = Visit(
        before.next_visit,
        when,
        told.drive,
        told.evidence,
        "merged",
        stayed=stayed,
        of=len(kept),
        **counts,
    )
    return replace(place, visits=_visits(before, visit))


def _events(before: Place, place: Place, what: dict[str, str]) -> list[Event]:
    """Return the events of a visit, in order of landmarks."""
    at = dict(zip(place.map.names, place.map.positions.tolist(), strict=True))
    return [Event(before.next_visit, name, word, *at[name]) for name, word in what.items()]


def _judged(place: Place, told: VisitData) -> tuple[dict[str, float], list[str]]:
    """Return how probably landmarks of both stand elsewhere than in the place, and who do not."""
    before, stays, found = place.aged(told.when), place.stays(told.when), dict[str, float]()
    common = [n for n in before.names if n in told.map.names]
    groups = max(1, -(-len(common) // MAX_TESTED))
    for some in (common[i::groups] for i in range(groups)):
        if len(some) < 2:
            continue
        mine, theirs = before.only(some, ()).loose(), told.map.only(some)
        n, order = 2 * len(some), theirs.columns(mine.names)
        known = mine.positions, mine.covariance[:n, :n]
        mapped = theirs.mean[order], theirs.covariance[np.ix_(order, order)]
        prior = np.array([1.0 - max(stays[name], FORGOTTEN) for name in mine.names])
        wrong = moved_probabilities(known, mapped, prior, before.size)
        found |= dict(zip(mine.names, wrong.tolist(), strict=True))
    return found, [name for name, wrong in found.items() if wrong <= 0.5]


def _missed(place: Place, told: VisitData) -> dict[str, float]:
    """Return landmarks in view that were not seen, with how probably that happens if they stand."""
    if told.looks is None:
        return {}
    origin = place.home_pose(place.required(told.home))
    looks, seen = told.looks.shares(place.map, origin)
    found = seen > 0
    share = float(seen[found].sum() / looks[found].sum()) if found.any() else 0.0
    return {
        name: missed_probability(share, n)
        for name, n, k in zip(place.map.names, looks.tolist(), seen.tolist(), strict=True)
        if n >= MIN_SIGHTINGS and not k and name not in told.map.names
    }


def _well_placed(some: JointMap) -> set[str]:
    """Return the landmarks that are placed well enough for bearings to be linear in their error."""
    most = CLOSE * 0.5 * some.size
    return {n for n, sigma in zip(some.names, some.sigmas.tolist(), strict=True) if sigma < most}


def _with_stored(place: Place, told: VisitData) -> Place:
    """Return a place with the homes and routes that were stored on a visit."""
    for name, (route, seen) in told.routes.items():
        require_name("route", name, place.routes)
        both = [n for n in seen.names if n in place.standings]
        if len(both) >= VERIFIED:
            route = route.carried(seen, place.map, both)
            place = replace(place, routes={**place.routes, name: route})
    for name, (stored, answer) in told.homes.items():
        require_name("home", name, place.homes)
        if answer.pose is None or answer.covariance is None:
            continue
        origin = place.home_pose(place.required(told.home))
        pose, turn = compose(np.array(origin), np.array(answer.pose)), rotation(origin.heading)
        spread = turn @ answer.covariance @ turn.T
        there = place.map.with_home(name, {}, Pose(0.0, 0.0, 0.0), pose, spread)
        place = replace(place, map=there, homes={**place.homes, name: stored})
    return place
