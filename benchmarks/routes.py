"""Routes: errors of a repeat relative to the taught route, after landmarks were moved.

`python -m benchmarks.routes [--seeds 5] [--only "30 % moved" ...]` teaches a route of 30 m with
five waypoints once in the warehouse of `benchmarks.places`, on the first drive of a new place. Then
it moves 0, 10, 30 and 50 % of the 40 landmarks (half of them by 0.3 to 2 m, half anywhere) and
repeats the route with the localiser in the place. With 30 % moved, the robot is also pushed aside
by 1.5 m, or starts elsewhere. Nothing is tuned to it.
"""

import math
import tempfile
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import shapely
from shapely import LineString

from benchmarks.measures import Figures
from benchmarks.monte_carlo import Column, Run, benchmark
from benchmarks.places.warehouse import Warehouse
from homeward.lab.simulation.course import Ending
from homeward.lab.simulation.scenario import Push, Repeat, Scenario, StartPose, Teach
from homeward.lab.simulation.simulate import Simulation, prepare, simulate
from homeward.localizer.localizer import Localizer
from homeward.localizer.smoothing import smooth
from homeward.places.files import save_place
from homeward.places.place import Place
from homeward.places.route import stops
from homeward.places.visit_data import collect_visit
from homeward.places.visiting import first_place
from homeward.registry import make_estimator
from homeward.track import run as follow

POINTS = ((1.5, 10.5), (10.0, 10.5), (10.0, 6.0), (18.5, 6.0), (18.5, 1.5))
"""In room coordinates [m]; the route starts at `BEGIN`."""
BEGIN, ELSEWHERE = (1.5, 6.0), (6.0, 6.0)
SPEED, DWELL_S, MAX_S = 0.4, 3.0, 300.0
PUSH = Push(at=84.0, y=1.5, turn=0.5)  # half way, in the middle aisle
CASES: dict[str, tuple[float, tuple[float, float], Push | None]] = {
    **{f"{share:.0%} moved": (share, BEGIN, None) for share in (0.0, 0.1, 0.3, 0.5)},
    "pushed off": (0.3, BEGIN, PUSH),
    "begun elsewhere": (0.3, ELSEWHERE, None),
}
"""Share of the landmarks that moved, start in room coordinates [m], and push."""
NEAR, STAYS, STAYS_M = 0.1, 0.25, 2.0
"""The robot is on the route if nearer than this, and nearer than this for the next metres [m]."""
COLUMNS = (
    Column("RMS [m]", "rms"),
    Column("of worst hall", "rms", np.nanmax),
    Column("maximum", "worst", np.nanmax, 2),
    Column("at waypoints", "stops"),
    Column("worst", "stops_worst", np.nanmax),
    Column("on it after [s]", "entered", digits=1),
    Column("worst", "entered", np.nanmax, 1),
    Column("reached the end", "done", np.nanmean, 2),
)


@dataclass
class Lesson:
    """A taught route."""

    truth: np.ndarray  # (n, 4): t [s] and pose in the home frame
    place: Place

    @property
    def line(self) -> LineString:
        return LineString(self.truth[:, 1:3])

    @property
    def stops(self) -> np.ndarray:
        """(5, 2): true positions at the waypoints, with the end [m]."""
        rows = [row for row, _ in stops(self.truth[:, 0], self.truth[:, 1:])]
        return self.truth[[*rows, -1], 1:3]


def true_way(simulation: Simulation) -> np.ndarray:
    truth = simulation.drive.truth
    return np.column_stack([truth.t, truth.x, truth.y, truth.heading])


@lru_cache(maxsize=1)
def teach(seed: int) -> Lesson:
    start = StartPose(x=BEGIN[0], y=BEGIN[1], heading=math.pi / 2, prior=False)
    by_hand = Teach(speed=SPEED, points=POINTS, dwell=DWELL_S, duration=MAX_S)
    made = simulate(Warehouse(seed).scenario(start, by_hand, 1000 * seed))
    drive = made.drive
    localizer = Localizer(drive.home, **drive.settings.robot)
    data = collect_visit(localizer, drive, follow(drive, localizer), 0.0)
    data = data.store_route("round", smooth(drive, localizer.settings))
    return Lesson(true_way(made), first_place("hall", localizer, data))


def again(
    seed: int, share: float, at: tuple[float, float], push: Push | None, place: str
) -> Scenario:
    """Return the repeat after a share of the landmarks was moved, starting near a point."""
    hall = Warehouse(seed, moved_share=share, gone_share=0.0)
    hall.night()
    rng = np.random.default_rng([seed, 7])
    x, y = np.array(at) + rng.uniform(-0.2, 0.2, 2)
    heading = math.pi / 2 + rng.uniform(-0.2, 0.2)
    repeat = Repeat(place=place, route="round", speed=SPEED, duration=MAX_S, push=push)
    start = StartPose(x=x, y=y, heading=heading, prior=False)
    return hall.scenario(start, repeat, 1000 * seed + 1 + round(100 * share))


def figures(lesson: Lesson, way: np.ndarray, done: bool, since: float) -> Figures:
    """Return the errors of a true path, (n, 4), while it is on the route, again after `since`."""
    t, off = way[:, 0], shapely.distance(lesson.line, shapely.points(way[:, 1:3]))
    went = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(way[:, 1:3], axis=0).T))])
    stays = np.array([(off[(went >= m) & (went < m + STAYS_M)] < STAYS).all() for m in went])
    on = np.flatnonzero((off < NEAR) & stays)
    first, again = (some[0] if some.size else len(way) for some in (on, on[t[on] > since]))
    row = np.arange(len(way))
    counted = off[(row >= again) | ((row >= first) & (t < since))]
    reached = way[[*(row for row, _ in stops(t, way[:, 1:])), -1], 1:3]
    # From the end backwards: a robot that started elsewhere left out the first ones.
    both = min(len(reached), len(lesson.stops)) if done else 0
    misses = np.hypot(*(reached[::-1][:both] - lesson.stops[::-1][:both]).T)
    return {
        "rms": float(np.sqrt(np.mean(counted**2))) if counted.size else None,
        "worst": float(counted.max()) if counted.size else None,
        "stops": float(np.median(misses)) if both else None,
        "stops_worst": float(misses.max()) if both else None,
        "entered": float(t[again]) - since if again < len(way) else math.inf,
        "done": done,
    }


def measured(run: Run) -> Figures:
    """Repeat the route in one hall."""
    lesson = teach(run.seed)
    with tempfile.TemporaryDirectory() as folder:
        save_place(lesson.place, Path(folder) / "hall")
        scenario = again(run.seed, *CASES[run.scenario], str(Path(folder) / "hall"))
        estimator = make_estimator("robust", prepare(scenario))
        made = simulate(scenario.model_copy(update={"estimator": "place"}), estimator)
    push = scenario.trajectory.push
    done = made.ending is Ending.DONE
    return figures(lesson, true_way(made), done, push.at if push else 0.0)


def main() -> None:
    benchmark(__doc__, measured, [*CASES], COLUMNS, seeds=5)


if __name__ == "__main__":
    main()
