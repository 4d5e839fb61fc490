"""Differences of places: what others found since a map was published, and whether it matters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from homeward.io.table import quoted
from homeward.live.fleet.messages import Change, Placed
from homeward.places.joint_map import JointMap
from homeward.places.persistence import GONE, LandmarkPersistence
from homeward.places.place import Place
from homeward.runs.report.words import count, listing

SUSPECTED, LEFT = 0.5, 0.1
"""Probability that a landmark is in place while one robot found otherwise, and two robots."""


def spread(at: Placed) -> np.ndarray:
    """Return the covariance of a position, (2, 2)."""
    return np.array([[at[2], at[3]], [at[3], at[4]]])


def placed(joint: JointMap) -> dict[str, Placed]:
    """Return the positions of the landmarks of a map and their covariances."""
    found = {}
    for k, (name, (x, y)) in enumerate(zip(joint.names, joint.positions.tolist(), strict=True)):
        (xx, xy), (_, yy) = joint.covariance[2 * k : 2 * k + 2, 2 * k : 2 * k + 2].tolist()
        found[name] = x, y, xx, xy, yy
    return found


def part(place: Place, names: set[str]) -> Place:
    """Return a place with some of its landmarks; others of `names` are ignored."""
    return place.without(place.persistence.keys() - names)


def with_changes(place: Place, changes: Sequence[Change], robot: str, when: float) -> Place:
    """Return a place with the changes that others than `robot` found, at `when` [days since 1970].

    A landmark that moved has its new position. A suspected one remains, with an uncertainty that
    includes the position where one robot saw it. What the robot itself found is in its visit.
    """
    persistence = dict(place.persistence)
    moved, suspected = dict[str, Placed](), dict[str, Placed]()
    for change in changes:
        others = [at for name, at in change.by.items() if name != robot]
        if not others:
            continue
        at = min(filter(None, others), key=lambda at: at[2] + at[4], default=None)
        name, was = change.landmark, persistence.get(change.landmark)
        if was is None:
            if at is not None and change.what == "new":
                moved[name] = at
                in_place = 1.0 if change.confirmed else SUSPECTED
                persistence[name] = LandmarkPersistence(when, when, in_place)
        elif change.what == "returned":
            persistence[name] = was.seen_in_place(when) if change.confirmed else was
        elif change.confirmed and at is not None:
            moved[name], persistence[name] = at, was.seen_elsewhere(when)
        else:
            if at is not None:
                suspected[name] = at
            left = LEFT if change.confirmed else SUSPECTED
            persistence[name] = replace(was, stands=min(was.stands, left))
    return replace(place, map=_changed(place.map, moved, suspected), persistence=persistence)


def _changed(
    joint: JointMap, moved: Mapping[str, Placed], suspected: Mapping[str, Placed]
) -> JointMap:
    """Return a map with landmarks at other positions, whose errors are independent of the rest."""
    if not (moved or suspected):
        return joint
    kept = joint.marginal({*joint.names} - moved.keys())
    covariance, k, n = kept.covariance.copy(), 2 * len(moved), 2 * len(kept.names)
    for name, at in suspected.items():
        rows = kept.columns([name])
        off = np.subtract(at[:2], kept.mean[rows])
        covariance[np.ix_(rows, rows)] += np.outer(off, off)
    both = np.zeros((kept.mean.size + k, kept.mean.size + k))
    stay = np.delete(np.arange(len(both)), np.arange(n, n + k))  # homes come last
    both[np.ix_(stay, stay)] = covariance
    for i, at in enumerate(moved.values()):
        rows = n + 2 * i + np.arange(2)
        both[np.ix_(rows, rows)] = spread(at)
    mean = np.insert(kept.mean, n, np.array([at[:2] for at in moved.values()]).ravel())
    return JointMap((*kept.names, *moved), kept.homes, mean, both)


def difference(before: Place, now: Place, by: str, when: float) -> tuple[Change, ...] | None:
    """Return the changes from a place to a later one, found `by` its merger.

    None where they do not suffice: it has other homes or routes, or landmarks that stayed have
    positions outside their standard deviation, or much smaller ones.
    """
    at, found = placed(now.map), list[Change]()
    for name, is_now in now.persistence.items():
        was = before.persistence.get(name)
        if was is None:
            what = "new"
        elif is_now.moved > was.moved:
            what = "moved"
        elif (is_now.stands < GONE) != (was.stands < GONE):
            what = "gone" if is_now.stands < GONE else "returned"
        else:
            continue
        where = None if what == "gone" else at[name]
        found.append(Change(landmark=name, what=what, confirmed=True, by={by: where}))
    is_all = is_same(with_changes(before, found, "", when), now)
    return tuple(found) if is_all and before.together == now.together else None


def is_same_news(
    place: Place, before: Sequence[Change], now: Sequence[Change], when: float
) -> bool:
    """Return whether changes of a place have the same effect for each robot."""
    known = {(c.landmark, *sorted(c.by)) for c in before}
    if known != {(c.landmark, *sorted(c.by)) for c in now}:
        return False
    some = part(place, {c.landmark for c in now})
    return is_same(*(with_changes(some, changes, "", when) for changes in (before, now)))


def is_same(before: Place, now: Place) -> bool:
    """Return whether two places have the same landmarks at the same positions, homes and routes."""
    kinds = [(p.map.names, p.homes, p.routes) for p in (before, now)]
    if any({*was} != {*are} for was, are in zip(*kinds, strict=True)):
        return False
    was = before.map.marginal(now.map.names, ())
    order = was.columns(now.map.names)
    off = np.hypot(*(now.map.positions - was.mean[order].reshape(-1, 2)).T)
    sigmas = was.sigmas[order[::2] // 2], now.map.sigmas
    is_near = (off <= sigmas[0]) & (sigmas[1] < 2.0 * sigmas[0]) & (sigmas[0] < 2.0 * sigmas[1])
    return bool(is_near.all()) and doubtful(before) == doubtful(now)


def doubtful(place: Place) -> set[str]:
    """Return the landmarks that may not be in place."""
    return {name for name, p in place.persistence.items() if p.stands <= SUSPECTED}


def change_words(before: Place, now: Place) -> str:
    """Describe what other robots changed in a place."""
    was, is_at = (dict(zip(p.map.names, p.map.positions, strict=True)) for p in (before, now))
    sigmas = (dict(zip(p.map.names, p.map.sigmas.tolist(), strict=True)) for p in (before, now))
    (wide, sharp), both = sigmas, [n for n in was if n in is_at]
    limits = {n: max(5.0 * min(wide[n], sharp[n]), 0.05) for n in both}  # suspected ones are wide
    changes = {
        "moved": [n for n in both if np.hypot(*(is_at[n] - was[n])) > limits[n]],
        "new": [n for n in is_at if n not in was],
        "removed": [n for n in was if n not in is_at],
    }
    words = [
        f"{len(names)} {what} ({listing(names, 8)})" for what, names in changes.items() if names
    ]
    counted = count(len(is_at), "landmark")
    return f"place {quoted(now.name)} updated: {listing([*words, counted])}"
