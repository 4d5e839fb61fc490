"""The paper's filters in closed loop: one run of a case, or many at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Literal

import casadi as ca
import numpy as np

from homeward.control.laws import homing
from homeward.drives.drive import Columns
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Twist
from homeward.lab.engine.batch.homing import Law, homing_program, run_homing
from homeward.lab.engine.program import Machine, allocate
from homeward.lab.filters.ekf import ExtendedKalmanFilter, ProportionalIntegralFilter
from homeward.lab.filters.settings import Engine
from homeward.lab.model import POLAR, PolarModel
from homeward.lab.studies.paper.settings import PaperSettings
from homeward.lab.studies.paper.world import CaseName, PaperWorld, draw_world

PI_HT, DEAD_RECKONING = "PI-EKF (HT)", "dead reckoning"
FILTERS = ("EKF", "A-EKF (one)", "A-EKF (all)", "PI-EKF", PI_HT, DEAD_RECKONING)
"""A-EKF with the first wrong home bearing as only parameter (beta*_1 if none is wrong), and with
all home bearings; PI-EKF with M as set, and with M = H'; the EKF without bearings."""


@dataclass(frozen=True)
class Run:
    """One filter in one world, k samples long; sample 0 is the start."""

    t: np.ndarray
    """(k,) [s]"""
    pose: np.ndarray
    """(k, 3), the true x [m], y [m], heading [rad]."""
    state: np.ndarray
    """(k, n), the estimate: R [m], theta, alpha, bearings, parameters [rad]."""
    variance: np.ndarray
    """(k, n), diagonal of P."""
    estimated: tuple[int, ...]
    """Landmarks whose home bearings are the parameters."""
    arrived: bool
    """Whether the estimated R came below the stop radius."""

    @property
    def errors(self) -> np.ndarray:
        """Estimated minus true R [m], theta, alpha [rad]: (k, 3)."""
        return polar_errors(self.state, self.pose)


def polar_errors(state: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """Return estimates (k, 3 or more) minus true poses (k, 3) of R [m], theta, alpha [rad]: (k, 3).

    An estimate with negative R counts as the same position with positive R.
    """
    (x, y, heading), (R, theta, alpha) = pose.T, state[:, :POLAR].T
    away, direction = np.abs(R) - np.hypot(x, y), theta + np.pi * (R < 0) - np.arctan2(y, x)
    return np.column_stack([away, wrap(direction), wrap(alpha - heading)])


def run_filter(name: str, case: CaseName, world: PaperWorld, settings: PaperSettings) -> Run:
    """Run one of `FILTERS` through a world, closing the loop in Cases 1 to 3."""
    settings = filter_settings(name, settings)
    kind, law = filter_kind(name, world, settings), control_law(case, settings)
    loop = Machine(homing_program(kind, law))
    fill(loop.variables, kind, world, settings)
    steps = len(world.visible)
    pose, state, variance = np.zeros((steps, 3)), np.zeros((steps, kind.model.n)), []
    arrived, given = False, loop.variables
    for k in range(steps):
        pose[k], state[k] = given["pose"], given["state"]
        variance.append(np.diag(given["covariance"]).copy())
        arrived = case != "4" and abs(state[k, 0]) < settings.assumed.stop_radius
        if arrived or not np.all(np.isfinite(state[k])):
            break
        given["mask"][:] = world.visible[k]
        given["noise"][:], given["disturbance"][:] = world.noise[k], world.disturbance[k]
        loop.do("world")
        if world.sight is not None and name != DEAD_RECKONING:
            dt, there = settings.printed.sample_time, given["pose"].copy()
            given["bearings"][:], given["mask"][:] = world.sight.measure(k, there, dt)
        loop.do("predict", "update")
    n = len(variance)
    t = np.arange(n) * settings.printed.sample_time
    return Run(t, pose[:n], state[:n], np.array(variance), kind.model.estimated, arrived)


def draw(case: CaseName, settings: PaperSettings, run: int) -> PaperWorld:
    """Draw run number `run` of a case, with measurements from the model or from images."""
    if settings.measurements == "model":
        return draw_world(case, settings, run)
    # Images need OpenCV, which the model does not.
    from homeward.lab.studies.paper.images import draw_image_world

    return draw_image_world(case, settings, run)


def filter_settings(name: str, settings: PaperSettings) -> PaperSettings:
    """Return the settings with the changes for one of `FILTERS`."""
    change: dict[str, Any] = {}
    if name == PI_HT:
        change = {"printed": settings.printed.model_copy(update={"M": "HT"})}
    if name == DEAD_RECKONING:
        unseen = {"minimum_visible": settings.printed.landmarks + 1}
        change = {"assumed": settings.assumed.model_copy(update=unseen)}
    return settings.model_copy(update=change)


def filter_kind(name: str, world: PaperWorld, settings: PaperSettings) -> ExtendedKalmanFilter:
    """Return one of `FILTERS` for a world, whose faults determine the parameters."""
    q, assumed = settings.printed.landmarks, settings.assumed
    estimated: tuple[int, ...] = ()
    if name.startswith("A-EKF"):
        wrong = np.flatnonzero(world.moved)
        one = (int(wrong[0]) if wrong.size else 0,)
        estimated = one if name == "A-EKF (one)" else tuple(range(q))
    model = PolarModel(q, estimated, assumed.guard, assumed.inverse)
    kind = ProportionalIntegralFilter if name.startswith("PI-EKF") else ExtendedKalmanFilter
    return kind(model, assumed.integration)


def fill(
    given: dict[str, np.ndarray],
    kind: ExtendedKalmanFilter,
    world: PaperWorld,
    settings: PaperSettings,
) -> None:
    """Set the inputs of the loop that are the same in all samples."""
    printed, assumed, model = settings.printed, settings.assumed, kind.model
    unit = np.ones(model.n)
    unit[0] = 0.01  # the paper has R in cm
    parameters = slice(POLAR + model.q, model.n)

    given["pose"][:] = world.start
    given["landmarks"][...] = world.landmarks
    given["speed"][:], given["dt"][:] = printed.speed_cm / 100, printed.sample_time
    given["stored"][:] = world.stored
    given["state"][:POLAR] = world.guess
    given["state"][parameters] = world.stored[list(model.estimated)]
    given["covariance"][...] = np.diag(printed.P0 * unit**2)
    given["state_variance"][parameters] = printed.Qd
    if assumed.meaning_of_Q == "input":
        given["input_covariance"][...] = printed.Q * np.diag([0.01**2, 1.0])
    else:
        given["state_variance"][: POLAR + model.q] = printed.Q * unit[: POLAR + model.q] ** 2
    given["variance"][:] = printed.R if assumed.meaning_of_R == "variance" else printed.R**2
    given["gate"][:], given["minimum_visible"][:] = np.inf, assumed.minimum_visible
    if kind.integral:
        given["proportional"][...] = np.diag(_gains(printed.Pi, model.q) * unit)
        given["integral_gain"][...] = _integral_gain(printed.M, given["integral_gain"].shape)


def _gains(Pi: float | tuple[float, ...], q: int) -> np.ndarray:
    """Return the diagonal of Pi, (3 + q,)."""
    pose, bearings = (Pi[:POLAR], Pi[POLAR]) if isinstance(Pi, tuple) else ([Pi] * POLAR, Pi)
    return np.array([*pose, *[bearings] * q])


def _integral_gain(M: float | Literal["HT", "own"], shape: tuple[int, ...]) -> np.ndarray:
    """Return M, (3 + q, q)."""
    if not isinstance(M, str):
        return np.full(shape, M)
    matrix = np.full((shape[0], shape[0] - POLAR), float(M == "own"))
    matrix[POLAR:] = np.eye(shape[0] - POLAR)
    return matrix.reshape(shape)


def control_law(case: CaseName, settings: PaperSettings) -> Law:
    """Return the control law of a case; the same object for the same law."""
    return _circle_law(settings.assumed.circle_turn_rate) if case == "4" else homing


@lru_cache
def _circle_law(turn_rate: float) -> Law:
    """Return the open-loop law of Case 4; the same object for the same turn rate."""
    return lambda polar, speed: Twist(speed, ca.SX(turn_rate))


OF_WORLD = ("pose", "landmarks", "stored", "state")
"""Inputs of the loop that differ from world to world."""
DRAWN = {"mask": "visible", "noise": "noise", "disturbance": "disturbance"}
"""Inputs that differ from sample to sample, and the attribute of a world that has them."""
FAR = 0.2
"""Minimum distance from home [m] at which theta is meaningful."""


@dataclass(frozen=True)
class Errors(Columns):
    """Errors of one filter in several runs; infinite where it diverged."""

    rmse: np.ndarray
    """(runs, 3), of R [m], theta, alpha [rad] over each run."""
    theta_far: np.ndarray
    """(runs,), RMSE of theta [rad] over the samples farther than `FAR` from home."""
    final: np.ndarray
    """(runs, 3), absolute errors of R [m], theta, alpha [rad] in the last sample."""
    final_distance: np.ndarray
    """(runs,), true distance from home at the end [m]."""


def errors_over(error: np.ndarray, pose: np.ndarray) -> Errors:
    """Return the errors of one run, with a leading axis of one.

    `error` (k, 3) has R [m], theta, alpha [rad] at each sample, NaN where the filter diverged;
    `pose` (k, 3) is true.
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
    worlds: Sequence[PaperWorld],
    settings: PaperSettings,
    engine: Engine = "auto",
) -> Errors:
    """Run a filter through worlds of the same number of samples, each as `run_filter` does."""
    worlds = [rolled(world) for world in worlds]
    settings = filter_settings(name, settings)
    kind, law = filter_kind(name, worlds[0], settings), control_law(case, settings)
    _, given = allocate(homing_program(kind, law).shapes)
    of_world: dict[str, list[np.ndarray]] = {key: [] for key in OF_WORLD}
    for world in worlds:
        fill(given, kind, world, settings)
        for key in OF_WORLD:
            of_world[key].append(given[key].copy())
    constant = {k: v for k, v in given.items() if k not in (*OF_WORLD, *DRAWN)}
    # Open loop, nothing ends a run.
    radius = 0.0 if case == "4" else settings.assumed.stop_radius
    last = len(worlds[0].visible) - 1

    def over_time(name: str) -> np.ndarray:
        values = np.array([getattr(world, name)[:last] for world in worlds])
        return values[..., 0] if values.shape[-1] == 1 else values  # of one landmark, numbers

    result = run_homing(
        kind,
        {**constant, **{k: np.array(v) for k, v in of_world.items()}, "stop_radius": radius},
        runs=len(worlds),
        steps=last,
        law=law,
        series={key: over_time(name) for key, name in DRAWN.items()},
        history=("error", "pose"),
        engine=engine,
        threads=1,
    )
    error, pose = result.history["error"], result.history["pose"]
    error = np.where(result.diverged[:, None, None], np.nan, error)
    kept = [errors_over(error[k, :n], pose[k, :n]) for k, n in enumerate(result.samples)]
    return replace(Errors.joined(kept), final_distance=result.final_distance)


def rolled(world: PaperWorld) -> PaperWorld:
    """Return the same world with its first wrong landmark as number 0.

    One compiled filter then serves all worlds.
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
