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
from scipy.special import chdtri

from homeward import core
from homeward.geometry.se2 import MIN_DISTANCE
from homeward.geometry.statistics import ROUNDING
from homeward.localizer.motions import Motion
from homeward.localizer.reference import extension, factors, frame, labels, motion, sets, window
from homeward.localizer.reference.extension import Extra, Unknown
from homeward.localizer.reference.factors import NormalEquations, WeighedSightings
from homeward.localizer.reference.frame import GateInput, GateResult
from homeward.localizer.reference.sets import Evidence, HomeArrays, HomeSolution, Linear
from homeward.localizer.reference.window import AddMore, Linearised, Solution, Window
from homeward.localizer.tunables import (
    BEND,
    BRIDGED,
    CLOSE,
    FALSE_ALARM,
    FIT_CONVERGED,
    GATE,
    INFLATION,
    LINEAR,
    MAJORITY,
    MAX_HOME_TURN,
    MAX_LAG_S,
    MAX_SOLVE_STEPS,
    MEAN_S,
    MIN_BEARING_SIGMA,
    MIN_SIDEWAYS_SHARE,
    MIN_STEADY_SPEED,
    MINIMAL,
    NEGLIGIBLE_CALIBRATION,
    NUM_BENDS,
    OUTLIER_SIGMA,
    SOLVE_CONVERGED,
    SPEED_TIME_S,
    TURN_TIME_S,
    UPHEAVAL,
    VAGUE,
    VARIANCE_ROUNDING,
)
from homeward.odometry.history import MOVING_SPEED, STEADY_S
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
        moving_speed=MOVING_SPEED,
        sideways_share=MIN_SIDEWAYS_SHARE,
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
def _gate_tunables(build: Callable[..., Any]) -> Any:
    """Return the tunables of `gate_frame` for the compiled core."""
    return build(
        false_alarm=FALSE_ALARM,
        inflation=INFLATION,
        linear=LINEAR,
        majority=MAJORITY,
        min_sigma=MIN_BEARING_SIGMA,
        vague=VAGUE,
        rounding=VARIANCE_ROUNDING,
        turn_limit=float(chdtri(1, FALSE_ALARM)),
        minimal=MINIMAL,
    )


def gate_frame(given: GateInput) -> GateResult:
    """Predict and test the bearings of a frame; see `reference.frame.gate_frame`."""
    compiled = core.compiled
    if compiled is None:
        return frame.gate_frame(given)
    motion, offset = given.motion, np.zeros(3) if given.offset is None else given.offset
    state = given.mean, given.covariance, given.p_static
    camera = motion.delta, motion.covariance, motion.jacobian, given.mount, offset
    seen = given.bearings, given.sigmas, given.landmark
    found = compiled.gate_frame(
        *(np.ascontiguousarray(each) for each in (*state, *camera, *seen)),
        *(given.scale, given.is_keyframe, given.gate, *given.stamps),
        _gate_tunables(compiled.GateTunables),
    )
    residual, deviation, accepted, *rest = found
    return GateResult(residual, deviation, accepted.astype(bool), *rest)


def propagate(
    mean: np.ndarray, covariance: np.ndarray, motion: Motion
) -> tuple[np.ndarray, np.ndarray]:
    """Propagate the newest pose of a state by a motion; see `reference.frame.propagate`."""
    compiled = core.compiled
    if compiled is None:
        return frame.propagate(mean, covariance, motion)
    arrays = mean, covariance, motion.uncalibrated, motion.covariance, motion.jacobian
    there, spread = compiled.propagate(*(np.ascontiguousarray(each) for each in arrays))
    return there, spread


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


def linearised(given: Window, add_more: AddMore | None = None) -> Linearised:
    """Linearise a window at its estimate; see `reference.window.linearised`."""
    compiled = core.compiled
    if compiled is None:
        return window.linearised(given, add_more)
    arrays, residual, jacobian, *rest = _compiled_window(compiled, given).linearised()
    built, seen = NormalEquations(*arrays), given.seen
    if add_more is not None:
        add_more(built, given.poses, given.shared)
    found = WeighedSightings(residual, jacobian, seen.pose[seen.frame], seen.landmark)
    return Linearised(built, found, factors.OdometryErrors(*rest))


def extend(given: Linearised, unknown: Unknown, with_absorbed: bool = False) -> Extra:
    """Return the posterior of additional unknowns of a window; see `reference.extension.extend`."""
    compiled = core.compiled
    if compiled is None:
        return extension.extend(given, unknown, with_absorbed)
    arrays = *_arrays(given.equations), *given.seen, *given.motions, *unknown[:3]
    contiguous = map(np.ascontiguousarray, arrays)
    by_motion = unknown.by_motion
    by_motion = None if by_motion is None else np.ascontiguousarray(by_motion)
    with _singular():
        return Extra(*compiled.extend(*contiguous, by_motion, with_absorbed))


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


@cache
def _set_tunables(build: Callable[..., Any]) -> Any:
    """Return the tunables of sets of home bearings for the compiled core."""
    return build(
        max_turn=MAX_HOME_TURN,
        converged=FIT_CONVERGED,
        rounding=ROUNDING,
        min_distance=MIN_DISTANCE,
        outlier_sigma=OUTLIER_SIGMA,
        upheaval=UPHEAVAL,
    )


def _compiled_home(compiled: ModuleType, given: HomeArrays) -> Any:
    """Return a resection problem as the compiled core has it."""
    arrays = (np.ascontiguousarray(a) if isinstance(a, np.ndarray) else a for a in given)
    return compiled.Home(*arrays, _set_tunables(compiled.SetTunables))


def fit_home(
    given: HomeArrays, home: np.ndarray, inliers: np.ndarray, steps: int
) -> tuple[Linear, HomeSolution] | None:
    """Fit home to a set of home bearings by Gauss-Newton; see `reference.sets.fit`."""
    compiled = core.compiled
    if compiled is None:
        return sets.fit(given, home, inliers, steps)
    found = _compiled_home(compiled, given).fit(*_contiguous(home, inliers), steps)
    return None if found is None else (Linear(*found[0]), HomeSolution(*found[1]))


def propagate_home(
    given: HomeArrays, linear: Linear, mean: np.ndarray, inliers: np.ndarray
) -> tuple[Linear, HomeSolution] | None:
    """Solve for home after a small change of the map; see `reference.sets.propagated`."""
    compiled = core.compiled
    if compiled is None:
        return sets.propagated(given, linear, mean, inliers)
    arrays = _contiguous(*linear, mean, inliers)
    found = _compiled_home(compiled, given).propagate(*arrays)
    return None if found is None else (Linear(*found[0]), HomeSolution(*found[1]))


def solve_set(given: HomeArrays, linear: Linear, inliers: np.ndarray) -> HomeSolution | None:
    """Solve for home by a set of home bearings; see `reference.sets.solved`."""
    compiled = core.compiled
    if compiled is None:
        return sets.solved(given, linear, inliers)
    found = _compiled_home(compiled, given).solve(*_contiguous(*linear, inliers))
    return None if found is None else HomeSolution(*found)


def weigh_set(
    given: HomeArrays, linear: Linear, inliers: np.ndarray, found: HomeSolution
) -> Evidence:
    """Return the evidence of a set of home bearings; see `reference.sets.weighed`."""
    compiled = core.compiled
    if compiled is None:
        return sets.weighed(given, linear, inliers, found)
    arrays = _contiguous(linear.at, inliers, found.step, found.inverse, found.alone)
    return Evidence(*_compiled_home(compiled, given).weigh(*arrays, found.log_density))


def log_labels(
    members: np.ndarray,
    one_body: np.ndarray,
    right: np.ndarray,
    wrong: np.ndarray | float,
    more: np.ndarray,
) -> np.ndarray:
    """Return the log prior of labels; see `reference.labels.log_labels`."""
    compiled = core.compiled
    if compiled is None:
        return labels.log_labels(members, one_body, right, wrong, more)
    each = np.broadcast_to(np.asarray(wrong, float), right.shape[1:])
    return np.asarray(
        compiled.log_labels(*_contiguous(members, one_body, right, each, more), UPHEAVAL)
    )


def _contiguous(*arrays: np.ndarray) -> Iterator[np.ndarray]:
    """Return arrays as the compiled core needs them."""
    return (np.ascontiguousarray(each) for each in arrays)


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
