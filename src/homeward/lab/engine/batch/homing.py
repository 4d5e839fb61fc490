"""Batches of closed loops: motion, measurement, control law and filter, with random noise."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from homeward.control.laws import homing
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Polar, Twist
from homeward.lab.engine.batch.execution import execute
from homeward.lab.engine.batch.job import Draw, Result, job_of
from homeward.lab.engine.program import OBSERVE, Program
from homeward.lab.filters.ekf import ExtendedKalmanFilter, named_function, steps
from homeward.lab.filters.settings import Engine
from homeward.lab.model import POLAR, discretise, true_bearings, unicycle_rates

Law = Callable[[Polar, ca.SX], Twist]
"""From the estimated pose and the speed [m/s] to a twist."""

DRAWS = (
    Draw("noise", "bearing_sigma", True, 0),
    Draw("disturbance", "disturbance_sigma", True, 1),
    Draw("mask", "visibility", False, 2),
)
"""Random variables of every step: noise of bearings and twist, and the landmarks in view."""


@lru_cache(maxsize=64)
def world_function(n: int, q: int, law: Law) -> ca.Function:
    """Return one sample of the world as a function of the filter's state.

    The law acts on the estimate. The robot moves with the commanded twist and its disturbance, as a
    Cartesian unicycle, which is never singular; then the camera measures the bearings.

    Inputs are ``state`` (n,) of the filter, ``pose`` (3,), the true x [m], y [m] and heading [rad],
    ``landmarks`` (q, 2) [m] in the home frame, ``speed`` [m/s], ``disturbance`` (2,) of the twist,
    ``noise`` (q,) of the bearings [rad] and ``dt`` [s]. Outputs are ``control`` (2,), ``pose`` and
    ``bearings`` (q,).
    """
    state, pose, landmarks = ca.SX.sym("state", n), ca.SX.sym("pose", 3), ca.SX.sym("marks", q, 2)
    speed, disturbance = ca.SX.sym("speed"), ca.SX.sym("disturbance", 2)
    noise, dt = ca.SX.sym("noise", q), ca.SX.sym("dt")
    command = ca.vertcat(*law(Polar(state[0], state[1], state[2]), speed))
    moved = discretise(unicycle_rates, pose, command + disturbance, dt).state
    bearings = true_bearings(moved, landmarks) + noise
    given = {"state": state, "pose": pose, "landmarks": landmarks, "speed": speed}
    given |= {"disturbance": disturbance, "noise": noise, "dt": dt}
    outputs = {"control": command, "pose": moved, "bearings": bearings}
    return named_function("world", given, outputs)


@lru_cache(maxsize=64)
def score_function(n: int) -> ca.Function:
    """Return the error of a belief as a function.

    Inputs are ``pose`` (3,), ``state`` (n,), ``covariance`` (n, n) and ``stop_radius`` [m]. Outputs
    are ``error`` (3,), estimated minus true R [m], theta, alpha [rad], ``squared_error`` (3,),
    ``nees`` of (x, y, heading), and ``arrived``, 1 where the estimated R is below the stop radius.
    An estimate with negative R is the same place as one with positive R in the opposite direction.
    """
    pose, state = ca.SX.sym("pose", 3), ca.SX.sym("state", n)
    covariance, radius = ca.SX.sym("covariance", n, n), ca.SX.sym("stop_radius")
    R, theta, alpha = state[0], state[1], state[2]
    error = ca.vertcat(
        ca.fabs(R) - ca.hypot(pose[0], pose[1]),
        wrap(theta + ca.pi * (R < 0) - ca.atan2(pose[1], pose[0])),
        wrap(alpha - pose[2]),
    )
    # The error of (x, y) along and across the estimated direction, in the units of the state: the
    # Jacobian of (x, y, heading) by (R, theta, alpha) is a rotation times diag(1, R, 1).
    along, across = ca.cos(theta), ca.sin(theta)
    dx, dy = R * along - pose[0], R * across - pose[1]
    own = ca.vertcat(along * dx + across * dy, (along * dy - across * dx) / R, error[2])
    nees = own.T @ ca.inv_minor(covariance[:POLAR, :POLAR]) @ own
    outputs = {
        "error": error,
        "squared_error": error**2,
        "nees": nees,
        "arrived": ca.fabs(R) < radius,
    }
    given = {"pose": pose, "state": state, "covariance": covariance, "stop_radius": radius}
    return named_function("score", given, outputs)


@lru_cache(maxsize=64)
def homing_program(kind: ExtendedKalmanFilter, law: Law) -> Program:
    """Return one sample of a closed loop."""
    n, q = kind.model.n, kind.model.q
    return Program({"world": world_function(n, q, law), **steps(kind), OBSERVE: score_function(n)})


class HomingResult(Result):
    """Results of many closed loops, one entry per run; samples include the start."""

    @property
    def reached(self) -> np.ndarray:
        """(runs,), bool: the estimated R came below the stop radius."""
        return self.stopped

    @property
    def rmse(self) -> np.ndarray:
        """(runs, 3), of R [m], theta, alpha [rad] over a run's samples; infinite where diverged."""
        return np.asarray(np.sqrt(self._mean("squared_error")))

    @property
    def nees(self) -> np.ndarray:
        """(runs,), mean NEES of (x, y, heading) over a run's samples; infinite where diverged.

        NaN where the covariance was singular at some sample.
        """
        return self._mean("nees")[:, 0]

    @property
    def pose(self) -> np.ndarray:
        """(runs, 3), true x [m], y [m], heading [rad] at the last sample."""
        return self.final["pose"]

    @property
    def state(self) -> np.ndarray:
        """(runs, n), the estimate at the last sample."""
        return self.final["state"]

    @property
    def final_distance(self) -> np.ndarray:
        """True distance from home at the last sample [m], (runs,)."""
        return np.asarray(np.hypot(self.pose[:, 0], self.pose[:, 1]))

    def _mean(self, name: str) -> np.ndarray:
        with np.errstate(invalid="ignore", divide="ignore"):
            mean = self.sums[name] / self.samples[:, None]
        return np.where(self.diverged[:, None], np.inf, mean)


def run_homing(
    kind: ExtendedKalmanFilter,
    given: Mapping[str, ArrayLike],
    *,
    runs: int,
    steps: int,
    seed: int = 0,
    first_run: int = 0,
    law: Law = homing,
    series: Mapping[str, ArrayLike] | None = None,
    history: Sequence[str] = (),
    engine: Engine = "auto",
    threads: int | None = None,
) -> HomingResult:
    """Run a filter in closed loop, many times.

    Each run scores its start, then advances and scores again until the estimated R is below the
    stop radius, the belief diverges, or `steps` samples are done. The noise of run ``first_run +
    i`` does not depend on batch, filter, engine or threads.

    Parameters
    ----------
    kind : ExtendedKalmanFilter
        The filter.
    given : mapping of str to array_like
        Constants, for all runs or with a leading axis of runs. By the names of
        `homeward.lab.filters.ekf`: the initial belief (state, covariance; active is zero by
        default) and the filter's parameters (dt, stored, input_covariance, state_variance,
        variance, gate, minimum_visible and, with an integral, proportional and integral_gain). For
        the world: ``pose`` (3,), the true x [m], y [m], heading [rad] at the start; ``landmarks``
        (q, 2) [m] in the home frame; ``speed`` [m/s]; ``stop_radius`` [m]; ``bearing_sigma`` (q,)
        or a number [rad]; ``disturbance_sigma`` (2,) of the twist in every sample [m/s, rad/s];
        ``visibility`` (q,) or a number, the probability that a landmark is in view. The last two
        default to zeros and ones. Landmarks whose direction is not `stored` have moved.
    runs, steps : int
        Number of runs, and largest number of steps in each.
    seed : int
        Seed of all noise, in [0, 2^64).
    first_run : int
        Number of the first run, which selects its noise.
    law : callable
        The control law, on symbols; the paper's homing law by default.
    series : mapping of str to array_like, optional
        Values in place of random ones (noise, disturbance, mask): (steps, ...) for all runs, or
        (runs, steps, ...).
    history : sequence of str
        Variables to return at every sample: pose, state, covariance, error, nees, control, ...
    engine, threads
        See `homeward.lab.engine.batch.execution.execute`.

    Raises
    ------
    ValueError
        For an unknown variable or a wrong shape.
    """
    program, q = homing_program(kind, law), kind.model.q
    extra = {"bearing_sigma": q, "disturbance_sigma": 2, "visibility": q}
    values = {"visibility": 1.0, "gate": np.inf, **given}
    series = series or {}
    # Variables in `series`, and those with a scale of zero, are not drawn.
    draws = tuple(
        d for d in DRAWS if d.name not in series and np.any(np.asarray(values.get(d.scale, 0.0)))
    )
    job = job_of(
        program,
        values,
        series,
        runs,
        steps,
        history,
        final=("pose", "state"),
        extra=extra,
        seed=seed,
        first_run=first_run,
        draws=draws,
        sums=("squared_error", "nees"),
        stop="arrived",
    )
    return HomingResult(**vars(execute(job, engine, threads)))
