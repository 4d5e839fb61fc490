"""The numerical heart: compiled where the compiled core is installed, else the reference in NumPy.

Both give the same numbers but for rounding. The text to read is `homeward.localizer.reference`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from types import ModuleType
from typing import Any

import numpy as np

from homeward import core
from homeward.geometry.covariance import ROUNDING
from homeward.geometry.se2 import MIN_DISTANCE
from homeward.localizer.motions import Motion
from homeward.localizer.reference import factors, motion, window
from homeward.localizer.reference.factors import NormalEquations, WeighedSightings
from homeward.localizer.reference.window import AddMore, Solution, Window
from homeward.localizer.tunables import (
    BEND,
    BRIDGED,
    CLOSE,
    GATE,
    LINEAR,
    MAX_LAG_S,
    MAX_SOLVE_STEPS,
    MEAN_S,
    MIN_STEADY_SPEED,
    NEGLIGIBLE_CALIBRATION,
    NUM_BENDS,
    SOLVE_CONVERGED,
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


@cache
def _window_tunables(build: Callable[..., Any]) -> Any:
    """Return the tunables of windows for the compiled core."""
    return build(
        gate=GATE,
        linear=LINEAR,
        close=CLOSE,
        converged=SOLVE_CONVERGED,
        negligible=NEGLIGIBLE_CALIBRATION,
        rounding=ROUNDING,
        min_distance=MIN_DISTANCE,
        max_steps=MAX_SOLVE_STEPS,
    )


def _compiled_window(compiled: ModuleType, given: Window) -> Any:
    """Return a window as the compiled core has it; its arrays must not change meanwhile."""
    poses, shared, steps, seen, *rest = given
    arrays = (np.ascontiguousarray(each) for each in (poses, shared, steps, *seen, *rest))
    return compiled.Window(*arrays, _window_tunables(compiled.WindowTunables))


def solve(given: Window, add_more: AddMore | None = None) -> Solution:
    """Solve a window by Gauss-Newton; see `reference.window.solve`."""
    compiled = core.compiled
    if compiled is None:
        return window.solve(given, add_more)

    def add(arrays: tuple[np.ndarray, ...], poses: np.ndarray, shared: np.ndarray) -> None:
        if add_more is not None:
            add_more(NormalEquations(*arrays), poses, shared)

    more = None if add_more is None else add
    with _singular():
        found = _compiled_window(compiled, given).solve(more)
    poses, shared, covariance, is_bounded, has_converged = found
    return Solution(poses, shared, covariance, is_bounded.astype(bool), has_converged)


def equations(given: Window, add_more: AddMore | None = None) -> NormalEquations:
    """Return the normal equations of a window; see `reference.window.equations`."""
    compiled = core.compiled
    if compiled is None:
        return window.equations(given, add_more)
    built = NormalEquations(*_compiled_window(compiled, given).equations())
    if add_more is not None:
        add_more(built, given.poses, given.shared)
    return built


def solve_equations(e: NormalEquations) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Solve normal equations; see `reference.window.Elimination.solve`."""
    compiled = core.compiled
    if compiled is None:
        return window.eliminate(e).solve()
    with _singular():
        steps, shared, covariance = compiled.solve_equations(*_arrays(e))
    return steps, shared, covariance


def add_sightings(e: NormalEquations, seen: WeighedSightings) -> None:
    """Add sightings to normal equations; see `reference.factors.add_sightings`."""
    compiled = core.compiled
    if compiled is None:
        factors.add_sightings(e, seen)
        return
    compiled.add_sightings(*(np.ascontiguousarray(each) for each in seen), *_arrays(e))


@contextmanager
def _singular() -> Iterator[None]:
    """Raise the error of NumPy where the compiled core finds singular equations."""
    try:
        yield
    except ValueError as error:
        raise np.linalg.LinAlgError(str(error)) from error


def _arrays(e: NormalEquations) -> tuple[np.ndarray, ...]:
    """Return the arrays of normal equations in the order of the compiled core."""
    return e.own, e.next, e.shared, e.common, e.slope, e.common_slope
