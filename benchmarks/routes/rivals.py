"""What a route is driven by otherwise: odometry alone, and from home to home by bearings."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from homeward.control.goals import BearingGoal, Belief, PointGoal
from homeward.control.laws import law_named
from homeward.drives.drive import HomeBearing
from homeward.drives.settings import Start
from homeward.estimator import Counts, Estimate, Status
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose, Twist, advance, between, to_polar
from homeward.lab.simulation.course import Camera
from homeward.lab.simulation.live_robot import LiveRobot
from homeward.lab.simulation.scenario import Homing, Scenario
from homeward.lab.simulation.trajectories import Control, GoalControl, exact, limits_of
from homeward.lab.simulation.world import build_world
from homeward.odometry.validity import TWIST_VALIDITY_S
from homeward.registry import make_estimator

APART = 2.0
"""Homes on the way are so far apart [m]."""
FIXED = 3
"""A home that sees fewer landmarks than fix a pose is none."""
LEG_S = 60.0
"""A home that is not reached so long after the one before is never reached [s]."""
AGAIN = Homing(speed=0.4, stop_radius=0.1, landmark_distance=4.0, drives_unlocalised=True)


class DeadReckoning:
    """An estimator that believes odometry, and begins where the robot truly is."""

    name, notes = "odometry", ()

    def __init__(self, start: Pose) -> None:
        self.counts = Counts()
        self._t, self._pose, self._twist = 0.0, start, Twist(0.0, 0.0)

    def odometry(self, t: float, v: float, omega: float) -> None:
        """Take a twist."""
        self._pose = self._at(t)
        self._t, self._twist = t, Twist(v, omega)

    def bearings(
        self, t: float, sightings: Mapping[str, float], sigmas: Mapping[str, float] | None = None
    ) -> Estimate:
        """Look away."""
        return self.estimate(t)

    def estimate(self, t: float) -> Estimate:
        """Predict."""
        pose = self._at(t)
        pose = pose._replace(heading=wrap(pose.heading))
        return Estimate(t, Status.LOCALISED, "believed", pose, np.zeros((3, 3)))

    def landmarks(self) -> list:
        """Return nothing."""
        return []

    def _at(self, t: float) -> Pose:
        return advance(self._pose, self._twist, min(t - self._t, TWIST_VALIDITY_S))


class StoredHome(NamedTuple):
    """A home on the way: where it truly is, and what the camera saw there."""

    pose: Pose
    seen: dict[str, float]


def homes_on_the_way(taught: Scenario, truth: np.ndarray) -> list[StoredHome]:
    """Return homes along a true way, (n, 3), as a camera of the day of teaching saw them."""
    camera = Camera(taught, build_world(taught))
    driven = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(truth[:, :2], axis=0).T))])
    number = max(round(driven[-1] / APART), 1)
    # The last of rows as far along: where the robot stood and turned, as it left.
    rows = np.searchsorted(driven, driven[-1] * np.arange(1, number + 1) / number, side="right") - 1
    poses = [Pose(*truth[i].tolist()) for i in rows.tolist()]
    homes = [StoredHome(pose, camera.look(pose)) for pose in poses]
    return [home for home in homes if len(home.seen) >= FIXED]


def from_home_to_home(
    scenario: Scenario, homes: list[StoredHome], by: str
) -> tuple[np.ndarray, float]:
    """Drive from each home to the next, by nothing but what the camera saw there.

    The way from one home to the next is known as truly as it was taught, so that a filter begins
    with the right prior.

    Parameters
    ----------
    scenario : Scenario
        Of the day of the repeat.
    homes : list of StoredHome
        Those on the way.
    by : str
        a-ekf, the paper's filter; or a law by bearings, with a compass that is right.

    Returns
    -------
    ndarray, shape (n, 4)
        Time [s] and true pose.
    float
        The share of homes that were reached.
    """
    robot, rows = LiveRobot(scenario), list[tuple[float, ...]]()
    believed = robot.pose
    for number, home in enumerate(homes):
        leg = (_filtered if by == "a-ekf" else _faced)(robot, home, believed, by)
        begun = robot.t
        while leg.drive():
            rows.append((robot.t, *robot.pose))
            if robot.t - begun > LEG_S:
                return np.array(rows), number / len(homes)
        believed = leg.end
    return np.array(rows), 1.0


@dataclasses.dataclass
class _Leg:
    """The way to one home."""

    robot: LiveRobot
    home: StoredHome
    control: Control
    end: Pose
    """Where the robot believes it is."""

    def believes(self) -> Belief:
        """Sense; return the estimate in the frame of home."""
        raise NotImplementedError

    def drive(self) -> bool:
        """Drive a step; return whether home is not reached yet."""
        belief = self.believes()
        twist = self.control.twist(self.robot.t, belief)
        self.robot.command(twist or Twist(0.0, 0.0), hold=2 * self.robot.period)
        return twist is not None


class _filtered(_Leg):
    def __init__(self, robot: LiveRobot, home: StoredHome, believed: Pose, by: str) -> None:
        super().__init__(
            robot, home, GoalControl(PointGoal("home", 0.0, 0.0), limits_of(AGAIN)), believed
        )
        there = to_polar(between(home.pose, believed))
        start = Start(
            R=max(float(there.R), 0.05),
            theta=float(there.theta),
            alpha=float(there.alpha),
            sigma_R=0.1,
            sigma_theta=0.1,
            sigma_alpha=0.1,
        )
        told = robot.drive.settings.model_copy(update={"start": start})
        stored = {name: HomeBearing(b) for name, b in home.seen.items()}
        drive = dataclasses.replace(robot.drive, home=stored, settings=told)
        self._estimator = make_estimator(by, drive, {"engine": "interpreter"})

    def believes(self) -> Belief:
        """See `_Leg`."""
        sensed = self.robot.step()
        self._estimator.odometry(sensed.t, *sensed.twist)
        if sensed.seen:
            self._estimator.bearings(sensed.t, sensed.seen)
        estimate = self._estimator.estimate(self.robot.t)
        pose = estimate.pose
        if pose is not None:
            x, y, heading = self.home.pose
            c, s = math.cos(heading), math.sin(heading)
            self.end = Pose(
                x + c * pose.x - s * pose.y, y + s * pose.x + c * pose.y, heading + pose.heading
            )
        return Belief(Status.LOCALISED, pose, estimate.covariance)


class _faced(_Leg):
    def __init__(self, robot: LiveRobot, home: StoredHome, believed: Pose, by: str) -> None:
        slope = law_named(by)
        assert slope is not None
        goal = BearingGoal(slope, home.seen, AGAIN.landmark_distance)
        control = GoalControl(goal, limits_of(AGAIN))
        super().__init__(robot, home, control, believed)
        self._seen: dict[str, float] = {}

    def believes(self) -> Belief:
        """See `_Leg`."""
        looked = self.robot.pose.heading - self.home.pose.heading
        sensed = self.robot.step()
        if sensed.seen is not None:
            self._seen = {n: float(wrap(b + looked)) for n, b in sensed.seen.items()}
        compass = float(wrap(self.robot.pose.heading - self.home.pose.heading))
        return exact(Pose(0.0, 0.0, compass), self._seen)
