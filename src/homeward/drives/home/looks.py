"""Home while the robot is there: what it sees of it is gathered as it comes, and then solved."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Unpack

from homeward.drives.drive import HomeBearing, Robot
from homeward.drives.home.spin import Spin, spin
from homeward.drives.known import known_robot
from homeward.drives.samples import Samples
from homeward.errors import InputError

LONGEST_S = 600.0
"""Looks that nobody ended would fill the memory [s]."""


class HomeLooks:
    """Looks from one place: while the robot turns on the spot, or several short ones.

    Home is where the robot was at the first twist.

    >>> looks = HomeLooks(sensor={"x": 0.2})
    >>> looks.odometry(0.0, 0.0, 0.5)  # and so on, as for a Localizer
    >>> looks.bearings(0.1, {"door": 0.31})
    >>> localizer = Localizer(looks.home(), sensor={"x": 0.2})

    Parameters
    ----------
    **robot : Robot
        What is known of the robot, as for a `Localizer`.
    """

    def __init__(self, **robot: Unpack[Robot]) -> None:
        self._robot = known_robot(robot)
        self._samples = Samples()
        self._begun: float | None = None
        self._too_long = False

    def odometry(self, t: float, v: float, omega: float) -> None:
        """Take a twist that holds from `t` [s] on: `v` [m/s] forward, `omega` [rad/s]."""
        if self._takes(t):
            self._samples.add_twist(t, v, omega)

    def bearings(
        self, t: float, sightings: Mapping[str, float], sigmas: Mapping[str, float] | None = None
    ) -> None:
        """Take all sightings of stamp `t` [s], as `Localizer.bearings`."""
        if self._takes(t):
            self._samples.add_bearings(t, sightings, sigmas)

    def spin(self) -> Spin:
        """Return what the looks tell of home; errors as `home`."""
        if self._too_long:
            raise InputError(f"home was looked at for more than {LONGEST_S:g} s")
        odometry, seen = self._samples.odometry(), self._samples.sightings()
        if not odometry.t.size or not seen.t.size:
            raise InputError("of home nothing was seen, or there was no odometry")
        span = float(odometry.t[0]), max(float(odometry.t[-1]), float(seen.t[-1]))
        return spin(span, odometry, seen, self._robot)

    def home(self) -> dict[str, HomeBearing]:
        """Return the home bearings, with their deviations.

        Raises
        ------
        InputError
            When nothing was seen, or that took too long, or as `homeward.drives.home.spin.spin`.
        """
        return self.spin().home

    def _takes(self, t: float) -> bool:
        if not math.isfinite(t):
            return False
        if self._begun is None:
            self._begun = t
        self._too_long |= not t - self._begun <= LONGEST_S
        return not self._too_long
