"""How long a plan takes: 10 x 10 m at 10 cm, 30 landmarks, nine shelves that hide; goal 10 s.

`python -m benchmarks.plan [--runs 3] [--open]`. Prints wall time, best of the runs, and the
processor time of all threads; `--open` leaves the shelves away, so that all landmarks are seen.
"""

from __future__ import annotations

import argparse
import os
import time

import numpy as np

from homeward.lab.planning.analysis import analyse
from homeward.lab.planning.floor import candidate_places, make_floor
from homeward.lab.planning.settings import HomePlace, Plan

LANDMARKS = 30


def big_plan(shelves: bool) -> Plan:
    """Return the plan, landmarks drawn along walls and shelves with a fixed seed."""
    corners = [(x, y) for x in (1.5, 4.2, 7.0) for y in (2.0, 4.5, 7.0)] if shelves else []
    empty = Plan(
        outline=((0, 0), (10, 0), (10, 10), (0, 10)),
        shelves=tuple(((x, y), (x + 1.5, y), (x + 1.5, y + 0.5), (x, y + 0.5)) for x, y in corners),
        home=HomePlace(x=0.8, y=0.8),
    )
    places = candidate_places(empty, make_floor(empty))
    drawn = np.random.default_rng(0).choice(len(places), LANDMARKS, replace=False)
    marks = {f"L{k}": (float(x), float(y)) for k, (x, y) in enumerate(places[drawn])}
    return empty.model_copy(update={"landmarks": marks})


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--open", action="store_true")
    options = parser.parse_args()
    plan = big_plan(not options.open)
    walls, processors = [], []
    for _ in range(options.runs):
        wall, processor = time.perf_counter(), time.process_time()
        view = analyse(plan)
        walls.append(time.perf_counter() - wall)
        processors.append(time.process_time() - processor)
    print(
        f"{view.position.size} places, {len(view.names)} landmarks, {len(plan.shelves)} shelves,"
        f" {len(view.advice.candidates)} candidate places for {plan.further} more:"
        f" {min(walls):.1f} s (goal 10), {min(processors):.1f} s of processor time on"
        f" {os.cpu_count()} cores"
    )


if __name__ == "__main__":
    main()
