"""Input queues of the clients, processed in turns so that no client delays the others."""

from __future__ import annotations

import asyncio
import contextlib
import sys
import threading
import time
from collections import deque
from collections.abc import AsyncIterator

from homeward.errors import InputError
from homeward.live.messages import MAX_LINE, EStop, parse

Line = bytes | str
TURN_S = 0.0002
"""Maximum time for one client before the others have their turn [s]. 20 clients then delay a
command, or a stop, by 8 ms, less than a command's period of 20 ms."""
MAX_PENDING = 2**20
"""Reading from a client pauses while more than this is not processed [byte]."""
CHUNK = 2**14
"""Maximum size of one read from a client [byte]; it is split into lines within 1 ms."""
MAX_LINES_AHEAD = 100
"""Maximum number of lines that are read from stdin ahead of processing."""


class ClientTurn:
    """Time slice of a client on the loop's thread."""

    def __init__(self) -> None:
        self._until = time.monotonic() + TURN_S

    async def end(self) -> None:
        """Yield to other tasks when the turn is over; reading buffered data never yields."""
        if time.monotonic() >= self._until:
            await asyncio.sleep(0)
            self._until = time.monotonic() + TURN_S


class Inbox:
    """Queue of the lines of one client."""

    def __init__(self) -> None:
        self._lines = deque[Line]()
        self._bytes, self._changed = 0, asyncio.Event()
        self.ended = False
        """Whether the queue accepts no more lines."""

    async def put(self, line: Line) -> None:
        """Add a line; wait while the queue is full."""
        while self._bytes > MAX_PENDING and not self.ended:
            await self._change()
        self._lines.append(line)
        self._bytes += len(line)
        self._changed.set()

    async def take(self) -> Line | None:
        """Return the oldest line, or None after the last one."""
        while not self._lines:
            if self.ended:
                return None
            await self._change()
        line = self._lines.popleft()
        self._bytes -= len(line)
        self._changed.set()
        return line

    def end(self) -> None:
        """Accept no more lines."""
        self.ended = True
        self._changed.set()

    async def _change(self) -> None:
        self._changed.clear()
        await self._changed.wait()


def stop_in(line: Line) -> EStop | None:
    """Return the emergency stop in a line, which must not wait in a queue, or None."""
    word = b"estop" if isinstance(line, bytes) else "estop"
    if word not in line:  # type: ignore[operator]
        return None
    try:
        message = parse(line)
    except InputError:
        return None
    return message if isinstance(message, EStop) and message.engaged else None


async def tcp_lines(reader: asyncio.StreamReader) -> AsyncIterator[bytes]:
    """Yield lines until the client disconnects or sends a line that is too long."""
    rest = b""
    with contextlib.suppress(OSError):
        while chunk := await reader.read(CHUNK):
            *lines, rest = (rest + chunk).split(b"\n")
            for line in filter(None, lines):
                yield line
            if len(rest) > MAX_LINE:
                return
            await asyncio.sleep(0)  # reading buffered data never yields to other tasks
    if rest:
        yield rest


async def stdin_lines() -> AsyncIterator[bytes]:
    """Yield lines until stdin ends, read by a thread."""
    loop, read = asyncio.get_running_loop(), asyncio.Queue[bytes]()
    room = threading.Semaphore(MAX_LINES_AHEAD)

    def wait() -> None:
        # A separate buffer: at exit the interpreter locks that of sys.stdin, and aborts if this
        # thread holds the lock, as it does while it waits for a line.
        with (
            contextlib.suppress(RuntimeError),  # the loop was closed meanwhile
            open(sys.stdin.fileno(), "rb", closefd=False) as stdin,
        ):
            line = b"\n"
            while line:
                room.acquire()
                line = stdin.readline(MAX_LINE + 1)
                loop.call_soon_threadsafe(read.put_nowait, line)

    threading.Thread(target=wait, daemon=True).start()
    while line := await read.get():
        yield line
        room.release()
