"""The client of the manual: its messages are valid, and it follows the commands."""

import re
import socket
import threading
from pathlib import Path

import pytest

from homeward.live.messages import Command, line_of, parse

PAGE = Path(__file__).parents[2] / "docs" / "do" / "live.md"
LINES = 9


class Stops(Exception):
    """Enough was driven."""


class Robot:
    v, omega = 0.2, 0.0

    def see(self):
        return {"door": 0.3}

    def drive(self, v, omega):
        raise Stops(v, omega)


def test_the_manuals_client_follows_the_schema_and_the_commands():
    (code,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    heard = []
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(20.0)

        def serve():
            link, _ = server.accept()
            with link, link.makefile("rb") as lines:
                heard.extend(parse(next(lines).decode()) for _ in range(LINES))
                command = Command(v=0.1, omega=-0.2, hold=0.3, state="driving", reason="")
                link.sendall(line_of(command).encode())
                lines.read()

        thread = threading.Thread(target=serve)
        thread.start()
        result = {"given": Robot()}
        code = code.replace("7707", str(server.getsockname()[1]))
        with pytest.raises(Stops) as stopped:
            exec(code.replace("robot = ...", "robot = given  #"), result)
        result["link"].close()
    assert stopped.value.args == (0.1, -0.2)
    thread.join(20.0)
    assert [m.type for m in heard[:3]] == ["hello", "home", "go_home"]
    assert {m.type for m in heard[3:]} == {"odometry", "bearings"}
