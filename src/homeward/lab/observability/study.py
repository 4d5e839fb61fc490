"""Analysis of a model or a drive: rank, meaning, and worlds that look the same."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from homeward.errors import InputError
from homeward.geometry.frames import Pose, between, compose
from homeward.lab.model import POLAR
from homeward.lab.observability.lie import MOST_LANDMARKS, ModelRank, observe_model
from homeward.lab.observability.ranks import Rank
from homeward.lab.observability.scene import CALIBRATIONS, Calibration, Scene, drive
from homeward.lab.observability.words import Freedom, in_words

STEP = 0.08
"""From one member to the next home or a landmark moves by this share of the scene's length."""
MEMBERS = 32
"""On either side at most."""
RAYS = 6
"""Number of directions followed where home is free in more than one."""
NEWTON = 4
NEARLY = 1e-7
SAME = 1e-9
"""Members differ by less than this in every bearing [rad]."""


@dataclass(frozen=True)
class Trace:
    """A curve of members, followed from the true one."""

    unknowns: np.ndarray
    """(k, 3 + 2 q + c), the unknowns of the scene, the truth among them."""
    difference: float
    """The largest difference of anything measured between a member and the truth [rad, m]."""

    @property
    def homes(self) -> np.ndarray:
        """(k, 3), home in each: x [m], y [m], heading [rad]."""
        return self.unknowns[:, :POLAR]

    def landmarks(self, q: int) -> np.ndarray:
        """Return the landmarks in each member, shape (k, q, 2) [m]."""
        return self.unknowns[:, POLAR : POLAR + 2 * q].reshape(-1, q, 2)


def trace_family(scene: Scene) -> list[Trace]:
    """Follow the null space of a scene, and return curves of worlds that look the same.

    There is none when all is observable, one for one free direction, else `RAYS` of them. Each
    step goes along the local null space, and Newton's method then removes the effect of curvature.
    A curve ends where a member stops looking the same: at a landmark, say.
    """
    null = scene.rank().null / scene.worth[:, None]
    if not null.size:
        return []
    base = np.linalg.qr(null)[0]
    if base.shape[1] == 1:
        starts = [base[:, 0]]
    else:
        # The two directions that move home the most, and those between them.
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
    """Return members one after the other from the truth, the truth itself left out."""
    worth, size = scene.worth, scene.rank().null.shape[1]
    now, members = scene.truth, []
    tangents = _split(scene.jacobian() * worth, size)[1]
    for _ in range(MEMBERS):
        direction = tangents.T @ (tangents @ direction)
        reach = float(np.abs(direction).max())
        if reach < 1e-9:
            break
        direction = direction / reach
        now = now + STEP * direction * worth
        for _ in range(NEWTON):
            off, jacobian = scene.compare(now)
            across, tangents = _split(jacobian * worth, size)
            now = now - worth * (across @ off)
            if np.abs(off).max() < NEARLY:
                break  # the step just taken squares this
        if not np.abs(scene.compare(now)[0]).max() < SAME:
            break
        members.append(now)
    return members


def _split(jacobian: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the pseudo-inverse across the null space of a given size, and that space's basis."""
    # By eigenvectors of the small normal matrix: Newton's method takes out what that loses.
    values, vectors = np.linalg.eigh(jacobian.T @ jacobian)
    kept = vectors[:, size:]
    return kept @ (kept.T @ jacobian.T / values[size:, None]), vectors[:, :size].T


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

    They stand at generic places 1.5 to 3 m from home; for the motion "circle", all on one circle
    with it. `unknown`, `compass` and `distances` are those of `Scene`.
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
    names, places = tuple(f"L{i + 1}" for i in range(landmarks)), np.stack([seen.x, seen.y], axis=1)
    poses = drive(Pose(0.0, 0.0, 0.0), twists, intervals)
    visible, stored = np.ones((STEPS + 1, landmarks), bool), np.ones(landmarks, bool)
    given = visible, stored, twists, intervals, unknown, compass, distances
    return Scene(names, np.array(home, float), places, poses, *given)


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


@dataclass(frozen=True)
class SceneView:
    """What all bearings of one drive past landmarks determine."""

    title: str
    scene: Scene
    found: Rank
    """Of everything measured by all unknowns: home (3), landmarks (2 q), calibration."""
    freedoms: tuple[Freedom, ...]
    """Unobservable directions, in words."""

    @property
    def unknowns(self) -> int:
        """How many there are."""
        return len(self.scene.truth)


@dataclass(frozen=True)
class ModelView:
    """The paper's question for q landmarks, with a drive that shows the answer."""

    model: ModelRank | None
    """Rank of the Lie derivatives, where any drive was asked for; they know no calibration."""
    freedoms: tuple[Freedom, ...]
    """Unobservable directions, in words."""
    drive: SceneView
    family: tuple[Trace, ...]
    """Other worlds in which every bearing of that drive is the same."""


def observe(
    landmarks: int,
    *,
    compass: bool = False,
    distances: bool = False,
    motion: Motion | None = None,
    unknown: tuple[Calibration, ...] = (),
) -> ModelView:
    """Return what bearings to q landmarks determine: numbers, words and a family of worlds.

    Parameters
    ----------
    landmarks : int
        q, from 1 to `MOST_LANDMARKS`.
    compass, distances : bool
        Whether the heading, and the landmarks' distances from home, are known.
    motion : str, optional
        One of `MOTIONS`; by default any motion, for which Lie derivatives answer, shown on an arc.
    unknown : tuple of str
        Which of `CALIBRATIONS` are unknown too.

    Raises
    ------
    InputError
        For a number of landmarks, a motion or a calibration that there is not.
    """
    if not 1 <= landmarks <= MOST_LANDMARKS:
        raise InputError(f"landmarks must be from 1 to {MOST_LANDMARKS}, not {landmarks}")
    if motion is not None and motion not in MOTIONS:
        raise InputError(f"no motion {motion!r}; there are: {', '.join(MOTIONS)}")
    for name in unknown:
        if name not in CALIBRATIONS:
            raise InputError(f"nothing called {name!r}; there are: {', '.join(CALIBRATIONS)}")
    if motion == "circle" and landmarks < 2:
        raise InputError("a circle through home and its landmarks needs two of them")
    unknown = tuple(sorted(set(unknown), key=CALIBRATIONS.index))
    scene = make_scene(landmarks, motion or "arc", unknown, compass, distances)
    drive = observe_scene(_title(landmarks, motion or "arc", unknown), scene)
    model, freedoms = None, drive.freedoms
    if motion is None and not unknown:
        model = observe_model(landmarks, compass, distances)
        freedoms = tuple(in_words(model_scene(model), model.null))
    return ModelView(model, freedoms, drive, tuple(trace_family(scene)))


def observe_scene(title: str, scene: Scene) -> SceneView:
    """Return rank and meaning of a scene."""
    found = scene.rank()
    return SceneView(title, scene, found, tuple(in_words(scene, found.null)))


def observe_motions() -> tuple[SceneView, ...]:
    """Return the views of the usual motions and unknown calibrations, one after the other."""
    asked: list[tuple[int, Motion, tuple[Calibration, ...]]] = [
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
    return tuple(
        observe_scene(_title(q, motion, unknown), make_scene(q, motion, unknown))
        for q, motion, unknown in asked
    )


def model_scene(model: ModelRank) -> Scene:
    """Return the place at which a model's null space was found, as a scene of one pose."""
    q = model.landmarks
    names = tuple(f"L{i + 1}" for i in range(q))
    return Scene(
        *(
            names,
            model.home,
            model.marks,
            np.zeros((1, 3)),
            np.ones((1, q), bool),
            np.ones(q, bool),
        ),
        compass=model.compass,
        distances=model.distances,
        axis="the robot's heading",
    )


def _title(q: int, motion: Motion, unknown: tuple[Calibration, ...]) -> str:
    text = f"{q} landmark{'' if q == 1 else 's'}, {MOTIONS[motion]}"
    told = ", ".join(name.replace("-", " ") for name in unknown)
    return f"{text}; unknown: {told}" if told else text
