"""Server of the studio: the page and its WebSocket on one port of this machine.

The WebSocket server also sends the files of the page, so that no second server is needed.
"""

from __future__ import annotations

import asyncio
import contextlib
import hmac
import json
import math
import re
import secrets
import signal
import time
from collections import deque
from collections.abc import Callable
from http import HTTPStatus
from importlib import resources
from typing import Any, NamedTuple

from homeward.errors import InputError
from homeward.io.blas_threads import single_threaded_blas
from homeward.studio.messages import MAX_MESSAGE, Hello, Pace, Request, parse
from homeward.studio.session import Session

TICK_S = 1 / 40
"""Minimum interval of pictures [s]; the page interpolates."""
BUSY_S = 0.1
"""Maximum time of one turn of the session [s]."""
HELLO_S = 5.0
CLOSE_S = 1.0
"""Timeout of pages that do not answer when the studio ends [s]."""
MAX_WAITING = 1000
OWN = re.compile(r"http://(localhost|127\.0\.0\.1)(:\d+)?")
KINDS = {"html": "text/html", "js": "text/javascript", "css": "text/css"}
POLICY = "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; " + (
    "connect-src 'self' ws:; img-src 'self' blob: data:; base-uri 'none'; form-action 'none'"
)


class Line(NamedTuple):
    """A serialised message."""

    kind: str
    text: str


class Page:
    """Queue of unsent messages to a page, with only the newest message of each kind.

    A page that does not read delays nothing; websockets' keepalive ends its connection.
    """

    def __init__(self, socket: Any) -> None:
        self._socket, self._unsent, self._some = socket, dict[str, str](), asyncio.Event()

    def queue(self, line: Line) -> None:
        """Queue a message; it replaces an unsent one of its kind."""
        self._unsent.pop(line.kind, None)
        self._unsent[line.kind] = line.text
        self._some.set()

    async def send(self) -> None:
        """Send queued messages until the page has disconnected."""
        from websockets.exceptions import ConnectionClosed

        with contextlib.suppress(ConnectionClosed):
            while await self._some.wait():
                while self._unsent:
                    await self._socket.send(self._unsent.pop(next(iter(self._unsent))))
                self._some.clear()


class Studio:
    """Serves one session to pages of this machine with the token."""

    def __init__(self, session: Session) -> None:
        self._session, self.token = session, secrets.token_urlsafe(16)
        self._pages: set[Page] = set()
        self._requests: deque[tuple[Request, Page]] = deque(maxlen=MAX_WAITING)
        self._pace = 1.0

    async def serve(self, port: int = 0, opened: Callable[[str], None] | None = None) -> None:
        """Serve until Ctrl-C or SIGTERM; `opened` receives the address of the page."""
        from websockets.asyncio.server import serve

        ended = asyncio.Event()
        with contextlib.suppress(ValueError, NotImplementedError):  # not on the main thread
            for sign in (signal.SIGINT, signal.SIGTERM):
                asyncio.get_running_loop().add_signal_handler(sign, ended.set)
        try:
            host = await serve(
                self._talk,
                "127.0.0.1",
                port,
                origins=[OWN],
                max_size=MAX_MESSAGE,
                close_timeout=CLOSE_S,
                process_request=_page,
            )
        except OSError as error:
            raise InputError(f"cannot listen at port {port}: {error.strerror or error}") from error
        async with host:
            playing = asyncio.create_task(self._play())
            playing.add_done_callback(lambda _: ended.set())
            if opened is not None:
                at = host.sockets[0].getsockname()[1]
                opened(f"http://127.0.0.1:{at}/?token={self.token}")
            await ended.wait()
            failed = playing.exception() if playing.done() else None
            playing.cancel()
        if failed is not None:
            raise failed

    async def _talk(self, socket: Any) -> None:
        """Receive the requests of a page, after a hello with the token."""
        from websockets.exceptions import ConnectionClosed

        page = Page(socket)
        sending = asyncio.create_task(page.send())
        try:
            hello = parse(await asyncio.wait_for(socket.recv(), HELLO_S))
            token = hello.token.encode() if isinstance(hello, Hello) else b""
            if not hmac.compare_digest(token, self.token.encode()):
                raise InputError("wrong token: open the address that homeward studio printed")
            page.queue(_line(self._session.scene()))
            page.queue(_line(self._session.picture()))
            self._pages.add(page)
            async for line in socket:
                try:
                    self._requests.append((parse(line), page))
                except InputError as error:
                    page.queue(_refusal(error))
        except InputError as error:
            with contextlib.suppress(ConnectionClosed):
                await socket.send(_refusal(error).text)
        except (ConnectionClosed, TimeoutError):
            pass
        finally:
            self._pages.discard(page)
            sending.cancel()

    async def _play(self) -> None:
        """Advance the time of the session while a page is connected."""
        behind, then = 0.0, time.monotonic()
        while True:
            await asyncio.sleep(max(TICK_S - (time.monotonic() - then), 0.001))
            now = time.monotonic()
            # A slow machine loses time instead of catching up.
            behind = min(behind + self._pace * (now - then), 2 * BUSY_S * max(self._pace, 1.0))
            then = now
            if not self._pages:
                behind = 0.0
                continue
            messages, behind = await asyncio.to_thread(self._work, behind)
            for line, to in messages:
                for page in self._pages if to is None else [to]:
                    page.queue(line)

    def _work(self, behind: float) -> tuple[list[tuple[Line, Page | None]], float]:
        """Execute requests, and step; return messages with their page, None for all pages."""
        messages: list[tuple[Line, Page | None]] = []
        session, version = self._session, self._session.version
        with single_threaded_blas():
            while self._requests:
                request, page = self._requests.popleft()
                try:
                    if isinstance(request, Pace):
                        self._pace = request.pace
                    elif (answer := session.do(request)) is not None:
                        messages.append((_line(answer), page))
                except InputError as error:
                    messages.append((_refusal(error), page))
                    version = -1  # redraw: the page may have drawn the change
            until, stepped = time.monotonic() + BUSY_S, False
            began = session.now_s
            while session.now_s - began < behind and time.monotonic() < until:
                session.step()
                stepped = True
        if session.version != version:
            messages.insert(0, (_line(session.scene()), None))
            stepped = True
        if stepped:
            messages.append((_line(session.picture()), None))
        return messages, max(behind - (session.now_s - began), -TICK_S * 8)


def _line(message: dict[str, Any]) -> Line:
    """Return a message as JSON, with null for infinite numbers and NaN."""
    return Line(message["type"], json.dumps(_finite(message), separators=(",", ":")))


def _refusal(error: InputError) -> Line:
    return _line({"type": "error", "text": str(error)})


def _finite(value: Any) -> Any:
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {key: _finite(v) for key, v in value.items()}
    return [_finite(v) for v in value] if isinstance(value, (list, tuple)) else value


def _page(connection: Any, request: Any) -> Any:
    """Return the response with a file of the page; None for a WebSocket."""
    upgrades = request.headers.get_all("Upgrade")
    if len(upgrades) > 1:
        return connection.respond(HTTPStatus.BAD_REQUEST, "more than one Upgrade header\n")
    if upgrades and upgrades[0].lower() == "websocket":
        return None
    from websockets.datastructures import Headers
    from websockets.http11 import Response

    name = request.path.partition("?")[0].strip("/") or "index.html"
    files = {
        file.name: file for file in resources.files("homeward.studio").joinpath("page").iterdir()
    }
    kind = KINDS.get(name.rpartition(".")[2])
    if name not in files or kind is None:
        return connection.respond(HTTPStatus.NOT_FOUND, "no such page\n")
    body = files[name].read_bytes()
    headers = Headers(
        {
            "Content-Type": f"{kind}; charset=utf-8",
            "Content-Length": str(len(body)),
            "Content-Security-Policy": POLICY,
            "Cache-Control": "no-store",
            "Referrer-Policy": "no-referrer",
            "X-Content-Type-Options": "nosniff",
        }
    )
    return Response(200, "OK", headers, body)
