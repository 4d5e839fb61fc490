"""Timing in alternation: everything once per round, ratios within a round, goals and a baseline."""

import os
import subprocess
import sys
import time
from collections.abc import Callable

import numpy as np

from homeward.lab.engine.batch.execution import available_threads

TOLERANCE = 0.5  # minimum share of its baseline for a ratio: machines and their load differ


def per_sample(call: Callable[[int], object], count: int) -> Callable[[], float]:
    """Return a timer of one call per sample, over the next `count` samples in each round."""
    at = [0]

    def timed() -> float:
        first, at[0] = at[0], at[0] + count
        return clock(lambda: [call(k) for k in range(first, first + count)]) / count

    return timed


def clock(call: Callable[[], object]) -> float:
    began = time.process_time()
    call()
    return time.process_time() - began


def longest_thread(call: Callable[[], object]) -> float:
    """Return the processor time [s] of a call that shares its work evenly between two threads."""
    own, every = time.thread_time(), time.process_time()
    call()
    own, every = time.thread_time() - own, time.process_time() - every
    return own + (every - own) / 2


def wall(call: Callable[[], object]) -> float:
    began = time.perf_counter()
    call()
    return time.perf_counter() - began


def in_turns(
    timed: dict[str, Callable[[], float]], rounds: int, rest: float = 0.0
) -> dict[str, np.ndarray]:
    """Time everything once per round, after one warm-up round, with a rest [s] before each."""
    for call in timed.values():
        call()
    rows = []
    for _ in range(rounds):
        row = []
        for call in timed.values():
            time.sleep(rest)
            row.append(call())
        rows.append(row)
    return dict(zip(timed, np.array(rows).T, strict=True))


def ratio(taken: dict[str, np.ndarray], peer: str, name: str) -> float:
    return float(np.median(taken[peer] / taken[name]))


def goal(words: str, value: float, least: float) -> None:
    print(f"  {words}: {value:,.2f} (goal: {least:,g}) {'met' if value >= least else 'MISSED'}")


def gate(ratios: dict[str, float], baseline: dict[str, float]) -> int:
    """Print the ratios that are too far below the baseline, and return their number."""
    low = [k for k in baseline if k in ratios and ratios[k] < TOLERANCE * baseline[k]]
    for name in low:
        print(f"GATE: {name}: {ratios[name]:.2f}, baseline {baseline[name]:.2f}")
    print("gate: " + ("FAILED" if low else f"all ratios at least {TOLERANCE:g} of the baseline"))
    return len(low)


def busy() -> str:
    """Return the machine's load as text."""
    return f"load average {os.getloadavg()[0]:.1f} on {available_threads()} cores"


def start_up(rounds: int) -> None:
    print(f"\nstart-up, wall time, best of {rounds}:")
    for words, call, most in (
        ("import homeward", ["-c", "import homeward"], 0.5),
        ("homeward --help", ["-c", "from homeward.cli.main import app; app()", "--help"], 0.7),
    ):
        taken = min(
            wall(lambda call=call: subprocess.run([sys.executable, *call], capture_output=True))
            for _ in range(rounds)
        )
        result = "met" if taken < most else "MISSED"
        print(f"  {words}: {taken:.2f} s (goal: below {most:g}) {result}")
