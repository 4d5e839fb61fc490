"""Homing laws by name: which way home is, from a pose or from bearings alone, and how to steer."""

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
"""Home counts as reached within this distance [m]; the paper does not say."""
Slope = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""From the directions of landmarks now and at home (k,) [rad], both in the home frame, to the way
home (2,): minus the gradient of a cost."""


def average_landmark_vector(now: np.ndarray, home: np.ndarray) -> np.ndarray:
    """Return the sum of the unit vectors to the landmarks now, less that at home.

    That is minus the gradient of sum_i r_i (1 - cos d_i), r_i the distance of landmark i and d_i
    the angle between its directions now and at home, although no distance is known. Each term is
    a norm less a linear function of the robot's place: the cost is convex, and zero at home alone
    once two landmarks and home are not in line.

    References
    ----------
    Lambrinos, Moeller, Labhart, Pfeifer, Wehner, "A mobile robot employing insect strategies for
    navigation", 2000; as a gradient: Tron, Daniilidis, arXiv:1402.3584, 2014.
    """
    return np.array(
        [np.cos(now).sum() - np.cos(home).sum(), np.sin(now).sum() - np.sin(home).sum()]
    )


def squared_angles(now: np.ndarray, home: np.ndarray) -> np.ndarray:
    """Return minus the gradient of sum_i r_i d_i^2 / 2, by bearings alone.

    With home at the origin, the robot at x and landmark i at distance D_i from home, the gradient
    times x is sum_i d_i^2 / 2 (r_i - D_i cos d_i) + D_i d_i sin d_i. Each term is at least
    D_i d_i (sin d_i - d_i cos d_i / 2), which is positive unless d_i is zero: the cost grows on
    every ray from home, and has no minimum but home.

    References
    ----------
    Tron, Daniilidis, "Technical report on Optimization-Based Bearing-Only Visual Homing with
    Applications to a 2-D Unicycle Model", arXiv:1402.3584, 2014: the costs r f(cos d); the proof
    above is for this one.
    """
    d = wrap(home - now)
    c, s = np.cos(now), np.sin(now)
    return np.array([(d**2 / 2 * c + d * s).sum(), (d**2 / 2 * s - d * c).sum()])


LAWS: dict[str, Slope | None] = {
    "paper": None,
    "lyapunov": None,
    "alv": average_landmark_vector,
    "tron": squared_angles,
}
"""Each name with what it makes of bearings; None: it needs a pose."""


def law_named(name: str) -> Slope | None:
    """Return what a law makes of bearings; of other packages, too, see `homeward.plugins.load`.

    Raises
    ------
    InputError
        When there is no law of that name, or what makes it cannot be called.
    """
    return LAWS[name] if name in LAWS else cast(Slope, load(GROUP, name, LAWS))


def way_home(
    slope: Slope, seen: Mapping[str, float], home: Mapping[str, float], distance: float
) -> tuple[float, float] | None:
    """Return about where home is from the robot, x, y [m] in the home frame.

    Its direction is that of `slope`. Its length is that of a Gauss-Newton step, as if all landmarks
    were at one distance: about right near home, whichever of them are in sight.

    Parameters
    ----------
    slope : callable
        Of `LAWS`.
    seen : mapping of str to float
        Id to direction in the home frame [rad]: bearing plus heading.
    home : mapping of str to float
        Id to home bearing [rad].
    distance : float
        Of landmarks [m], about.

    Returns
    -------
    (float, float) or None
        None where fewer than two landmarks of home are in sight.

    Raises
    ------
    InputError
        When `slope` raises, or returns no two finite numbers.
    """
    both = [i for i in seen if i in home]
    if len(both) < 2:
        return None
    now = np.array([seen[i] for i in both])
    try:
        down = np.asarray(slope(now, np.array([home[i] for i in both])), float)
    except Exception as error:
        raise fault("the homing law", error) from error
    if down.shape != (2,) or not np.isfinite(down).all():
        raise InputError("a homing law gave no x and y to drive along")
    # A step s turns the sight line of a landmark by what of s is across it, over its distance.
    across = np.stack([-np.sin(now), np.cos(now)])
    step = distance * np.linalg.pinv(across @ across.T, 1e-6, hermitian=True) @ down
    length, slope_size = math.hypot(*step), math.hypot(*down)
    x, y = down * (length / slope_size if slope_size else 0.0)
    return float(x), float(y)


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


def steer(x: float, y: float, heading: float, speed: float, max_turn_rate: float) -> Twist:
    """Return the command that drives a unicycle down a cost, with its speed and turn rate bounded.

    With e the bearing of the way (x, y), turn at clip(e / 1 s) and drive at
    min(speed, |(x, y)| / 1 s) max(cos e, 0). The cost never grows, for its rate is minus the
    slope times v cos e; and it falls but for the time, at most pi / 2 over the turn rate, in which
    the robot turns towards a way that stands still meanwhile. So from everywhere the robot gets to
    the one place without a slope, however tight the bounds are.

    Parameters
    ----------
    x, y : float
        The way, in the home frame [m].
    heading : float
        Of the robot [rad].
    speed : float
        The most [m/s].
    max_turn_rate : float
        The most [rad/s].
    """
    e = wrap(math.atan2(y, x) - heading)
    turn = max(-max_turn_rate, min(max_turn_rate, e))
    return Twist(min(speed, math.hypot(x, y)) * max(math.cos(e), 0.0), turn)
