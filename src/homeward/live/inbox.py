"""What clients sent and the session has not taken yet; no client keeps the others waiting."""

from __future__ import annotations

import asyncio
import contextlib
import sys
import threading
import time
from collections import deque
from collections.abc import AsyncIterator

from homeward.errors import InputError
from homeward.live.messages import LONGEST_LINE, EStop, parse

Line = bytes | str
TURN_S = 0.0002
"""A client reads, or is worked for, for at most this time before others have their turn [s]; 20
clients then delay a command, or a stop, by 8 ms, less than a command's period of 20 ms."""
MAX_UNTAKEN = 2**20
"""A client that sent more than this and has not had its turn is not read on [byte]."""
CHUNK = 2**14
"""Read at once from a client [byte]; it is split into lines within 1 ms."""
LINES_AHEAD = 100
"""Read from stdin before they are looked at."""


class ClientTurn:
    """A client's turn on the loop's thread."""

    def __init__(self) -> None:
        self._until = time.monotonic() + TURN_S

    async def end(self) -> None:
        """Let others work when the turn is over; a read of what has arrived never does that."""
        if time.monotonic() >= self._until:
            await asyncio.sleep(0)
            self._until = time.monotonic() + TURN_S


class Inbox:
    """Lines of one client in their order."""

    def __init__(self) -> None:
        self._lines = deque[Line]()
        self._bytes, self._changed = 0, asyncio.Event()
        self.ended = False
        """Whether no more lines come, or are taken."""

    async def put(self, line: Line) -> None:
        """Add a line; wait while too much has not been taken."""
        while self._bytes > MAX_UNTAKEN and not self.ended:
            await self._change()
        self._lines.append(line)
        self._bytes += len(line)
        self._changed.set()

    async def take(self) -> Line | None:
        """Return the oldest line, and None after the last one."""
        while not self._lines:
            if self.ended:
                return None
            await self._change()
        line = self._lines.popleft()
        self._bytes -= len(line)
        self._changed.set()
        return line

    def end(self) -> None:
        """Let no more lines come."""
        self.ended = True
        self._changed.set()

    async def _change(self) -> None:
        self._changed.clear()
        await self._changed.wait()


def stop_in(line: Line) -> EStop | None:
    """Return the emergency stop in a line, which must not wait; None for any other line."""
    word = b"estop" if isinstance(line, bytes) else "estop"
    if word not in line:  # type: ignore[operator]
        return None
    try:
        message = parse(line)
    except InputError:
        return None
    return message if isinstance(message, EStop) and message.engaged else None


async def tcp_lines(reader: asyncio.StreamReader) -> AsyncIterator[bytes]:
    """Yield lines until the client is gone, or sends one without an end."""
    rest = b""
    with contextlib.suppress(OSError):
        while chunk := await reader.read(CHUNK):
            *lines, rest = (rest + chunk).split(b"\n")
            for line in filter(None, lines):
                yield line
            if len(rest) > LONGEST_LINE:
                return
            await asyncio.sleep(0)  # reading what has arrived lets nobody else work
    if rest:
        yield rest


async def stdin_lines() -> AsyncIterator[bytes]:
    """Yield lines until stdin ends; a thread waits for them."""
    loop, read = asyncio.get_running_loop(), asyncio.Queue[bytes]()
    room = threading.Semaphore(LINES_AHEAD)

    def wait() -> None:
        # A buffer of its own: as the interpreter ends it locks that of sys.stdin, and aborts where
        # this thread holds the lock, as it does while it waits for a line.
        with (
            contextlib.suppress(RuntimeError),  # the loop was closed meanwhile
            open(sys.stdin.fileno(), "rb", closefd=False) as stdin,
        ):
            line = b"\n"
            while line:
                room.acquire()
                line = stdin.readline(LONGEST_LINE + 1)
                loop.call_soon_threadsafe(read.put_nowait, line)

    threading.Thread(target=wait, daemon=True).start()
    while line := await read.get():
        yield line
        room.release()
