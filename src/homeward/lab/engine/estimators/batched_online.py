"""Online filters over recorded drives, many at once in the lanes of a batch.

A drive becomes a timetable of predictions, each with a duration, a twist and perhaps the bearings
of a stamp at its end. Compiled loops then run many filters at once with the results of
`OnlineFilter`, to the last digits.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import lru_cache

import casadi as ca
import numpy as np

from homeward.drives.drive import Drive
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Polar, from_polar, polar_covariance_to_pose
from homeward.lab.engine.batch.execution import SLOWER, execute, source
from homeward.lab.engine.batch.job import Given, Job, given_values
from homeward.lab.engine.estimators.online import OnlineFilter
from homeward.lab.engine.estimators.runner import FilterRunner, Numbers, in_steps
from homeward.lab.engine.native.source import choose
from homeward.lab.engine.program.stages import BELIEF, Program, Symbolic, filter_parts
from homeward.lab.filters.backend import LOST_SIGMA
from homeward.lab.filters.ekf import (
    UPDATE_OUTPUTS,
    ExtendedKalmanFilter,
    Prediction,
    named_function,
    symbols,
)
from homeward.lab.filters.settings import Engine
from homeward.lab.model import POLAR
from homeward.odometry.validity import TwistValidity
from homeward.track import BEARINGS, ODOMETRY, Innovations, Track, grid_times, in_order

SAME_S = 1e-9
"""Stamps that differ by less are the same stamp [s]."""
Step = tuple[float, float, float, bool]
"""A prediction: duration [s], v [m/s], omega [rad/s], and whether there was no odometry."""


class Timetable:
    """Steps of a drive for a filter whose states are the landmarks `ids`."""

    def __init__(self, drive: Drive, ids: Sequence[str]) -> None:
        self.steps: list[Step] = []
        self.t: list[float] = []
        """Times of the rows of the track [s]."""
        self.rows: list[tuple[int, list[Step]]] = []
        """For each row, the index of the sample before it and the steps from there to it."""
        self._stamps: list[tuple[float, int, dict[int, float], dict[int, float]]] = []
        self._now, self._twist, self._twist_t = math.nan, (math.nan, math.nan), -math.inf
        self._hold = TwistValidity()
        self._index = {landmark: i for i, landmark in enumerate(ids)}
        self._yaw = drive.settings.sensor.yaw
        self._read(drive)
        shape = len(self.steps), len(ids)
        self.bearings, self.mask = np.zeros((2, *shape))
        """(steps, q) each: bearings [rad] at the end of each step, and 1 where there is one."""
        self.sigma = np.full(shape, math.nan)
        """(steps, q), standard deviations of bearings that have their own [rad]."""
        self.stamp = np.full(len(self.steps), math.nan)
        """(steps,), stamps of the bearings [s]."""
        for t, k, seen, sigmas in self._stamps:
            self.stamp[k], self.mask[k, list(seen)] = t, 1.0
            self.bearings[k, list(seen)] = list(seen.values())
            self.sigma[k, list(sigmas)] = list(sigmas.values())

    def _read(self, drive: Drive) -> None:
        """Add the samples in the order of `homeward.track.run`."""
        o, sightings = drive.odometry, drive.sightings.stamps()
        twists = zip(o.t.tolist(), o.v.tolist(), o.omega.tolist(), strict=True)
        stamps = np.unique(drive.sightings.t)
        grid = grid_times(drive.span, stamps)
        # A grid point moves to an odometry stamp at the same time.
        after = np.append(o.t, math.inf)[np.searchsorted(o.t, grid - SAME_S)]
        snapped = np.where(after - grid < SAME_S, after, grid)
        times = zip(grid.tolist(), snapped.tolist(), strict=True)
        for kind in in_order(o.t, stamps, snapped):
            if kind == ODOMETRY:
                t, v, omega = next(twists)
                self._advance(t)
                if math.isfinite(v) and math.isfinite(omega):
                    self._twist, self._twist_t = (v, omega), t
                    self._hold.add(t)
                else:
                    self._twist_t = -math.inf
            elif kind == BEARINGS:
                t, seen, sigmas = next(sightings)
                self._advance(t)
                self._add_bearings(t, seen, sigmas)
                self._row(t, [])
            else:
                t, same = next(times)
                self._row(t, self._steps_to(same))

    @property
    def end(self) -> float:
        """Stamp of the last sample [s]."""
        return self._now

    def _row(self, t: float, steps: list[Step]) -> None:
        self.t.append(t)
        self.rows.append((len(self.steps), steps))

    def _steps_to(self, t: float) -> list[Step]:
        """Return the steps from now to `t` [s], equal to those of `OnlineFilter`."""
        if math.isnan(self._now):
            return []
        held = min(max(self._twist_t + self._hold.seconds, self._now), t)
        driven = [(dt, *self._twist, False) for dt in in_steps(held - self._now)]
        return driven + [(dt, 0.0, 0.0, True) for dt in in_steps(t - held)]

    def _advance(self, t: float) -> None:
        self.steps += self._steps_to(t)
        self._now = t

    def _add_bearings(
        self, t: float, seen: Mapping[str, float], sigmas: Mapping[str, float]
    ) -> None:
        known = {
            self._index[i]: float(wrap(value + self._yaw))
            for i, value in seen.items()
            if i in self._index
        }
        own = {self._index[i]: s for i, s in sigmas.items() if i in self._index and s > 0}
        if not self.steps or (self._stamps and self._stamps[-1][1] == len(self.steps) - 1):
            self.steps.append((0.0, 0.0, 0.0, False))
        self._stamps.append((t, len(self.steps) - 1, known, own))


MAX_NUMBERS = 2**24
"""Largest number of doubles of all samples of the runs of a batch: 128 MB."""
SAVED_S = 5e-4
"""Time of a step in Python that a batch saves [s]."""
HISTORY = (*BELIEF, *UPDATE_OUTPUTS)


def batch_kind(estimator: object) -> ExtendedKalmanFilter | None:
    """Return the kind of an estimator's filter; None where it cannot run in a batch."""
    if type(estimator) is not OnlineFilter or type(estimator.backend) is not FilterRunner:
        return None
    return estimator.backend.kind


def _runner(estimator: OnlineFilter) -> FilterRunner:
    assert isinstance(estimator.backend, FilterRunner)
    return estimator.backend


def run_batched(
    drives: Sequence[Drive],
    estimators: Sequence[OnlineFilter],
    engine: Engine = "auto",
    more: float = 1.0,
) -> list[Track | None]:
    """Run filters of one kind, each over its drive, with the result of `homeward.track.run`.

    There is one drive for each filter; filters over the same drive share one object. The filters
    are new, of one `batch_kind`, and end in the state after their drive. `more` is all work to come
    as a multiple of this call, which decides whether compiling pays. A track has only rows and
    innovations; it is None for a filter that must run on its own: no compiled code is available, or
    its belief diverged.
    """
    ids = [tuple(e.ids) for e in estimators]
    differ = {(id(d), i): d for d, i in zip(drives, ids, strict=True)}
    made = {key: Timetable(drive, key[1]) for key, drive in differ.items()}
    own = [made[id(d), i] for d, i in zip(drives, ids, strict=True)]
    longest = max(len(table.steps) for table in own)
    kind = batch_kind(estimators[0])
    assert kind is not None
    numbers = (longest + 1) * sum(online_program(kind).size(name) for name in HISTORY)
    chunk = max(2, MAX_NUMBERS // numbers)
    tracks: list[Track | None] = []
    for first in range(0, len(own), chunk):
        part = slice(first, first + chunk)
        tracks += _tracks(kind, own[part], estimators[part], engine, more * len(own) / chunk)
    return tracks


@lru_cache(maxsize=64)
def online_program(kind: ExtendedKalmanFilter) -> Program:
    """Return a filter whose noise is given as densities: scale, predict, update."""
    step = symbols(Prediction, kind.model, kind.integral)
    lost, density = ca.SX.sym("lost"), ca.SX.sym("input_density", 2)
    walk = ca.SX.sym("state_density", step.state_variance.shape)
    gain = ca.SX.sym("proportional_density", step.proportional.shape)
    noise = ca.if_else(lost, ca.DM([LOST_SIGMA**2] * 2), density) / ca.fmax(step.dt, SAME_S)
    inputs = {"dt": step.dt, "lost": lost, "input_density": density}
    inputs |= {"state_density": walk, "proportional_density": gain}
    outputs = {
        "input_covariance": ca.diag(ca.if_else(step.dt > 0, noise, 0.0)),
        "state_variance": walk * step.dt,
        "proportional": gain * step.dt,
    }
    scale = named_function("scale", inputs, outputs)
    return Program({"scale": (Symbolic(scale),)} | filter_parts(kind))


def _tracks(
    kind: ExtendedKalmanFilter,
    tables: Sequence[Timetable],
    estimators: Sequence[OnlineFilter],
    engine: Engine,
    more: float,
) -> list[Track | None]:
    runners = [_runner(e) for e in estimators]
    starts = [runner.start() for runner in runners]
    beliefs = {name: np.array([getattr(s, name) for s in starts]) for name in BELIEF}
    found = _histories(kind, runners, beliefs, [t.steps for t in tables], tables, engine, more)
    if found is None:
        return [None] * len(tables)
    tracks: list[Track | None] = []
    for r, (table, estimator) in enumerate(zip(tables, estimators, strict=True)):
        history = {name: found[name][r, : len(table.steps) + 1] for name in HISTORY}
        rows = _rows(kind, runners[r], table, history, engine)
        tracks.append(None if rows is None else _track(table, estimator, history, *rows))
    return tracks


def _histories(
    kind: ExtendedKalmanFilter,
    runners: Sequence[FilterRunner],
    beliefs: Mapping[str, np.ndarray],
    steps: Sequence[list[Step]],
    tables: Sequence[Timetable],
    engine: Engine,
    more: float,
) -> dict[str, np.ndarray] | None:
    """Return `HISTORY` at every sample, (runs, steps + 1, ...); None without compiled code.

    Without timetables there are no bearings.
    """
    # A single run differs from lanes in its last digits, so there are at least 2 runs.
    pick = np.arange(max(2, len(runners))) % len(runners)
    program, longest = online_program(kind), max(len(s) for s in steps)
    q, runs = kind.model.q, pick.size
    table = np.zeros((len(runners), longest, 4))
    bearings, mask = np.zeros((2, len(runners), longest, q))
    tunings = [runner.tuning for runner in runners]
    variance = np.empty(bearings.shape)
    for r, own in enumerate(steps):
        table[r, : len(own)] = np.reshape(own, (-1, 4))  # `own` may be empty
        variance[r] = tunings[r].bearing_sigma ** 2
        if tables:
            seen, k = tables[r], len(own)
            bearings[r, :k], mask[r, :k] = seen.bearings, seen.mask
            variance[r, :k] = np.where(np.isnan(seen.sigma), variance[r, :k], seen.sigma**2)
    start = dict(beliefs)
    for name in ("stored", "gate", "minimum_visible", "input_density", "state_density"):
        start[name] = np.array([getattr(tuning, name) for tuning in tunings])
    if kind.integral:
        start["proportional_density"] = np.array([t.proportional for t in tunings])
        start["integral_gain"] = np.array([t.integral_gain for t in tunings])
    series = {"dt": table[..., :1], "control": table[..., 1:3], "lost": table[..., 3:]}
    series |= {"bearings": bearings, "mask": mask, "variance": variance}

    def given(name: str, values: np.ndarray, *along: int) -> Given:
        shape = program.shapes[name]
        entries = () if shape == (1,) else shape
        return given_values(name, values[pick].reshape(runs, *along, *entries), shape, runs, *along)

    at_start = tuple(given(k, v) for k, v in start.items())
    at_steps = tuple(given(k, v, longest) for k, v in series.items())
    job = Job(program, runs, longest, at_start, at_steps, final=(), history=HISTORY)
    saved = more * SAVED_S * runs * longest
    result, _ = choose(
        engine, saved, lambda: source(job), lambda: execute(job, "native", 1), SLOWER
    )
    return None if result is None else result.history


def _rows(
    kind: ExtendedKalmanFilter,
    runner: FilterRunner,
    table: Timetable,
    history: Mapping[str, np.ndarray],
    engine: Engine,
) -> tuple[np.ndarray, np.ndarray] | None:
    """Return states (rows, n) and covariances (rows, n, n); None where the belief diverged."""
    before = np.array([k for k, _ in table.rows], int)
    state, covariance = history["state"][before], history["covariance"][before]
    ahead = [i for i, (_, steps) in enumerate(table.rows) if steps]
    if ahead:
        # Rows between samples are predictions that the filter does not keep.
        beliefs = {name: history[name][before[ahead]] for name in BELIEF}
        steps = [table.rows[i][1] for i in ahead]
        found = _histories(kind, [runner] * len(ahead), beliefs, steps, (), engine, math.inf)
        if found is None:
            return None
        last = np.array([len(s) for s in steps])
        here = np.arange(len(ahead))
        state[ahead] = found["state"][here, last]
        covariance[ahead] = found["covariance"][here, last]
    finite = np.isfinite(history["state"]).all() and np.isfinite(state).all()
    return (state, covariance) if finite else None


def _track(
    table: Timetable,
    estimator: OnlineFilter,
    history: Mapping[str, np.ndarray],
    state: np.ndarray,
    covariance: np.ndarray,
) -> Track:
    """Return the track of one filter, and set the filter to its end."""
    runner, ids = _runner(estimator), np.array(estimator.ids)
    q, n = len(ids), state.shape[1]
    before, after = history["active"][:-1], history["active"][1:]
    memory = np.concatenate([history[name][-1].ravel(order="F") for name in BELIEF])
    sightings = ((history["accepted"][1:] > 0) | (after > before)).sum(axis=0)
    estimator.restore(Numbers(n, q, memory), table.end, sightings)
    enough = table.mask.sum(axis=1, keepdims=True) >= runner.minimum_visible
    step, landmark = np.nonzero((table.mask > 0) & enough & (before > 0))
    at = step + 1, landmark
    polar = Polar(*state[:, :POLAR].T)
    pose = from_polar(polar)
    return Track(
        estimator=estimator.name,
        t=np.array(table.t),
        x=np.asarray(pose.x),
        y=np.asarray(pose.y),
        heading=np.asarray(pose.heading),
        covariance=polar_covariance_to_pose(polar, covariance[:, :POLAR, :POLAR]),
        status=[],
        reason=[],
        innovations=Innovations(
            t=table.stamp[step],
            landmark=ids[landmark],
            value=history["innovation"][at],
            sigma=np.sqrt(np.maximum(history["innovation_variance"][at], 0.0)),
            accepted=history["accepted"][at] > 0,
        ),
        update_seconds=np.empty(0),
        run_seconds=0.0,
        landmarks=estimator.landmarks(),
        counts=estimator.counts,
        notes=estimator.notes,
    )
