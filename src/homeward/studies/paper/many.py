"""One filter through many worlds of the paper's cases at once, by the batch engine."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from homeward.engine.batch.homing import run_homing
from homeward.engine.choice import Engine
from homeward.engine.interpreter import Interpreter
from homeward.simulation.closed_loop import closed_loop_function
from homeward.studies.paper.cases import control_law, fill, filter_kind
from homeward.studies.paper.settings import PaperSettings
from homeward.studies.paper.world import CaseName, World

OF_WORLD = ("pose", "landmarks", "stored", "state")
"""Inputs of the loop that differ from world to world."""
DRAWN = ("mask", "noise", "disturbance")
"""Those that differ from sample to sample."""


def run_many(
    name: str,
    case: CaseName,
    worlds: Sequence[World],
    settings: PaperSettings,
    engine: Engine = "auto",
) -> tuple[np.ndarray, np.ndarray]:
    """Run one of `homeward.studies.paper.cases.FILTERS` through worlds, each as `run_filter` does.

    Returns
    -------
    rmse : ndarray, shape (worlds, 3)
        Of R [m], theta, alpha [rad] over each run; infinite where the filter diverged.
    final_distance : ndarray, shape (worlds,)
        True distance from home at the end [m].
    """
    # The first wrong landmark comes first everywhere, so that one compiled filter serves all.
    worlds = [_rolled(world) for world in worlds]
    kind = filter_kind(name, worlds[0], settings)
    law = control_law(case, settings)
    given = Interpreter(closed_loop_function(kind, law)).inputs
    of_world: dict[str, list[np.ndarray]] = {key: [] for key in OF_WORLD}
    for world in worlds:
        fill(given, kind, world, settings)
        for key in OF_WORLD:
            of_world[key].append(given[key].copy())
    constant = {k: v for k, v in given.items() if k not in (*OF_WORLD, *DRAWN)}
    # Open loop, nothing ends a run.
    radius = 0.0 if case == "4" else settings.assumed.stop_radius
    last = len(worlds[0].visible) - 1
    result = run_homing(
        kind,
        {**constant, **{k: np.array(v) for k, v in of_world.items()}, "stop_radius": radius},
        runs=len(worlds),
        steps=last,
        law=law,
        series={
            "mask": np.array([w.visible[:last] for w in worlds]),
            "noise": np.array([w.noise[:last] for w in worlds]),
            "disturbance": np.array([w.disturbance[:last] for w in worlds]),
        },
        engine=engine,
        threads=1,
    )
    return result.rmse, result.final_distance


def _rolled(world: World) -> World:
    """Return the same world with its landmarks counted from the first wrong one on."""
    first = int(np.argmax(world.faults != 0))
    return replace(
        world,
        landmarks=np.roll(world.landmarks, -first, axis=0),
        faults=np.roll(world.faults, -first),
        moved=np.roll(world.moved, -first),
        visible=np.roll(world.visible, -first, axis=1),
        noise=np.roll(world.noise, -first, axis=1),
    )
