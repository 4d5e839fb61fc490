"""How far odometry may be off, as a drive says or as wheels mostly are."""

from __future__ import annotations

import numpy as np

from homeward.drives.drive import OdometryNoise, Positive
from homeward.io.strict import Strict


class OdometryDefaults(Strict):
    """Errors of an odometry of which nothing is known: a wheeled robot's, uncalibrated."""

    distance: Positive = 0.05
    """Diffusion along the path, and sideways to a third of it, in a room [m per root of a metre];
    times the root of k among landmarks at k times the distance, if nearer."""
    turn_by_turning: Positive = 0.05
    """Diffusion of the heading by turning [rad per root of a radian]."""
    turn_by_driving: Positive = 0.03
    """Diffusion of the heading by driving [rad per root of a metre]."""
    turn_scale: Positive = 0.05
    """Constant relative error of the turn rate [1]."""
    turn_bias: Positive = 0.003
    """Constant error of the turn rate while the robot moves [rad/s]."""
    turn_slip: Positive = 0.05
    """Speed lost in bends, per turn rate [m]; none when the drive tells its speed scale."""
    speed_scale: Positive = 0.03
    """Constant relative error of the speed [1]; bearings cannot tell it, so it is only carried."""


def noise_rates(given: OdometryNoise, default: OdometryDefaults) -> np.ndarray:
    """Return how fast white noise grows: as the drive says, or else in proportion to the motion.

    Returns
    -------
    ndarray, shape (3, 3)
        Of the variances along [m^2/s], across [m^2/s] and of the heading [rad^2/s] (rows): what is
        constant, what is in proportion to the speed [m/s], and what to the turn rate [rad/s].
    """
    rates = np.zeros((3, 3))
    if given.speed_sigma is None:
        rates[:2, 1] = default.distance**2, default.distance**2 / 9.0
    else:
        rates[0, 0] = given.speed_sigma**2
    if given.turn_sigma is None:
        rates[2, 1:] = default.turn_by_driving**2, default.turn_by_turning**2
    else:
        rates[2, 0] = given.turn_sigma**2
    return rates
