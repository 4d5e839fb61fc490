"""A session on stdin and stdout."""

import asyncio
import contextlib
import json
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from test_server import serving

from homeward.live.settings import LiveSettings


def test_a_session_over_stdin_answers_every_line_and_ends_with_it(tmp_path):
    lines = [{"type": "hello"}, {"type": "home", "bearings": {"a": 0.1, "b": 1.0, "c": 2.0}}]
    for k in range(120):
        lines.append({"type": "odometry", "t": 0.02 * k, "v": 0.2, "omega": 0.3})
        lines.append({"type": "bearings", "t": 0.02 * k, "bearings": {"a": 0.1 + 0.001 * k}})
    text = "".join(json.dumps(line) + "\n" for line in lines) + "nonsense\n"
    command = [sys.executable, "-m", "homeward", "live", "--record", str(tmp_path / "r")]
    done = subprocess.run(command, input=text, capture_output=True, text=True, check=True)
    said = [json.loads(line) for line in done.stdout.splitlines()]
    assert sum(x["type"] == "estimate" for x in said) == 120
    assert any("not JSON" in x.get("text", "") for x in said)
    command = [sys.executable, "-m", "homeward", "live", "--replay"]
    again = subprocess.run([*command, str(tmp_path / "r" / "session.jsonl")], capture_output=True)
    assert again.stdout.decode() == "120 answers, all equal to the last bit\n"
    assert (
        LiveSettings().queue == 200
    )  # less than the number received: stdin waits for the estimator


LOOK = '{"type":"bearings","t":%d,"bearings":{}}\n'


@contextlib.contextmanager
def live_on_pipes():
    """The process of a session that answers."""
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen([sys.executable, "-m", "homeward", "live"], text=True, **pipes) as live:
        live.stdin.write(LOOK % 0)
        live.stdin.flush()
        while json.loads(live.stdout.readline())["type"] != "estimate":
            pass  # on a slow machine, diagnostics may come first
        yield live


def test_who_closes_the_pipe_ends_the_session_without_a_word():
    with live_on_pipes() as live:
        live.stdout.close()
        with contextlib.suppress(BrokenPipeError):
            for t in range(1, 100):
                live.stdin.write(LOOK % t)
                live.stdin.flush()
        assert live.wait(60.0) == 0
        assert live.stderr.read() == ""


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
@pytest.mark.parametrize("words", ["info sample", "--help"])
def test_a_command_whose_output_cannot_be_written_ends_with_one_line(words):
    command = [sys.executable, "-m", "homeward", *words.split()]
    with open("/dev/full", "w") as full:
        ended = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True)
    assert (ended.returncode, ended.stderr.count("\n")) == (2, 1)
    without = subprocess.run(["sh", "-c", '"$@" >&-', "sh", *command], capture_output=True)
    assert (without.returncode, without.stderr) == (0, b"")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_full_disk_ends_the_session_with_one_line_and_keeps_its_recording(tmp_path):
    command = [sys.executable, "-m", "homeward", "live", "--record", str(tmp_path / "r")]
    with open("/dev/full", "w") as full:
        ended = subprocess.run(
            command, input=LOOK % 0, stdout=full, stderr=subprocess.PIPE, text=True
        )
    assert ended.returncode == 2
    assert ended.stderr == (
        "homeward: standard output: cannot be written: No space left on device; free space there"
        " or choose another destination\n"
    )
    assert (tmp_path / "r" / "session.jsonl").exists()


@pytest.mark.parametrize("how", ["closed", "SIGINT", "SIGTERM"])
def test_a_session_that_waits_for_a_line_ends_without_a_word(how):
    with live_on_pipes() as live:
        live.stdout.close() if how == "closed" else live.send_signal(signal.Signals[how])
        assert live.wait(60.0) == 0  # and stdin is open, and quiet
        assert live.stderr.read() == ""


def test_stdin_may_end_after_the_session(monkeypatch):
    before, (reading, writing) = set(threading.enumerate()), os.pipe()

    async def whole():
        async with serving(stdio=True):
            pass

    with open(reading) as stdin, open(writing, "wb") as writer:
        monkeypatch.setattr(sys, "stdin", stdin)
        asyncio.run(whole())
        (waiting,) = set(threading.enumerate()) - before
        writer.close()
        waiting.join()  # an error in it would be a warning of pytest's
