"""A place as a robot uses it: the published map, with what other robots found since then."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from homeward.live.fleet.messages import Change, Placed
from homeward.places.joint_map import JointMap
from homeward.places.persistence import LandmarkPersistence
from homeward.places.place import Place

SUSPECTED, LEFT = 0.5, 0.1
"""Probability that a landmark is in place while one robot found otherwise, and two robots."""


def spread(at: Placed) -> np.ndarray:
    """Return the covariance of a position, (2, 2)."""
    return np.array([[at[2], at[3]], [at[3], at[4]]])


def with_changes(place: Place, changes: Sequence[Change], robot: str, when: float) -> Place:
    """Return a place with the changes that others than `robot` found, at `when` [days since 1970].

    A landmark that moved has its new position. A suspected one remains, with an uncertainty that
    includes the position where one robot saw it. What the robot itself found is in its visit.
    """
    persistence = dict(place.persistence)
    placed, suspected = dict[str, Placed](), dict[str, Placed]()
    for change in changes:
        others = [at for name, at in change.by.items() if name != robot]
        if not others:
            continue
        at = min(filter(None, others), key=lambda at: at[2] + at[4], default=None)
        name, was = change.landmark, persistence.get(change.landmark)
        if was is None:
            if at is not None and change.what == "new":
                placed[name] = at
                in_place = 1.0 if change.confirmed else SUSPECTED
                persistence[name] = LandmarkPersistence(when, when, in_place)
        elif change.what == "returned":
            persistence[name] = was.seen_in_place(when) if change.confirmed else was
        elif change.confirmed and at is not None:
            placed[name], persistence[name] = at, was.seen_elsewhere(when)
        else:
            if at is not None:
                suspected[name] = at
            left = LEFT if change.confirmed else SUSPECTED
            persistence[name] = replace(was, stands=min(was.stands, left))
    return replace(place, map=_changed(place.map, placed, suspected), persistence=persistence)


def _changed(
    joint: JointMap, placed: Mapping[str, Placed], suspected: Mapping[str, Placed]
) -> JointMap:
    """Return a map with landmarks at other positions, whose errors are independent of the rest."""
    if not (placed or suspected):
        return joint
    kept = joint.marginal({*joint.names} - placed.keys())
    covariance, k, n = kept.covariance.copy(), 2 * len(placed), 2 * len(kept.names)
    for name, at in suspected.items():
        rows = kept.columns([name])
        off = np.subtract(at[:2], kept.mean[rows])
        covariance[np.ix_(rows, rows)] += np.outer(off, off)
    both = np.zeros((kept.mean.size + k, kept.mean.size + k))
    stay = np.delete(np.arange(len(both)), np.arange(n, n + k))  # homes come last
    both[np.ix_(stay, stay)] = covariance
    for i, at in enumerate(placed.values()):
        rows = n + 2 * i + np.arange(2)
        both[np.ix_(rows, rows)] = spread(at)
    mean = np.insert(kept.mean, n, np.array([at[:2] for at in placed.values()]).ravel())
    return JointMap((*kept.names, *placed), kept.homes, mean, both)


def is_same(before: Place, now: Place) -> bool:
    """Return whether two places have the same landmarks at the same positions, homes and routes."""
    if before.map.names != now.map.names or {*before.homes} != {*now.homes}:
        return False
    if {*before.routes} != {*now.routes}:
        return False
    off = np.hypot(*(now.map.positions - before.map.positions).T)
    sigmas = before.map.sigmas, now.map.sigmas
    is_near = (off <= sigmas[0]) & (sigmas[1] < 2.0 * sigmas[0]) & (sigmas[0] < 2.0 * sigmas[1])
    return bool(is_near.all()) and doubtful(before) == doubtful(now)


def doubtful(place: Place) -> set[str]:
    """Return the landmarks that may not be in place."""
    return {name for name, p in place.persistence.items() if p.stands <= SUSPECTED}
