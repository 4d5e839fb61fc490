"""A drive of a study, and what is known of it that no estimator is told."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from homeward.drives.drive import Drive
from homeward.simulation.simulate import Simulation
from homeward.studies.study.bound import has_bound, simulation_bound

Bound = tuple[np.ndarray, np.ndarray] | None
"""Stamps (n,) and covariances (n, 3, 3) of `simulation_bound`, or None where it is not known."""


@dataclass(frozen=True)
class Trial:
    """A drive with truth, and by what its estimators are judged."""

    drive: Drive
    moved: frozenset[str]
    """Landmarks whose home bearing is wrong."""
    none_else: bool
    """Whether it is known that no other's is."""
    true_home: dict[str, float]
    """Right home bearings of all landmarks, in the robot's home frame [rad]."""
    final_distance: float
    """True distance from home at the end [m]."""
    bound: Bound


def simulated_trial(simulation: Simulation) -> Trial:
    """Return the trial of a simulation: where landmarks stand is known."""
    world = simulation.world
    return Trial(
        simulation.drive,
        frozenset(world.moved),
        True,
        dict(zip(world.ids, np.arctan2(*world.in_home_frame.T[::-1]).tolist(), strict=True)),
        simulation.final_distance,
        simulation_bound(simulation) if has_bound(simulation) else None,
    )
