"""The host of the studio: the page and its WebSocket on one port of this machine.

The page is a handful of files, which the WebSocket server hands out itself: no second server, and
no more packages than `homeward live` needs.
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
from typing import Any, Protocol

from homeward.errors import InputError, needs_extra
from homeward.one_thread import one_thread
from homeward.studio.messages import LONGEST, Asked, Hello, Pace, parse

TICK_S = 1 / 40
"""Between two pictures at least [s]; the page draws those between."""
BUSY_S = 0.1
"""The session works for so long at most before it is asked and shown again [s]."""
HELLO_S = 5.0
MOST_UNREAD = 2**22
"""Who leaves so much unread gets no pictures meanwhile [byte]."""
MOST_WAITING = 1000
OWN = re.compile(r"http://(localhost|127\.0\.0\.1)(:\d+)?")
KINDS = {"html": "text/html", "js": "text/javascript", "css": "text/css"}
POLICY = "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; " + (
    "connect-src 'self' ws:; img-src 'self' blob: data:; base-uri 'none'; form-action 'none'"
)


class Played(Protocol):
    """What the studio can host: a scene that is played, or a drive that was."""

    @property
    def version(self) -> int:
        """Counts what changes `scene`."""

    @property
    def now_s(self) -> float:
        """How far it is [s of its own time]; infinite where nothing is left to play."""

    def step(self) -> None:
        """Go on a little."""

    def do(self, asked: Asked) -> dict[str, Any] | None:
        """Do what the page asks for; return what to answer, if anything."""

    def scene(self) -> dict[str, Any]:
        """Return what changes seldom."""

    def picture(self) -> dict[str, Any] | None:
        """Return what changes with every step; None when nothing did."""


class Studio:
    """Serves one session to the pages of this machine that know the token.

    Parameters
    ----------
    session : Played
        What is shown.
    token : str, optional
        That a page must say; None: a new one.
    """

    def __init__(self, session: Played, token: str | None = None) -> None:
        self._session, self.token = session, token or secrets.token_urlsafe(16)
        self._pages: set[Any] = set()
        self._asked: deque[tuple[Asked, Any]] = deque(maxlen=MOST_WAITING)
        self._pace = 1.0

    async def serve(self, port: int = 0, opened: Callable[[str], None] | None = None) -> None:
        """Serve until Ctrl-C or SIGTERM; `opened` is told the page's address.

        Raises
        ------
        InputError
            When the port cannot be listened at, or websockets are not installed.
        """
        try:
            from websockets.asyncio.server import serve
        except ModuleNotFoundError as error:
            raise needs_extra("the studio's pages", "live") from error
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
                max_size=LONGEST,
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
        """Take what a page asks for, once it said the token."""
        from websockets.exceptions import ConnectionClosed

        try:
            hello = parse(await asyncio.wait_for(socket.recv(), HELLO_S))
            told = hello.token.encode() if isinstance(hello, Hello) else b""
            if not hmac.compare_digest(told, self.token.encode()):
                raise InputError("wrong token: open the address that homeward studio printed")
            await socket.send(_text(self._session.scene()))
            picture = self._session.picture()
            if picture is not None:
                await socket.send(_text(picture))
            self._pages.add(socket)
            async for line in socket:
                try:
                    self._asked.append((parse(line), socket))
                except InputError as error:
                    await socket.send(_text({"type": "error", "text": str(error)}))
        except InputError as error:
            with contextlib.suppress(ConnectionClosed):
                await socket.send(_text({"type": "error", "text": str(error)}))
        except (ConnectionClosed, TimeoutError):
            pass
        finally:
            self._pages.discard(socket)

    async def _play(self) -> None:
        """Let time go by for the session while somebody looks."""
        behind, then = 0.0, time.monotonic()
        while True:
            await asyncio.sleep(max(TICK_S - (time.monotonic() - then), 0.001))
            now = time.monotonic()
            # Time that could not be kept up with is let go, not made up for.
            behind = min(behind + self._pace * (now - then), 2 * BUSY_S * max(self._pace, 1.0))
            then = now
            if not self._pages:
                behind = 0.0
                continue
            said, behind = await asyncio.to_thread(self._work, behind)
            for out, to in said:
                for page in [to] if to is not None else list(self._pages):
                    if page.transport.get_write_buffer_size() < MOST_UNREAD:
                        with contextlib.suppress(Exception):
                            await page.send(out)

    def _work(self, behind: float) -> tuple[list[tuple[str, Any]], float]:
        """Do what was asked for, and step; return what to say to whom, None being all."""
        said: list[tuple[str, Any]] = []
        session, version = self._session, self._session.version
        with one_thread():
            while self._asked:
                asked, page = self._asked.popleft()
                try:
                    if isinstance(asked, Pace):
                        self._pace = asked.pace
                    elif (answer := session.do(asked)) is not None:
                        said.append((_text(answer), page))
                except InputError as error:
                    said.append((_text({"type": "error", "text": str(error)}), page))
                    version = -1  # what the page drew already is put right
            until, stepped = time.monotonic() + BUSY_S, False
            began = session.now_s
            while session.now_s - began < behind and time.monotonic() < until:
                session.step()
                stepped = True
        if session.version != version:
            said.insert(0, (_text(session.scene()), None))
            stepped = True
        if stepped and (picture := session.picture()) is not None:
            said.append((_text(picture), None))
        left = behind - (session.now_s - began) if math.isfinite(began) else 0.0
        return said, max(left, -TICK_S * 8)


def _text(message: dict[str, Any]) -> str:
    """Return a message as JSON; a number that is not finite is null."""
    return json.dumps(_finite(message), separators=(",", ":"))


def _finite(value: Any) -> Any:
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {key: _finite(v) for key, v in value.items()}
    return [_finite(v) for v in value] if isinstance(value, (list, tuple)) else value


def _page(connection: Any, request: Any) -> Any:
    """Answer a request for one of the page's files; None lets a WebSocket pass."""
    if request.headers.get("Upgrade", "").lower() == "websocket":
        return None
    from websockets.datastructures import Headers
    from websockets.http11 import Response

    name = request.path.partition("?")[0].strip("/") or "index.html"
    files = {
        file.name: file for file in resources.files("homeward.studio").joinpath("page").iterdir()
    }
    kind = KINDS.get(name.rpartition(".")[2])
    if name not in files or kind is None:
        return connection.respond(HTTPStatus.NOT_FOUND, "there is no such page\n")
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
