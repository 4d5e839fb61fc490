"""The numerical heart: compiled where the compiled core is installed, else the reference in NumPy.

Both give the same numbers but for rounding. The text to read is `homeward.localizer.reference`.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

from homeward import core
from homeward.localizer.motions import Motion
from homeward.localizer.reference import motion, window
from homeward.localizer.reference.window import NormalEquations, SightedFrom, WeighedSightings
from homeward.localizer.tunables import (
    BEND,
    BRIDGED,
    GATE,
    MAX_LAG_S,
    MEAN_S,
    MIN_STEADY_SPEED,
    NUM_BENDS,
    SPEED_TIME_S,
    TURN_TIME_S,
)
from homeward.odometry.history import STEADY_S
from homeward.odometry.validity import TWIST_VALIDITY_S


@cache
def _motion_tunables(build: Callable[..., Any]) -> Any:
    """Return the tunables of `preintegrate` for the compiled core."""
    return build(
        speed_time=SPEED_TIME_S,
        turn_time=TURN_TIME_S,
        bridged=BRIDGED,
        validity=TWIST_VALIDITY_S,
        mean=MEAN_S,
        steady=STEADY_S,
        min_steady_speed=MIN_STEADY_SPEED,
        max_lag=MAX_LAG_S,
        bend=BEND,
        num_bends=NUM_BENDS,
    )


def preintegrate(
    table: np.ndarray,
    begin: float,
    end: float,
    calibration: np.ndarray,
    rates: np.ndarray,
    usual: tuple[float, float],
    straightest: float,
) -> tuple[Motion, np.ndarray, float]:
    """Preintegrate the twists between two times; see `reference.motion.preintegrate`."""
    compiled = core.compiled
    if compiled is None:
        return motion.preintegrate(table, begin, end, calibration, rates, usual, straightest)
    linear = table, begin, end, np.ascontiguousarray(calibration)
    tunables = _motion_tunables(compiled.MotionTunables)
    delta, covariance, jacobian, path, turned, by_bend, moving = compiled.preintegrate(
        *linear, np.ascontiguousarray(rates), *usual, straightest, tunables
    )
    found = Motion(delta, covariance, jacobian, path, turned, calibration, True)
    return found, by_bend, moving


def add_odometry(
    e: NormalEquations, poses: np.ndarray, calibration: np.ndarray, steps: np.ndarray
) -> None:
    """Add the motions between poses to normal equations; see `reference.window.add_odometry`."""
    compiled = core.compiled
    if compiled is None:
        window.add_odometry(e, poses, calibration, steps)
        return
    inputs = (np.ascontiguousarray(each) for each in (poses, calibration, steps))
    compiled.add_odometry(*inputs, *_arrays(e))


def add_sightings(e: NormalEquations, seen: WeighedSightings) -> None:
    """Add sightings to normal equations; see `reference.window.add_sightings`."""
    compiled = core.compiled
    if compiled is None:
        window.add_sightings(e, seen)
        return
    compiled.add_sightings(*(np.ascontiguousarray(each) for each in seen), *_arrays(e))


def add_bearings(
    e: NormalEquations, seen: SightedFrom, poses: np.ndarray, shared: np.ndarray
) -> None:
    """Add bearings to normal equations; see `reference.window.add_bearings`."""
    compiled = core.compiled
    if compiled is None:
        window.add_bearings(e, seen, poses, shared)
        return
    inputs = (np.ascontiguousarray(each) for each in (*seen, poses, shared))
    compiled.add_bearings(*inputs, GATE, *_arrays(e))


def solve(e: NormalEquations) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Solve normal equations; see `reference.window.Elimination.solve`."""
    compiled = core.compiled
    if compiled is None:
        return window.eliminate(e).solve()
    try:
        steps, shared, covariance = compiled.solve_chain(*_arrays(e))
    except ValueError as error:
        raise np.linalg.LinAlgError(str(error)) from error
    return steps, shared, covariance


def _arrays(e: NormalEquations) -> tuple[np.ndarray, ...]:
    """Return the arrays of normal equations in the order of the compiled core."""
    return e.own, e.next, e.shared, e.common, e.slope, e.common_slope
