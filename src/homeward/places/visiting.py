"""Update of a place from a drive, or from another robot's place."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from itertools import chain, count
from typing import Any

import numpy as np

from homeward.errors import HomewardError
from homeward.geometry.frames import Pose
from homeward.geometry.se2 import compose, rotation
from homeward.io.table import quoted
from homeward.localizer.localizer import Localizer
from homeward.localizer.output.faces import moved_probabilities, relative_size
from homeward.localizer.tunables import CLOSE, GIVEN_WRONG, INLIER, VERIFIED
from homeward.places.joint_map import JointMap, fused
from homeward.places.persistence import (
    FORGOTTEN,
    GONE,
    MIN_VIEWS,
    LandmarkPersistence,
    missed_probability,
    tally,
)
from homeward.places.place import Event, Place, StoredHome, Visit
from homeward.places.views import Views
from homeward.places.visit_data import VisitData, require_name
from homeward.reasons import ANOTHER_SIZE_ADVICE, another_size

MIN_STAYED_SHARE = 0.5
"""Minimum number of landmarks that stayed, as a share of the expected number. A visit with fewer is
of another place, or most of the place was rearranged; it is not merged."""
MAX_EVENTS = 4000
"""Number of events to keep, and of visits a tenth as many: a year of about one visit a day."""
ANY_SIZE = 1.0
"""Standard deviation of the scale of a map that may be of any size [1]."""
ELSEWHERE = (
    "It is another place, or most landmarks were moved or have other ids. Give another folder to "
    "begin a new place."
)
"""What a drive that contradicts a place may be, and what to do."""
FIRST_HOME = "home"
"""Default name of the first home."""


def first_place(name: str, localizer: Localizer, data: VisitData, home: str = FIRST_HOME) -> Place:
    """Return a new place from its first drive, in the frame of the drive's home.

    `HomewardError` if home was not found in the map, or too few landmarks are accurate enough for
    a later drive to be localised in this place.
    """
    own = localizer.snapshot()
    found, observed = own.home, own.home_bearings
    if found is None:
        raise HomewardError("no place to store: home was not found on this drive")
    static = {m.landmark for m in localizer.landmarks() if m.moved is False}
    right = {n: b for n, b in observed.items() if n in static and n in data.map.names}
    vague = np.diag([data.map.size**2, data.map.size**2, np.pi**2])
    mounts = np.array([own.home_mounts[n] for n in right]).reshape(-1, 3)
    if len(data.map.names) < VERIFIED:  # two define no frame
        raise _too_few(len(data.map.names))
    there = data.map.with_home(home, right, mounts, found, vague).at_home(home)
    there = there.marginal(_well_placed(there))
    if len(there.names) < VERIFIED:
        raise _too_few(len(there.names))
    when = data.when
    seen = _views(data, there, Pose(0.0, 0.0, 0.0)).seen
    persistence = {
        n: LandmarkPersistence(when, when, seen_from=tuple(map(float, seen.get(n, ()))))
        for n in there.names
    }
    place = Place(name, there, persistence, {home: StoredHome(when, dict(observed))})
    what = dict.fromkeys(there.names, "new")
    return _with_stored(_with_history(place, place, data, "first", what), data)


def _too_few(landmarks: int) -> HomewardError:
    """Return the error for a place with too few landmarks."""
    return HomewardError(
        f"no place to store: {landmarks} landmarks are mapped accurately, and a place needs"
        f" {VERIFIED}; drive further"
    )


def merged(place: Place, data: VisitData) -> Place:
    """Return a place after a visit: maps are fused, and moved, gone and new landmarks updated.

    A visit that contradicts the place is only listed, as "apart". A landmark that was tested after
    the end of the visit stays as it is. `InputError` if the drive is already in the place, or
    stores a home or route whose name exists.
    """
    place.require_new(data.drive, data.evidence)
    placed = _well_placed(data.map)
    tested, stayed = _compared(place, data)
    if _contradiction(place, data, tested, stayed) is not None:
        return kept_apart(place, data)
    theirs = data.map
    later = {n for n, p in place.persistence.items() if p.last > data.until}
    moved = [n for n, wrong in tested.items() if wrong > 0.5 and n in placed and n not in later]
    new = [n for n in theirs.names if n in placed and n not in place.persistence]
    used = theirs.marginal({*stayed, *moved, *new})
    there = _with_map(place, data.when, used, stayed, data.scale_sigma)
    if there is None:
        return kept_apart(place, data)
    return _with_stored(_updated(place, there, data, tested, moved, new, later), data)


def why_apart(place: Place, data: VisitData) -> str:
    """Return why `merged` keeps a visit apart from a place, with what to do."""
    found = _contradiction(place, data, *_compared(place, data))
    return found or f"it contradicts the distances of its landmarks. {ELSEWHERE}"


def _compared(place: Place, data: VisitData) -> tuple[dict[str, float], list[str]]:
    """Return the `_moved_probabilities` of a visit, with the errors of its scale."""
    scaled = replace(data, map=data.map.with_vague_scale(data.scale_sigma))
    return _moved_probabilities(place, scaled)


def _contradiction(
    place: Place, data: VisitData, tested: Collection[str], stayed: list[str]
) -> str | None:
    """Return why a visit contradicts a place, if it does; see `_moved_probabilities`."""
    mine, theirs = place.map.names, data.map.names
    if not {*mine} & {*theirs}:
        named = f"{quoted(theirs[0])} on the drive, {quoted(mine[0])} in the place"
        return f"they have no landmark in common (ids such as {named}). {ELSEWHERE}"
    stays = place.stays(data.when)
    expected = sum(stays[n] for n in tested)
    needed, agreeing = max(VERIFIED, MIN_STAYED_SHARE * expected), stayed
    if len(stayed) < needed:
        of_any_size = replace(data, map=data.map.with_vague_scale(ANY_SIZE))
        agreeing = _moved_probabilities(place, of_any_size)[1]
    if len(agreeing) >= needed:
        own = data.map.marginal(agreeing).with_vague_scale(data.scale_sigma)
        size = relative_size(*_common_maps(place, data.when, own, agreeing), place.map.size)
        if size != 1.0:
            return f"{another_size(size)}. {ANOTHER_SIZE_ADVICE}"
    if agreeing is stayed:
        return None
    share = f"of {len(tested)} common landmarks, {len(stayed)} are where the place has them"
    return f"{share}. {ELSEWHERE}"


def kept_apart(place: Place, data: VisitData) -> Place:
    """Return a place that only lists a visit, as "apart"."""
    return _with_history(place, place, data, "apart", {})


def merged_places(place: Place, other: Place) -> Place:
    """Return a place with the landmarks, homes and routes of another robot's place of this room.

    If a landmark's positions differ, the later observation is used; landmarks that are gone in the
    other place are ignored. The other place's name is appended to names of its homes and routes
    that exist already. `InputError` if both contain the same drive, which would count twice.
    `HomewardError` if they are of different rooms, or most was rearranged between them.
    """
    known = other.evidence
    place.require_new(other.name, known)
    names = _free_names(place.homes, other.homes, other.name)
    when = max(place.when, other.when)
    theirs = replace(other.aged(when), homes=tuple(names[h] for h in other.map.homes))
    theirs = theirs.marginal({n for n, stays in other.stays(when).items() if stays >= GONE})
    theirs_data = VisitData(other.name, known, when, theirs, together=other.together)
    tested, stayed = _moved_probabilities(place, theirs_data)
    differ = HomewardError(
        f"too few of the {len(tested)} common landmarks are at the same place in both: "
        "these are two different places, or most landmarks were moved"
    )
    if len(stayed) < max(VERIFIED, MIN_STAYED_SHARE * len(tested)):
        raise differ
    older = {n for n in tested if other.persistence[n].last < place.persistence[n].last}
    theirs = theirs.marginal({n for n in theirs.names if n in stayed or n not in older})
    there = _with_map(place, when, theirs, stayed)
    if there is None:
        raise differ
    size = relative_size(*_common_maps(place, when, theirs, stayed), place.map.size)
    if size != 1.0:
        raise HomewardError(
            f"{quoted(place.name)} is {size:.2g} times as large as {quoted(other.name)}: the wheels"
            " of one of their robots had another size, or spun; calibrate it with homeward tune"
        )
    now = there.map
    others = {n: replace(other.persistence[n], seen_from=()) for n in theirs.names}  # other frame
    both = {**place.persistence, **others}
    both |= {n: place.persistence[n].combined(other.persistence[n]) for n in stayed}
    persistence = {n: both[n] for n in now.names}
    homes = {**place.homes, **{names[h]: s for h, s in other.homes.items()}}
    ways = _free_names(there.routes, other.routes, other.name)
    more = {ways[n]: r.transferred(other.map, now, stayed) for n, r in other.routes.items()}
    there = replace(there, persistence=persistence, homes=homes, routes=there.routes | more)
    there = replace(there, together=tuple(dict.fromkeys((*place.together, *other.together))))
    new = [n for n in now.names if n not in place.persistence]
    moved = [n for n in tested if n not in stayed and n not in older]
    what = dict.fromkeys(new, "new") | dict.fromkeys(moved, "moved")
    return _with_history(place, there, theirs_data, "merged", what, len(stayed))


def _with_map(
    place: Place, when: float, theirs: JointMap, stayed: list[str], scale_sigma: float = 0.0
) -> Place | None:
    """Return a place with map and routes after fusion with another map; None on disagreement."""
    joint, disagreement = fused(place.aged(when), theirs, stayed, scale_sigma)
    if disagreement > INLIER**2:
        return None
    now = joint.at_home(place.origin)
    routes = {n: r.transferred(place.map, now, stayed) for n, r in place.routes.items()}
    return replace(place, map=now, routes=routes)


def _free_names(here: Collection[str], theirs: Collection[str], of: str) -> dict[str, str]:
    """Return new names for the homes or routes of another place, named `of`, in a place."""
    names = dict[str, str]()
    for one in theirs:
        longer = f"{one} of {of}"
        tries = chain((one, longer), (f"{longer}, {number}" for number in count(2)))
        taken = {*here, *names.values()}
        names[one] = next(name for name in tries if name not in taken)
    return names


def _with_history(
    before: Place,
    place: Place,
    data: VisitData,
    result: str,
    what: Mapping[str, str],
    stayed: int = 0,
) -> Place:
    """Return a place with the history of the place `before` and a visit.

    `what` are its events by landmark. The first visit and the last ones are kept.
    """
    number, counts = before.next_visit, dict[str, Any](Counter(what.values()))
    at = dict(zip(place.map.names, place.map.positions.tolist(), strict=True))
    events = [Event(number, name, word, *at[name]) for name, word in what.items()]
    of = len(place.map.names) - counts.pop("forgotten", 0)
    about = number, data.when, data.drive, data.evidence, result, stayed
    first, *others = (*before.visits, Visit(*about, **counts, of=of))
    return replace(
        place,
        visits=(first, *others[1 - MAX_EVENTS // 10 :]),
        events=(*before.events, *events)[-MAX_EVENTS:],
    )


def _updated(
    before: Place,
    place: Place,
    data: VisitData,
    tested: dict[str, float],
    moved: list[str],
    new: list[str],
    later: Collection[str],
) -> Place:
    """Return a place with the persistence of each landmark, events and the visit updated.

    Landmarks of `later` were tested after this visit, and are not changed.
    """
    when, usual = data.when, before.usual_rate
    views = _views(data, before.map, before.home_pose(before.required(data.home)))
    persistence, missed = dict[str, LandmarkPersistence](), _missed(before, data, views)
    by_body = _in_place_by_bodies(before, data, tested)
    what = dict.fromkeys(moved, "moved") | dict.fromkeys(new, "new")
    for name in place.map.names:
        was = before.persistence.get(name)
        if was is None:
            persistence[name] = LandmarkPersistence(since=when, last=when)
        elif name in later:
            persistence[name] = was
        elif name in moved:
            persistence[name] = was.seen_elsewhere(when)
        elif name in tested and tested[name] <= 0.5:
            persistence[name] = was.seen_in_place(when, list(views.seen.get(name, ())))
            if was.stands < GONE:
                what[name] = "returned"
        elif name in tested:  # moved, to an uncertain position
            persistence[name] = was.updated(when, 1.0 - tested[name])
        else:
            now = was.was_missed(when, usual, missed[name]) if name in missed else was
            if name in by_body:
                alone = now.stays(when, usual)
                in_place = by_body[name] + GIVEN_WRONG * (alone - by_body[name])
                now = was.updated(when, in_place)
            persistence[name] = now
        if was is not None and persistence[name].stands < GONE <= was.stands:
            what[name] = "gone"
    forgotten = [n for n, s in persistence.items() if s.stays(when, usual) < FORGOTTEN]
    what |= dict.fromkeys(forgotten, "forgotten")
    kept = [n for n in persistence if n not in forgotten]
    lost = [persistence[n] for n in forgotten]
    stayed = sum(wrong <= 0.5 for wrong in tested.values())
    place = _with_history(before, place, data, "merged", what, stayed)
    return replace(
        place,
        map=place.map.marginal(kept),
        persistence={n: persistence[n] for n in kept},
        past=tuple(np.add(before.past, tally(lost)).tolist()),
    )


def _moved_probabilities(place: Place, data: VisitData) -> tuple[dict[str, float], list[str]]:
    """Return the probability that each common landmark moved, and the names of the others."""
    stays, found = place.stays(data.when), dict[str, float]()
    common = [n for n in place.map.names if n in data.map.names]
    if len(common) >= 2:
        maps = _common_maps(place, data.when, data.map, common)
        prior = np.array([1.0 - max(stays[name], FORGOTTEN) for name in common])
        about = common, (*place.together, *data.together)
        wrong = moved_probabilities(*maps, prior, place.map.size, *about)
        found = dict(zip(common, wrong.tolist(), strict=True))
    return found, [name for name, wrong in found.items() if wrong <= 0.5]


def _common_maps(
    place: Place, when: float, theirs: JointMap, common: Sequence[str]
) -> tuple[tuple[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]:
    """Return positions and covariances of common landmarks in a place at `when`, and elsewhere.

    The landmarks, two or more, are in the order of the place.
    """
    mine, at = place.aged(when).marginal(common, ()).with_vague_datum(), theirs.columns(common)
    mapped = theirs.mean[at].reshape(-1, 2), theirs.covariance[np.ix_(at, at)]
    return (mine.positions, mine.covariance), mapped


def _in_place_by_bodies(
    place: Place, data: VisitData, tested: dict[str, float]
) -> dict[str, float]:
    """Return the probability of landmarks that were not tested to be in place, by given groups.

    Of a group that moves together, all tested landmarks are in place, or all moved.
    """
    found = dict[str, float]()
    for group in dict.fromkeys((*place.together, *data.together)):
        wrong = [tested[n] for n in group if n in tested]
        if wrong and (max(wrong) <= 0.5 or min(wrong) > 0.5):
            in_place = 1.0 - float(np.mean(wrong))
            found |= {n: in_place for n in group if n in place.persistence and n not in tested}
    return found


def _views(data: VisitData, places: JointMap, origin: Pose) -> Views:
    return Views() if data.frames is None else data.frames.views(places, origin)


def _missed(place: Place, data: VisitData, views: Views) -> dict[str, float]:
    """Return landmarks in sight that were never seen, with the probability of that if static."""
    known = {name: np.array(p.seen_from) for name, p in place.persistence.items() if p.seen_from}
    in_sight, share = views.in_sight(known)
    return {
        name: missed_probability(share, number)
        for name, number in in_sight.items()
        if number >= MIN_VIEWS and name not in views.seen and name not in data.map.names
    }


def _well_placed(some: JointMap) -> set[str]:
    """Return the landmarks accurate enough for bearings to be linear in their error."""
    limit = CLOSE * 0.5 * some.size
    return {n for n, sigma in zip(some.names, some.sigmas.tolist(), strict=True) if sigma < limit}


def _with_stored(place: Place, data: VisitData) -> Place:
    """Return a place with the homes and routes stored on a visit, and its given bodies."""
    place = replace(place, together=tuple(dict.fromkeys((*place.together, *data.together))))
    for name, (route, seen) in data.routes.items():
        require_name("route", name, place.routes)
        both = [n for n in seen.names if n in place.persistence]
        if len(both) >= VERIFIED:
            route = route.transferred(seen, place.map, both)
            place = replace(place, routes={**place.routes, name: route})
    for name, (stored, answer) in data.homes.items():
        require_name("home", name, place.homes)
        if answer.pose is None or answer.covariance is None:
            continue
        origin = place.home_pose(place.required(data.home))
        pose, turn = compose(np.array(origin), np.array(answer.pose)), rotation(origin.heading)
        spread = turn @ answer.covariance @ turn.T
        there = place.map.with_home(name, {}, np.empty((0, 3)), pose, spread)
        place = replace(place, map=there, homes={**place.homes, name: stored})
    return place
