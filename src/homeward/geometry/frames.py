"""Poses, twists and polar coordinates in SE(2), on floats, arrays and CasADi symbols.

A pose is (x, y, heading) of the robot's centre; (R, theta, alpha) are its polar coordinates in the
home frame: distance from home, direction seen from home, heading.
"""

from __future__ import annotations

import math
from typing import Any, Literal, NamedTuple

import numpy as np

from homeward.geometry.angles import apply, wrap

Integration = Literal["rk4", "euler"]
"""Integration method of symbolic motion models."""


class Pose(NamedTuple):
    """A pose in the plane: x [m], y [m], heading [rad]."""

    x: Any
    y: Any
    heading: Any


class Polar(NamedTuple):
    """A pose in the paper's polar coordinates: R [m], theta [rad], alpha [rad]."""

    R: Any
    theta: Any
    alpha: Any


class Twist(NamedTuple):
    """Twist of a unicycle: v [m/s] forward, omega [rad/s] anti-clockwise."""

    v: Any
    omega: Any


def compose(a: Pose, b: Pose) -> Pose:
    """Return pose `b`, which is in the frame of `a`, in the parent frame of `a`."""
    c, s = apply("cos", a.heading), apply("sin", a.heading)
    return Pose(a.x + c * b.x - s * b.y, a.y + s * b.x + c * b.y, wrap(a.heading + b.heading))


def inverse(a: Pose) -> Pose:
    """Return the inverse: its composition with `a` is the origin."""
    c, s = apply("cos", a.heading), apply("sin", a.heading)
    return Pose(-c * a.x - s * a.y, s * a.x - c * a.y, wrap(-a.heading))


def between(a: Pose, b: Pose) -> Pose:
    """Return pose `b` in the frame of `a`; both are in one frame."""
    return compose(inverse(a), b)


def advance(pose: Pose, twist: Twist, dt: Any, vy: Any = 0.0) -> Pose:
    """Return the pose after `dt` [s] of a constant twist, exactly, on an arc.

    Arguments are floats, or arrays of one shape. The heading [rad] is not wrapped. A holonomic
    robot also moves to its left, at `vy` [m/s].
    """
    half: Any = 0.5 * twist.omega * dt
    trig: Any = np
    shrink: Any
    if isinstance(half, np.ndarray):
        shrink = np.sinc(half / math.pi)
    else:  # same result, much faster
        trig = math
        # sin(x)/x loses nothing for small x; below this it is 1 to the last bit.
        shrink = math.sin(half) / half if abs(half) > 1e-8 else 1.0
    chord, left = twist.v * dt * shrink, vy * dt * shrink
    c, s = trig.cos(pose.heading + half), trig.sin(pose.heading + half)
    return Pose(
        pose.x + chord * c - left * s, pose.y + chord * s + left * c, pose.heading + 2.0 * half
    )


def to_polar(pose: Pose) -> Polar:
    """Return (R, theta, alpha) of a pose in the home frame; theta is 0 at home."""
    return Polar(
        apply("hypot", pose.x, pose.y), apply("arctan2", pose.y, pose.x), wrap(pose.heading)
    )


def from_polar(polar: Polar) -> Pose:
    """Return the pose in the home frame; a negative R is opposite to theta."""
    return Pose(
        polar.R * apply("cos", polar.theta), polar.R * apply("sin", polar.theta), wrap(polar.alpha)
    )


def bearing(pose: Pose, x: Any, y: Any) -> Any:
    """Return the bearing [rad] of the point (x, y) from a pose, in (-pi, pi]."""
    return wrap(apply("arctan2", y - pose.y, x - pose.x) - pose.heading)


def position_sigma(covariance: np.ndarray) -> Any:
    """Return the standard deviation of a position along its worst direction [m].

    The semi-major axis of the 1-sigma ellipse of a covariance (..., k, k) of x, y [m] and any
    further components; NaN gives NaN, and a single covariance a float.
    """
    xx, xy, yy = covariance[..., 0, 0], covariance[..., 0, 1], covariance[..., 1, 1]
    largest = 0.5 * (xx + yy) + np.hypot(0.5 * (xx - yy), xy)
    return np.sqrt(np.maximum(largest, 0.0))


def polar_covariance_to_pose(polar: Polar, covariance: np.ndarray) -> np.ndarray:
    """Transform a covariance (..., 3, 3) of (R, theta, alpha) to (x, y, heading), to first order.

    In m and rad; `polar` is the point of linearisation: numbers, or arrays of one shape.
    """
    c, s = np.cos(polar.theta), np.sin(polar.theta)
    jacobian = np.zeros((*np.shape(c), 3, 3))
    jacobian[..., 0, 0], jacobian[..., 0, 1] = c, -polar.R * s
    jacobian[..., 1, 0], jacobian[..., 1, 1] = s, polar.R * c
    jacobian[..., 2, 2] = 1.0
    return np.asarray(jacobian @ covariance @ np.swapaxes(jacobian, -1, -2))
