"""Timing side by side: everything once a round, ratios within a round, goals and a baseline."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable

import numpy as np

from homeward.lab.engine.batch.execution import available_threads

TOLERANCE = 0.5
"""A ratio may fall to this share of its baseline: machines differ, and other work disturbs."""


def per_sample(call: Callable[[int], object], count: int) -> Callable[[], float]:
    """Return a timer of a call a sample, over the next `count` samples at every round."""
    at = [0]

    def timed() -> float:
        first, at[0] = at[0], at[0] + count
        return clock(lambda: [call(k) for k in range(first, first + count)]) / count

    return timed


def clock(call: Callable[[], object]) -> float:
    """Return the processor time of a call [s]."""
    began = time.process_time()
    call()
    return time.process_time() - began


def longest_thread(call: Callable[[], object]) -> float:
    """Return the processor time of a call whose work two other threads share evenly [s]."""
    own, every = time.thread_time(), time.process_time()
    call()
    own, every = time.thread_time() - own, time.process_time() - every
    return own + (every - own) / 2


def wall(call: Callable[[], object]) -> float:
    """Return the wall time of a call [s]."""
    began = time.perf_counter()
    call()
    return time.perf_counter() - began


def in_turns(
    timed: dict[str, Callable[[], float]], rounds: int, rest: float = 0.0
) -> dict[str, np.ndarray]:
    """Time everything once a round, after one round to warm up, with a rest [s] before each."""
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
    """Return the median over the rounds of how many times longer the peer took."""
    return float(np.median(taken[peer] / taken[name]))


def goal(words: str, value: float, least: float) -> None:
    """Print a figure beside its goal."""
    print(f"  {words}: {value:,.2f} (goal: {least:,g}) {'met' if value >= least else 'MISSED'}")


def gate(ratios: dict[str, float], baseline: dict[str, float]) -> int:
    """Return how many ratios are below what the baseline allows, and print them."""
    low = [k for k in baseline if k in ratios and ratios[k] < TOLERANCE * baseline[k]]
    for name in low:
        print(f"GATE: {name}: {ratios[name]:.2f}, baseline {baseline[name]:.2f}")
    print("gate: " + ("FAILED" if low else f"all ratios at least {TOLERANCE:g} of the baseline"))
    return len(low)


def busy() -> str:
    """Return in words what else this machine has to do, which takes from two cores."""
    waiting, cores = os.getloadavg()[0], available_threads()
    return f"{waiting:.1f} processes wanted these {cores} cores over the last minute"


def start_up(rounds: int) -> None:
    """Time what a user waits for before anything happens, by the wall."""
    print("\nstart-up, best of a few:")
    for words, call, most in (
        ("import homeward", ["-c", "import homeward"], 0.5),
        ("homeward --help", ["-c", "from homeward.cli.main import app; app()", "--help"], 0.7),
    ):
        taken = min(
            wall(lambda call=call: subprocess.run([sys.executable, *call], capture_output=True))
            for _ in range(rounds)
        )
        verdict = "met" if taken < most else "MISSED"
        print(f"  {words}: {taken:.2f} s (goal: below {most:g}) {verdict}")
