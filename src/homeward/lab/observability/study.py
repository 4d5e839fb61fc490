"""What a user asks of a model or a drive: a rank, what it means, and worlds that look the same."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from homeward.errors import InputError
from homeward.lab.observability.lie import MOST_LANDMARKS, ModelRank, observe_model
from homeward.lab.observability.motions import MOTIONS, Motion, make_scene
from homeward.lab.observability.ranks import Rank
from homeward.lab.observability.scene import CALIBRATIONS, Calibration, Scene
from homeward.lab.observability.trace import Trace, trace_family
from homeward.lab.observability.words import Freedom, in_words


@dataclass(frozen=True)
class SceneView:
    """What all the bearings of one drive past landmarks tell."""

    title: str
    scene: Scene
    found: Rank
    """Of everything measured by all unknowns: home (3), landmarks (2 q), calibration."""
    freedoms: tuple[Freedom, ...]
    """What cannot be told, in words; none when everything can."""

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
    """What cannot be told, in words."""
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
    """Return what bearings to q landmarks can tell, in numbers, in words and as a family of worlds.

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
    """Return what the usual motions and unknown calibrations tell, one after the other."""
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
    return Scene(
        names=tuple(f"L{i + 1}" for i in range(q)),
        home=model.home,
        landmarks=model.marks,
        poses=np.zeros((1, 3)),
        visible=np.ones((1, q), bool),
        stored=np.ones(q, bool),
        compass=model.compass,
        distances=model.distances,
        axis="the robot's heading",
    )


def _title(q: int, motion: Motion, unknown: tuple[Calibration, ...]) -> str:
    text = f"{q} landmark{'' if q == 1 else 's'}, {MOTIONS[motion]}"
    told = ", ".join(name.replace("-", " ") for name in unknown)
    return f"{text}; unknown: {told}" if told else text
