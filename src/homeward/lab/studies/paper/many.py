"""One filter through many worlds of the paper's cases at once, by the batch engine."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from homeward.lab.engine.batch.homing import Law, homing_program, run_homing
from homeward.lab.engine.program.interpreter import allocate
from homeward.lab.filters.ekf import ExtendedKalmanFilter
from homeward.lab.filters.settings import Engine
from homeward.lab.studies.paper.cases import control_law, fill, filter_kind, filter_settings
from homeward.lab.studies.paper.settings import PaperSettings
from homeward.lab.studies.paper.world import CaseName, World

OF_WORLD = ("pose", "landmarks", "stored", "state")
"""Inputs of the loop that differ from world to world."""
DRAWN = {"mask": "visible", "noise": "noise", "disturbance": "disturbance"}
"""Those that differ from sample to sample, by what of a world they are."""
FAR = 0.2
"""Nearer to home than this [m] its direction, theta, says little."""


@dataclass(frozen=True)
class Errors:
    """What is kept of one filter's runs; infinite where it diverged."""

    rmse: np.ndarray
    """(runs, 3), of R [m], theta, alpha [rad] over each run."""
    theta_far: np.ndarray
    """(runs,), RMSE of theta [rad] over the samples farther than `FAR` from home."""
    final: np.ndarray
    """(runs, 3), the size of the last sample's errors of R [m], theta, alpha [rad]."""
    final_distance: np.ndarray
    """(runs,), true distance from home at the end [m]."""


def errors_over(error: np.ndarray, pose: np.ndarray) -> Errors:
    """Return what is kept of one run, with a leading axis of one.

    Errors (k, 3) are of R [m], theta, alpha [rad] at each sample, no numbers where the filter
    diverged; poses (k, 3) are true.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        square = np.square(error)
        distance = np.hypot(pose[:, 0], pose[:, 1])
        far = square[distance > FAR, 1]
        rmse, theta = np.sqrt(square.mean(axis=0)), np.sqrt(far.mean() if far.size else np.nan)
    lost = not np.isfinite(rmse).all()
    none = np.full(3, np.inf)
    return Errors(
        (none if lost else rmse)[None],
        np.array([np.inf if lost else theta]),
        (none if lost else np.abs(error[-1]))[None],
        distance[-1:],
    )


def run_many(
    name: str,
    case: CaseName,
    worlds: Sequence[World],
    settings: PaperSettings,
    engine: Engine = "auto",
) -> Errors:
    """Run a filter of `homeward.lab.studies.paper.cases` through worlds, each as `run_filter` does.

    They have as many samples each.
    """
    worlds = [rolled(world) for world in worlds]
    kind, law, given = given_of(name, case, worlds, settings)
    last = len(worlds[0].visible) - 1

    def over_time(name: str) -> np.ndarray:
        values = np.array([getattr(world, name)[:last] for world in worlds])
        return values[..., 0] if values.shape[-1] == 1 else values  # of one landmark, numbers

    result = run_homing(
        kind,
        given,
        runs=len(worlds),
        steps=last,
        law=law,
        series={key: over_time(name) for key, name in DRAWN.items()},
        history=("error", "pose"),
        engine=engine,
        threads=1,
    )
    error, pose = result.history["error"], result.history["pose"]
    far = np.hypot(pose[..., 0], pose[..., 1]) > FAR
    square = np.square(error[..., 1], where=far, out=np.zeros(far.shape))
    with np.errstate(invalid="ignore"):
        theta = np.sqrt(square.sum(axis=1) / far.sum(axis=1))
    final = np.abs(error[np.arange(len(worlds)), result.samples - 1])
    lost = result.diverged
    return Errors(
        result.rmse,
        np.where(lost, np.inf, theta),
        np.where(lost[:, None], np.inf, final),
        result.final_distance,
    )


def given_of(
    name: str, case: CaseName, worlds: Sequence[World], settings: PaperSettings
) -> tuple[ExtendedKalmanFilter, Law, dict[str, np.ndarray | float]]:
    """Return a filter, its law, and what `run_homing` is given of each world but the noise.

    Worlds are `rolled`.
    """
    settings = filter_settings(name, settings)
    kind = filter_kind(name, worlds[0], settings)
    law = control_law(case, settings)
    _, given = allocate(homing_program(kind, law).shapes)
    of_world: dict[str, list[np.ndarray]] = {key: [] for key in OF_WORLD}
    for world in worlds:
        fill(given, kind, world, settings)
        for key in OF_WORLD:
            of_world[key].append(given[key].copy())
    constant = {k: v for k, v in given.items() if k not in (*OF_WORLD, *DRAWN)}
    # Open loop, nothing ends a run.
    radius = 0.0 if case == "4" else settings.assumed.stop_radius
    own = {k: np.array(v) for k, v in of_world.items()}
    return kind, law, {**constant, **own, "stop_radius": radius}


def rolled(world: World) -> World:
    """Return the same world with its landmarks counted from the first wrong one on.

    So one compiled filter serves all.
    """
    first = int(np.argmax(world.faults != 0))
    return replace(
        world,
        landmarks=np.roll(world.landmarks, -first, axis=0),
        faults=np.roll(world.faults, -first),
        moved=np.roll(world.moved, -first),
        visible=np.roll(world.visible, -first, axis=1),
        noise=np.roll(world.noise, -first, axis=1),
    )
