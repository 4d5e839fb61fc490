"""When samples are taken, and the log that they go into."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from homeward.control.goals import Belief
from homeward.drives.drive import Drive, Odometry, Sightings, Truth
from homeward.estimator import Estimate, Estimator
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose, Twist
from homeward.lab.simulation.scenario import Course
from homeward.lab.simulation.trajectories import exact
from homeward.lab.simulation.world import Stream, generator, quantise


def stamps(course: Course) -> tuple[list[float], list[float], list[float]]:
    """Return the increasing stamps of a drive's odometry, bearings and truth [s]."""
    rates, duration = course.rates, course.trajectory.duration
    rng = generator(course, Stream.TIMES)
    odometry = _stamps(rates.odometry, duration, rates.jitter, rng)
    bearings = _stamps(rates.bearings, duration, rates.jitter, rng)
    return odometry, bearings, _stamps(rates.truth, duration, 0.0, rng)


def within(stamps: list[float], begin: float, end: float) -> list[float]:
    """Return those in [begin, end) of increasing stamps."""
    return stamps[bisect_left(stamps, begin) : bisect_left(stamps, end)]


def _stamps(rate: float, duration: float, jitter: float, rng: np.random.Generator) -> list[float]:
    """Return increasing stamps [s] from 0 to `duration`, whole milliseconds."""
    regular = np.arange(int(duration * rate + 1e-9) + 1) / rate
    off = rng.uniform(-jitter, jitter, regular.size)
    off[0] = 0.0
    return [quantise(t, 3) for t in (regular + off).tolist()]


class Log:
    """What a robot would log, told to the estimator in the loop as it is written.

    `yaw` is that of the camera on the robot [rad].
    """

    def __init__(self, estimator: Estimator | None, yaw: float = 0.0) -> None:
        self._estimator, self._yaw = estimator, yaw
        self._odometry: list[tuple[float, float, float]] = []
        self._sightings: list[tuple[float, str, float, float]] = []
        self._truth: list[tuple[float, float, float, float]] = []
        self.estimates: list[Estimate] = []
        self.seen: dict[str, float] = {}
        """Id to direction in the home frame [rad], of what was seen last, as far as is known."""
        self._latest: Mapping[str, float] = {}
        self.last_words = ""
        """Why the robot gave up."""

    def believed(self, t: float, true: Pose) -> Belief:
        """Return the estimate that steers: the estimator's, or the truth."""
        if self._estimator is None:
            return exact(true, self.seen)
        estimate = self._estimator.estimate(t)
        return Belief(estimate.status, estimate.pose, estimate.covariance, self.seen)

    def odometry(self, t: float, twist: Twist) -> None:
        """Log a measured twist."""
        self._odometry.append((t, twist.v, twist.omega))
        if self._estimator is not None:
            self._estimator.odometry(t, twist.v, twist.omega)

    def bearings(
        self, t: float, seen: Mapping[str, float], sigmas: Mapping[str, float] | None = None
    ) -> None:
        """Log id to bearing and perhaps sigma [rad]; where nothing was seen, nothing is left."""
        self._latest, given = seen, sigmas or {}
        self._sightings.extend((t, i, value, given.get(i, np.nan)) for i, value in seen.items())
        if self._estimator is not None and seen:
            self.estimates.append(self._estimator.bearings(t, seen, sigmas))

    def face(self, t: float, true: Pose) -> None:
        """Turn what was seen at `t` [s] into the home frame, by the heading of what steers."""
        if self.estimates and self.estimates[-1].t == t:
            pose = self.estimates[-1].pose  # it has just answered
        else:
            pose = self.believed(t, true).pose
        if pose is not None:
            turn = self._yaw + pose.heading
            self.seen = {i: float(wrap(b + turn)) for i, b in self._latest.items()}

    def truth(self, t: float, pose: Pose) -> None:
        """Log the true pose in the home frame."""
        heading = float(wrap(pose.heading))
        self._truth.append((t, quantise(pose.x, 4), quantise(pose.y, 4), quantise(heading, 4)))

    def fill(self, drive: Drive) -> Drive:
        """Return the drive with everything that was logged."""
        return replace(
            drive,
            odometry=Odometry(*np.array(self._odometry, float).T),
            sightings=Sightings.of_rows(self._sightings),
            truth=Truth(*np.array(self._truth, float).T),
        )
