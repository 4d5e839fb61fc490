"""What a recorded drive tells a filter, step by step, whatever the filter is."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from homeward.drives.drive import Drive
from homeward.geometry.angles import wrap
from homeward.lab.engine.estimators.runner import in_steps
from homeward.odometry.validity import TwistValidity
from homeward.track import BEARINGS, ODOMETRY, grid_times, in_order

SAME_S = 1e-9
"""Stamps that differ by less are one, written in two ways [s]."""
Step = tuple[float, float, float, bool]
"""A prediction: how long [s], v [m/s], omega [rad/s], and whether there was no odometry."""


class Timetable:
    """What a drive tells a filter that knows landmarks by their ids, step by step.

    Parameters
    ----------
    drive : Drive
        What was recorded.
    ids : sequence of str
        Landmarks in the order of the states.
    """

    def __init__(self, drive: Drive, ids: Sequence[str]) -> None:
        self.steps: list[Step] = []
        self.t: list[float] = []
        """Of the rows of the track [s]."""
        self.rows: list[tuple[int, list[Step]]] = []
        """The number of the sample before each row, and the steps from there to it."""
        self._stamps: list[tuple[float, int, dict[int, float], dict[int, float]]] = []
        self._now, self._twist, self._twist_t = math.nan, (math.nan, math.nan), -math.inf
        self._hold = TwistValidity()
        self._index = {landmark: i for i, landmark in enumerate(ids)}
        self._yaw = drive.settings.sensor.yaw
        self._read(drive)
        shape = len(self.steps), len(ids)
        self.bearings, self.mask = np.zeros((2, *shape))
        """(steps, q) [rad], and 1 where there is one, taken at the end of each step."""
        self.sigma = np.full(shape, math.nan)
        """(steps, q), of those that have one of their own [rad]."""
        self.stamp = np.full(len(self.steps), math.nan)
        """(steps,), when they were taken [s]."""
        for t, k, seen, sigmas in self._stamps:
            self.stamp[k], self.mask[k, list(seen)] = t, 1.0
            self.bearings[k, list(seen)] = list(seen.values())
            self.sigma[k, list(sigmas)] = list(sigmas.values())

    def _read(self, drive: Drive) -> None:
        """Take what `homeward.track.run` would feed, in its order."""
        o, sightings = drive.odometry, drive.sightings.stamps()
        twists = zip(o.t.tolist(), o.v.tolist(), o.omega.tolist(), strict=True)
        stamps = np.unique(drive.sightings.t)
        grid = grid_times(drive.span, stamps)
        # A grid point and an odometry stamp that mean one time are one.
        after = np.append(o.t, math.inf)[np.searchsorted(o.t, grid - SAME_S)]
        snapped = np.where(after - grid < SAME_S, after, grid)
        times = zip(grid.tolist(), snapped.tolist(), strict=True)
        for kind in in_order(o.t, stamps, snapped):
            if kind == ODOMETRY:
                t, v, omega = next(twists)
                self._go(t)
                if math.isfinite(v) and math.isfinite(omega):
                    self._twist, self._twist_t = (v, omega), t
                    self._hold.add(t)
                else:
                    self._twist_t = -math.inf
            elif kind == BEARINGS:
                t, seen, sigmas = next(sightings)
                self._go(t)
                self._look(t, seen, sigmas)
                self._row(t, [])
            else:
                t, same = next(times)
                self._row(t, self._way(same))

    @property
    def end(self) -> float:
        """Stamp of the last sample [s]."""
        return self._now

    def _row(self, t: float, way: list[Step]) -> None:
        self.t.append(t)
        self.rows.append((len(self.steps), way))

    def _way(self, t: float) -> list[Step]:
        """Return the steps from now to `t` [s], as `OnlineFilter` takes them."""
        if math.isnan(self._now):
            return []
        held = min(max(self._twist_t + self._hold.seconds, self._now), t)
        driven = [(dt, *self._twist, False) for dt in in_steps(held - self._now)]
        return driven + [(dt, 0.0, 0.0, True) for dt in in_steps(t - held)]

    def _go(self, t: float) -> None:
        self.steps += self._way(t)
        self._now = t

    def _look(self, t: float, seen: Mapping[str, float], sigmas: Mapping[str, float]) -> None:
        known = {
            self._index[i]: float(wrap(value + self._yaw))
            for i, value in seen.items()
            if i in self._index
        }
        own = {self._index[i]: s for i, s in sigmas.items() if i in self._index and s > 0}
        if not self.steps or (self._stamps and self._stamps[-1][1] == len(self.steps) - 1):
            self.steps.append((0.0, 0.0, 0.0, False))
        self._stamps.append((t, len(self.steps) - 1, known, own))
