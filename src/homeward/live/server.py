"""Server of a session: JSON lines on stdin and stdout, on TCP, and as WebSocket messages.

One robot, any number of clients: every client can send messages to the session, and receives all of
its output. Messages are processed on the loop's thread in turns of 0.2 ms, so that no client
delays commands or other clients; the estimator runs in its own thread.
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
from pathlib import Path
from typing import Any

from homeward.errors import HomewardError, InputError
from homeward.io.writing import state_folder, stdout_error, write_whole
from homeward.live.inbox import ClientTurn, Inbox, Line, stdin_lines, stop_in, tcp_lines
from homeward.live.messages import MAX_LINE, EStop, EventOut, Hello, Input, Output, line_of, parse
from homeward.live.session import Session

HELLO_S = 5.0
"""A client must send hello within this time [s]."""
MAX_CLIENTS = 20
MAX_UNREAD = 2**20
"""A client with more unread output is disconnected [byte]."""
DIAGNOSTICS_S = 1.0
"""Interval of diagnostics and landmarks [s]."""
IDLE_S = 0.1
"""Interval of checks for a command while the robot is not driven [s]; a drive begins at most this
much later, and ten idle sessions on one computer save a fifth of one core."""
MAX_REFUSED = 100
"""A client is disconnected after this number of refused lines in a row."""
WEBSOCKET_CHUNK = 2**10
"""Size of a read from a WebSocket [byte]; its at most 170 frames are parsed in 2 ms."""
CLOSE_S = 1.0
"""Timeout for the close of a WebSocket [s]."""
SWITCH_S = 0.001
"""Thread switch interval [s]; Python's default of 5 ms would delay the loop's thread."""
WRONG_TOKEN, READ_ONLY = "wrong token", "the token of this client only permits to read"
WRONG_TOKEN_S = 1.0
"""Time until a wrong token is refused, one client after the other [s]."""


def given_token() -> str | None:
    """Return the token of servers that other machines can connect to, if there is one."""
    return os.environ.get("HOMEWARD_TOKEN") or None


@dataclass(frozen=True)
class Address:
    """Host and port to listen at."""

    host: str
    port: int

    @property
    def is_loopback(self) -> bool:
        """Whether only this machine can connect."""
        with contextlib.suppress(ValueError):
            return ipaddress.ip_address(self.host).is_loopback
        return self.host == "localhost"


def address(text: str) -> Address:
    """Parse ``PORT`` (this machine only) or ``HOST:PORT``."""
    host, _, port = text.rpartition(":")
    if not (port.isascii() and port.isdecimal() and int(port) < 2**16):
        raise InputError(f"{text}: must be PORT or HOST:PORT")
    return Address(host.strip("[]") or "127.0.0.1", int(port))


def stop_file(*addresses: Address) -> Path | None:
    """Return the file of an emergency stop of the robot with these addresses.

    None without an address, or with any port: then nothing identifies the robot.
    """
    if not addresses or any(where.port == 0 for where in addresses):
        return None
    names = (f"{where.host}_{where.port}".replace(":", "_") for where in addresses)
    return state_folder() / "stops" / "-".join(names)


@dataclass(eq=False)
class _Client:
    """A connected client: functions to send a line, to get its unread bytes, and to close it."""

    send: Callable[[str], None]
    unread: Callable[[], int]
    close: Callable[[], None]
    is_observer: bool = False
    """Whether it may only read."""


@dataclass
class Server:
    """Server of a new session, until it is stopped or stdin, if it is read, ends.

    Every client must send hello with the `token`, which is required if other machines can connect;
    with the `observe_token` it may only read. `watch` receives all output of the session.
    """

    session: Session
    token: str | None = None
    observe_token: str | None = None
    stop_file: Path | None = None
    """File that exists while an emergency stop is engaged, so that a restart does not release it;
    see `stop_file`."""
    watch: Callable[[Output], None] | None = None
    ports: list[int] = field(default_factory=list)
    """Ports of TCP and WebSocket that `serve` opened."""
    _clients: set[_Client] = field(default_factory=set)
    _guess: asyncio.Lock = field(default_factory=asyncio.Lock)
    _writing: threading.Lock = field(default_factory=threading.Lock)
    _unwritten: set[asyncio.Future[None]] = field(default_factory=set)
    _done: bool = False
    _failure: BaseException | None = None
    _loop: asyncio.AbstractEventLoop = field(init=False)
    _end: Callable[[], object] = lambda: None

    async def serve(
        self,
        tcp: Address | None = None,
        websocket: Address | None = None,
        stdio: bool = False,
        opened: Callable[[list[int]], None] | None = None,
    ) -> None:
        """Serve; `opened` receives the ports of TCP and WebSocket, in this order.

        `InputError` where an address cannot be opened, or needs a token.
        """
        both = (tcp, self._tcp), (websocket, self._websocket)
        given = [(where, listen) for where, listen in both if where is not None]
        for where, _ in given:
            if self.token is None and not where.is_loopback:
                raise InputError(
                    f"{where.host}: other machines could connect; set a token in HOMEWARD_TOKEN"
                )
        if self.stop_file is not None and self.stop_file.exists():
            self.session.receive(EStop(engaged=True), time.monotonic(), self.stop_file)
        sys.setswitchinterval(SWITCH_S)
        self._loop = loop = asyncio.get_running_loop()
        ended = asyncio.Event()
        self._end = functools.partial(loop.call_soon_threadsafe, ended.set)
        with contextlib.suppress(RuntimeError, ValueError):  # not on the main thread
            for sign in (signal.SIGINT, signal.SIGTERM):
                loop.add_signal_handler(sign, ended.set)
        worker = threading.Thread(target=self._process, args=(loop,), daemon=True)
        async with contextlib.AsyncExitStack() as stack:
            for where, listen in given:
                try:
                    self.ports.append(await stack.enter_async_context(listen(where)))
                except OSError as error:
                    raise cannot_listen(where, error) from error
            worker.start()
            ticking = asyncio.create_task(self._tick())
            ticking.add_done_callback(lambda _: ended.set())
            if opened is not None:
                opened(self.ports)
            if stdio:
                stdio_client = _Client(self._print, lambda: 0, lambda: None)
                self._clients.add(stdio_client)
                reading = asyncio.create_task(self._process_stdin(stdio_client))
            try:
                await ended.wait()
            finally:
                if stdio:
                    reading.cancel()
                self._done = True
                self.session.end()
                await asyncio.to_thread(worker.join)
                await asyncio.sleep(0)  # send the worker's last output
                failure = ticking.exception() if ticking.done() else self._failure
                ticking.cancel()
                for client in list(self._clients):
                    client.close()
                if self._unwritten:
                    await asyncio.wait(self._unwritten)
        if failure is not None:
            raise failure

    def _process(self, loop: asyncio.AbstractEventLoop) -> None:
        """Run the estimator, in its own thread."""
        try:
            self.session.run(lambda out: loop.call_soon_threadsafe(self._send, out))
        except BaseException as error:  # `serve` raises it
            self._failure = error
            self._end()

    async def _tick(self) -> None:
        """Send commands at a steady rate, and diagnostics at `DIAGNOSTICS_S`."""
        period, last = 1.0 / self.session.settings.rate, 0.0
        due, is_driven = time.monotonic(), True
        while True:
            due = max(due + (period if is_driven else max(period, IDLE_S)), time.monotonic())
            await asyncio.sleep(due - time.monotonic())
            now, is_driven = time.monotonic(), True
            try:
                command = self.session.tick(now)
                is_driven = command is not None
                if command is not None:
                    self._send(command)
            except HomewardError as error:
                self._send(EventOut(type="error", text=str(error)))
            if now - last >= DIAGNOSTICS_S:
                last = now
                self._send(self.session.diagnostics(now))
                self.session.request_landmarks()

    def _send(self, out: Output) -> None:
        """Send a message to all clients; disconnect those that do not read."""
        if self.watch is not None:
            self.watch(out)
        line = line_of(out)
        for client in list(self._clients):
            if client.unread() > MAX_UNREAD:
                self._clients.discard(client)
                client.close()
            else:
                client.send(line)

    def _receive(self, message: Input, client: _Client) -> None:
        self.session.receive(message, time.monotonic(), client)
        if isinstance(message, EStop) and self.stop_file is not None:
            kept = self._loop.run_in_executor(None, self._keep_stop, self.stop_file)
            self._unwritten.add(kept)
            kept.add_done_callback(self._unwritten.discard)

    def _keep_stop(self, file: Path) -> None:
        """Write or delete the file of the emergency stop, not on the loop's thread."""
        with self._writing:
            try:
                if self.session.is_stopped:
                    file.parent.mkdir(parents=True, exist_ok=True)
                    write_whole(file, b"")
                else:
                    file.unlink(missing_ok=True)
            except (HomewardError, OSError) as error:
                text = f"the emergency stop would not outlast a restart: {error}"
                event = EventOut(type="error", text=text)
                self._loop.call_soon_threadsafe(self._send, event)

    def _receive_line(self, line: Line, client: _Client) -> bool:
        """Process a line; return whether it is a valid message."""
        if client.is_observer:
            return self._refuse(READ_ONLY, client)
        try:
            self._receive(parse(line), client)
        except HomewardError as error:
            self._refuse(str(error), client)
            return not isinstance(error, InputError)
        return True

    async def _converse(
        self, lines: AsyncIterator[Line], client: _Client, is_file: bool = False
    ) -> None:
        """Process a client's lines in turn with those of others, but a stop at once.

        A file is read no faster than the estimator works, to its end.
        """
        inbox, turn = Inbox(), ClientTurn()
        processing = asyncio.create_task(self._process_inbox(inbox, client, is_file))
        try:
            async for line in lines:
                if not client.is_observer and (stop := stop_in(line)) is not None:
                    self._receive(stop, client)
                elif line.strip():
                    await inbox.put(line)
                if inbox.ended:
                    break
                await turn.end()
            inbox.end()
            await processing
        finally:
            processing.cancel()

    async def _process_inbox(self, inbox: Inbox, client: _Client, is_file: bool) -> None:
        refused, turn = 0, ClientTurn()
        while (line := await inbox.take()) is not None:
            while is_file and self.session.waiting > self.session.settings.queue // 2:
                await asyncio.sleep(0.001)
            refused = 0 if self._receive_line(line, client) else refused + 1
            if refused >= MAX_REFUSED and not is_file:
                self._refuse(f"disconnected: {refused} lines in a row were refused", client)
                inbox.end()
                await asyncio.sleep(0.01)  # send the reason
                client.close()
                return
            await turn.end()

    async def _welcome(self, line: Line, client: _Client) -> bool:
        """Answer the first line; return whether it is a valid hello."""
        try:
            hello = parse(line)
        except InputError as error:
            return self._refuse(str(error), client)
        if not isinstance(hello, Hello):
            return self._refuse("the first message must be hello", client)
        token = (hello.token or "").encode()
        known = (self.token, self.observe_token)
        is_own, is_observers = (
            text is not None and hmac.compare_digest(token, text.encode()) for text in known
        )
        client.is_observer = is_observers and not is_own
        if self.token is not None and not (is_own or is_observers):
            async with self._guess:
                await asyncio.sleep(WRONG_TOKEN_S)
            return self._refuse(WRONG_TOKEN, client)
        if len(self._clients) >= MAX_CLIENTS:
            return self._refuse(f"too many connections: at most {MAX_CLIENTS}", client)
        client.send(line_of(Hello()))
        self._clients.add(client)
        return True

    def _refuse(self, why: str, client: _Client) -> bool:
        client.send(line_of(EventOut(type="error", text=why)))
        return False

    def _print(self, line: str) -> None:
        """Write a line to stdout; end the server when that fails or the reader has closed it."""
        try:
            sys.stdout.write(line)
            sys.stdout.flush()
        except OSError as error:
            why = stdout_error(error)
            self._failure = None if isinstance(error, BrokenPipeError) else why
            self._end()

    async def _process_stdin(self, client: _Client) -> None:
        """Process all lines of stdin, and end with it."""
        await self._converse(stdin_lines(), client, is_file=True)
        while self.session.waiting:
            await asyncio.sleep(0.001)
        self._end()

    async def _talk(self, lines: AsyncIterator[Line], client: _Client) -> None:
        """Serve a client from its hello until it disconnects."""
        try:
            first = await asyncio.wait_for(anext(lines, b""), HELLO_S)
            if await self._welcome(first, client):
                await self._converse(lines, client)
            else:
                await asyncio.sleep(0.01)  # send the reason
        except (OSError, TimeoutError):  # disconnected, or silent
            pass
        except asyncio.CancelledError:  # the server ends; Python 3.11 would print a traceback
            if not self._done:
                raise
        finally:
            self._clients.discard(client)

    @contextlib.asynccontextmanager
    async def _tcp(self, where: Address) -> AsyncIterator[int]:
        """Listen for JSON lines."""

        async def talk(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            def send(line: str) -> None:
                if not writer.transport.is_closing():  # asyncio would print a warning
                    writer.write(line.encode())

            client = _Client(send, writer.transport.get_write_buffer_size, writer.close)
            try:
                await self._talk(tcp_lines(reader), client)
            finally:
                writer.close()

        server = await asyncio.start_server(talk, where.host, where.port, limit=MAX_LINE)
        try:
            yield server.sockets[0].getsockname()[1]
        finally:
            server.close()

    @contextlib.asynccontextmanager
    async def _websocket(self, where: Address) -> AsyncIterator[int]:
        """Listen for WebSockets, one message per line.

        Any page in a browser can connect to this machine, also one that another program serves on
        another port, so without a token no page is accepted.
        """
        from websockets.asyncio.server import serve
        from websockets.exceptions import ConnectionClosed

        async def talk(socket: Any) -> None:
            socket.transport.max_size = WEBSOCKET_CHUNK  # asyncio reads 256 kB by default
            queue: asyncio.Queue[str] = asyncio.Queue()
            unread = [0]

            def enqueue(line: str) -> None:
                unread[0] += len(line)
                queue.put_nowait(line)

            async def send() -> None:
                while True:
                    line = await queue.get()
                    await socket.send(line.rstrip("\n"))
                    unread[0] -= len(line)

            sending = asyncio.create_task(send())
            with contextlib.suppress(asyncio.CancelledError, ConnectionClosed):
                try:
                    client = _Client(enqueue, lambda: unread[0], socket.transport.abort)
                    await self._talk(aiter(socket), client)
                finally:
                    sending.cancel()
                await sending

        origins = None if self.token is not None else [None]
        options: Any = {"origins": origins, "max_size": MAX_LINE, "close_timeout": CLOSE_S}
        async with serve(talk, where.host, where.port, **options) as server:
            yield server.sockets[0].getsockname()[1]


def cannot_listen(where: Address, error: OSError) -> InputError:
    """Return the error of an address that cannot be opened."""
    return InputError(f"cannot listen at {where.host}:{where.port}: {error.strerror or error}")
