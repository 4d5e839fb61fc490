"""A simulated robot for a live session: senses, drives as commanded, and talks over TCP."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Callable, Iterator, Mapping
from typing import NamedTuple

from homeward.control.following import STAND
from homeward.errors import HomewardError, InputError
from homeward.estimator import Status
from homeward.geometry.frames import Pose, Twist, advance
from homeward.lab.simulation.course import Camera, Wheels
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
    """What the robot's sensors say at one time."""

    t: float
    """[s]"""
    twist: Twist
    """By its wheels."""
    seen: Mapping[str, float] | None
    """Id to bearing from the camera's axis [rad]; None where the camera did not look."""


class LiveRobot:
    """A robot in a scenario, at its start, of which only the trajectory is not driven.

    Rates are the scenario's, its jitter left out. A command that is not repeated in time ends.
    """

    def __init__(self, scenario: Scenario) -> None:
        self.view = scenario.view
        """Of the camera [rad]."""
        self.turns = scenario.trajectory.spin is not None
        """Whether home is where it begins, and is stored by a turn."""
        self.drive = prepare(scenario)
        """Before it begins: home and settings, no samples."""
        self.world = build_world(scenario)
        self.t = 0.0
        """[s]"""
        self.pose = scenario.start.in_home_frame(scenario.home.pose)
        """True, in the home frame; for scoring alone."""
        self._home = self.pose if self.turns else Pose(0.0, 0.0, 0.0)
        self.period = 1.0 / scenario.rates.odometry
        """Of `step` [s]."""
        self._looks = 1.0 / scenario.rates.bearings
        self._steps = self._looked = 0
        self._wheels, self._camera = Wheels(scenario), Camera(scenario, self.world)
        self._command, self._until = STAND, -math.inf

    @property
    def distance(self) -> float:
        """True distance from home [m]."""
        return math.hypot(self.pose.x - self._home.x, self.pose.y - self._home.y)

    def command(self, twist: Twist, hold: float) -> None:
        """Drive by `twist` from the next step on, for `hold` [s]."""
        self._command, self._until = twist, self.t + hold

    def step(self) -> Sensed:
        """Say what is sensed now, and drive on until it is time for that again."""
        twist = self._command if self.t < self._until else STAND
        seen = None
        if self.t >= self._looked * self._looks - 1e-9:
            seen, self._looked = self._camera.look(self.pose), self._looked + 1
        sensed = Sensed(self.t, self._wheels.measure(twist), seen)
        self.pose = Pose(*map(float, advance(self.pose, twist, self.period)))
        self._steps += 1
        self.t = round(self._steps * self.period, 6)
        return sensed

    def sense_by(self, scenario: Scenario) -> None:
        """Sense as another scenario has it from now on; landmarks, home and rates stay."""
        self._wheels, self._camera = Wheels(scenario), Camera(scenario, self.world)

    def move_landmark(self, name: str, dx: float, dy: float) -> None:
        """Move a landmark by so much, in room coordinates [m]."""
        self.world.places[self.world.ids.index(name)] += (dx, dy)


LOOKS_ROUND_S = 8.0
"""It drives in circles for so long at least, and until it is localised [s]."""
CIRCLES = 0.15
"""At this speed [m/s]."""


Task = GoalMessage | StoreRoute
"""Task of a robot in a session; to store a route it drives it."""


class SimulatedRobotClient:
    """Client of a live session: circles until it is localised, and then does its task.

    It follows the session's commands, home (by default) or elsewhere, or drives a route by hand to
    teach it: `hand` returns what drives it along that, from a pose. A robot that turns at home does
    that first. It gives up after `longest` [s of its own time].
    """

    def __init__(
        self,
        robot: LiveRobot,
        longest: float = 300.0,
        task: Task | None = None,
        hand: Callable[[Pose], Control] | None = None,
    ) -> None:
        self.robot, self._longest = robot, longest
        self.task: Task = task or GoHome()
        self.ending: Command | EventOut | None = None
        """What was said last of the task: a command "arrived" or "failed", or, of a route that
        is to be stored, what came of that."""
        self._search = Search(CIRCLES, robot.view)
        self._turning = robot.turns
        self._status = Status.WAITING
        self._asked, self._began = False, 0.0
        self._hand = hand
        self._driven: Control | None = None
        """What drives it along the route that it teaches, once that has begun."""
        self._stored = False

    @property
    def succeeded(self) -> bool:
        """Whether it did its task."""
        if isinstance(self.ending, EventOut):
            return self.ending.type == "event"
        return self.ending is not None and self.ending.state == "arrived"

    @property
    def last_words(self) -> str:
        """What was said last of its task."""
        said = self.ending
        if said is None or isinstance(said, EventOut):
            return "" if said is None else said.text
        return f"{said.state}: {said.reason}"

    def restart(self) -> None:
        """Drive in circles again, from where it ended."""
        self.ending, self._asked, self._began = None, False, self.robot.t
        self._search.end()

    def home(self) -> SetHome | TurnHome:
        """Return what the robot's camera saw at home, or that it turns there."""
        if self.robot.turns:
            return TurnHome()
        home = self.robot.drive.home
        return SetHome(
            bearings={i: seen.bearing for i, seen in home.items()},
            sigmas={i: seen.sigma for i, seen in home.items() if seen.sigma > 0},
        )

    def step(self) -> Iterator[Input]:
        """Drive for one period of the odometry; yield what is to be said."""
        if not self._asked and not self._turning:
            self.robot.command(self._search.twist(self.robot.t), hold=1.0)
        elif self._driven is not None and not self._stored:
            twist = self._driven.twist(self.robot.t, exact(self.robot.pose))
            self.robot.command(twist or STAND, hold=1.0)
            if twist is None:
                self._stored = True
                yield self.task
        sensed = self.robot.step()
        yield OdometryIn(t=sensed.t, v=sensed.twist.v, omega=sensed.twist.omega)
        if sensed.seen is not None:
            yield BearingsIn(t=sensed.t, bearings=sensed.seen)
        looked = not self._turning and sensed.t - self._began > LOOKS_ROUND_S
        if looked and not self._asked and self._status is Status.LOCALISED:
            self._asked = True
            yield self.task if self._hand is None else BeginRoute()

    def on_message(self, said: object) -> None:
        """Take a message of the session."""
        if isinstance(said, Answer):
            self._status = said.status
        elif isinstance(said, EventOut) and self._asked and self._hand is not None:
            if self._stored:
                self.ending = said
            elif said.type == "error":  # it knows too little yet
                self.restart()
            elif self._driven is None:
                self._driven = self._hand(self.robot.pose)
        elif isinstance(said, Command) and (self._turning or (self._asked and self._hand is None)):
            self.robot.command(Twist(said.v, said.omega), said.hold)
            if said.state in ("arrived", "failed"):
                self.ending = said
            elif said.state == "turned" and not self._asked:
                self._turning, self._began = False, self.robot.t

    @property
    def done(self) -> bool:
        """Whether its task is over, or it gave up."""
        return self.ending is not None or self.robot.t > self._longest


async def play(
    player: SimulatedRobotClient,
    place: Address,
    pace: float,
    token: str | None,
    tell: Callable[[str], None],
) -> None:
    """Let a player talk to the session at an address, `pace` times as fast as time goes by.

    Raises
    ------
    InputError
        When nobody listens there, or what listens is no session.
    HomewardError
        When the session ends the talk.
    """
    try:
        reader, writer = await asyncio.wait_for(
            asyncio.open_connection(place.host, place.port, limit=MAX_LINE), HELLO_S
        )
    except (OSError, TimeoutError) as error:
        reason = getattr(error, "strerror", None) or str(error) or f"no answer in {HELLO_S:g} s"
        raise InputError(f"nobody listens at {place.host}:{place.port}: {reason}") from error

    def say(message: Input) -> None:
        writer.write(line_of(message).encode())

    async def hear() -> Output | None:
        try:
            line = await reader.readline()
        except ValueError as error:
            raise HomewardError(f"a line of more than {MAX_LINE:,} bytes came") from error
        return parse_output(line) if line else None

    async def listen() -> None:
        while (said := await hear()) is not None:
            player.on_message(said)
            if isinstance(said, EventOut):
                tell(said.text)

    listening: asyncio.Task[None] | None = None
    try:
        say(Hello(token=token))
        try:
            welcome = await asyncio.wait_for(hear(), HELLO_S)
        except TimeoutError as error:
            raise HomewardError(f"no hello within {HELLO_S:g} s") from error
        if isinstance(welcome, EventOut):
            raise HomewardError(welcome.text)
        if welcome is None:
            raise HomewardError("the session ended the talk")
        listening = asyncio.create_task(listen())
        say(player.home())
        began = time.monotonic()
        while not player.done:
            for message in player.step():
                say(message)
            await writer.drain()
            await asyncio.sleep(began + player.robot.t / pace - time.monotonic())
            if listening.done():
                listening.result()
                raise HomewardError("the session ended the talk")
    except HomewardError as error:
        raise HomewardError(f"{place.host}:{place.port}: {error}") from error
    except ConnectionError as error:
        raise HomewardError("the session ended the talk") from error
    finally:
        if listening is not None:
            listening.cancel()
            await asyncio.wait([listening])
            if not listening.cancelled():
                listening.exception()  # what it raised was raised above, or does not matter now
        writer.close()
