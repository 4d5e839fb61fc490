"""The robot's own program: wheels, encoders, scanner, camera, and a live session of homeward.

Its only input is its sensors; the true pose is for scoring.
The session is the one of `homeward live`, in this process and on the simulator's clock, so that a
run is repeatable and may be slower or faster than real time.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Protocol

import mujoco
import numpy as np

from examples.warehouse.vehicle import CAMERA_X, RADIUS, TRACK
from examples.warehouse.world import World
from homeward.control.limits import Limits
from homeward.drives.settings import DriveSettings, OdometryNoise, Sensor
from homeward.estimator import Status
from homeward.geometry.frames import Pose, compose, inverse
from homeward.live import messages as msg
from homeward.live.localisation import Homes
from homeward.live.place_session import PlaceSession
from homeward.live.recording import Recorder
from homeward.live.session import Session
from homeward.live.settings import LiveSettings
from homeward.vision.tags.front_end import TagBearings

TICK_S = 0.02
"""Period of encoders and commands [s]."""
CAMERA_TICKS = 6
"""Ticks from image to image: 8.3 Hz."""
LATENCY_TICKS = 3
"""Ticks from an image to its bearings."""
TICKS_PER_TURN = 4096
"""Encoder counts per turn of a wheel."""
LIMITS = Limits(speed=0.5, radius=0.015)
SEARCH = 0.15, 0.5
"""Speed [m/s] and turn rate [rad/s] of circles until the robot is localised."""
SEARCH_S = 4.0
"""Minimum time of a search [s]."""
SCAN_Z = 0.16, 0.22
"""Heights of the scanner's planes: at the edge of the racks' lowest shelf, and above it [m]."""
BACK, BACK_S, BACK_CLEAR = 0.2, 2.0, 0.3
"""Speed [m/s] and time [s] of backing off from an obstacle, and the free distance it needs [m]."""
CLEAR = 0.8
"""Free distance ahead without which a searching robot turns on the spot [m]."""


SETTINGS = DriveSettings(
    sensor=Sensor(x=CAMERA_X, y=0.0, yaw=0.0), odometry=OdometryNoise(speed_scale_sigma=0.005)
)
"""What a user measures: the camera's position, and a drive of 10 m with a tape (5 cm)."""


class Eye(Protocol):
    """A camera, rendered or simulated."""

    def see(self) -> TagBearings:
        """Return the tags in view now."""


class Base:
    """Two wheels with encoders, and a scanner that looks ahead and behind."""

    def __init__(self, world: World, number: int = 0) -> None:
        self._world, self._robot = world, world.robots[number]
        self._counts = self._read()

    def drive(self, v: float, omega: float) -> None:
        """Set the velocity that the motors aim at [m/s, rad/s]."""
        half = TRACK / 2 * omega
        self._robot.turn_wheels((v - half) / RADIUS, (v + half) / RADIUS)

    def measure(self) -> tuple[float, float]:
        """Return the mean velocity since the last call, one tick ago [m/s, rad/s]."""
        before, self._counts = self._counts, self._read()
        left, right = (self._counts - before) * (math.tau / TICKS_PER_TURN * RADIUS / TICK_S)
        return float(left + right) / 2, float(right - left) / TRACK

    def free(self, sign: int = 1) -> float:
        """Return the free distance ahead (sign 1) or behind (-1) of the robot [m], at most 4."""
        world, found = self._world, 4.0
        x, y, heading = self._robot.pose
        c, s, hit = sign * math.cos(heading), sign * math.sin(heading), np.zeros(1, np.int32)
        for z, side in product(SCAN_Z, (-0.24, -0.12, 0.0, 0.12, 0.24)):
            at, way = np.array([x + 0.26 * c - side * s, y + 0.26 * s + side * c, z]), [c, s, 0.0]
            body = self._robot.body
            distance = mujoco.mj_ray(world.model, world.data, at, way, None, 1, body, hit)
            if distance >= 0:
                found = min(found, distance)
        return found

    def _read(self) -> np.ndarray:
        return np.floor(np.array(self._robot.wheel_angles) / math.tau * TICKS_PER_TURN)


@dataclass(frozen=True)
class Moment:
    """An answer, and the true pose at its stamp."""

    t: float
    status: Status
    truth: Pose
    """In the home frame."""
    pose: Pose | None
    covariance: np.ndarray | None

    @property
    def error(self) -> float:
        """Position error [m], NaN without a pose."""
        return math.nan if self.pose is None else math.dist(self.pose[:2], self.truth[:2])


@dataclass
class Outcome:
    """What became of a task."""

    task: msg.Input
    state: str = ""
    reason: str = ""
    at: Pose | None = None
    """True pose at its end, in the home frame."""
    t: float = math.nan


@dataclass(eq=False)
class Robot:
    """The robot with its tasks.

    `see` gives the tags in view. Tasks are messages of the live protocol, done one after the other:
    `turn_home`, `go_to`, `go_home`. Before each goal the robot drives in circles until it is
    localised; after a failure it turns on the spot (and first backs off, if an obstacle caused it)
    and tries again. `home` is the true pose of home in the hall, for scoring.
    """

    world: World
    eye: Eye
    tasks: Sequence[msg.Input]
    home: Pose
    settings: DriveSettings = SETTINGS
    place: PlaceSession | None = None
    recorder: Callable[..., Recorder] | None = None
    limits: Limits = LIMITS
    number: int = 0
    """Of its vehicle in the world."""

    def __post_init__(self) -> None:
        self._live = LiveSettings(limits=self.limits)
        self.session = Session(self._live, self.settings, {}, self.place)
        self.recording = None if self.recorder is None else self.recorder(settings=self._live)
        if self.recording is not None:
            self.session.watch(self.recording.keep)
        self.base, self.vehicle = Base(self.world, self.number), self.world.robots[self.number]
        self.outcomes: list[Outcome] = []
        self.moments: list[Moment] = []
        self.events: list[tuple[float, str]] = []
        """Times [s] and texts of what the session reported."""
        self.landmarks: tuple[msg.LandmarkOut, ...] = ()
        self.seen: TagBearings | None = None
        """The tags in the last image."""
        self.truth: list[tuple[float, Pose]] = []
        """True poses in the home frame, at each tick."""
        self.measured: list[tuple[float, float, float]] = []
        """Odometry: time [s], speed [m/s], yaw rate [rad/s]."""
        self.collisions: set[tuple[int, str]] = set()
        """Whole seconds in which the robot touched something, and its name."""
        self.doing = "waiting"
        """The state in words, for the film."""
        self.looks = 0
        """Number of images."""
        self._ticks = 0
        self._waiting: deque[tuple[int, msg.BearingsIn]] = deque()
        self._todo = deque(self.tasks)
        self._current: Outcome | None = None
        self._search_until = self._back_until = -math.inf
        self._status = Status.WAITING

    @property
    def done(self) -> bool:
        """Whether no task is left."""
        return self._current is None and not self._todo

    @property
    def answer(self) -> Moment | None:
        """The last answer."""
        return self.moments[-1] if self.moments else None

    def true_pose(self) -> Pose:
        """Return the true pose in the home frame, for scoring."""
        return Pose(*map(float, compose(inverse(self.home), Pose(*self.vehicle.pose))))

    def tick(self) -> None:
        """Sense, decide, and drive for `TICK_S`."""
        self.act()
        self.world.advance(TICK_S)
        self.note_contacts()

    def act(self) -> None:
        """Sense, decide, and set the velocity for the next `TICK_S`."""
        session, now = self.session, self.world.t
        v, omega = self.base.measure()
        stamp = max(now - TICK_S, 0.0)
        self.measured.append((stamp, v, omega))
        session.receive(msg.OdometryIn(t=stamp, v=v, omega=omega), now)
        self.truth.append((now, self.true_pose()))
        if self._ticks % CAMERA_TICKS == 0:
            self.look(now)
        while self._waiting and self._waiting[0][0] <= self._ticks:
            session.receive(self._waiting.popleft()[1], now)
        free = self.base.free()
        session.receive(msg.Obstacle(distance=free), now)
        if self._ticks % 50 == 0:
            session.request_landmarks()
        for out in session.process():
            self._on_output(out)
        self._command(session.tick(now), free)
        self._ticks += 1

    def note_contacts(self) -> None:
        """Note what the robot touches now."""
        self.collisions |= {(int(self.world.t), name) for name in self.vehicle.touches()}

    def look(self, now: float) -> None:
        """Take an image; its bearings are sent `LATENCY_TICKS` later."""
        self.seen = seen = self.read()
        self.looks += 1
        message = msg.BearingsIn(t=now, bearings=seen.bearings, sigmas=seen.sigmas)
        self._waiting.append((self._ticks + LATENCY_TICKS, message))

    def read(self) -> TagBearings:
        """Return the tags in view."""
        return self.eye.see()

    def restart(self, homes: Homes) -> None:
        """Start a new session with home bearings, and begin the current task again."""
        self.session = Session(self._live, self.settings, homes, self.place)
        self._status = Status.WAITING
        self._waiting.clear()
        if self._current is not None:
            self._todo.appendleft(self._current.task)
            self._current = None

    def _command(self, command: msg.Command | None, free: float) -> None:
        current = self._current
        if current is not None and command is not None:
            self.base.drive(command.v, command.omega)
            self.doing = ": ".join(filter(None, (command.state, command.reason)))
            if command.state in ("arrived", "turned", "failed"):
                self._finish(current, command)
            return
        if current is not None or not self._todo:  # not answered yet, or nothing to do
            self.base.drive(0.0, 0.0)
            self.doing = "at rest"
            return
        if self.world.t < self._back_until and self.base.free(-1) > BACK_CLEAR:
            self.base.drive(-BACK, 0.0)
            self.doing = "backing off from an obstacle"
            return
        task = self._todo[0]
        searches = not isinstance(task, msg.TurnHome) and (
            self._status is not Status.LOCALISED
            or self.world.t < self._search_until
            or free < CLEAR
        )
        if searches:
            speed, turn = SEARCH
            circles = self._status is not Status.LOCALISED and free > CLEAR
            self.base.drive(speed if circles else 0.0, turn)
            self.doing = "circling until localised" if circles else "turning to look round"
            return
        self._current = Outcome(self._todo.popleft())
        self.session.receive(self._current.task, self.world.t)

    def _finish(self, outcome: Outcome, command: msg.Command) -> None:
        outcome.state, outcome.reason = command.state, command.reason
        outcome.at, outcome.t = self.true_pose(), self.world.t
        self.events.append((self.world.t, self.doing))
        self._current = None
        if command.state == "failed":
            self._todo.appendleft(outcome.task)
            is_blocked = command.reason.startswith("blocked")
            self._back_until = self.world.t + (BACK_S if is_blocked else 0.0)
            self._search_until = self._back_until + SEARCH_S
        elif command.state == "turned":
            self._search_until = self.world.t + SEARCH_S
        self.outcomes.append(outcome)

    def _on_output(self, out: msg.Output) -> None:
        if isinstance(out, msg.Answer):
            self._status = out.status
            covariance = None
            if out.covariance is not None:
                covariance = np.zeros((3, 3))
                covariance[np.triu_indices(3)] = out.covariance
                covariance += np.triu(covariance, 1).T
            pose = None if out.pose is None else Pose(*out.pose)
            truth = self.truth[-1 - round((self.world.t - out.t) / TICK_S)][1]
            self.moments.append(Moment(out.t, out.status, truth, pose, covariance))
        elif isinstance(out, msg.LandmarksOut):
            self.landmarks = out.landmarks
        elif isinstance(out, msg.EventOut):
            self.events.append((self.world.t, out.text))
