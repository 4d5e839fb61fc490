"""The memory of a session that goes on and on."""

import ctypes
import gc
import sys
from typing import ClassVar

import numpy as np
import pytest

from benchmarks.soak import WARM_S, Shuttle
from homeward.live.messages import Answer
from homeward.live.recording import Recorder
from homeward.live.session import Session
from homeward.live.settings import LiveSettings

RATES = {"rates.odometry": 10.0, "rates.bearings": 10.0}
MINUTES = 4
"""Duration of the measurement after the warm-up."""
EVERY_S, AVERAGED = 25.0, 4
"""Interval of the measurements [s]; the first and last of them are averaged."""
MAX_OBJECTS = 200
"""Growth per minute: a third of one object kept of each of 10 answers a second."""
MAX_BYTES = 100_000
"""Growth per minute: 160 bytes kept of each answer, in objects that exist anyway."""
LIBC = ctypes.CDLL(None)


class Heap(ctypes.Structure):
    """`struct mallinfo2` of glibc."""

    _fields_: ClassVar = [("numbers", ctypes.c_size_t * 10)]


def allocated():
    """Python's objects, and bytes taken from malloc."""
    LIBC.mallinfo2.restype = Heap
    numbers = LIBC.mallinfo2().numbers
    return sys.getallocatedblocks(), numbers[4] + numbers[7]  # in mmapped blocks and in others


@pytest.mark.skipif(not hasattr(LIBC, "mallinfo2"), reason="no glibc of 2.33 or later")
def test_a_recorded_session_grows_by_nothing_once_it_is_warm(tmp_path):
    shuttle = Shuttle(WARM_S + 60.0 * MINUTES, **RATES)
    robot = shuttle.robot.drive.settings
    recorder = Recorder(tmp_path / "recording", LiveSettings(), robot, {})
    session, answers, rows = Session(LiveSettings(), robot, {}), 0, []
    session.watch(recorder.keep)
    session.receive(shuttle.home(), 0.0)
    while not shuttle.done:
        now = shuttle.robot.t
        if now > WARM_S + EVERY_S * len(rows):
            shuttle.latencies.clear()
            gc.collect()
            rows.append((now / 60.0, *allocated()))
        for message in shuttle.step():
            session.receive(message, now)
        for said in session.process():
            answers += isinstance(said, Answer)
            shuttle.on_message(said)
        if (command := session.tick(now)) is not None:
            shuttle.on_message(command)
    recorder.close()
    assert answers > 9.5 * (WARM_S + 60.0 * MINUTES)
    assert len(rows) >= 2 * AVERAGED
    first, last = np.mean(rows[:AVERAGED], axis=0), np.mean(rows[-AVERAGED:], axis=0)
    minutes, objects, taken = last - first
    assert objects / minutes < MAX_OBJECTS
    assert taken / minutes < MAX_BYTES
