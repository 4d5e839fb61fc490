"""Common-motion test: landmarks that moved by one rigid motion mean that the robot was carried.

If several landmarks moved by one rigid motion, and hardly anything seen before is still in place,
the odometry frame itself moved: the robot was lifted and put down where little of its map was in
sight. Then landmarks mapped before and after are not in one frame.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from homeward.geometry.angles import wrap
from homeward.geometry.frames import position_sigma
from homeward.localizer.map.landmarks import Landmarks
from homeward.localizer.tunables import CLOSE, INLIER, MIN_TOGETHER


@dataclass(frozen=True)
class Displaced:
    """Positions of k landmarks before and after they moved."""

    before: np.ndarray
    """(k, 2) [m]"""
    now: np.ndarray
    """(k, 2) [m]"""
    variance: np.ndarray
    """(k,): variance of a coordinate of the difference, the larger one [m^2]."""
    last: np.ndarray
    """(k,): last keyframe that saw them at the old position."""
    first: np.ndarray
    """(k,): first keyframe that saw them at the new position."""


def carried_since(landmarks: Landmarks) -> int | None:
    """Return the keyframe after which the robot was carried, None if it was not.

    The evidence is in landmarks that were declared moved.
    """
    mapped, former = landmarks.mapped, landmarks.former
    pairs = [(was, mapped[n]) for n, was in former.items() if n in mapped]
    if len(pairs) < MIN_TOGETHER:
        return None
    before, covariance = landmarks.places(was for was, _ in pairs)
    now, more = landmarks.places(is_ for _, is_ in pairs)
    displaced = Displaced(
        before,
        now,
        position_sigma(covariance + more) ** 2,
        np.array([was.last for was, _ in pairs]),
        np.array([is_.first for _, is_ in pairs]),
    )
    stayed = [m for n, m in mapped.items() if n not in former]
    entered, last = np.array([m.first for m in stayed]), np.array([m.last for m in stayed])
    return carried_at(displaced, entered, last)


def carried_at(displaced: Displaced, entered: np.ndarray, last: np.ndarray) -> int | None:
    """Return the keyframe after which the robot was carried, or None if it was not.

    `displaced` are landmarks that were declared moved; the others (m,) were initialised at the
    keyframes `entered`, and last fitted at `last`.
    """
    together = moved_together(displaced)
    if together.sum() < MIN_TOGETHER:
        return None
    moved_last, moved_first = displaced.last[together], displaced.first[together]
    best, when = 0, None
    for k in sorted(set(moved_last.tolist())):
        moved = int(((moved_last <= k) & (moved_first >= k)).sum())
        stayed = int(((entered <= k) & (last > k)).sum())
        if moved >= MIN_TOGETHER and moved - stayed > best:
            best, when = moved - stayed, k
    return when


def moved_together(displaced: Displaced) -> np.ndarray:
    """Return the largest set of landmarks that moved by one rigid motion, shape (k,), bool."""
    before, now = displaced.before, displaced.now
    most = np.zeros(len(before), bool)
    reach = CLOSE * float(np.hypot(*np.ptp(before, axis=0))) if len(before) else 0.0
    for i, j in combinations(range(len(before)), 2):
        a, b = before[j] - before[i], now[j] - now[i]
        turn = wrap(np.arctan2(b[1], b[0]) - np.arctan2(a[1], a[0]))
        c, s = np.cos(turn), np.sin(turn)
        middle = 0.5 * (before[i] + before[j])
        there = (before - middle) @ np.array([[c, s], [-s, c]]) + 0.5 * (now[i] + now[j])
        # The two that define the motion err, too, all the more the closer they are.
        lever = np.hypot(*(before - middle).T) / max(float(np.hypot(*a)), 1e-9)
        pair = displaced.variance[i] + displaced.variance[j]
        sigma = np.sqrt(displaced.variance + pair * (0.25 + lever**2))
        off = np.hypot(*(now - there).T)
        fits = off < np.minimum(INLIER * sigma, reach)
        if fits[i] and fits[j] and fits.sum() > most.sum():
            most = fits
    return most
