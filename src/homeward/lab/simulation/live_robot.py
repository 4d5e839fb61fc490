"""Simulated robot for a live session: senses, follows commands, communicates over TCP."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Callable, Iterator, Mapping
from typing import NamedTuple

from homeward.control.goals import STAND
from homeward.errors import HomewardError, InputError
from homeward.estimator import Status
from homeward.geometry.frames import Pose, Twist, advance
from homeward.lab.simulation.course import Camera, Chassis, Wheels
from homeward.lab.simulation.scenario import Scenario
from homeward.lab.simulation.simulate import prepare
from homeward.lab.simulation.trajectories import Control, Search, exact
from homeward.lab.simulation.world import build_world
from homeward.live.messages import (
    MAX_LINE,
    Answer,
    BearingsIn,
    BeginRoute,
    Command,
    EventOut,
    GoalMessage,
    GoHome,
    Hello,
    Input,
    OdometryIn,
    Output,
    SetHome,
    StoreRoute,
    TurnHome,
    line_of,
    parse_output,
)
from homeward.live.server import HELLO_S, Address


class Sensed(NamedTuple):
    """Sensor readings at one time."""

    t: float
    """[s]"""
    twist: Twist
    """Measured by the wheels."""
    seen: Mapping[str, float] | None
    """Id to bearing from the camera's axis [rad]; None where no frame was taken."""
    vy: float = 0.0
    """Speed to the left, by the wheels [m/s]."""


class LiveRobot:
    """Robot of a scenario, driven by commands instead of the scenario's trajectory.

    It uses the scenario's rates without jitter. A command that is not repeated in time ends.
    """

    def __init__(self, scenario: Scenario) -> None:
        self.view = scenario.view
        """Field of view of the camera [rad]."""
        self.turns = scenario.trajectory.spin is not None
        """Whether home is the start, and is stored by a rotation there."""
        self.drive = prepare(scenario)
        """Home and settings, no samples."""
        self.world = build_world(scenario)
        self.t = 0.0
        """[s]"""
        self.pose = scenario.start.in_home_frame(scenario.home.pose)
        """True pose in the home frame, for scoring only."""
        self._home = self.pose if self.turns else Pose(0.0, 0.0, 0.0)
        self.period = 1.0 / scenario.rates.odometry
        """Duration of a `step` [s]."""
        self._looks = 1.0 / scenario.rates.bearings
        self._steps = self._looked = 0
        self._wheels, self._camera = Wheels(scenario), Camera(scenario, self.world)
        self._is_holonomic = Chassis(scenario.robot).is_holonomic
        self._command, self._vy, self._until = STAND, 0.0, -math.inf

    @property
    def distance(self) -> float:
        """True distance from home [m]."""
        return math.hypot(self.pose.x - self._home.x, self.pose.y - self._home.y)

    def command(self, twist: Twist, hold: float, vy: float = 0.0) -> None:
        """Drive with `twist`, and `vy` [m/s] to the left, from the next step on, for `hold` [s]."""
        self._command, self._vy, self._until = twist, vy, self.t + hold

    def step(self) -> Sensed:
        """Return the sensor readings now, and drive for one period."""
        twist, vy = (self._command, self._vy) if self.t < self._until else (STAND, 0.0)
        seen = None
        if self.t >= self._looked * self._looks - 1e-9:
            seen, self._looked = self._camera.look(self.pose), self._looked + 1
        measured = self._wheels.measure(twist)
        left = self._wheels.measure_sideways(vy) if self._is_holonomic else 0.0
        sensed = Sensed(self.t, measured, seen, left)
        self.pose = Pose(*map(float, advance(self.pose, twist, self.period, vy)))
        self._steps += 1
        self.t = round(self._steps * self.period, 6)
        return sensed

    def sense_by(self, scenario: Scenario) -> None:
        """Use the sensors of another scenario from now on; landmarks, home and rates stay."""
        self._wheels, self._camera = Wheels(scenario), Camera(scenario, self.world)

    def move_landmark(self, name: str, dx: float, dy: float) -> None:
        """Move a landmark by (dx, dy), in room coordinates [m]."""
        self.world.places[self.world.ids.index(name)] += (dx, dy)


MIN_CIRCLES_S = 8.0
"""The robot drives in circles until it is localised, and at least for this time [s]."""
CIRCLE_SPEED = 0.15
"""[m/s]"""


Task = GoalMessage | StoreRoute
"""Task of a robot in a session; to store a route, the robot drives it."""


class SimulatedRobotClient:
    """Client of a live session: drives in circles until localised, then does its task.

    It follows the session's commands, home by default, or teaches a route with its own control:
    `make_control` returns that from a pose. A robot that stores home by a rotation does so first.
    It gives up after `longest` [s of its own time].
    """

    def __init__(
        self,
        robot: LiveRobot,
        longest: float = 300.0,
        task: Task | None = None,
        make_control: Callable[[Pose], Control] | None = None,
    ) -> None:
        self.robot, self._longest = robot, longest
        self.task: Task = task or GoHome()
        self.ending: Command | EventOut | None = None
        """Last message about the task: a command "arrived" or "failed", or the event of a route
        that was to be stored."""
        self._search = Search(CIRCLE_SPEED, robot.view)
        self._turning = robot.turns
        self._status = Status.WAITING
        self._asked, self._began = False, 0.0
        self._make_control = make_control
        self._teaching: Control | None = None
        """Control along the route to teach, once that has begun."""
        self._stored = False

    @property
    def succeeded(self) -> bool:
        """Whether the task is done."""
        if isinstance(self.ending, EventOut):
            return self.ending.type == "event"
        return self.ending is not None and self.ending.state == "arrived"

    @property
    def summary(self) -> str:
        """Last message about the task, as text."""
        ending = self.ending
        if ending is None or isinstance(ending, EventOut):
            return "" if ending is None else ending.text
        return f"{ending.state}: {ending.reason}"

    def restart(self) -> None:
        """Drive in circles again, from the current pose."""
        self.ending, self._asked, self._began = None, False, self.robot.t
        self._search.end()

    def home(self) -> SetHome | TurnHome:
        """Return the message with the home bearings, or the request to turn at home."""
        if self.robot.turns:
            return TurnHome()
        home = self.robot.drive.home
        return SetHome(
            bearings={i: seen.bearing for i, seen in home.items()},
            sigmas={i: seen.sigma for i, seen in home.items() if seen.sigma > 0},
        )

    def step(self) -> Iterator[Input]:
        """Drive for one period of the odometry; yield the messages to send."""
        if not self._asked and not self._turning:
            self.robot.command(self._search.twist(self.robot.t), hold=1.0)
        elif self._teaching is not None and not self._stored:
            twist = self._teaching.twist(self.robot.t, exact(self.robot.pose))
            self.robot.command(twist or STAND, hold=1.0)
            if twist is None:
                self._stored = True
                yield self.task
        sensed = self.robot.step()
        yield OdometryIn(t=sensed.t, v=sensed.twist.v, omega=sensed.twist.omega, vy=sensed.vy)
        if sensed.seen is not None:
            yield BearingsIn(t=sensed.t, bearings=sensed.seen)
        looked = not self._turning and sensed.t - self._began > MIN_CIRCLES_S
        if looked and not self._asked and self._status is Status.LOCALISED:
            self._asked = True
            yield self.task if self._make_control is None else BeginRoute()

    def on_message(self, message: object) -> None:
        """Handle a message of the session."""
        teaches = self._make_control is not None
        if isinstance(message, Answer):
            self._status = message.status
        elif isinstance(message, EventOut) and self._asked and self._make_control is not None:
            if self._stored:
                self.ending = message
            elif message.type == "error":  # the map is not good enough yet
                self.restart()
            elif self._teaching is None:
                self._teaching = self._make_control(self.robot.pose)
        elif isinstance(message, Command) and (self._turning or (self._asked and not teaches)):
            self.robot.command(Twist(message.v, message.omega), message.hold, message.vy)
            if message.state in ("arrived", "failed"):
                self.ending = message
            elif message.state == "turned" and not self._asked:
                self._turning, self._began = False, self.robot.t

    @property
    def done(self) -> bool:
        """Whether the task has ended, or the robot gave up."""
        return self.ending is not None or self.robot.t > self._longest


async def play(
    player: SimulatedRobotClient,
    place: Address,
    pace: float,
    token: str | None,
    on_event: Callable[[str], None],
) -> None:
    """Connect a client to the session at an address, at `pace` times real time.

    Raises `InputError` when no session answers there, `HomewardError` when the session ends the
    connection.
    """
    try:
        reader, writer = await asyncio.wait_for(
            asyncio.open_connection(place.host, place.port, limit=MAX_LINE), HELLO_S
        )
    except (OSError, TimeoutError) as error:
        reason = getattr(error, "strerror", None) or str(error) or f"no answer in {HELLO_S:g} s"
        advice = f"start one with `homeward live --tcp {place.port}`"
        problem = f"no session at {place.host}:{place.port}: {reason}"
        raise InputError(problem, advice=advice) from error

    def send(message: Input) -> None:
        writer.write(line_of(message).encode())

    async def receive() -> Output | None:
        try:
            line = await reader.readline()
        except ValueError as error:
            raise HomewardError(f"received a line of more than {MAX_LINE:,} bytes") from error
        return parse_output(line) if line else None

    async def listen() -> None:
        while (message := await receive()) is not None:
            player.on_message(message)
            if isinstance(message, EventOut):
                on_event(message.text)

    listening: asyncio.Task[None] | None = None
    try:
        send(Hello(token=token))
        try:
            welcome = await asyncio.wait_for(receive(), HELLO_S)
        except TimeoutError as error:
            raise HomewardError(f"no answer to hello within {HELLO_S:g} s") from error
        if isinstance(welcome, EventOut):
            raise HomewardError(welcome.text)
        if welcome is None:
            raise HomewardError("the session closed the connection")
        listening = asyncio.create_task(listen())
        send(player.home())
        began = time.monotonic()
        while not player.done:
            for message in player.step():
                send(message)
            await writer.drain()
            await asyncio.sleep(began + player.robot.t / pace - time.monotonic())
            if listening.done():
                listening.result()
                raise HomewardError("the session closed the connection")
    except HomewardError as error:
        raise HomewardError(f"{place.host}:{place.port}: {error}") from error
    except ConnectionError as error:
        raise HomewardError("the session closed the connection") from error
    finally:
        if listening is not None:
            listening.cancel()
            await asyncio.wait([listening])
            if not listening.cancelled():
                listening.exception()  # its error was raised above, or is not needed
        writer.close()
