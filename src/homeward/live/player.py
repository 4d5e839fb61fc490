"""A simulated robot that talks to a live session over TCP, and asks it the way home."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Callable, Iterator

from homeward.control import Twist
from homeward.errors import HomewardError, InputError
from homeward.estimator import Status
from homeward.live.messages import (
    LONGEST_LINE,
    Answer,
    BearingsIn,
    Command,
    Event,
    GoHome,
    Hello,
    Input,
    OdometryIn,
    SetHome,
    TurnHome,
    line_of,
    parse_output,
)
from homeward.live.server import Address
from homeward.simulation.live_robot import LiveRobot
from homeward.simulation.trajectories import Search

LOOKS_ROUND_S = 8.0
"""It drives in circles for so long at least, and until it is localised [s]."""
CIRCLES = 0.15
"""At this speed [m/s]."""


class Player:
    """Drives in circles until it is localised, and then home as it is told.

    One that turns at home does that first, as it is told, too.

    Parameters
    ----------
    robot : LiveRobot
        At its start.
    longest : float
        It gives up then [s of its own time].
    """

    def __init__(self, robot: LiveRobot, longest: float = 300.0) -> None:
        self.robot, self._longest = robot, longest
        self.ending: Command | None = None
        """The last command, "arrived" or "failed"."""
        self._search = Search(CIRCLES, robot.view)
        self._turning = robot.turns
        self._status = Status.WAITING
        self._asked, self._began = False, 0.0

    def again(self) -> None:
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
        sensed = self.robot.step()
        yield OdometryIn(t=sensed.t, v=sensed.twist.v, omega=sensed.twist.omega)
        if sensed.seen is not None:
            yield BearingsIn(t=sensed.t, bearings=sensed.seen)
        looked = not self._turning and sensed.t - self._began > LOOKS_ROUND_S
        if looked and not self._asked and self._status is Status.LOCALISED:
            self._asked = True
            yield GoHome()

    def hear(self, said: object) -> None:
        """Take what the session said."""
        if isinstance(said, Answer):
            self._status = said.status
        elif isinstance(said, Command) and (self._asked or self._turning):
            self.robot.command(Twist(said.v, said.omega), said.hold)
            if said.state in ("arrived", "failed"):
                self.ending = said
            elif said.state == "turned" and not self._asked:
                self._turning, self._began = False, self.robot.t

    @property
    def done(self) -> bool:
        """Whether it is home, or gave up."""
        return self.ending is not None or self.robot.t > self._longest


async def play(
    player: Player, place: Address, pace: float, token: str | None, tell: Callable[[str], None]
) -> None:
    """Let a player talk to the session at an address, `pace` times as fast as time goes by.

    Raises
    ------
    InputError
        When nobody listens there.
    HomewardError
        When the session ends the talk.
    """
    try:
        reader, writer = await asyncio.open_connection(place.host, place.port, limit=LONGEST_LINE)
    except OSError as error:
        reason = error.strerror or error
        raise InputError(f"nobody listens at {place.host}:{place.port}: {reason}") from error

    def say(message: Input) -> None:
        writer.write(line_of(message).encode())

    async def listen() -> None:
        while line := await reader.readline():
            said = parse_output(line)
            player.hear(said)
            if isinstance(said, Event):
                tell(said.text)

    listening = asyncio.create_task(listen())
    try:
        say(Hello(token=token))
        say(player.home())
        began = time.monotonic()
        while not player.done:
            for message in player.step():
                say(message)
            await writer.drain()
            await asyncio.sleep(began + player.robot.t / pace - time.monotonic())
            if listening.done():
                raise HomewardError("the session ended the talk")
    except ConnectionError as error:
        raise HomewardError("the session ended the talk") from error
    finally:
        listening.cancel()
        with contextlib.suppress(asyncio.CancelledError, OSError):
            await listening
        writer.close()
