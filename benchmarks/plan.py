"""Runtime of a plan: 10 x 10 m at 10 cm, 30 landmarks, nine opaque shelves; goal 10 s.

`python -m benchmarks.plan [--runs 3]` prints wall time, best of the runs, and the processor time
of all threads.
"""

import os
import time

import numpy as np
import shapely

from benchmarks import monte_carlo
from homeward.lab.planning.analysis import analyse
from homeward.lab.planning.floor import make_floor
from homeward.lab.planning.settings import HomePlace, Plan

LANDMARKS = 30


def big_plan() -> Plan:
    corners = [(x, y) for x in (1.5, 4.2, 7.0) for y in (2.0, 4.5, 7.0)]
    empty = Plan(
        outline=((0, 0), (10, 0), (10, 10), (0, 10)),
        shelves=tuple(((x, y), (x + 1.5, y), (x + 1.5, y + 0.5), (x, y + 0.5)) for x, y in corners),
        home=HomePlace(x=0.8, y=0.8),
    )
    floor = make_floor(empty)
    rings = [solid.exterior for solid in (floor.outline, *floor.shelves)]
    spacing = sum(ring.length for ring in rings) / 120
    along = [ring.interpolate(np.arange(0.5 * spacing, ring.length, spacing)) for ring in rings]
    places = shapely.get_coordinates(np.concatenate(along))
    drawn = np.random.default_rng(0).choice(len(places), LANDMARKS, replace=False)
    marks = {f"L{k}": (float(x), float(y)) for k, (x, y) in enumerate(places[drawn])}
    return empty.model_copy(update={"landmarks": marks})


def main() -> None:
    options, plan = monte_carlo.parsed(__doc__, runs=3), big_plan()
    walls, processors = [], []
    for _ in range(options.runs):
        wall, processor = time.perf_counter(), time.process_time()
        view = analyse(plan)
        walls.append(time.perf_counter() - wall)
        processors.append(time.process_time() - processor)
    print(
        f"{view.position.size} places, {len(view.names)} landmarks, {len(plan.shelves)} shelves:"
        f" {min(walls):.1f} s (goal 10), {min(processors):.1f} s of processor time on"
        f" {os.cpu_count()} cores"
    )


if __name__ == "__main__":
    main()
