"""Drives that show what can and cannot be told: straight, on the spot, home on a circle."""

from __future__ import annotations

from typing import Literal

import numpy as np

from homeward.geometry.frames import Pose, between, compose
from homeward.lab.observability.scene import Calibration, Scene, drive

Motion = Literal["arc", "straight", "towards", "spot", "still", "circle"]
MOTIONS: dict[Motion, str] = {
    "arc": "an arc",
    "straight": "straight on",
    "towards": "straight towards L1",
    "spot": "turning on the spot",
    "still": "standing still",
    "circle": "an arc, with home on the circle through all landmarks",
}
STEPS = 12
DURATION = 12.0
"""[s]"""
SPEED = 0.2
"""[m/s]"""
GOLDEN = np.pi * (3 - np.sqrt(5))
"""Turning by this angle again and again [rad], no two landmarks come in line."""
START = Pose(0.9, -0.6, 0.4)
"""Of the robot, from home."""


def make_scene(
    landmarks: int,
    motion: Motion = "arc",
    unknown: tuple[Calibration, ...] = (),
    compass: bool = False,
    distances: bool = False,
) -> Scene:
    """Return a drive of 12 s past landmarks that are all seen all the time, and by home.

    Parameters
    ----------
    landmarks : int
        How many, at generic places 1.5 to 3 m from home; for "circle", all on one circle with it.
    motion : str
        One of `MOTIONS`.
    unknown, compass, distances
        As in `Scene`.
    """
    marks = _on_a_circle(landmarks) if motion == "circle" else _around(landmarks)
    if motion == "towards":
        ahead = compose(START, Pose(2.0 + SPEED * DURATION, 0.0, 0.0))
        marks[0] = ahead.x, ahead.y
    twists = np.zeros((STEPS, 2))
    twists[:, 0] = 0.0 if motion in ("spot", "still") else SPEED
    if motion in ("arc", "circle", "spot"):
        # The turn rate changes, lest its scale and its bias look the same.
        twists[:, 1] = np.linspace(0.15, 0.45, STEPS)
    intervals = np.full(STEPS, DURATION / STEPS)
    home = between(START, Pose(0.0, 0.0, 0.0))
    seen = between(START, Pose(marks[:, 0], marks[:, 1], 0.0))
    return Scene(
        names=tuple(f"L{i + 1}" for i in range(landmarks)),
        home=np.array(home, float),
        landmarks=np.stack([seen.x, seen.y], axis=1),
        poses=drive(Pose(0.0, 0.0, 0.0), twists, intervals),
        visible=np.ones((STEPS + 1, landmarks), bool),
        stored=np.ones(landmarks, bool),
        twists=twists,
        intervals=intervals,
        unknown=unknown,
        compass=compass,
        distances=distances,
    )


def _around(q: int) -> np.ndarray:
    """Return q generic places around home, shape (q, 2)."""
    i = np.arange(q)
    far = 1.5 + 1.5 * ((0.618034 * i + 0.3) % 1.0)
    return np.stack([far * np.cos(GOLDEN * i + 0.7), far * np.sin(GOLDEN * i + 0.7)], axis=1)


def _on_a_circle(q: int) -> np.ndarray:
    """Return q places on a circle that passes through home, shape (q, 2)."""
    angle = 0.8 + 2 * np.pi * (np.arange(q) + 1) / (q + 1.5)
    centre = 1.6 * np.array([np.cos(0.8), np.sin(0.8)])
    return np.asarray(-1.6 * np.stack([np.cos(angle), np.sin(angle)], axis=1) + centre)
