"""The host of a session: who may talk to it, and how."""

import asyncio
import contextlib
import functools
import json
import threading
import time

import pytest
from live_rig import SCENARIO
from typer.testing import CliRunner

from homeward.cli.main import app
from homeward.drives.drive import HomeBearing
from homeward.errors import HomewardError, InputError
from homeward.estimator import synchronised
from homeward.lab.simulation.live_robot import LiveRobot, SimulatedRobotClient, play
from homeward.lab.simulation.simulate import load_scenario
from homeward.live.messages import BearingsIn, GoHome, Hello, OdometryIn, line_of
from homeward.live.server import Address, Server, address, stop_file
from homeward.live.session import NOT_OWN_STOP, Session
from homeward.live.settings import LiveSettings
from homeward.localizer.localizer import Localizer

ANY = Address("127.0.0.1", 0)
HELLO = line_of(Hello()).encode()


def asynchronous(test):
    """Run a test in an event loop."""

    @functools.wraps(test)
    def run(**fixtures):
        asyncio.run(test(**fixtures))

    return run


@contextlib.asynccontextmanager
async def serving(session=None, token=None, stop_file=None, **where):
    """The ports of a server, and the server."""
    server = Server(session or Session(), token, stop_file=stop_file)
    opened = asyncio.get_running_loop().create_future()
    task = asyncio.create_task(server.serve(**where, opened=opened.set_result))
    try:
        await asyncio.wait({task, opened}, return_when=asyncio.FIRST_COMPLETED)
        if task.done():
            task.result()
        yield opened.result(), server
    finally:
        task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await task


async def answers(port, *lines, count=1):
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    for line in lines:
        writer.write(line)
    out = [json.loads(line) for line in [await reader.readline() for _ in range(count)] if line]
    return out, reader, writer


@asynchronous
async def test_a_robot_comes_home_over_tcp():
    async with serving(tcp=ANY) as (ports, _):
        changes = SCENARIO | {"rates.odometry": 40.0, "rates.bearings": 20.0}
        player = SimulatedRobotClient(LiveRobot(load_scenario("paper-homing", changes)))
        await play(player, Address("127.0.0.1", ports[0]), 1.0, None, lambda text: None)
    assert player.ending.state == "arrived"
    assert player.robot.distance < 0.05


@pytest.mark.parametrize(
    ("first", "words"),
    [
        (b"GET / HTTP/1.1\r\n\r\n", "not JSON"),
        (b'{"type":"estop","engaged":false}\n', "the first message must be hello"),
        (b'{"type":"hello"}\n', "wrong token"),
        (b'{"type":"hello","token":"guess"}\n', "wrong token"),
        (b'{"type":"hello","version":7}\n', "must be 1"),
    ],
)
@asynchronous
async def test_who_does_not_say_hello_as_he_must_is_let_go(first, words):
    async with serving(token="secret", tcp=ANY) as (ports, server):
        (said,), reader, writer = await answers(ports[0], first, HELLO)
        assert said["type"] == "error"
        assert words in said["text"]
        with contextlib.suppress(ConnectionError):
            assert await reader.read() == b""
        writer.close()
        assert server.session.waiting == 0


@asynchronous
async def test_wrong_tokens_wait_one_after_the_other_and_the_right_one_does_not(monkeypatch):
    monkeypatch.setattr("homeward.live.server.WRONG_TOKEN_S", 0.2)
    async with serving(token="secret", tcp=ANY) as (ports, _):
        began, right = time.monotonic(), line_of(Hello(token="secret")).encode()
        guesses = [asyncio.create_task(answers(ports[0], HELLO)) for _ in range(4)]
        (said,), _, writer = await answers(ports[0], right)
        assert said["type"] == "hello"
        assert time.monotonic() - began < 0.2
        writer.close()
        for (said,), _, writer in await asyncio.gather(*guesses):
            assert said["text"] == "wrong token"
            writer.close()
        assert time.monotonic() - began >= 0.8


@asynchronous
async def test_an_observer_may_only_read():
    async with serving(token="secret", tcp=ANY) as (ports, server):
        server.observe_token = "glass"
        hello = line_of(Hello(token="glass")).encode()
        stop = b'{"type":"estop","engaged":true}\n'
        go = b'{"type":"go_home"}\n'
        out, reader, writer = await answers(ports[0], hello, stop, go, count=3)
        assert [x["type"] for x in out] == ["hello", "error", "error"]
        assert "only permits to read" in out[1]["text"]
        while json.loads(await reader.readline())["type"] != "diagnostics":
            pass
        assert not server.session.is_stopped
        writer.close()


STOP = b'{"type":"estop","engaged":true}\n'
RELEASE = b'{"type":"estop","engaged":false}\n'


@asynchronous
async def test_only_the_client_that_gave_a_stop_releases_it_also_after_a_restart(tmp_path):
    file = tmp_path / "state" / "stop"

    async def until(condition):
        async with asyncio.timeout(20.0):
            while not condition():
                await asyncio.sleep(0.01)

    async def error(reader):
        async with asyncio.timeout(20.0):
            while (out := json.loads(await reader.readline()))["type"] != "error":
                pass
        return out["text"]

    async with serving(stop_file=file, tcp=ANY) as (ports, server):
        _, _, own = await answers(ports[0], HELLO, STOP)
        await until(file.exists)
        assert server.session.is_stopped
        _, reader, other = await answers(ports[0], HELLO, RELEASE)
        assert await error(reader) == NOT_OWN_STOP
        other.write(STOP + RELEASE)  # the release of its own stop
        own.write(RELEASE)
        await until(lambda: not (server.session.is_stopped or file.exists()))
        own.write(STOP)
        await until(file.exists)
        own.close()
        other.write(RELEASE)
        assert await error(reader) == NOT_OWN_STOP
        other.close()
    async with serving(stop_file=file, tcp=ANY) as (ports, server):
        assert server.session.is_stopped
        _, reader, writer = await answers(ports[0], HELLO, STOP, RELEASE, RELEASE)
        assert await error(reader) == NOT_OWN_STOP
        writer.close()
    file.unlink()  # --release-stop
    async with serving(stop_file=file, tcp=ANY) as (ports, server):
        assert not server.session.is_stopped


def test_a_restart_with_release_stop_releases_the_stop_of_the_same_addresses(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    assert stop_file() is stop_file(ANY) is None
    stopped = [stop_file(Address("127.0.0.1", port)) for port in (7707, 7708)]
    for file in stopped:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.touch()

    async def nothing(*_):
        pass

    monkeypatch.setattr(Server, "serve", nothing)
    assert CliRunner().invoke(app, ["live", "--tcp", "7707"]).exit_code == 0
    assert all(file.exists() for file in stopped)
    CliRunner().invoke(app, ["live", "--tcp", "7707", "--release-stop"])
    assert [file.exists() for file in stopped] == [False, True]


@asynchronous
async def test_bad_lines_are_answered_and_an_endless_one_ends_the_talk():
    async with serving(tcp=ANY) as (ports, _):
        out, reader, writer = await answers(ports[0], HELLO, b"nonsense\n", count=2)
        assert [x["type"] for x in out] == ["hello", "error"]
        writer.write(b"x" * 200_000)
        with contextlib.suppress(ConnectionError):
            async with asyncio.timeout(5):
                await reader.read()
        writer.close()
        # The session goes on for others.
        out, _, writer = await answers(ports[0], HELLO)
        assert out[0]["type"] == "hello"
        writer.close()


class Talkative(Session):
    """Sends much to all clients for each message."""

    def process(self):
        return [*super().process(), Hello(token="x" * 60_000)]


def test_a_robot_is_commanded_while_the_estimator_is_stuck():
    stuck, free = threading.Event(), threading.Event()

    class Stuck(Localizer):
        @synchronised
        def bearings(self, *seen):
            stuck.set()
            free.wait(30.0)
            return super().bearings(*seen)

    async def whole():
        session = Session(homes={"home": {"a": HomeBearing(0.1), "b": HomeBearing(1.0)}})
        session.localisation.estimator = Stuck({"a": 0.1, "b": 1.0})
        async with serving(session, tcp=ANY) as (ports, _):
            lines = (BearingsIn(t=0.0, bearings={"a": 0.1}), GoHome())
            _, reader, writer = await answers(
                ports[0], HELLO, *(line_of(x).encode() for x in lines)
            )
            try:
                while not stuck.is_set():
                    await asyncio.sleep(0.01)
                kinds = [
                    json.loads(await asyncio.wait_for(reader.readline(), 10.0))["type"]
                    for _ in range(100)  # two seconds, and landmarks are asked for each second
                ]
            finally:
                free.set()
                writer.close()
            return kinds

    kinds = asyncio.run(whole())
    assert set(kinds) == {"command", "diagnostics"}


@asynchronous
async def test_who_does_not_read_is_let_go_and_others_hear_on():
    async with serving(Talkative(), tcp=ANY) as (ports, _):
        _, ignored, deaf = await answers(ports[0], HELLO)
        deaf.transport.pause_reading()
        _, reader, writer = await answers(ports[0], HELLO)
        for k in range(400):
            writer.write(line_of(OdometryIn(t=0.02 * k, v=0.0, omega=0.0)).encode())
            async with asyncio.timeout(5):
                while len(await reader.readline()) < 60_000:
                    pass
        deaf.transport.resume_reading()
        async with asyncio.timeout(5):
            with contextlib.suppress(ConnectionError):
                while await ignored.read(2**20):
                    pass
        deaf.close()
        writer.close()


@asynchronous
async def test_others_than_this_machine_need_a_token():
    with pytest.raises(InputError, match="set a token"):
        async with serving(tcp=Address("0.0.0.0", 0)):
            pass


@pytest.mark.parametrize(
    ("text", "meant"),
    [
        ("7707", Address("127.0.0.1", 7707)),
        ("robot:80", Address("robot", 80)),
        ("[::1]:80", Address("::1", 80)),
    ],
)
def test_addresses(text, meant):
    assert address(text) == meant
    assert meant.is_loopback == (text != "robot:80")


@pytest.mark.parametrize("text", ["", "robot", "a:b", "1:99999", "-1", "²"])
def test_what_is_no_address_is_refused(text):
    with pytest.raises(InputError, match="HOST:PORT"):
        address(text)


@asynchronous
async def test_nobody_listens():
    async with serving(tcp=ANY) as (ports, _):
        port = ports[0]
    player = SimulatedRobotClient(LiveRobot(load_scenario("paper-homing", SCENARIO)))
    with pytest.raises(HomewardError, match="no session at"):
        await play(player, Address("127.0.0.1", port), 1.0, None, lambda text: None)


@asynchronous
async def test_websockets_take_the_same_messages_and_no_pages_of_other_sites():
    connect = pytest.importorskip("websockets.asyncio.client").connect
    from websockets.exceptions import InvalidStatus

    async with serving(websocket=ANY) as (ports, _):
        url = f"ws://127.0.0.1:{ports[0]}"
        async with connect(url) as socket:
            await socket.send(HELLO.decode())
            assert json.loads(await socket.recv())["type"] == "hello"
            await socket.send("nonsense")
            while json.loads(await socket.recv())["type"] != "error":
                pass
            await socket.send(line_of(OdometryIn(t=0.0, v=0.0, omega=0.0)))
            said = {"faults": ["no odometry yet"]}
            while "no odometry yet" in said.get("faults", ["no odometry yet"]):
                said = json.loads(await socket.recv())
        for page in ("http://localhost:8000", "https://example.org"):
            with pytest.raises(InvalidStatus):
                await connect(url, origin=page)
    async with serving(token="secret", websocket=ANY) as (ports, _):
        url = f"ws://127.0.0.1:{ports[0]}"
        async with connect(url, origin="http://localhost:8000") as socket:
            await socket.send('{"type":"hello","token":"secret"}')
            assert json.loads(await socket.recv())["type"] == "hello"


async def hears(reader, wanted, within=10.0):
    """The first message that is wanted."""
    async with asyncio.timeout(within):
        while True:
            said = json.loads(await reader.readline())
            if wanted(said):
                return said


def types_taken(session):
    """The types of messages in the order in which they are taken."""
    taken, receive = [], session.receive

    def taking(message, *others):
        taken.append(message.type)
        receive(message, *others)

    session.receive = taking
    return taken


ODOMETRY = b'{"type":"odometry","t":%d,"v":0.1,"omega":0.0}\n'


@pytest.mark.parametrize("same", [True, False])
def test_a_stop_is_taken_before_what_a_client_sent_without_a_pause(same):
    async def whole():
        session = Session()
        taken = types_taken(session)
        async with serving(session, tcp=ANY) as (ports, _):
            _, _, fast = await answers(ports[0], HELLO)
            _, _, other = await answers(ports[0], HELLO)
            fast.write(b"".join(ODOMETRY % k for k in range(10_000)))
            (fast if same else other).write(STOP)
            async with asyncio.timeout(60):
                while taken.count("odometry") < 10_000 or "estop" not in taken:
                    await asyncio.sleep(0.01)
            for writer in (fast, other):
                writer.close()
        return taken

    taken = asyncio.run(whole())
    assert taken.count("odometry") == 10_000  # and nothing is lost
    assert taken.count("estop") == 1
    assert taken.index("estop") < 9_000


@pytest.mark.parametrize("line", [b"nonsense\n", b"\n", ODOMETRY % 1])
@asynchronous
async def test_commands_go_on_while_a_client_sends_without_a_pause(line):
    async with serving(tcp=ANY) as (ports, _):
        _, fast_reader, fast = await answers(ports[0], HELLO)
        _, reader, writer = await answers(ports[0], HELLO, line_of(GoHome()).encode())

        async def flood():
            with contextlib.suppress(ConnectionError):
                while True:
                    fast.write(line * 1000)
                    await fast.drain()
                    await asyncio.sleep(0)

        async def ignore():
            with contextlib.suppress(ConnectionError):
                while await fast_reader.read(2**16):
                    pass

        tasks = [asyncio.create_task(flood()), asyncio.create_task(ignore())]
        for _ in range(25):
            await hears(reader, lambda said: said["type"] == "command")
        for task in tasks:
            task.cancel()
        fast.close()
        writer.close()


@asynchronous
async def test_who_sends_refused_lines_without_end_is_let_go_without_a_word_on_stderr(caplog):
    async with serving(tcp=ANY) as (ports, _):
        _, reader, writer = await answers(ports[0], HELLO)
        writer.write(b"nonsense\n" * 20_000)
        said = await hears(reader, lambda said: "disconnected" in said.get("text", ""))
        assert said["text"] == "disconnected: 100 lines in a row were refused"
        with contextlib.suppress(ConnectionError):
            async with asyncio.timeout(5):
                await reader.read()
        writer.close()
        # One that hangs up at once is no reason for complaints either.
        _, _, writer = await answers(ports[0], HELLO)
        writer.write(b"nonsense\n" * 20_000)
        await writer.drain()
        writer.transport.abort()
        out, _, writer = await answers(ports[0], HELLO)
        assert out[0]["type"] == "hello"
        await asyncio.sleep(0.2)
        writer.close()
    assert caplog.text == ""


def test_too_many_messages_of_one_client_cost_another_nothing():
    session = Session(LiveSettings(queue=20))
    for k in range(5):
        session.receive(BearingsIn(t=0.1 * k, bearings={}), 0.0, "robot")
    for k in range(200):
        session.receive(OdometryIn(t=0.002 * k, v=0.0, omega=0.0), 0.0, "fast")
    kept = [message.type for message, *_ in session._queue]
    assert kept.count("bearings") == 5
    assert len(kept) == 20


@pytest.mark.parametrize(
    ("sent", "words"),
    [
        (b"x" * 200_000, "received a line of more than 65,536 bytes"),
        (b"", "no answer to hello within"),
    ],
)
def test_a_simulated_robot_is_refused_by_what_is_no_session(sent, words, monkeypatch):
    monkeypatch.setattr("homeward.lab.simulation.live_robot.HELLO_S", 0.5)

    async def whole():
        async def serve(reader, writer):
            writer.write(sent)
            try:
                with contextlib.suppress(ConnectionError):
                    while await reader.read(2**16):
                        pass
            finally:
                writer.close()

        server = await asyncio.start_server(serve, "127.0.0.1", 0)
        port = server.sockets[0].getsockname()[1]
        player = SimulatedRobotClient(LiveRobot(load_scenario("paper-homing", SCENARIO)))
        try:
            async with asyncio.timeout(10):
                await play(player, Address("127.0.0.1", port), 1.0, None, lambda text: None)
        finally:
            server.close()
            await asyncio.sleep(0.1)  # both sides are closed

    with pytest.raises(HomewardError, match=words):
        asyncio.run(whole())
