"""Odometry history: the twists that pictures, which may come late, still need."""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

import numpy as np

from homeward.drives.dead_reckoning import dead_reckoning
from homeward.drives.drive import DriveSettings, Odometry
from homeward.drives.odometry_noise import OdometryDefaults, noise_rates
from homeward.estimator import HOLD_S
from homeward.frames import Pose, between, compose

SLIP = 0.05
"""Error of odometry between pictures, as a share of the way and of the turn, beside its noise."""


class Twist(NamedTuple):
    """A twist, and how far the robot had gone by then."""

    t: float
    """It holds from here on [s]."""
    v: float
    """[m/s]"""
    omega: float
    """[rad/s]"""
    gone: np.ndarray
    """(2,): way and turn [m, rad]."""


class OdometryHistory:
    """Twists in order of time, integrated from one to another."""

    def __init__(self, settings: DriveSettings) -> None:
        self._noise_rates = noise_rates(settings.odometry, OdometryDefaults())
        self._twists: deque[Twist] = deque()

    @property
    def newest(self) -> float:
        """Stamp of the newest twist [s]; minus infinity where there is none."""
        return self._twists[-1].t if self._twists else -math.inf

    def add(self, t: float, v: float, omega: float) -> None:
        """Take a twist that holds from `t` [s] on, not before the newest."""
        self._twists.append(Twist(t, v, omega, self.gone(t)))

    def forget(self, t: float) -> None:
        """Drop the twists that did not hold at `t` [s] or later."""
        while len(self._twists) > 1 and self._twists[1].t <= t:
            self._twists.popleft()

    def gone(self, t: float) -> np.ndarray:
        """Return way and turn up to `t` [s], (2,) [m, rad]."""
        if not self._twists:
            return np.zeros(2)
        held = next((twist for twist in reversed(self._twists) if twist.t <= t), self._twists[0])
        rates = np.array([abs(held.v), held.omega])
        return held.gone + rates * min(max(t - held.t, 0.0), HOLD_S)

    def propagate(
        self, pose: Pose, covariance: np.ndarray, start: float, end: float
    ) -> tuple[Pose, np.ndarray]:
        """Move a pose of time `start` [s] and its covariance, (3, 3), on to `end` [s]."""
        if not self._twists:
            return pose, covariance
        times, v, omega = np.array([twist[:3] for twist in self._twists]).T
        ends = dead_reckoning(Odometry(times, v, omega), np.array([start, end]))
        motion = between(*(Pose(*(float(c[k]) for c in ends)) for k in (0, 1)))
        x, y, heading = compose(pose, motion)
        way = math.hypot(motion.x, motion.y)
        jacobian = np.eye(3)
        jacobian[:2, 2] = pose.y - y, x - pose.x
        slip = SLIP * np.array([way, way, motion.heading])
        held = np.minimum(np.append(times[1:], end), end) - np.maximum(times, start)
        held = np.clip(held, 0.0, HOLD_S)
        moving = (v != 0.0) | (omega != 0.0)
        done = np.array([held @ moving, held @ np.abs(v), held @ np.abs(omega)])
        along, _, turned = self._noise_rates @ done
        noise = np.diag(slip**2 + np.array([along, along, turned]))
        return Pose(x, y, heading), jacobian @ covariance @ jacobian.T + noise
