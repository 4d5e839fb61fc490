"""Odometry from the wheels' counters or speeds in a sensor_msgs/JointState."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from homeward.drives.drive import Odometry
from homeward.drives.plausibility import MIN_JUMP, without_implausible
from homeward.drives.ros.settings import OdometryTopic
from homeward.errors import InputError

BITS = 8, 15, 16, 24, 31, 32
"""Sizes of the counters whose wrap-around is known; signed or not, a wrap is a step of 2^bits."""
WRAPPED = "wrap-arounds of wheel counters, removed"


class Wheels:
    """The wheels of a robot in messages of the type sensor_msgs/JointState."""

    def __init__(self, given: OdometryTopic) -> None:
        if given.wheel_radius is None or given.track_width is None:
            raise InputError(
                f"{given.topic}: wheels need wheel_radius and track_width in the topics file"
            )
        self._given = given
        self._radius, self._track = given.wheel_radius, given.track_width
        self._by_position: bool | None = None
        self._wheels: tuple[list[str], list[str]] | None = None

    def row(self, message: Any) -> list[float] | None:
        """Return the angle (or rate) of each wheel, left ones first; None without all of them."""
        names = list(message.name)
        if self._wheels is None:
            left = self._joints(names, self._given.left, "left")
            right = self._joints(names, self._given.right, "right")
            if not left or not right:
                return None
            self._wheels = left, right
            self._by_position = len(message.position) == len(names)
        values = message.position if self._by_position else message.velocity
        wheels = self._wheels[0] + self._wheels[1]
        if len(values) != len(names) or not set(wheels) <= set(names):
            return None
        return [float(values[names.index(name)]) for name in wheels]

    @staticmethod
    def _joints(names: list[str], wanted: tuple[str, ...], side: str) -> list[str]:
        if wanted:
            return list(wanted) if set(wanted) <= set(names) else []
        return [name for name in names if side in name.lower()]

    def odometry(self, t: np.ndarray, wheels: np.ndarray, remarks: dict[str, int]) -> Odometry:
        """Return the odometry of wheels, shape (n, k) [rad or rad/s], at `t`, shape (n,) [s].

        Wrap-arounds of counters are removed; other implausible motion is unknown. `remarks` counts
        both.
        """
        assert self._wheels is not None
        if self._by_position:
            tolerance = MIN_JUMP / self._radius
            parts = [_unwrapped(column, tolerance, remarks) for column in wheels.T]
            steps = np.diff(t)[:, None]
            last = np.zeros((1, wheels.shape[1]))
            wheels = np.concatenate([np.diff(np.stack(parts, axis=1), axis=0) / steps, last])
        count = len(self._wheels[0])
        left = self._radius * wheels[:, :count].mean(axis=1)
        right = self._radius * wheels[:, count:].mean(axis=1)
        odometry = Odometry(t, (left + right) / 2, (right - left) / self._track)
        return without_implausible(odometry, remarks)


def _unwrapped(angle: np.ndarray, tolerance: float, remarks: dict[str, int]) -> np.ndarray:
    """Return a wheel's angle [rad] without the wrap-arounds of its counter.

    A step is a wrap-around where it differs by at most `tolerance` [rad] from the step before it,
    once the span of a counter is removed: a turn, or 2^bits times the smallest unit of the angle,
    or 2^bits where the angle is counted in ticks.
    """
    if angle.size < 3:
        return angle
    step = np.diff(angle)
    unit = _unit(step)
    spans = [math.tau, *(2.0**bits * size for size in {1.0, unit} if size for bits in BITS)]
    usual = np.median(np.abs(step))
    wraps = 0
    for i in np.flatnonzero(np.abs(step) > tolerance + 4.0 * usual).tolist():
        before = step[i - 1] if i else 0.0
        span = min(spans, key=lambda s: abs(abs(step[i] - before) - s))
        if abs(abs(step[i] - before) - span) <= tolerance:
            step[i] -= math.copysign(span, step[i])
            wraps += 1
    if wraps:
        remarks[WRAPPED] = remarks.get(WRAPPED, 0) + wraps
    return np.append(angle[0], angle[0] + np.cumsum(step))


def _unit(step: np.ndarray) -> float:
    """Return the angle of one tick, of which all steps are multiples; 0 where there is none."""
    size = np.unique(np.abs(step[step != 0.0]))
    gaps = np.diff(np.append(0.0, size))
    # Rounding errors part steps that are equal.
    gaps = gaps[gaps > 1e-6 * np.median(size)] if size.size else gaps
    if not gaps.size:
        return 0.0
    unit = float(gaps.min())
    small = size[size < 1e5 * unit]
    if not small.size:
        return 0.0
    number = np.round(small / unit)
    unit = float(small @ number / (number @ number))
    return unit if np.abs(small / unit - number).max() < 0.1 else 0.0
