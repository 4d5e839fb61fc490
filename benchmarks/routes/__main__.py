"""Routes: errors of a repeat relative to the taught route, after landmarks were moved.

`python -m benchmarks.routes [--seeds 5] [--save FILE]` teaches a route of 30 m with five waypoints
once in the warehouse of `benchmarks.places`, on the first drive of a new place. Then it moves 0,
10, 30 and 50 % of the 40 landmarks (half of them by 0.3 to 2 m, half anywhere) and repeats the
route: with the localiser in the place; with odometry only, from the true pose; and from home to
home, one each 2 m, from their bearings only, with the paper's A-EKF (true prior) or the law of Tron
and Daniilidis (true compass). With the place and 30 % moved, the robot is also pushed aside by
1.5 m, or starts elsewhere. Nothing is tuned to it.
"""

import json
import math
import tempfile
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks import monte_carlo
from benchmarks.places.warehouse import HOME, Warehouse
from benchmarks.routes.rivals import DeadReckoning, from_home_to_home, homes_on_the_way
from homeward.control.following import Path as Line
from homeward.geometry.frames import Pose, between
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
from homeward.track import run

POINTS = ((1.5, 10.5), (10.0, 10.5), (10.0, 6.0), (18.5, 6.0), (18.5, 1.5))
"""In room coordinates [m]; the route starts at `BEGIN`."""
BEGIN, ELSEWHERE = (1.5, 6.0), (6.0, 6.0)
SPEED, DWELL_S, MAX_S = 0.4, 3.0, 300.0
SHARES = (0.0, 0.1, 0.3, 0.5)
PUSH = Push(at=84.0, y=1.5, turn=0.5)  # half way, in the middle aisle
NEAR, STAYS, STAYS_M = 0.1, 0.25, 2.0
"""The robot is on the route if nearer than this, and nearer than this for the next metres [m]."""
FOLLOW = ("place", "odometry")  # methods that follow the route; the others drive from home to home
HOW = (*FOLLOW, "a-ekf", "tron")


@dataclass
class Figures:
    """Errors of one repeat."""

    rms: float  # distance from the taught path, in ground truth [m]
    worst: float
    at_stops: list[float]
    """Distance from the stops at the waypoints when taught [m]; empty without stops, or if the
    robot did not reach the end."""
    done: float  # driven share of the route; 1 if the robot reports the end
    entered_s: float = 0.0  # time at which it was on the route, first or again [s]


@dataclass
class Lesson:
    """A taught route."""

    scenario: Scenario
    truth: np.ndarray  # (n, 4): t [s] and pose in the home frame
    place: Place

    @property
    def line(self) -> Line:
        return Line(self.truth[:, 1:3])

    @property
    def stops(self) -> np.ndarray:
        """(5, 2): true positions at the waypoints, with the end [m]."""
        rows = [row for row, _ in stops(self.truth[:, 0], self.truth[:, 1:])]
        return self.truth[[*rows, -1], 1:3]


def true_way(simulation: Simulation) -> np.ndarray:
    truth = simulation.drive.truth
    return np.column_stack([truth.t, truth.x, truth.y, truth.heading])


def teach(seed: int) -> Lesson:
    hall = Warehouse(seed)
    start = StartPose(x=BEGIN[0], y=BEGIN[1], heading=math.pi / 2, prior=False)
    by_hand = Teach(speed=SPEED, points=POINTS, dwell=DWELL_S, duration=MAX_S)
    scenario = hall.scenario(start, by_hand, 1000 * seed)
    made = simulate(scenario)
    drive = made.drive
    localizer = Localizer(drive.home, **drive.settings.robot)
    data = collect_visit(localizer, drive, run(drive, localizer), 0.0)
    data = data.store_route("round", smooth(drive, localizer.settings))
    return Lesson(scenario, true_way(made), first_place("hall", localizer, data))


def changed(seed: int, share: float) -> Warehouse:
    """Return the hall of the same seed after a share of its landmarks was moved."""
    hall = Warehouse(seed, moved_share=share, gone_share=0.0)
    hall.night()
    return hall


def again(
    seed: int, share: float, at: tuple[float, float], push: Push | None, place: str
) -> Scenario:
    """Return the repeat after a share of the landmarks was moved, starting near a point."""
    rng = np.random.default_rng([seed, 7])
    x, y = np.array(at) + rng.uniform(-0.2, 0.2, 2)
    heading = math.pi / 2 + rng.uniform(-0.2, 0.2)
    repeat = Repeat(place=place, route="round", speed=SPEED, duration=MAX_S, push=push)
    start = StartPose(x=x, y=y, heading=heading, prior=False)
    return changed(seed, share).scenario(start, repeat, 1000 * seed + 1 + round(100 * share))


def figures(lesson: Lesson, way: np.ndarray, done: float, since: float = 0.0) -> Figures:
    """Return the errors of a true path, (n, 4), while it is on the route, again after `since`."""
    t, off = way[:, 0], distance(lesson.line, way[:, 1:3])
    went = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(way[:, 1:3], axis=0).T))])
    stays = np.array([(off[(went >= m) & (went < m + STAYS_M)] < STAYS).all() for m in went])
    on = np.flatnonzero((off < NEAR) & stays)
    first, again = (some[0] if some.size else len(way) for some in (on, on[t[on] > since]))
    row = np.arange(len(way))
    counted = off[(row >= again) | ((row >= first) & (t < since))]
    reached = way[[*(row for row, _ in stops(t, way[:, 1:])), -1], 1:3]
    # From the end backwards: a robot that started elsewhere left out the first ones.
    both = min(len(reached), len(lesson.stops)) if done == 1.0 else 0
    misses = (reached[::-1][:both] - lesson.stops[::-1][:both])[::-1]
    return Figures(
        float(np.sqrt(np.mean(counted**2))) if counted.size else math.nan,
        float(counted.max()) if counted.size else math.nan,
        np.hypot(*misses.T).tolist(),
        done,
        float(t[again]) - since if again < len(way) else math.inf,
    )


def distance(line: Line, points: np.ndarray) -> np.ndarray:
    a, b = line.points[:-1], line.points[1:]
    keep = np.hypot(*(b - a).T) > 0
    a, way = a[keep], (b - a)[keep]
    out = np.empty(len(points))
    for i, point in enumerate(points):
        share = np.clip(((point - a) * way).sum(1) / (way * way).sum(1), 0.0, 1.0)
        out[i] = np.hypot(*(a + share[:, None] * way - point).T).min()
    return out


def driven_share(lesson: Lesson, way: np.ndarray) -> float:
    """Return the share of the route before the last position near it."""
    near = way[distance(lesson.line, way[:, 1:3]) < 0.5]
    if not len(near):
        return 0.0
    return lesson.line.entry(Pose(*near[-1, 1:])) / lesson.line.length


def drive_again(lesson: Lesson, scenario: Scenario, how: str) -> tuple[Figures, np.ndarray]:
    """Repeat the route with a method; return the errors and the true path."""
    push = scenario.trajectory.push
    since = push.at if push else 0.0
    if how in FOLLOW:
        prepared = prepare(scenario)
        start = scenario.start.in_home_frame(scenario.home.pose)
        place = how == "place"
        estimator = make_estimator("robust", prepared) if place else DeadReckoning(start)
        made = simulate(scenario.model_copy(update={"estimator": how}), estimator)
        way = true_way(made)
        done = 1.0 if made.ending is Ending.DONE else driven_share(lesson, way)
    else:
        homes = homes_on_the_way(lesson.scenario, lesson.truth[:, 1:])
        way, done = from_home_to_home(scenario, homes, how)
    found = figures(lesson, way, done, since)
    # Driving from home to home has no stops.
    return (found if how in FOLLOW else replace(found, at_stops=[])), way


def one_seed(seed: int) -> list[dict[str, object]]:
    lesson, rows = teach(seed), []
    route = lesson.place.routes["round"].poses
    off = distance(lesson.line, route[:, :2])
    print(f"seed {seed}: taught {len(route)} nodes, RMSE {np.sqrt(np.mean(off**2)):.3f} m")
    with tempfile.TemporaryDirectory() as folder:
        save_place(lesson.place, Path(folder) / "hall")
        where = str(Path(folder) / "hall")
        plans = [(f"{share:.0%} moved", share, BEGIN, None, how) for share in SHARES for how in HOW]
        plans += [("pushed off", 0.3, BEGIN, PUSH, "place")]
        plans += [("begun elsewhere", 0.3, ELSEWHERE, None, "place")]
        for case, share, at, push, how in plans:
            found, way = drive_again(lesson, again(seed, share, at, push, where), how)
            print(
                f"  {case}, {how}: RMS {found.rms:.3f} m, worst {found.worst:.3f}, at waypoints "
                f"{[round(m, 3) for m in found.at_stops]}, {found.done:.0%} driven, on it after "
                f"{found.entered_s:.1f} s",
                flush=True,
            )
            drawn = way[:: max(len(way) // 600, 1)].round(3).tolist()
            rows.append({"seed": seed, "case": case, "how": how, "way": drawn, **asdict(found)})
    taught = {"line": lesson.truth[::5].round(3).tolist(), "stops": lesson.stops.round(3).tolist()}
    moved = changed(seed, 0.3)
    at = {n: between(HOME.pose, Pose(*p, 0.0))[:2] for n, p in moved.places.items()}
    marks = {n: [*map(float, p), n in moved.moved] for n, p in at.items()}
    rows.append({"seed": seed, "case": "taught", **taught, "marks": marks})
    return rows


def table(rows: list[dict[str, object]]) -> None:
    print(
        "| | | distance from the path: RMS of median and worst hall, maximum [m] "
        "| at waypoints: median, worst [m] | on it after: median, worst [s] | reached the end |"
    )
    print("|---" * 6 + "|")
    for case, how in dict.fromkeys((r["case"], r["how"]) for r in rows if "how" in r):
        some = [r for r in rows if r["case"] == case and r.get("how") == how]
        rms, worst = ([r[what] for r in some] for what in ("rms", "worst"))
        stops = [m for r in some for m in r["at_stops"]]
        after = [r["entered_s"] for r in some]
        at = f"{np.median(stops):.3f}, {max(stops):.3f}" if stops else "-"
        print(
            f"| {case} | {how} | {np.nanmedian(rms):.3f}, {np.nanmax(rms):.3f}, "
            f"{np.nanmax(worst):.2f} | {at} | {np.median(after):.1f}, {max(after):.1f} "
            f"| {sum(r['done'] == 1.0 for r in some)} of {len(some)} |"
        )


def main() -> None:
    options = monte_carlo.parsed(__doc__, seeds=5, save=Path)
    rows = [row for seed in range(options.seeds) for row in one_seed(seed)]
    table(rows)
    if options.save:
        options.save.write_text(json.dumps(rows), encoding="utf-8")


if __name__ == "__main__":
    main()
