"""Place server: JSON lines over TCP between live sessions and one shared place."""

from __future__ import annotations

import asyncio
import contextlib
import fcntl
import hmac
import signal
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from homeward.errors import HomewardError, InputError
from homeward.io.blas_threads import single_threaded_blas
from homeward.io.reading import naming
from homeward.io.table import quoted
from homeward.live.messages import EventOut, line_of
from homeward.live.server import HELLO_S, MAX_CLIENTS, WRONG_TOKEN, Address, cannot_listen
from homeward.live.shared.merging import LIVE, QUARANTINED, SharedPlace, is_same
from homeward.live.shared.messages import (
    MAX_LINE,
    Join,
    Kept,
    VisitMessage,
    parse_request,
    place_message,
)
from homeward.places.place import Place

UPDATE_S = 1.0
"""Minimum interval between places that are sent [s]; the first change is sent at once."""
REFINE_S = 30.0
"""Interval at which a place is sent that became more accurate, without other changes [s]."""

MAX_LOAD = 0.33
"""Maximum share of one core for the places that are sent."""


@dataclass(eq=False)
class _Robot:
    """A connected session: its writer, its visit, and the place that it received last."""

    writer: asyncio.StreamWriter
    visit: str | None = None
    place: Place | None = None

    def send(self, message: Any) -> None:
        if self.writer.transport.get_write_buffer_size() > MAX_LINE:
            self.writer.close()  # it does not read
        elif not self.writer.is_closing():
            self.writer.write(line_of(message).encode())


class PlaceServer:
    """Server of a shared place; `log` receives what happens, in words.

    `token` is required if other machines can connect.
    """

    def __init__(
        self, shared: SharedPlace, token: str | None, log: Callable[[str], None] = lambda _: None
    ) -> None:
        self._shared, self._token, self._log = shared, token, log
        self._robots, self._conversations = set[_Robot](), set[asyncio.Task[None]]()
        self._quarantined: set[str] = set()
        self._places = shared.without_each()
        """The place without each visit, as it was sent last."""
        self._whole: Place | None = None
        """The place with all visits, if a robot needed it since then."""
        self._sent = shared.state
        self._sent_at, self._received, self._cost_s = 0.0, 0, 0.0
        self._news = asyncio.Event()
        """Whether a visit was received since the place was last compared."""

    async def serve(
        self, where: Address, opened: Callable[[int], None], ended: asyncio.Event | None = None
    ) -> None:
        """Serve until `ended`, SIGINT or SIGTERM; `opened` receives the port.

        `InputError` where the address cannot be opened or needs a token, or another server has the
        place.
        """
        if self._token is None and not where.is_loopback:
            raise InputError(
                f"{where.host}: other machines could connect; set a token in HOMEWARD_TOKEN"
            )
        ended = ended or asyncio.Event()
        loop = asyncio.get_running_loop()
        with contextlib.suppress(RuntimeError, ValueError):  # not on the main thread
            for sign in (signal.SIGINT, signal.SIGTERM):
                loop.add_signal_handler(sign, ended.set)
        lock = self._shared.folder / LIVE / "lock"
        with naming(lock, "cannot be written"), lock.open("w") as only, single_threaded_blas():
            try:
                fcntl.flock(only, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise InputError("another server has this place", self._shared.folder) from None
            try:
                server = await asyncio.start_server(
                    self._converse, where.host, where.port, limit=MAX_LINE
                )
            except OSError as error:
                raise cannot_listen(where, error) from error
            async with server:
                opened(server.sockets[0].getsockname()[1])
                updating = asyncio.create_task(self._update())
                updating.add_done_callback(lambda _: ended.set())
                await ended.wait()
                failure = updating.exception() if updating.done() else None
                updating.cancel()
                for conversation in list(self._conversations):
                    conversation.cancel()
                await asyncio.gather(*self._conversations, return_exceptions=True)
        if failure is not None:
            raise failure

    async def _converse(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        robot, task = _Robot(writer), asyncio.current_task()
        assert task is not None
        self._conversations.add(task)
        try:
            self._join(robot, await asyncio.wait_for(reader.readline(), HELLO_S))
            while line := await reader.readline():
                self._receive(robot, line)
        except (ValueError, HomewardError) as error:  # ValueError: a line that is too long
            known = isinstance(error, HomewardError)
            why = str(error) if known else f"a message of more than {MAX_LINE:,} bytes"
            self._log(f"disconnected {writer.get_extra_info('peername')}: {why}")
            robot.send(EventOut(type="error", text=why))
        except (OSError, TimeoutError, asyncio.CancelledError):
            pass
        finally:
            self._robots.discard(robot)
            self._conversations.discard(task)
            writer.close()

    def _join(self, robot: _Robot, line: bytes) -> None:
        """Process the first message of a session; `InputError` where it is refused."""
        join = parse_request(line)
        if not isinstance(join, Join):
            raise InputError("the first message must be join")
        token, name = (join.token or "").encode(), self._shared.place.name
        if self._token is not None and not hmac.compare_digest(token, self._token.encode()):
            raise InputError(WRONG_TOKEN)
        if join.place not in (None, name):
            raise InputError(f"this is the place {quoted(name)}, not {quoted(str(join.place))}")
        if len(self._robots) >= MAX_CLIENTS:
            raise InputError(f"too many connections: at most {MAX_CLIENTS}")
        robot.visit = join.visit
        self._send_place(robot, self._place_without(join.visit))
        self._robots.add(robot)

    def _receive(self, robot: _Robot, line: bytes) -> None:
        message = parse_request(line)
        if not isinstance(message, VisitMessage):
            raise InputError("join is only the first message")
        self._received += 1
        robot.visit = message.visit if not message.ended else robot.visit
        result = self._shared.add(message, time.time())
        self._news.set()
        visit = self._shared.visits.get(message.visit)
        unconfirmed = visit is not None and bool(visit.unconfirmed)
        robot.send(
            Kept(visit=message.visit, ended=bool(result), unconfirmed=unconfirmed, text=result)
        )
        if result:
            self._log(f"visit {message.visit}: {result}")
        if visit is not None and (visit.changes is None) != (message.visit in self._quarantined):
            self._quarantined ^= {message.visit}
            text = QUARANTINED if visit.changes is None else "this visit is merged again"
            self._log(f"visit {message.visit}: {text}")
            robot.send(EventOut(type="event", text=text))

    async def _update(self) -> None:
        """Send the place to each robot for which the visits of others changed it."""
        while True:
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._news.wait(), REFINE_S)
            wait = max(UPDATE_S, (1.0 / MAX_LOAD - 1.0) * self._cost_s)
            await asyncio.sleep(max(self._sent_at + wait - time.monotonic(), 0.0))
            self._news.clear()
            now, began = time.monotonic(), time.process_time()
            for text in self._shared.end_abandoned(time.time()):
                self._log(text)
            refines = self._received and now - self._sent_at > REFINE_S
            if self._shared.state == self._sent and not refines:
                continue
            self._sent, self._received = self._shared.state, 0
            self._places, self._whole = self._shared.without_each(), None
            for robot in list(self._robots):
                place = self._place_without(robot.visit)
                if robot.place is None or not is_same(robot.place, place):
                    self._send_place(robot, place)
                    await asyncio.sleep(0)
            self._sent_at = time.monotonic()
            self._cost_s = time.process_time() - began

    def _place_without(self, visit: str | None) -> Place:
        """Return the place for a robot."""
        if visit in self._places:
            return self._places[visit]
        if self._whole is None:
            self._whole = self._shared.with_all()
        return self._whole

    def _send_place(self, robot: _Robot, place: Place) -> None:
        robot.place = place
        robot.send(place_message(place))
