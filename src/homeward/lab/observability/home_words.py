"""Where home may lie, in words: anywhere, on a circle, on a line."""

from __future__ import annotations

import numpy as np

from homeward.io.naming import listing
from homeward.lab.model import POLAR
from homeward.lab.observability.scene import Scene

ON_IT = 1e-4
"""A landmark lies on a line, or on a circle, when it is off by less than this [1]."""


def freedom_of_home(scene: Scene, moves: np.ndarray) -> str:
    """Say how home moves, given (3, k) directions of its pose."""
    place = np.linalg.svd(moves[:2] / scene.length, compute_uv=False)
    dims = int((place > 1e-6).sum())
    if moves.shape[1] == POLAR:
        return "home may lie anywhere, facing any way"
    if dims == 0:
        return "home may face any way"
    if dims == 2:
        seen = scene.stored.nonzero()[0]
        name = f"{scene.names[seen[0]]} appears" if seen.size == 1 else "its landmarks appear"
        return f"home may lie anywhere, facing so that {name} under the stored bearing"
    along = moves[:, int(np.argmax(np.hypot(*moves[:2])))]
    direction = along[:2] / np.hypot(*along[:2])
    return _curve(scene, direction, float(along[2]))


def _curve(scene: Scene, direction: np.ndarray, turn: float) -> str:
    """Say along which curve home moves in a direction (2,): circle, line, or else its bearing."""
    home = scene.home[:2]
    stored = np.flatnonzero(scene.stored)
    marks = scene.landmarks[stored]
    away = marks - home
    far = np.maximum(np.hypot(*away.T), 1e-12)
    ahead = np.abs(direction[0] * away[:, 1] - direction[1] * away[:, 0]) / far
    if ahead.size and ahead.max() < ON_IT and abs(turn) * scene.length < ON_IT:
        return (
            f"home may lie anywhere on the line through itself and {names(scene, stored)},"
            " on this side of it"
        )
    across = np.abs(away @ direction) / far
    if stored.size == 1 and across[0] < ON_IT:
        return f"home may lie anywhere on a circle around {scene.names[stored[0]]}"
    centre = _tangent_circle(home, direction, marks)
    if stored.size >= 2 and centre is not None:
        return (
            f"home may lie anywhere on the circle through itself, {names(scene, stored)}"
            " (on its arc between them), turning as it goes"
        )
    angle = np.degrees(np.arctan2(direction[1], direction[0]))
    return f"home slides in the direction {angle:.0f}° from {scene.axis}"


def _tangent_circle(
    home: np.ndarray, direction: np.ndarray, marks: np.ndarray
) -> np.ndarray | None:
    """Return the centre of the circle that touches `direction` at home and holds all marks."""
    normal = np.array([-direction[1], direction[0]])
    away = marks - home
    across = away @ normal
    if len(marks) < 2 or np.abs(across).min() < 1e-9:
        return None
    radii = (away**2).sum(axis=1) / (2 * across)
    if np.ptp(radii) > ON_IT * np.abs(radii).min():
        return None
    return np.asarray(home + radii[0] * normal)


def slide_of_home(scene: Scene, move: np.ndarray) -> str:
    """Say how home moves in one direction, in metres and degrees."""
    far, turn = float(np.hypot(*move[:2])), np.degrees(move[2])
    if far < 1e-9:
        return "home turns"
    towards = np.degrees(np.arctan2(move[1], move[0]))
    turning = "" if abs(turn / far) < 0.01 else f", turning by {turn / far:.1f}° a metre,"
    return f"home slides in the direction {towards:.0f}° from {scene.axis}{turning}"


def names(scene: Scene, which: np.ndarray) -> str:
    """Return "L1, L2 and L3"."""
    return listing([scene.names[i] for i in which])
