"""The memory of a session that goes on and on."""

import gc
import os
import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks.soak import WARM_S, Shuttle
from homeward.live.messages import Answer
from homeward.live.recording import Recorder
from homeward.live.session import Session
from homeward.live.settings import LiveSettings

SECONDS = 120.0
"""Watched for, after warming up [s]."""
MOST_OBJECTS = 600
"""More a minute: a third of what one object kept of each of 30 answers a second would be."""
MOST_MB = 0.3
"""More a minute: what 160 bytes kept of each answer would be, which tell no new objects."""


def fed(folder):
    """Feed a recorded session, on the simulator's clock; yield once a minute after warming up."""
    shuttle = Shuttle(WARM_S + SECONDS + 1.0)
    robot = shuttle.robot.drive.settings
    recorder = Recorder(folder, LiveSettings(), robot, {})
    session, answers, due = Session(LiveSettings(), robot, {}), 0, WARM_S
    session.watch(recorder.keep)
    session.receive(shuttle.home(), 0.0)
    while not shuttle.done:
        now = shuttle.robot.t
        if now >= due:
            shuttle.latencies.clear()
            gc.collect()
            yield answers
            due += 60.0
        for message in shuttle.step():
            session.receive(message, now)
        for said in session.process():
            answers += isinstance(said, Answer)
            shuttle.on_message(said)
        if (command := session.tick(now)) is not None:
            shuttle.on_message(command)


def watch(folder):
    """Write answers, objects and resident memory [MB] once a minute."""
    for answers in fed(folder):
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        megabytes = pages * os.sysconf("SC_PAGE_SIZE") / 1e6
        sys.stdout.write(f"{answers} {sys.getallocatedblocks()} {megabytes}\n")


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="no /proc here")
def test_a_recorded_session_grows_by_nothing_once_it_is_warm(tmp_path):
    code = f"import sys; sys.path.insert(0, {str(Path(__file__).parent)!r})\n"
    code += "from pathlib import Path\nfrom test_live_memory import watch\n"
    code += f"watch(Path({str(tmp_path / 'recording')!r}))"
    # In a process of its own: memory that other tests left free would hide what is taken.
    root = Path(__file__).parents[2]
    told = subprocess.run(
        [sys.executable, "-c", code], cwd=root, capture_output=True, text=True, check=True
    )
    rows = [[float(cell) for cell in line.split()] for line in told.stdout.splitlines()]
    minutes = len(rows) - 1
    assert minutes == SECONDS / 60.0
    grown = [(last - first) / minutes for first, last in zip(rows[0], rows[-1], strict=True)]
    answers, objects, megabytes = grown
    assert answers > 1700
    assert objects < MOST_OBJECTS
    assert megabytes < MOST_MB
