"""Homing laws by name: the home vector from a pose or from bearings alone, and steering."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, cast

import numpy as np

from homeward.errors import InputError
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Polar, Twist
from homeward.plugins import LAWS as GROUP
from homeward.plugins import fault, load

STOP_RADIUS = 0.05
"""Home is reached within this distance [m]; the paper does not specify it."""
BearingLaw = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Function from the directions of landmarks now and at home (k,) [rad], both in the home frame, to
the direction of home (2,), minus the gradient of a cost."""


def average_landmark_vector(now: np.ndarray, home: np.ndarray) -> np.ndarray:
    """Return the sum of the unit vectors to the landmarks now, minus that at home.

    This is minus the gradient of sum_i r_i (1 - cos d_i), where r_i is the distance of landmark i
    and d_i the angle between its directions now and at home; it needs no distance. Each term is a
    norm minus a linear function of the robot's position, so the cost is convex. It is zero only
    at home if two landmarks and home are not collinear.

    References
    ----------
    Lambrinos, Moeller, Labhart, Pfeifer, Wehner, "A mobile robot employing insect strategies for
    navigation", 2000; as a gradient: Tron, Daniilidis, arXiv:1402.3584, 2014.
    """
    return np.array(
        [np.cos(now).sum() - np.cos(home).sum(), np.sin(now).sum() - np.sin(home).sum()]
    )


def squared_angles(now: np.ndarray, home: np.ndarray) -> np.ndarray:
    """Return minus the gradient of sum_i r_i d_i^2 / 2, from bearings alone.

    With home at the origin, the robot at x and landmark i at distance D_i from home, the gradient
    times x is sum_i d_i^2 / 2 (r_i - D_i cos d_i) + D_i d_i sin d_i. Each term is at least
    D_i d_i (sin d_i - d_i cos d_i / 2), which is positive unless d_i is zero: the cost increases
    along every ray from home, and home is its only minimum.

    References
    ----------
    Tron, Daniilidis, "Technical report on Optimization-Based Bearing-Only Visual Homing with
    Applications to a 2-D Unicycle Model", arXiv:1402.3584, 2014: the costs r f(cos d); the proof
    above is for this one.
    """
    d = wrap(home - now)
    c, s = np.cos(now), np.sin(now)
    return np.array([(d**2 / 2 * c + d * s).sum(), (d**2 / 2 * s - d * c).sum()])


LAWS: dict[str, BearingLaw | None] = {
    "paper": None,
    "lyapunov": None,
    "alv": average_landmark_vector,
    "tron": squared_angles,
}
"""Function of bearings of each law; None: the law needs a pose."""


def law_named(name: str) -> BearingLaw | None:
    """Return the function of bearings of a law, built-in or a plugin (`homeward.plugins.load`).

    `InputError` if there is no law of that name, or it is not callable.
    """
    return LAWS[name] if name in LAWS else cast(BearingLaw, load(GROUP, name, LAWS))


def home_vector(
    law: BearingLaw, seen: Mapping[str, float], home: Mapping[str, float], distance: float
) -> tuple[float, float] | None:
    """Return the approximate vector from the robot to home, x, y [m] in the home frame.

    Its direction is that of the law. Its length is that of a Gauss-Newton step with all landmarks
    at one `distance` [m], which is accurate near home for any subset of the landmarks. `seen` has
    the direction of each landmark in the home frame, bearing plus heading, and `home` its home
    bearing [rad]. None if fewer than two landmarks with a home bearing are in view; `InputError` if
    `law` raises, or does not return two finite numbers.
    """
    both = [i for i in seen if i in home]
    if len(both) < 2:
        return None
    now = np.array([seen[i] for i in both])
    try:
        down = np.asarray(law(now, np.array([home[i] for i in both])), float)
    except Exception as error:
        raise fault("the homing law", error) from error
    if down.shape != (2,) or not np.isfinite(down).all():
        raise InputError("the homing law must return two finite numbers, the direction x and y")
    # A step rotates the line of sight by its component across that line, divided by the distance.
    across = np.stack([-np.sin(now), np.cos(now)])
    step = distance * np.linalg.pinv(across @ across.T, 1e-6, hermitian=True) @ down
    length, slope_size = math.hypot(*step), math.hypot(*down)
    x, y = down * (length / slope_size if slope_size else 0.0)
    return float(x), float(y)


def homing(polar: Polar, speed: Any) -> Twist:
    """Return the paper's command, ``omega = pi - (alpha - theta)`` wrapped, at constant speed.

    The gain is 1/s. Home is reached from any pose with R well above ``speed * 1 s``; at a smaller
    distance the law cannot turn fast enough, and the robot passes home and turns back.

    Parameters
    ----------
    polar : Polar
        Estimated pose: R [m], theta [rad], alpha [rad]; floats, arrays or symbols.
    speed : float or casadi.SX
        [m/s]

    References
    ----------
    Patil, Thakkar, Vachhani, "State Estimation for Vision-based Localization under Uncertain
    Conditions".
    """
    return Twist(speed, wrap(math.pi - (polar.alpha - polar.theta)))


def steer(
    x: float,
    y: float,
    heading: float,
    speed: float,
    max_turn_rate: float,
    sharpness: float = 1.0,
) -> Twist:
    """Return the command that drives a unicycle down a cost, with limited speed and turn rate.

    With e the bearing of the home vector (x, y) [m] from the robot's heading [rad], turn at clip(e
    / 1 s) and drive at min(speed, |(x, y)| / 1 s) cos(k e), k being the `sharpness` (at least 1),
    while abs(k e) is below 90 degrees. The cost never increases, as its rate is minus its slope
    times v cos e. It decreases except while the robot turns on the spot towards a constant vector,
    for a bounded time. So the robot reaches the only point of zero slope from any pose, for any
    limits [m/s, rad/s].

    A larger `sharpness` makes the path to a point straighter: at 0.5 m/s it is off the line by at
    most 0.37 m with 1, and 0.18 m with 2.
    """
    e = wrap(math.atan2(y, x) - heading)
    turn = max(-max_turn_rate, min(max_turn_rate, e))
    share = math.cos(sharpness * e) if sharpness * abs(e) < math.pi / 2 else 0.0
    return Twist(min(speed, math.hypot(x, y)) * share, turn)
