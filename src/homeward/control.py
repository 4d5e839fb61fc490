"""The paper's homing law: turn towards home in proportion to the error, at constant speed."""

from __future__ import annotations

import math
from typing import Any, Literal, NamedTuple

import numpy as np

from homeward.angles import wrap
from homeward.frames import Polar, Pose

STOP_RADIUS = 0.05
"""Home counts as reached within this distance [m]; the paper does not say."""

Integration = Literal["rk4", "euler"]
"""How a motion is integrated where symbols are."""


class Twist(NamedTuple):
    """A command to a unicycle: v [m/s] forward, omega [rad/s] anti-clockwise."""

    v: Any
    omega: Any


def advance(pose: Pose, twist: Twist, dt: Any) -> Pose:
    """Return where a unicycle with a constant twist gets to in `dt` [s]: exactly, on an arc.

    Floats, or arrays of one shape. Headings [rad] are not wrapped here.
    """
    half: Any = 0.5 * twist.omega * dt
    trig: Any = np
    shrink: Any
    if isinstance(half, np.ndarray):
        shrink = np.sinc(half / math.pi)
    else:  # the same, much quicker
        trig = math
        # sin(x)/x loses nothing for small x; below this it is 1 to the last bit.
        shrink = math.sin(half) / half if abs(half) > 1e-8 else 1.0
    chord = twist.v * dt * shrink
    return Pose(
        pose.x + chord * trig.cos(pose.heading + half),
        pose.y + chord * trig.sin(pose.heading + half),
        pose.heading + 2.0 * half,
    )


def homing(polar: Polar, speed: Any) -> Twist:
    """Return the paper's command, ``omega = pi - (alpha - theta)`` wrapped, at constant speed.

    The gain is 1/s. Home is reached from any pose with R well above ``speed * 1 s``; closer than
    that the law cannot turn fast enough, and the robot goes round once more.

    Parameters
    ----------
    polar : Polar
        Where the robot believes it is: R [m], theta [rad], alpha [rad]; floats, arrays or symbols.
    speed : float or casadi.SX
        [m/s]

    References
    ----------
    Patil, Thakkar, Vachhani, "State Estimation for Vision-based Localization under Uncertain
    Conditions".
    """
    return Twist(speed, wrap(math.pi - (polar.alpha - polar.theta)))
