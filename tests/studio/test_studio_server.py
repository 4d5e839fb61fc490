"""The host of the studio: who gets the page, who the socket."""

import asyncio
import contextlib
import json
import secrets
import urllib.error
import urllib.request

import pytest
from typer.testing import CliRunner

from homeward.cli.main import app
from homeward.studio.scenes import open_scene
from homeward.studio.server import Studio
from homeward.studio.session import Session

pytest.importorskip("websockets", reason="the studio's pages need the extra `live`")


@contextlib.asynccontextmanager
async def hosted(played=None):
    """The address of a studio, with its token."""
    played = played or Session(open_scene("circle"), ("ekf",))
    studio, opened = Studio(played), asyncio.Future()
    task = asyncio.create_task(studio.serve(0, opened.set_result))
    try:
        yield await asyncio.wait_for(opened, 20)
    finally:
        task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await task


async def talk(address, *said, origin="http://127.0.0.1:1", count=1):
    """What the studio answers to lines of a page."""
    from websockets.asyncio.client import connect

    async with connect(address.partition("?")[0].replace("http", "ws"), origin=origin) as socket:
        for line in said:
            await socket.send(json.dumps(line))
        return [json.loads(await asyncio.wait_for(socket.recv(), 20)) for _ in range(count)]


def hello(address):
    return {"do": "hello", "token": address.partition("token=")[2]}


def test_a_page_is_told_the_scene_and_then_pictures():
    async def whole():
        async with hosted() as address:
            first = await talk(address, hello(address), {"do": "pace", "pace": 4}, count=4)
            assert [one["type"] for one in first] == ["scene", "frame", "frame", "frame"]
            assert first[3]["t"] > first[2]["t"] >= first[1]["t"]
            (_, _, wrong) = await talk(
                address, hello(address), {"do": "pace", "pace": 0}, {"do": "fly"}, count=3
            )
            assert wrong["type"] in ("error", "frame")

    asyncio.run(whole())


def test_a_page_that_does_not_read_holds_up_no_other():
    from websockets.asyncio.client import connect

    class Large:
        """Played things whose every picture fills the buffers of a socket."""

        version, now_s = 0, 0.0

        def step(self):
            self.now_s += 0.02

        def scene(self):
            return {"type": "scene"}

        def picture(self):
            return {"type": "frame", "t": self.now_s, "much": secrets.token_hex(2**18)}

    async def whole():
        async with hosted(Large()) as address:
            place = address.partition("?")[0].replace("http", "ws")
            async with connect(place, origin="http://127.0.0.1:1", max_queue=1) as silent:
                await silent.send(json.dumps(hello(address)))
                read = await talk(address, hello(address), count=40)
                assert read[-1]["t"] > read[1]["t"]
                silent.transport.abort()

    asyncio.run(whole())


@pytest.mark.parametrize(
    "first", [{"do": "hello", "token": "guess"}, {"do": "again"}, {"do": "nothing"}]
)
def test_without_the_token_nothing_is_told(first):
    async def whole():
        async with hosted() as address:
            (said,) = await talk(address, first)
            assert said["type"] == "error"

    asyncio.run(whole())


def test_pages_of_others_are_refused_by_their_origin():
    from websockets.exceptions import InvalidStatus

    async def whole():
        async with hosted() as address:
            for origin in ("https://example.org", "http://127.0.0.1.example.org", None):
                with pytest.raises(InvalidStatus):
                    await talk(address, hello(address), origin=origin)

    asyncio.run(whole())


def test_the_page_s_files_are_there_and_no_others():
    def get(address):
        with urllib.request.urlopen(address) as answer:
            return answer.headers, answer.read().decode()

    async def whole():
        async with hosted() as address:
            root = address.partition("?")[0]
            headers, page = await asyncio.to_thread(get, address)
            assert "default-src 'none'" in headers["Content-Security-Policy"]
            assert "main.js" in page
            assert "http" not in page
            for name in ("../session.py", "session.py", "%2e%2e/server.py", "nothing.js"):
                with pytest.raises(urllib.error.HTTPError, match="404"):
                    await asyncio.to_thread(get, root + name)

    asyncio.run(whole())


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["sample"], "not a scene; use warehouse, paper-homing, circle or a scenario.yaml"),
        (["nowhere.yaml"], "neither a file nor one of the presets"),
        (["--estimator", "nobody"], "no estimator 'nobody'"),
        (["--port", "1"], "cannot listen at port 1"),
    ],
)
def test_what_cannot_be_opened_is_one_line(words, said, monkeypatch):
    async def refused(*_, **__):
        raise PermissionError(13, "Permission denied")

    if "--port" in words:  # whoever runs the tests might be allowed to
        monkeypatch.setattr("websockets.asyncio.server.serve", refused)
    done = CliRunner().invoke(app, ["studio", "--no-browser", *words])
    assert done.exit_code == 2
    assert said in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1


def raw(address, request):
    """The answer to a request of bytes."""
    import socket
    from urllib.parse import urlsplit

    place = urlsplit(address)
    with socket.create_connection((place.hostname, place.port), timeout=10) as link:
        link.sendall(request)
        return link.recv(4096)


def test_two_upgrade_headers_are_refused_without_a_traceback(caplog):
    async def whole():
        async with hosted() as address:
            twice = b"Connection: Upgrade\r\nUpgrade: websocket\r\nUpgrade: websocket\r\n"
            request = b"GET / HTTP/1.1\r\nHost: x\r\n" + twice + b"\r\n"
            return await asyncio.to_thread(raw, address, request)

    assert asyncio.run(whole()).startswith(b"HTTP/1.1 400 ")
    assert "Traceback" not in caplog.text


def test_pages_that_do_not_answer_do_not_hold_up_the_end(monkeypatch):
    """The close timeout, not the 10 s of the library, bounds how long it takes."""
    import websockets.asyncio.server

    told, serve = {}, websockets.asyncio.server.serve

    def spying(*values, **named):
        told.update(named)
        return serve(*values, **named)

    monkeypatch.setattr("websockets.asyncio.server.serve", spying)

    async def whole():
        async with hosted():
            pass

    asyncio.run(whole())
    assert told["close_timeout"] <= 1.0
