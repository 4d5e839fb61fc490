"""A mosquitto of its own for a test."""

import os
import shutil
import socket
import subprocess
import time

import pytest

MOSQUITTO = shutil.which("mosquitto", path=os.environ["PATH"] + ":/usr/sbin:/usr/local/sbin")
IS_REQUIRED = bool(os.environ.get("HOMEWARD_NEEDS_BROKER"))
"""Whether a missing broker fails the tests, as in continuous integration."""
needs_broker = pytest.mark.skipif(
    MOSQUITTO is None and not IS_REQUIRED, reason="no mosquitto on the PATH"
)


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


class LocalBroker:
    """A mosquitto on a port of this machine, which can be killed and started again."""

    def __init__(self, folder, config=None):
        self.folder, self.port, self._process = folder, free_port(), None
        folder.mkdir(exist_ok=True)
        self.file = folder / "mosquitto.conf"
        lines = config or "allow_anonymous true\npersistence false\n"
        self.file.write_text(f"listener {self.port} 127.0.0.1\n{lines}user root\n")
        self.url = f"mqtt://127.0.0.1:{self.port}"
        self.start()

    def start(self):
        assert MOSQUITTO is not None, "no mosquitto on the PATH"
        with (self.folder / "log").open("ab") as log:
            self._process = subprocess.Popen(
                [MOSQUITTO, "-c", str(self.file)], stdout=log, stderr=log
            )
        end = time.monotonic() + 10.0
        while True:
            try:
                socket.create_connection(("127.0.0.1", self.port), 1.0).close()
                return
            except OSError:
                assert time.monotonic() < end
                assert self._process.poll() is None, (self.folder / "log").read_text()
                time.sleep(0.01)

    def kill(self):
        self._process.kill()
        self._process.wait()


def wait(condition, longest=20.0):
    end = time.monotonic() + longest
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.02)
