"""Guided start: the next motion with the most information on the landmarks of home.

Without a pose, distances of landmarks come from parallax only, and a drive towards a landmark has
none. Of a grid of motions (turn, drive `DRIVE_M`, and look ahead or back to where it
looked before), the best is the one with the largest expected information on the logarithms of the
distances of home's landmarks, from their sight lines by odometry.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from typing import NamedTuple

import numpy as np

from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose, compose
from homeward.sighting_keys import is_followed

DRIVE_M = 1.0
"""Distance of an advised drive [m]: a quarter of the distance of landmarks in a room."""
DISTANCES_M = 2.0 ** np.arange(4)
"""Distances that a landmark may have, equally probable: in a room or a hall, not known yet [m]."""
SIGHT_SIGMA = 0.05
"""Standard deviation of a parallax, with the errors of an uncalibrated odometry [rad]."""
NUM_TURNS = 24
"""Number of turns that are compared."""
TURN_COST = 0.02
"""Information that a turn by one radian must bring to be worth its time [1]."""
ENOUGH = 5
"""Landmarks of home in sight with which a search for more need not come first: three determine the
pose, and two may have moved."""


class Manoeuvre(NamedTuple):
    """A motion: turn on the spot, drive straight, turn on the spot."""

    turn: float
    """[rad], to the left."""
    distance: float
    """[m]"""
    turn_after: float
    """[rad], to the left."""

    @property
    def words(self) -> str:
        """The motion as an instruction for a person who drives the robot."""
        steps = [_turn(self.turn), f"drive {self.distance:g} m" if self.distance else ""]
        return ", then ".join(step for step in [*steps, _turn(self.turn_after)] if step)


class StartGuide:
    """Advises motions until there is a pose.

    Parameters
    ----------
    home : collection of str
        Landmarks that home saw; those without ids give no advice.
    camera : Pose
        Pose of the camera on the robot.
    """

    def __init__(self, home: Collection[str], camera: Pose) -> None:
        self._home, self._camera = frozenset(filter(is_followed, home)), camera
        self._first: dict[str, float] = {}
        """Direction of each landmark when it was first seen, in the odometry frame [rad] ..."""
        self._last: dict[str, float] = {}
        """... and when it was last seen."""
        self._robot = Pose(0.0, 0.0, 0.0)
        self._headings: tuple[float, float] | None = None
        """Smallest and largest heading with an image, unwrapped [rad]."""
        self._half_view = 0.0
        """Largest bearing so far, half of the field of view [rad]."""

    def add(self, robot: Pose, bearings: Mapping[str, float]) -> None:
        """Add the sightings of one image, with the robot's pose by odometry."""
        low, high = self._headings or (robot.heading, robot.heading)
        heading = self._robot.heading if self._headings else robot.heading
        heading += float(wrap(robot.heading - heading))
        self._headings = min(low, heading), max(high, heading)
        self._robot = robot._replace(heading=heading)
        camera = compose(robot, self._camera).heading
        for name, bearing in bearings.items():
            if not math.isfinite(bearing):
                continue
            bearing = float(wrap(bearing))
            self._half_view = max(self._half_view, abs(bearing))
            if name in self._home:
                direction = float(wrap(camera + bearing))
                self._first.setdefault(name, direction)
                self._last[name] = direction

    def advice(self) -> Manoeuvre | None:
        """Return the motion with the most information; None before the first image."""
        if self._headings is None:
            return None
        unseen = math.tau - 2.0 * self._half_view - self._headings[1] + self._headings[0]
        if len(self._last) < min(ENOUGH, len(self._home)) and unseen > 0.1:
            return Manoeuvre(math.tau, 0.0, 0.0)
        if not self._last:
            return Manoeuvre(0.0, DRIVE_M, 0.0)
        names = list(self._last)
        ahead = np.array([wrap(self._last[n] - self._robot.heading) for n in names])
        parallax = np.abs([wrap(self._last[n] - self._first[n]) for n in names])
        turns = wrap(math.tau * np.arange(NUM_TURNS) / NUM_TURNS)
        gains = self._gains(ahead, parallax, turns)
        back = np.stack([np.zeros(NUM_TURNS), np.abs(turns)])
        worth = gains - TURN_COST * (np.abs(turns) + back)
        best = np.argmax(worth.round(9))  # of motions that are equal but for rounding, the first
        looks_back, index = divmod(int(best), NUM_TURNS)
        turn = float(turns[index])
        return Manoeuvre(turn, DRIVE_M, -turn if looks_back else 0.0)

    def _gains(self, ahead: np.ndarray, parallax: np.ndarray, turns: np.ndarray) -> np.ndarray:
        """Return the expected information of each motion [1], (2, k): looking ahead, looking back.

        Parameters
        ----------
        ahead : ndarray, shape (n,)
            Bearings of landmarks from the robot's heading [rad].
        parallax : ndarray, shape (n,)
            Parallax that each has already [rad].
        turns : ndarray, shape (k,)
            Turns before the drive [rad].
        """
        off = wrap(ahead - turns[:, None])[:, :, None]
        across, along = DRIVE_M * np.sin(off), DISTANCES_M - DRIVE_M * np.cos(off)
        moved = np.arctan2(across, along)
        parallax = parallax[None, :, None]
        before, after = (
            np.log1p((angle / SIGHT_SIGMA) ** 2) for angle in (parallax, parallax + np.abs(moved))
        )
        gain = 0.5 * (after - before)
        there = wrap(off + moved)  # bearing after the drive, looking ahead
        back = wrap(there + turns[:, None, None])
        yaw = self._camera.heading
        looks = [np.abs(wrap(view - yaw)) <= self._half_view + 1e-9 for view in (there, back)]
        return np.stack([(gain * seen).mean(axis=2).sum(axis=1) for seen in looks])


def _turn(angle: float) -> str:
    """Return a turn in words, empty for none."""
    degrees = round(math.degrees(abs(angle)))
    if not degrees:
        return ""
    if degrees == 360:
        return "turn once around on the spot"
    return f"turn {'left' if angle > 0.0 else 'right'} {degrees} degrees"
