"""Work for workers of tests: functions that a process of its own can import."""

import os
import signal
import time
from pathlib import Path

import numpy as np


def square(x):
    return {"square": np.array([x * x]), "pid": np.array(os.getpid())}


def slow_square(x):
    time.sleep(0.15)
    return square(x)


def die_once(folder_and_x):
    """Be killed the first time that a certain block is begun."""
    folder, x = folder_and_x
    (Path(folder) / f"begun-{os.getpid()}-{x}").touch()
    if x == 3:
        try:
            (Path(folder) / "died").touch(exist_ok=False)
        except FileExistsError:
            pass
        else:
            os.kill(os.getpid(), signal.SIGKILL)
    return slow_square(x)


def die_always(x):
    os.kill(os.getpid(), signal.SIGKILL)


def in_this_process(function, arguments, processes):
    """Stand in for a pool of processes where a test is not about it."""
    for name, argument in arguments.items():
        yield name, function(argument)


def draw_no_figures(monkeypatch):
    """Write pages of studies without figures, where a test is not about them."""
    monkeypatch.setattr("homeward.lab.report.study.page.figures", lambda results: [])
