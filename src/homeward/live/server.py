"""The host of a session: JSON lines on stdin and stdout, on TCP, and as WebSocket messages.

One robot, any number of listeners: whatever anyone sends is for the session, and all hear what it
says. Messages are taken in on the loop's thread, in turns of 0.2 ms, so that no client
delays commands or others; the estimator works in a thread of its own.
"""

from __future__ import annotations

import asyncio
import contextlib
import functools
import hmac
import ipaddress
import os
import signal
import sys
import threading
import time
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass, field
from typing import Any

from homeward.errors import HomewardError, InputError
from homeward.io.blas_threads import single_threaded_blas
from homeward.live.inbox import ClientTurn, Inbox, Line, stdin_lines, stop_in, tcp_lines
from homeward.live.messages import LONGEST_LINE, EventOut, Hello, Input, Output, line_of, parse
from homeward.live.session import Session

HELLO_S = 5.0
"""Who connects says hello within [s]."""
MOST_LISTENERS = 20
MOST_UNREAD = 2**20
"""Who leaves so much unread is disconnected [byte]."""
SAID_S = 1.0
"""Diagnostics and landmarks are told so often [s]."""
MAX_REFUSED = 100
"""A client of which this number of lines in a row were refused is disconnected."""
WEBSOCKET_CHUNK = 2**10
"""Read at once from a WebSocket [byte]; 170 frames, the most that it holds, are parsed in 2 ms."""
CLOSE_S = 1.0
"""A WebSocket that does not answer when it is closed is dropped after this [s]."""
SWITCH_S = 0.001
"""The estimator's thread lets the loop's go on after this [s]; Python's own 5 ms add up."""
WRONG_TOKEN = "wrong token"


@dataclass(frozen=True)
class Address:
    """Where to listen."""

    host: str
    port: int

    @property
    def is_loopback(self) -> bool:
        """Whether only this machine can connect."""
        with contextlib.suppress(ValueError):
            return ipaddress.ip_address(self.host).is_loopback
        return self.host == "localhost"


def address(text: str) -> Address:
    """Return the address in ``PORT`` (of this machine alone), or ``HOST:PORT``."""
    host, _, port = text.rpartition(":")
    if not (port.isascii() and port.isdecimal() and int(port) < 2**16):
        raise InputError(f"{text}: must be PORT or HOST:PORT")
    return Address(host.strip("[]") or "127.0.0.1", int(port))


@dataclass(eq=False)
class _Listener:
    """Somebody connected: how to tell them a line, how much they left unread, how to end it."""

    tell: Callable[[str], None]
    unread: Callable[[], int]
    close: Callable[[], None]


@dataclass
class Server:
    """Serves a new session until it is stopped, or, where it reads stdin, until that ends.

    Everybody must say hello with the `token`, which is required where other machines can connect.
    `watch` receives everything that the session says.
    """

    session: Session
    token: str | None = None
    watch: Callable[[Output], None] | None = None
    ports: list[int] = field(default_factory=list)
    """Of TCP and WebSocket, as `serve` opened them."""
    _listeners: set[_Listener] = field(default_factory=set)
    _work: threading.Event = field(default_factory=threading.Event)
    _done: bool = False
    _failure: BaseException | None = None
    _end: Callable[[], object] = lambda: None

    async def serve(
        self,
        tcp: Address | None = None,
        websocket: Address | None = None,
        stdio: bool = False,
        opened: Callable[[list[int]], None] | None = None,
    ) -> None:
        """Serve; `opened` receives the ports of TCP and WebSocket, in this order.

        `InputError` where an address cannot be listened at, or may not be without a token.
        """
        for place in filter(None, (tcp, websocket)):
            if self.token is None and not place.is_loopback:
                raise InputError(f"{place.host}: others could connect; give a token")
        sys.setswitchinterval(SWITCH_S)
        loop = asyncio.get_running_loop()
        ended = asyncio.Event()
        self._end = functools.partial(loop.call_soon_threadsafe, ended.set)
        with contextlib.suppress(RuntimeError, ValueError):  # not on the main thread
            for sign in (signal.SIGINT, signal.SIGTERM):
                loop.add_signal_handler(sign, ended.set)
        worker = threading.Thread(target=self._process, args=(loop,), daemon=True)
        async with contextlib.AsyncExitStack() as stack:
            opening = [self._tcp(tcp)] if tcp else []
            opening += [self._websocket(websocket)] if websocket else []
            self.ports += [await stack.enter_async_context(listening) for listening in opening]
            worker.start()
            ticking = asyncio.create_task(self._tick())
            ticking.add_done_callback(lambda _: ended.set())
            if opened is not None:
                opened(self.ports)
            if stdio:
                me = _Listener(self._print, lambda: 0, lambda: None)
                self._listeners.add(me)
                reading = asyncio.create_task(self._take_stdin(me))
            try:
                await ended.wait()
            finally:
                if stdio:
                    reading.cancel()
                self._done = True
                self._work.set()
                await asyncio.to_thread(worker.join)
                await asyncio.sleep(0)  # what the worker said last is told
                failure = ticking.exception() if ticking.done() else self._failure
                ticking.cancel()
                for listener in list(self._listeners):
                    listener.close()
        if failure is not None:
            raise failure

    def _process(self, loop: asyncio.AbstractEventLoop) -> None:
        """Let the estimator work, in a thread of its own."""
        try:
            with single_threaded_blas():
                while not self._done or self.session.waiting:
                    self._work.wait()
                    self._work.clear()
                    for out in self.session.process():
                        loop.call_soon_threadsafe(self._tell, out)
        except BaseException as error:  # told by `serve`, which ends
            self._failure = error
            self._end()

    async def _tick(self) -> None:
        """Say commands at a steady rate, and now and then how things are."""
        period, said = 1.0 / self.session.settings.rate, 0.0
        due = time.monotonic()
        while True:
            due = max(due + period, time.monotonic())
            await asyncio.sleep(due - time.monotonic())
            now = time.monotonic()
            try:
                if (command := self.session.tick(now)) is not None:
                    self._tell(command)
            except HomewardError as error:
                self._tell(EventOut(type="error", text=str(error)))
                self._work.set()
            if now - said >= SAID_S:
                said = now
                self._tell(self.session.diagnostics(now))
                self.session.ask_landmarks()
                self._work.set()

    def _tell(self, out: Output) -> None:
        """Say something to all; who does not read is let go."""
        if self.watch is not None:
            self.watch(out)
        line = line_of(out)
        for listener in list(self._listeners):
            if listener.unread() > MOST_UNREAD:
                self._listeners.discard(listener)
                listener.close()
            else:
                listener.tell(line)

    def _take(self, message: Input, listener: _Listener) -> None:
        try:
            self.session.receive(message, time.monotonic(), listener)
        finally:
            self._work.set()

    def _take_line(self, line: Line, listener: _Listener) -> bool:
        """Take a line; return whether it is a message."""
        try:
            self._take(parse(line), listener)
        except HomewardError as error:
            self._refuse(str(error), listener)
            return not isinstance(error, InputError)
        return True

    async def _converse(
        self, lines: AsyncIterator[Line], listener: _Listener, is_file: bool = False
    ) -> None:
        """Take a client's lines in turn with those of others, and a stop as soon as it is read.

        A file is read no faster than the estimator works, to its end.
        """
        inbox, turn = Inbox(), ClientTurn()
        taking = asyncio.create_task(self._take_all(inbox, listener, is_file))
        try:
            async for line in lines:
                if (stop := stop_in(line)) is not None:
                    self._take(stop, listener)
                elif line.strip():
                    await inbox.put(line)
                if inbox.ended:
                    break
                await turn.end()
            inbox.end()
            await taking
        finally:
            taking.cancel()

    async def _take_all(self, inbox: Inbox, listener: _Listener, is_file: bool) -> None:
        refused, turn = 0, ClientTurn()
        while (line := await inbox.take()) is not None:
            while is_file and self.session.waiting > self.session.settings.queue // 2:
                await asyncio.sleep(0.001)
            refused = 0 if self._take_line(line, listener) else refused + 1
            if refused >= MAX_REFUSED and not is_file:
                self._refuse(f"disconnected: {refused} lines in a row were refused", listener)
                inbox.end()
                await asyncio.sleep(0.01)  # the reason is sent
                listener.close()
                return
            await turn.end()

    def _welcome(self, line: Line, listener: _Listener) -> bool:
        """Return whether a first line says hello as it must; answer it."""
        try:
            hello = parse(line)
        except InputError as error:
            return self._refuse(str(error), listener)
        if not isinstance(hello, Hello):
            return self._refuse("say hello first", listener)
        said = (hello.token or "").encode()
        if self.token is not None and not hmac.compare_digest(said, self.token.encode()):
            return self._refuse(WRONG_TOKEN, listener)
        if len(self._listeners) >= MOST_LISTENERS:
            return self._refuse("too many connections", listener)
        listener.tell(line_of(Hello()))
        self._listeners.add(listener)
        return True

    def _refuse(self, why: str, listener: _Listener) -> bool:
        listener.tell(line_of(EventOut(type="error", text=why)))
        return False

    def _print(self, line: str) -> None:
        """Say a line on stdout; end where nobody reads it any more."""
        try:
            sys.stdout.write(line)
            sys.stdout.flush()
        except BrokenPipeError:
            with open(os.devnull, "w") as nowhere:  # for what is left in the buffer
                os.dup2(nowhere.fileno(), sys.stdout.fileno())
            self._end()

    async def _take_stdin(self, me: _Listener) -> None:
        """Take all lines of stdin, and end with it."""
        await self._converse(stdin_lines(), me, is_file=True)
        while self.session.waiting:
            await asyncio.sleep(0.001)
        self._end()

    @contextlib.asynccontextmanager
    async def _tcp(self, place: Address) -> AsyncIterator[int]:
        """Listen for JSON lines."""

        async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            def tell(line: str) -> None:
                if not writer.transport.is_closing():  # else asyncio complains on stderr
                    writer.write(line.encode())

            lines = tcp_lines(reader)
            listener = _Listener(tell, writer.transport.get_write_buffer_size, writer.close)
            try:
                first = await asyncio.wait_for(anext(lines, b""), HELLO_S)
                if self._welcome(first, listener):
                    await self._converse(lines, listener)
            except (OSError, TimeoutError):  # gone, or silent
                pass
            except asyncio.CancelledError:  # the server ends; Python 3.11 would print a traceback
                if not self._done:
                    raise
            finally:
                self._listeners.discard(listener)
                writer.close()

        try:
            server = await asyncio.start_server(serve, place.host, place.port, limit=LONGEST_LINE)
        except OSError as error:
            raise _cannot(place, error) from error
        try:
            yield server.sockets[0].getsockname()[1]
        finally:
            server.close()

    @contextlib.asynccontextmanager
    async def _websocket(self, place: Address) -> AsyncIterator[int]:
        """Listen for WebSockets, a message a line.

        Any page that a browser shows may connect to this machine: without a token only pages of
        this machine are accepted, by their Origin.
        """
        import re

        from websockets.asyncio.server import serve
        from websockets.exceptions import ConnectionClosed

        own = re.compile(r"https?://(localhost|127\.0\.0\.1|\[::1\])(:\d+)?")
        origins = None if self.token is not None else [None, own]

        async def talk(socket: Any) -> None:
            socket.transport.max_size = WEBSOCKET_CHUNK  # of asyncio, which reads 256 kB otherwise
            queue: asyncio.Queue[str] = asyncio.Queue()
            unread = [0]

            def tell(line: str) -> None:
                unread[0] += len(line)
                queue.put_nowait(line)

            async def send() -> None:
                while True:
                    line = await queue.get()
                    await socket.send(line.rstrip("\n"))
                    unread[0] -= len(line)

            listener = _Listener(tell, lambda: unread[0], socket.transport.abort)
            sending = asyncio.create_task(send())
            try:
                if not self._welcome(await asyncio.wait_for(socket.recv(), HELLO_S), listener):
                    await asyncio.sleep(0.01)  # the reason is sent
                    return
                await self._converse(aiter(socket), listener)
            except (ConnectionClosed, TimeoutError):
                pass
            finally:
                self._listeners.discard(listener)
                sending.cancel()
                with contextlib.suppress(asyncio.CancelledError, ConnectionClosed):
                    await sending

        try:
            async with serve(
                talk,
                place.host,
                place.port,
                origins=origins,
                max_size=LONGEST_LINE,
                close_timeout=CLOSE_S,
            ) as server:
                yield server.sockets[0].getsockname()[1]
        except OSError as error:
            raise _cannot(place, error) from error


def _cannot(place: Address, error: OSError) -> InputError:
    return InputError(f"cannot listen at {place.host}:{place.port}: {error.strerror or error}")
