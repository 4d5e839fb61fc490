"""Contradiction between the poses and the twists of one nav_msgs/Odometry topic."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from homeward.drives.drive import Odometry
from homeward.drives.plausibility import steps_between, without_implausible
from homeward.odometry.limits import MAX_SPEED
from homeward.odometry.validity import TWIST_VALIDITY_S

WINDOWS_S = 1.0, 5.0
"""Intervals over which motions are compared [s]; the second for slow robots."""
MIN_MOTION = 0.05
"""Minimum motion in an interval [m, rad]; a smaller one may be noise of the poses."""
MIN_WINDOWS = 5
"""Minimum number of intervals with motion."""
MAX_GAIN_ERROR = 1 / 3
"""Maximum error of the gain between the two motions: the geometric middle between 0.1, the
calibration error of a poor robot, and 1, the error of a wrong frame, unit or sign."""
MAX_STILL = 1 / 3
"""Maximum share of the moving intervals in which one of the two does not move."""
STILL = 1e-4
"""Ratio to the other motion below which a motion counts as none."""
MIN_PERSISTENCE = 1.5
"""Minimum mean square of the motion over two intervals, as a multiple of that over one: it is 4 in
steady motion, 2 in a random walk, and 1 for white noise of the poses at standstill."""
DEVIATIONS = 3.0
"""Number of standard errors by which a wrong gain exceeds `MAX_GAIN_ERROR`."""
MIN_RESIDUAL = 0.05
"""Share of the motion below which residuals are ignored."""
BETTER = 4.0
"""Minimum factor by which another frame must reduce the squared residuals."""


class SourceContradiction(NamedTuple):
    """A contradiction, and the usable one of poses and twists."""

    words: str
    """Description of the contradiction."""
    poses: bool
    """Whether the poses are usable; else the twists."""


def contradiction(rows: np.ndarray) -> SourceContradiction | None:
    """Compare the twists of messages with the motion of their poses; None where they agree.

    `rows` (n, 7) are t [s], forward speed [m/s], yaw rate [rad/s], sideways speed [m/s], x [m], y
    [m] and heading [rad]; t increases.
    """
    rows = rows[np.isfinite(rows).all(axis=1)]
    if len(rows) < 3:
        return None
    short, long = (_motions(rows, window) for window in WINDOWS_S)
    path, turn = (a if _enough(*a[:2]) else b for a, b in zip(short, long, strict=True))
    return _compare(rows, *path, *turn)


def _enough(twist: np.ndarray, pose: np.ndarray) -> bool:
    """Return whether enough intervals have a motion."""
    return bool((np.maximum(np.abs(twist), np.abs(pose)) > MIN_MOTION).sum() >= MIN_WINDOWS)


def _motions(
    rows: np.ndarray, window: float
) -> tuple[tuple[np.ndarray, np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]:
    """Return translations (of twists, of poses in the robot's and the odom frame) and rotations.

    Translations are complex, forward + i left [m]; arrays have an entry for each interval.
    """
    t, dt = rows[:, 0], np.diff(rows[:, 0])
    twist = (rows[1:, 1:4] + rows[:-1, 1:4]) / 2 * dt[:, None]
    forward, sideways, turned = steps_between(rows[:, 4:])
    odom = np.diff(rows[:, 4]) + 1j * np.diff(rows[:, 5])
    # Intervals with a jump of the poses do not count.
    rates = (np.append(step / dt, 0.0) for step in (forward, turned, sideways))
    known = without_implausible(Odometry(t, *rates), {}).v[:-1]
    use = np.isfinite(known) & (dt <= 2 * TWIST_VALIDITY_S)
    number = ((t[:-1] - t[0]) / max(window, float(np.median(dt)))).astype(int)

    def summed(steps: np.ndarray) -> np.ndarray:
        steps = np.where(use, steps, 0)
        sums = np.bincount(number, steps.real)
        return sums + 1j * np.bincount(number, steps.imag) if np.iscomplexobj(steps) else sums

    path = twist[:, 0] + 1j * twist[:, 2], forward + 1j * sideways, odom
    return (summed(path[0]), summed(path[1]), summed(path[2])), (
        summed(twist[:, 1]),
        summed(turned),
    )


def _compare(
    rows: np.ndarray,
    twist: np.ndarray,
    pose: np.ndarray,
    odom: np.ndarray,
    twist_turn: np.ndarray,
    pose_turn: np.ndarray,
) -> SourceContradiction | None:
    """Compare translations and rotations of intervals."""
    path, turn = _relation(twist, pose), _relation(twist_turn, pose_turn)
    if "pose" in (path, turn):
        return SourceContradiction("the poses do not move while the twists do", False)
    moves = np.maximum(np.abs(twist), np.abs(pose)) > MIN_MOTION
    residual, residual_odom = (
        float(np.square(np.abs(p - twist)[moves]).sum()) for p in (pose, odom)
    )
    min_residual = np.square(MIN_RESIDUAL * np.abs(twist[moves])).sum()
    in_odom = _enough(twist, pose) and residual > max(min_residual, BETTER * residual_odom)
    if path is None and turn is None and not in_odom:
        return None
    coherent = np.square(pose.imag).sum() <= np.square(pose.real).sum()
    speed = np.abs(pose[moves]).sum() / max(np.ptp(rows[:, 0]), 1e-9)
    if in_odom:  # the same motion, also where the robot moves sideways
        words = "the twists are in the odom frame, not in the robot's"
        return SourceContradiction(words, bool(speed <= MAX_SPEED))
    usable = bool(coherent and speed <= MAX_SPEED)
    if "twist" in (path, turn):
        still = " and ".join(n for n, r in (("speed", path), ("yaw rate", turn)) if r == "twist")
        return SourceContradiction(
            f"the {still} of the twists is zero while the poses move", usable
        )
    both = ("translation", path), ("rotation", turn)
    gains = " and ".join(f"{gain} in {what}" for what, gain in both if gain is not None)
    return SourceContradiction(f"the motion of the poses is {gains}", usable)


def _relation(twist: np.ndarray, pose: np.ndarray) -> str | None:
    """Return None where both agree, "twist" or "pose" where that one does not move, or the gain."""
    size = np.abs(twist), np.abs(pose)
    moves = np.maximum(*size) > MIN_MOTION
    if not _enough(twist, pose):
        return None
    twist_still, pose_still = (moves & (a <= STILL * b) for a, b in (size, size[::-1]))
    for name, still in (("pose", pose_still), ("twist", twist_still)):
        if still.sum() > MAX_STILL * moves.sum():
            return None if name == "twist" and not _persists(pose) else name
    both = ~(twist_still | pose_still)  # also at standstill, where noise has little weight
    power = float(np.square(size[0][both]).sum())
    if not power > 0:
        return None
    gain = (np.conj(twist[both]) * pose[both]).sum() / power
    rest = np.square(np.abs(pose[both] - gain * twist[both])).sum()
    error = float(np.sqrt(rest / max(moves.sum() - 1, 1) / power))
    if abs(gain - 1) <= MAX_GAIN_ERROR + DEVIATIONS * error:
        return None
    if abs(gain.imag) > 0.1 * abs(gain):
        angle = np.degrees(np.angle(gain))
        return f"{abs(gain):.3g} x that of the twists, rotated by {angle:.0f} deg,"
    return f"{gain.real:.3g} x that of the twists"


def _persists(pose: np.ndarray) -> bool:
    """Return whether the motion of the poses is more than noise."""
    double = np.square(np.abs(pose[1:] + pose[:-1])).mean()
    return bool(double > MIN_PERSISTENCE * np.square(np.abs(pose)).mean())
