"""Alternatives for repeating a route: odometry only, and from home to home with bearings."""

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

APART = 2.0  # distance between homes along the route [m]
MIN_SEEN = 3  # minimum number of landmarks at a home
LEG_S = 60.0  # maximum time from one home to the next [s]
AGAIN = Homing(speed=0.4, stop_radius=0.1, landmark_distance=4.0, drives_unlocalised=True)


class DeadReckoning:
    """An estimator that uses only odometry, from the true start."""

    name, notes = "odometry", ()

    def __init__(self, start: Pose) -> None:
        self.counts = Counts()
        self._t, self._pose, self._twist = 0.0, start, Twist(0.0, 0.0)

    def odometry(self, t: float, v: float, omega: float) -> None:
        self._pose = self._at(t)
        self._t, self._twist = t, Twist(v, omega)

    def bearings(
        self, t: float, sightings: Mapping[str, float], sigmas: Mapping[str, float] | None = None
    ) -> Estimate:
        return self.estimate(t)

    def estimate(self, t: float) -> Estimate:
        pose = self._at(t)
        pose = pose._replace(heading=wrap(pose.heading))
        return Estimate(t, Status.LOCALISED, "dead reckoning", pose, np.zeros((3, 3)))

    def landmarks(self) -> list:
        return []

    def _at(self, t: float) -> Pose:
        return advance(self._pose, self._twist, min(t - self._t, TWIST_VALIDITY_S))


class StoredHome(NamedTuple):
    """A home on the route: its true pose, and its bearings."""

    pose: Pose
    seen: dict[str, float]


def homes_on_the_way(taught: Scenario, truth: np.ndarray) -> list[StoredHome]:
    """Return homes along a true path, (n, 3), as seen on the day of teaching."""
    camera = Camera(taught, build_world(taught))
    driven = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(truth[:, :2], axis=0).T))])
    number = max(round(driven[-1] / APART), 1)
    # Of several rows at one position, the last: as the robot left, after rotation on the spot.
    rows = np.searchsorted(driven, driven[-1] * np.arange(1, number + 1) / number, side="right") - 1
    poses = [Pose(*truth[i].tolist()) for i in rows.tolist()]
    homes = [StoredHome(pose, camera.look(pose)) for pose in poses]
    return [home for home in homes if len(home.seen) >= MIN_SEEN]


def from_home_to_home(
    scenario: Scenario, homes: list[StoredHome], by: str
) -> tuple[np.ndarray, float]:
    """Drive from each home to the next, using only its bearings.

    `by` is a-ekf, the paper's filter with the true prior, or a law that uses bearings, with a true
    compass. Returned are time [s] and true pose, (n, 4), and the share of reached homes.
    """
    robot, rows = LiveRobot(scenario), list[tuple[float, ...]]()
    start_pose = robot.pose
    for number, home in enumerate(homes):
        leg = (_filtered if by == "a-ekf" else _faced)(robot, home, start_pose, by)
        begun = robot.t
        while leg.drive():
            rows.append((robot.t, *robot.pose))
            if robot.t - begun > LEG_S:
                return np.array(rows), number / len(homes)
        start_pose = leg.end
    return np.array(rows), 1.0


@dataclasses.dataclass
class _Leg:
    """The drive to one home."""

    robot: LiveRobot
    home: StoredHome
    control: Control
    end: Pose  # estimated pose of the robot

    def belief(self) -> Belief:
        """Sense; return the estimate in the frame of home."""
        raise NotImplementedError

    def drive(self) -> bool:
        """Drive a step; return whether home is not reached yet."""
        belief = self.belief()
        twist = self.control.twist(self.robot.t, belief)
        self.robot.command(twist or Twist(0.0, 0.0), hold=2 * self.robot.period)
        return twist is not None


class _filtered(_Leg):
    def __init__(self, robot: LiveRobot, home: StoredHome, start_pose: Pose, by: str) -> None:
        super().__init__(
            robot, home, GoalControl(PointGoal("home", 0.0, 0.0), limits_of(AGAIN)), start_pose
        )
        there = to_polar(between(home.pose, start_pose))
        prior = Start(
            R=max(float(there.R), 0.05),
            theta=float(there.theta),
            alpha=float(there.alpha),
            sigma_R=0.1,
            sigma_theta=0.1,
            sigma_alpha=0.1,
        )
        settings = robot.drive.settings.model_copy(update={"start": prior})
        stored = {name: HomeBearing(b) for name, b in home.seen.items()}
        drive = dataclasses.replace(robot.drive, home=stored, settings=settings)
        self._estimator = make_estimator(by, drive, {"engine": "interpreter"})

    def belief(self) -> Belief:
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
    def __init__(self, robot: LiveRobot, home: StoredHome, start_pose: Pose, by: str) -> None:
        slope = law_named(by)
        assert slope is not None
        goal = BearingGoal(slope, home.seen, AGAIN.landmark_distance)
        control = GoalControl(goal, limits_of(AGAIN))
        super().__init__(robot, home, control, start_pose)
        self._seen: dict[str, float] = {}

    def belief(self) -> Belief:
        looked = self.robot.pose.heading - self.home.pose.heading
        sensed = self.robot.step()
        if sensed.seen is not None:
            self._seen = {n: float(wrap(b + looked)) for n, b in sensed.seen.items()}
        compass = float(wrap(self.robot.pose.heading - self.home.pose.heading))
        return exact(Pose(0.0, 0.0, compass), self._seen)
