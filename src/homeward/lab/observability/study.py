"""Analysis of a model or a drive: rank, unobservable directions, and indistinguishable worlds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from homeward.errors import InputError
from homeward.geometry.frames import Pose, between, compose
from homeward.lab.model import POLAR
from homeward.lab.observability.lie import MAX_LANDMARKS, ModelRank, observe_model
from homeward.lab.observability.scene import (
    CALIBRATIONS,
    Calibration,
    Scene,
    drive,
    landmark_names,
)
from homeward.lab.observability.words import Freedom, in_words

STEP = 0.08
"""Largest change of an unknown from one member to the next, in units of `Scene.worth`."""
MAX_MEMBERS = 32
"""Largest number of members on either side."""
RAYS = 6
"""Number of directions followed where home is free in more than one."""
MAX_NEWTON = 4
"""Largest number of Newton steps."""
NEWTON_TOLERANCE = 1e-7
"""Difference before a Newton step [rad] below which no further one is needed."""
SAME = 1e-9
"""Members differ by less than this in every measurement [rad, m]."""


@dataclass(frozen=True)
class Trace:
    """A curve of worlds that produce the same measurements as the true one."""

    unknowns: np.ndarray
    """(k, 3 + 2 q + c), the unknowns of each member; the true values are among them."""
    difference: float
    """Largest difference between a measurement of a member and its true value [rad, m]."""

    @property
    def homes(self) -> np.ndarray:
        """(k, 3), home in each member: x [m], y [m], heading [rad]."""
        return self.unknowns[:, :POLAR]

    def landmarks(self, q: int) -> np.ndarray:
        """Return the landmarks in each member, shape (k, q, 2) [m]."""
        return self.unknowns[:, POLAR : POLAR + 2 * q].reshape(-1, q, 2)


def trace_family(scene: Scene) -> list[Trace]:
    """Return curves of indistinguishable worlds along the null space of a scene.

    There is none when everything is observable, one for one free direction, otherwise `RAYS`. Each
    step goes along the local null space; Newton's method then removes the effect of curvature. A
    curve ends where a member becomes distinguishable, for example at a landmark.
    """
    null = scene.rank.null / scene.worth[:, None]
    if not null.size:
        return []
    base = np.linalg.qr(null)[0]
    if base.shape[1] == 1:
        starts = [base[:, 0]]
    else:
        # The two directions that move home the most, and directions between them.
        _, _, v = np.linalg.svd(base[:2])
        angles = np.pi * np.arange(RAYS) / RAYS
        starts = [base @ (np.cos(a) * v[0] + np.sin(a) * v[1]) for a in angles]
    return [_both_ways(scene, start) for start in starts]


def _both_ways(scene: Scene, direction: np.ndarray) -> Trace:
    back, ahead = (_follow(scene, sign * direction) for sign in (-1.0, 1.0))
    members = np.array([*reversed(back), scene.truth, *ahead])
    worst = max(float(np.abs(scene.compare(m)[0]).max()) for m in members)
    return Trace(members, worst)


def _follow(scene: Scene, direction: np.ndarray) -> list[np.ndarray]:
    """Return members in order from the true world, which is not included."""
    worth, size = scene.worth, scene.rank.null.shape[1]
    now, members = scene.truth, []
    tangents = _split(scene.jacobian() * worth, size)[1]
    for _ in range(MAX_MEMBERS):
        direction = tangents.T @ (tangents @ direction)
        reach = float(np.abs(direction).max())
        if reach < 1e-9:
            break
        direction = direction / reach
        now = now + STEP * direction * worth
        for _ in range(MAX_NEWTON):
            off, jacobian = scene.compare(now)
            across, tangents = _split(jacobian * worth, size)
            now = now - worth * (across @ off)
            if np.abs(off).max() < NEWTON_TOLERANCE:
                break  # convergence is quadratic
        if not np.abs(scene.compare(now)[0]).max() < SAME:
            break
        members.append(now)
    return members


def _split(jacobian: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the pseudo-inverse outside a null space of a given size, and a basis of that space."""
    # The normal matrix is small and loses digits, which Newton's method recovers.
    values, vectors = np.linalg.eigh(jacobian.T @ jacobian)
    kept = vectors[:, size:]
    return kept @ (kept.T @ jacobian.T / values[size:, None]), vectors[:, :size].T


Motion = Literal["arc", "straight", "towards", "spot", "still", "circle"]
MOTIONS: dict[Motion, str] = {
    "arc": "an arc",
    "straight": "straight ahead",
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
"""Angle between successive landmarks [rad], with which no two are in line."""
START = Pose(0.9, -0.6, 0.4)
"""Start pose of the robot in the home frame."""


def make_scene(
    landmarks: int,
    motion: Motion = "arc",
    unknown: tuple[Calibration, ...] = (),
    compass: bool = False,
    distances: bool = False,
) -> Scene:
    """Return a drive of 12 s with all landmarks in view at every stamp and at home.

    Landmarks are at generic places 1.5 to 3 m from home; for the motion "circle", on one circle
    with home. `unknown`, `compass` and `distances` are those of `Scene`.
    """
    marks = _on_a_circle(landmarks) if motion == "circle" else _around(landmarks)
    if motion == "towards":
        ahead = compose(START, Pose(2.0 + SPEED * DURATION, 0.0, 0.0))
        marks[0] = ahead.x, ahead.y
    twists = np.zeros((STEPS, 2))
    twists[:, 0] = 0.0 if motion in ("spot", "still") else SPEED
    if motion in ("arc", "circle", "spot"):
        # At a constant yaw rate, its scale and its bias could not be distinguished.
        twists[:, 1] = np.linspace(0.15, 0.45, STEPS)
    intervals = np.full(STEPS, DURATION / STEPS)
    home = between(START, Pose(0.0, 0.0, 0.0))
    seen = between(START, Pose(marks[:, 0], marks[:, 1], 0.0))
    names, places = landmark_names(landmarks), np.stack([seen.x, seen.y], axis=1)
    poses = drive(Pose(0.0, 0.0, 0.0), twists, intervals)
    visible, stored = np.ones((STEPS + 1, landmarks), bool), np.ones(landmarks, bool)
    given = visible, stored, twists, intervals, unknown, compass, distances
    title = _title(landmarks, motion, unknown)
    return Scene(names, np.array(home, float), places, poses, *given, title=title)


def _around(q: int) -> np.ndarray:
    """Return q generic places around home, shape (q, 2) [m]."""
    i = np.arange(q)
    far = 1.5 + 1.5 * ((0.618034 * i + 0.3) % 1.0)
    return np.stack([far * np.cos(GOLDEN * i + 0.7), far * np.sin(GOLDEN * i + 0.7)], axis=1)


def _on_a_circle(q: int) -> np.ndarray:
    """Return q places on a circle through home, shape (q, 2) [m]."""
    angle = 0.8 + 2 * np.pi * (np.arange(q) + 1) / (q + 1.5)
    centre = 1.6 * np.array([np.cos(0.8), np.sin(0.8)])
    return np.asarray(-1.6 * np.stack([np.cos(angle), np.sin(angle)], axis=1) + centre)


@dataclass(frozen=True)
class ModelView:
    """Observability of the paper's model with q landmarks, and an example drive."""

    model: ModelRank | None
    """Rank of the Lie derivatives, over all motions; None for one motion or with calibrations."""
    freedoms: tuple[Freedom, ...]
    """Unobservable directions, in words."""
    drive: Scene
    family: tuple[Trace, ...]
    """Other worlds with the same measurements on that drive."""


def observe(
    landmarks: int,
    *,
    compass: bool = False,
    distances: bool = False,
    motion: Motion | None = None,
    unknown: tuple[Calibration, ...] = (),
) -> ModelView:
    """Return the observability from bearings to q landmarks: ranks, words and equivalent worlds.

    `unknown`, `compass` and `distances` are those of `Scene`. By default all of `MOTIONS` count
    (Lie derivatives), with an arc as the example. Raises `InputError` when the number of landmarks
    is out of range (up to `MAX_LANDMARKS`), or a motion or calibration does not exist.
    """
    if not 1 <= landmarks <= MAX_LANDMARKS:
        raise InputError(f"landmarks must be from 1 to {MAX_LANDMARKS}, not {landmarks}")
    if motion is not None and motion not in MOTIONS:
        raise InputError(f"no motion {motion!r}; choose from: {', '.join(MOTIONS)}")
    for name in unknown:
        if name not in CALIBRATIONS:
            raise InputError(f"no calibration {name!r}; choose from: {', '.join(CALIBRATIONS)}")
    if motion == "circle" and landmarks < 2:
        raise InputError("the motion circle needs at least 2 landmarks")
    unknown = tuple(sorted(set(unknown), key=CALIBRATIONS.index))
    scene = make_scene(landmarks, motion or "arc", unknown, compass, distances)
    model, freedoms = None, in_words(scene, scene.rank.null)
    if motion is None and not unknown:
        model = observe_model(landmarks, compass, distances)
        freedoms = in_words(model.scene, model.null)
    return ModelView(model, tuple(freedoms), scene, tuple(trace_family(scene)))


def observe_motions() -> tuple[Scene, ...]:
    """Return the drives of typical motions and unknown calibrations."""
    cases: list[tuple[int, Motion, tuple[Calibration, ...]]] = [
        (2, "arc", ()),
        (3, "arc", ()),
        (4, "straight", ()),
        (3, "towards", ()),
        (4, "towards", ()),
        (5, "spot", ()),
        (5, "still", ()),
        (3, "circle", ()),
        *((5, "arc", (name,)) for name in CALIBRATIONS),
        (5, "straight", ("turn-scale",)),
    ]
    return tuple(make_scene(*case) for case in cases)


def _title(q: int, motion: Motion, unknown: tuple[Calibration, ...]) -> str:
    text = f"{q} landmark{'' if q == 1 else 's'}, {MOTIONS[motion]}"
    names = ", ".join(name.replace("-", " ") for name in unknown)
    return f"{text}; unknown: {names}" if names else text
