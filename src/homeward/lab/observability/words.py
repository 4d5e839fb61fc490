"""Null spaces in words: each direction is compared with known motions of home, landmarks and scale.

A sentence is used only for a direction that lies in the family that it names. Any other direction
is described by its largest components, with their units.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from homeward.io.naming import listing
from homeward.lab.model import POLAR
from homeward.lab.observability.ranks import beyond, common, orthonormal
from homeward.lab.observability.scene import CALIBRATIONS, UNITS, Scene

ON_CURVE = 1e-4
"""Largest relative distance of a landmark on a line or a circle."""


def _freedom_of_home(scene: Scene, moves: np.ndarray) -> str:
    """Describe the freedom of home, given (3, k) directions of its pose."""
    place = np.linalg.svd(moves[:2] / scene.length, compute_uv=False)
    dims = int((place > 1e-6).sum())
    if moves.shape[1] == POLAR:
        return "home may lie anywhere, facing any way"
    if dims == 0:
        return "home may face any way"
    if dims == 2:
        seen = scene.stored.nonzero()[0]
        name = f"{scene.names[seen[0]]} appears" if seen.size == 1 else "its landmarks appear"
        return f"home may lie anywhere, facing so that {name} at the stored bearing"
    along = moves[:, int(np.argmax(np.hypot(*moves[:2])))]
    direction = along[:2] / np.hypot(*along[:2])
    return _curve(scene, direction, float(along[2]))


def _curve(scene: Scene, direction: np.ndarray, turn: float) -> str:
    """Describe the curve along which home moves in a direction (2,): line, circle, or bearing."""
    stored = np.flatnonzero(scene.stored)
    away = scene.landmarks[stored] - scene.home[:2]
    far = np.maximum(np.hypot(*away.T), 1e-12)
    ahead = np.abs(direction[0] * away[:, 1] - direction[1] * away[:, 0]) / far
    if ahead.size and ahead.max() < ON_CURVE and abs(turn) * scene.length < ON_CURVE:
        return (
            f"home may lie anywhere on the line through itself and {names(scene, stored)},"
            " on this side"
        )
    across = np.abs(away @ direction) / far
    if stored.size == 1 and across[0] < ON_CURVE:
        return f"home may lie anywhere on a circle around {scene.names[stored[0]]}"
    if stored.size >= 2 and _is_on_circle(away, direction):
        return (
            f"home may lie anywhere on the circle through itself, {names(scene, stored)}"
            " (on its arc between them), with a heading that changes along it"
        )
    angle = np.degrees(np.arctan2(direction[1], direction[0]))
    return f"home slides in the direction {angle:.0f}° from {scene.axis}"


def _is_on_circle(away: np.ndarray, direction: np.ndarray) -> bool:
    """Return whether one circle, tangent to `direction` at home, contains all marks (k, 2)."""
    across = away @ np.array([-direction[1], direction[0]])
    if np.abs(across).min() < 1e-9:
        return False
    radii = (away**2).sum(axis=1) / (2 * across)
    return bool(np.ptp(radii) <= ON_CURVE * np.abs(radii).min())


def _slide_of_home(scene: Scene, move: np.ndarray) -> str:
    """Describe how home moves in one direction, in metres and degrees."""
    far, turn = float(np.hypot(*move[:2])), np.degrees(move[2])
    if far < 1e-9:
        return "home turns"
    towards = np.degrees(np.arctan2(move[1], move[0]))
    turning = "" if abs(turn / far) < 0.01 else f", turning by {turn / far:.1f}° per metre,"
    return f"home slides in the direction {towards:.0f}° from {scene.axis}{turning}"


def names(scene: Scene, which: np.ndarray) -> str:
    """Return "L1, L2 and L3"."""
    return listing([scene.names[i] for i in which])


ANGLE = 1e-4
"""A direction lies in a family when the sine of the angle between them is below this."""
SHARE = 0.05
"""Components below this share of the largest are not named."""


@dataclass(frozen=True)
class Freedom:
    """A set of directions that no bearing observes."""

    words: str
    """One sentence."""
    directions: np.ndarray
    """(3 + 2 q + c, k), how the unknowns of the scene can change together."""


def in_words(scene: Scene, null: np.ndarray, tolerance: float = ANGLE) -> list[Freedom]:
    """Return the meaning of directions of the unknowns of a scene, the motion of home first.

    Directions `null` (3 + 2 q + c, k) are independent, in the units of the unknowns; the directions
    of the result span the same space. A direction lies in a family when the sine of the angle
    between them is below the tolerance.
    """
    whole = orthonormal(null / scene.worth[:, None])
    described = whole[:, :0]
    freedoms: list[Freedom] = []
    for family in FAMILIES:
        block = family.block(scene)
        found = beyond(common(whole, block, tolerance), described)
        for words, directions in family.describe(scene, found) if found.size else []:
            freedoms.append(Freedom(words, directions * scene.worth[:, None]))
            described = orthonormal(np.hstack([described, directions]))
    freedoms += [
        Freedom(_components(scene, v), (v * scene.worth)[:, None])
        for v in beyond(whole, described).T
    ]
    home = scene.worth[:POLAR, None]
    return sorted(freedoms, key=lambda f: np.abs(f.directions[:POLAR] / home).max() <= 1e-6)


Described = list[tuple[str, np.ndarray]]
"""Sentences, each with its directions."""


def _home_alone(scene: Scene, found: np.ndarray) -> Described:
    """Home moves while robot and landmarks stay."""
    moves = found[:POLAR] * scene.worth[:POLAR, None]
    return [(_freedom_of_home(scene, moves), found)]


def _home_anywhere(scene: Scene, found: np.ndarray) -> Described:
    """Home may have any pose, because landmarks may slide along their lines of sight."""
    if np.linalg.matrix_rank(found[:POLAR], tol=1e-6) < POLAR:
        return []
    _, _, v = np.linalg.svd(found[:POLAR])
    words = (
        "home may lie anywhere as seen from the robot, facing any way: the distances of the"
        " landmarks are unknown and can compensate"
    )
    return [(words, orthonormal(found @ v[:POLAR].T))]


def _growth(scene: Scene) -> np.ndarray:
    """Return the direction in which all distances and the speed grow together."""
    grow = np.zeros(len(scene.worth))
    grow[:2] = scene.home[:2] - scene.poses[0, :2]
    marks = slice(POLAR, POLAR + 2 * len(scene.landmarks))
    grow[marks] = (scene.landmarks - scene.poses[0, :2]).ravel()
    if "speed-scale" in scene.unknown:
        grow[marks.stop + scene.unknown.index("speed-scale")] = 1.0
    return orthonormal((grow / scene.worth)[:, None])


def _scale(scene: Scene, found: np.ndarray) -> Described:
    """All distances grow together."""
    scaled = "speed-scale" in scene.unknown
    what = "the speed's scale and all distances" if scaled else "all distances"
    words = f"{what} may grow or shrink together by any factor: the scale is unobservable"
    return [(words, found)]


def _calibration(scene: Scene, found: np.ndarray) -> Described:
    """Only calibrations change."""
    first = POLAR + 2 * len(scene.landmarks)
    alone = np.abs(found[first:]).max(axis=1) > SHARE
    names = [_plain(name) for name, is_in in zip(scene.unknown, alone, strict=True) if is_in]
    return [(f"unobservable: {listing(names)}", found)]


def _landmarks_alone(scene: Scene, found: np.ndarray) -> Described:
    """Single landmarks move while everything else stays."""
    alike: dict[str, list[int]] = {}
    for i in range(len(scene.landmarks)):
        own = common(found, _mark_block(scene, i), ANGLE)
        if own.shape[1]:
            alike.setdefault(_mark_words(scene, i, own), []).append(i)
    described = []
    for words, which in alike.items():
        block = np.hstack([_mark_block(scene, i) for i in which])
        part = common(found, block, ANGLE)
        described.append((f"{names(scene, np.array(which))} {words}", part))
    return described


def _mark_block(scene: Scene, i: int) -> np.ndarray:
    return np.eye(len(scene.worth))[:, POLAR + 2 * i : POLAR + 2 * i + 2]


def _mark_words(scene: Scene, i: int, found: np.ndarray) -> str:
    """Describe where landmark i may lie."""
    if found.shape[1] == 2:
        return "may lie anywhere"
    move = found[POLAR + 2 * i : POLAR + 2 * i + 2, 0]
    sight = _sight(scene, i)
    if abs(move[0] * sight[1] - move[1] * sight[0]) < 1e-3 * np.hypot(*move):
        return "may lie anywhere on the line of sight from the robot"
    home = scene.landmarks[i] - scene.home[:2]
    if abs(move[0] * home[1] - move[1] * home[0]) < 1e-3 * np.hypot(*move) * np.hypot(*home):
        return "may lie anywhere on the line of sight from home"
    return "may shift in one direction"


def _home_and_sights(scene: Scene, found: np.ndarray) -> Described:
    """Home moves, and some landmarks slide along their lines of sight."""
    described = []
    for v in found.T:
        slides = np.hypot(*v[POLAR : POLAR + 2 * len(scene.landmarks)].reshape(-1, 2).T)
        which = np.flatnonzero(slides > SHARE * slides.max())
        one = which.size == 1
        sliding = f"{names(scene, which)} {'slides' if one else 'slide'} along the"
        sliding += f" {'line' if one else 'lines'} of sight from the robot"
        moving = np.abs(v[:POLAR]).max() > 1e-6
        home = v[:POLAR] * scene.worth[:POLAR]
        words = f"{_slide_of_home(scene, home)} while {sliding}" if moving else sliding
        described.append((words, v[:, None]))
    return described


def _components(scene: Scene, v: np.ndarray) -> str:
    """Describe a direction by its largest components, in their units, the largest first."""
    q = len(scene.landmarks)
    parts = [
        (float(np.hypot(*v[:2])), "home's place", float(np.hypot(*v[:2])) * scene.length, "m"),
        (abs(float(v[2])), "home's heading", abs(float(np.degrees(v[2]))), "°"),
    ]
    marks = np.hypot(*v[POLAR : POLAR + 2 * q].reshape(-1, 2).T)
    parts += [(float(m), scene.names[i], float(m) * scene.length, "m") for i, m in enumerate(marks)]
    for k, name in enumerate(scene.unknown):
        size = abs(float(v[POLAR + 2 * q + k]))
        real = size * float(scene.worth[POLAR + 2 * q + k])
        parts.append((size, _plain(name), real, UNITS[CALIBRATIONS.index(name)]))
    largest = max(size for size, *_ in parts)
    named = sorted((p for p in parts if p[0] > 4 * SHARE * largest), reverse=True)
    text = [f"{what} by {real:.2g} {unit}".rstrip() for _, what, real, unit in named[:4]]
    more = f" and {len(named) - 4} more" if len(named) > 4 else ""
    return "these can change together: " + ", ".join(text) + more


def _plain(name: str) -> str:
    """Return a calibration's name with its article."""
    return {"speed-scale": "the speed's scale", "turn-scale": "the turn rate's scale"}.get(
        name, "the " + name.replace("-", " ")
    )


def _home_and_sight_block(scene: Scene) -> np.ndarray:
    """Return orthonormal directions: home's pose, and each landmark along its line of sight."""
    q = len(scene.landmarks)
    block = np.zeros((len(scene.worth), POLAR + q))
    block[:POLAR, :POLAR] = np.eye(POLAR)
    for i in range(q):
        block[POLAR + 2 * i : POLAR + 2 * i + 2, POLAR + i] = _sight(scene, i)
    return block


def _sight(scene: Scene, i: int) -> np.ndarray:
    """Return the unit vector to landmark i from the mean position where the robot saw it."""
    rows = scene.visible[:, i]
    origin = scene.poses[rows if rows.any() else slice(None), :2].mean(axis=0)
    away = scene.landmarks[i] - origin
    return np.asarray(away / max(float(np.hypot(*away)), 1e-12))


@dataclass(frozen=True)
class Family:
    """Directions with a common meaning."""

    block: Callable[[Scene], np.ndarray]
    """Returns orthonormal directions that span the family."""
    describe: Callable[[Scene, np.ndarray], Described]
    """Returns the meaning of directions in it; empty where the family does not apply."""


FAMILIES = (
    Family(lambda s: np.eye(len(s.worth))[:, :POLAR], _home_alone),
    Family(_home_and_sight_block, _home_anywhere),
    Family(_growth, _scale),
    Family(lambda s: np.eye(len(s.worth))[:, POLAR + 2 * len(s.landmarks) :], _calibration),
    Family(
        lambda s: np.eye(len(s.worth))[:, POLAR : POLAR + 2 * len(s.landmarks)], _landmarks_alone
    ),
    Family(_home_and_sight_block, _home_and_sights),
)
"""In the order in which they are tried."""
