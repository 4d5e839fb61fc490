"""Rendered sparse rooms: bearings, heading and direction from pairs; homing by images; speed.

Every room that comes with homeward in turn, furnished by the seed. Pairs: home against
a place up to 3 m off, nothing moved. Homings: from up to 4 m with unknown heading, three boxes
moved since home, and someone walking through; in four of five the camera is tilted anew in each
picture. All goals are those of the issue.

    python -m benchmarks.render --pairs 60 --homings 50 --width 1024

`--first 1000` takes rooms furnished otherwise: methods are to be developed on such.
"""

from __future__ import annotations

import argparse
import math
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from multiprocessing import Pool
from typing import Any

import numpy as np

from homeward.drives.cameras.camera import unit_vectors
from homeward.errors import InputError
from homeward.estimator import Status
from homeward.geometry.angles import wrap
from homeward.geometry.frames import to_polar
from homeward.io.settings import validated
from homeward.lab.simulation.course import Ending
from homeward.lab.simulation.render.drive import Eye, ImageLoop, panorama_of, things_seen
from homeward.lab.simulation.render.rays.raycast import points, trace
from homeward.lab.simulation.render.room.presets import PLANS, room
from homeward.lab.simulation.render.room.settings import RenderScenario
from homeward.registry import make_estimator
from homeward.runs.scoring import errors
from homeward.track import track_of
from homeward.vision.comparison import compare
from homeward.vision.features.detection import Features, extract
from homeward.vision.opencv import opencv

NEAR_HOME = 0.02
"""A homing is good when it ends this near [m]."""
FAR_OFF = 22.06
"""Chi-square with three degrees of freedom that is exceeded as rarely as 4 sigma."""
FEWEST = 2
"""A moved box is one to be named when so many of its features were judged."""
MOVED, EDGE, STILL = "moved", "edge", "still"
"""Where a landmark is: on a box that was moved, beside one, on anything else."""
IMAGES_PER_S, PROCESSES = 2.5, 2
"""Images taken on the way home, some 6 cm apart far from it; and what homings are shared out to."""
TILTS = (0.0, 0.01, 0.02, 0.02, 0.03)
"""Standard deviation of roll and pitch from picture to picture, home's too, in the five homings of
each room [rad]; images.yaml says as much."""


def room_number(number: int, distance: tuple[float, float], moved: int) -> dict[str, Any]:
    """Return the settings of room number `number`, `robust` driving home in it."""
    names = list(PLANS)
    made = room(names[number % len(names)], number // len(names), distance, moved)
    return made.model_dump(exclude_none=True) | {"estimator": "robust"}


def scenario(number: int, width: int, distance: tuple[float, float], moved: int) -> RenderScenario:
    """Return room number `number`, its camera `width` pixels wide."""
    tree = room_number(number, distance, moved)
    tree["camera"] |= {"width": width, "height": width // 4}
    if not moved:
        tree["furnish"]["movers"] = 0
    return validated(RenderScenario, tree)


@dataclass
class Pair:
    """What a pair of panoramas came to; angles in degrees."""

    name: str
    accepted: bool
    bearings: np.ndarray
    heading: float
    direction: float
    nees: float


def pair(number: int, width: int) -> Pair:
    """Compare home with a place up to 3 m off, against the exact truth."""
    eye = Eye(scenario(number, width, (0.3, 3.0), moved=0))
    camera = panorama_of(eye)
    robot = eye.scenario.start.in_home_frame(eye.scenario.home.pose)
    home, now = (extract(p, camera) for p in (eye.home_picture(), eye.look(0.0, robot, 1)))
    seen = compare(home, now, camera)
    # The point that home's feature shows, and the bearing that it has from the other place.
    view, surfaces = eye.home_view, eye.then.at(eye.scenario.home_time, eye.home_view)[0]
    rays = unit_vectors(home.azimuth, home.elevation)[seen.home_row[seen.agrees]]
    place = points(trace(surfaces, view, rays), view, rays)
    there = eye.view(robot, 1)
    x, y, _ = ((place - there.position) @ there.rotation).T
    off = wrap(seen.pairs.now[seen.agrees, 0] - np.arctan2(y, x))
    true = to_polar(robot)
    error = wrap(np.array([seen.direction - true.theta, seen.heading - true.alpha]))
    nees = error @ np.linalg.solve(seen.covariance, error) if seen.accepted else math.nan
    direction, heading = np.degrees(np.abs(error)).tolist()
    off = np.degrees(np.abs(off)) if seen.accepted else np.empty(0)
    return Pair(eye.scenario.name, seen.accepted, off, heading, direction, nees)


@dataclass
class Homing:
    """How one homing by images ended."""

    words: str
    distance: float = math.inf
    """From home at the end [m]; infinite when it did not get there."""
    sure: bool = False
    """Whether the robot was sure to be home."""
    verdicts: dict[tuple[str, str], Counter[bool | None]] = field(default_factory=dict)
    """Where home's landmarks are, and on which thing: how many are called moved, still, neither."""
    nees: np.ndarray = field(default_factory=lambda: np.empty(0))
    """Of (x, y, heading), at each image where the robot was sure of its pose."""
    seconds: Counter[str] = field(default_factory=Counter)
    """Processor time of rendering and of all the rest [s]."""
    images: int = 0

    def count(self, where: str, verdict: bool | None) -> int:
        """Return how many landmarks there got a verdict."""
        return sum(v[verdict] for (place, _), v in self.verdicts.items() if place == where)


def homing(number: int, width: int) -> Homing:
    """Drive home by images alone."""
    opencv().setNumThreads(1)
    made = scenario(number, width, (1.0, 4.0), moved=3)
    tilt = TILTS[number // len(PLANS) % len(TILTS)]
    changes = {
        "rates": made.rates.model_copy(update={"bearings": IMAGES_PER_S}),
        "camera": made.camera.model_copy(update={"tilt_sigma": tilt}),
    }
    made = made.model_copy(update=changes)
    result = Homing(f"{made.name}-{made.seed} from {made.start.R:.2f} m, tilt {tilt:g} rad")
    began = time.process_time()
    try:
        loop = ImageLoop(Eye(made))
        loop.eye.look = partial(_timed, loop.eye.look, result.seconds)  # type: ignore[method-assign]
        estimator = make_estimator("robust", loop.drive)
        drive = loop.run(estimator)
    except InputError as error:
        result.words += f": {error}"
        return result
    result.seconds["all"], result.images = time.process_time() - began, drive.images
    result.words += f": {drive.ending.value}"
    result.distance, result.sure = drive.final_distance, drive.ending is Ending.DONE
    if drive.drive.truth is not None:
        sure = [e for e in drive.estimates if e.status is Status.LOCALISED]
        result.nees = errors(track_of(estimator, sure), drive.drive.truth).nees
    boxes = loop.eye.scenario.boxes
    moved = frozenset(n for n, box in boxes.items() if box.stood is not None)
    home = loop.front_end.home
    things, edge = things_seen(loop.eye, home), at_edge(loop.eye, home, moved)
    for landmark in drive.landmarks:
        if landmark.landmark.startswith("h") and landmark.sightings:
            row = int(landmark.landmark[1:])
            thing = things[row]
            where = MOVED if thing in moved else EDGE if edge[row] else STILL
            if not thing.startswith("mover"):
                result.verdicts.setdefault((where, thing), Counter())[landmark.moved] += 1
    return result


def at_edge(eye: Eye, home: Features, moved: frozenset[str]) -> np.ndarray:
    """Say of each feature of home's picture whether it lies on or beside a moved box.

    Beside it is where it is no farther off than the feature is large: of what is seen there, the
    edge moved with the box, and the wall behind it did not.
    """
    truth = eye.home_truth()
    width = truth.thing.shape[1]
    on_moved = np.isin(truth.thing, [i for i, n in enumerate(eye.then.things) if n in moved])
    row, column = np.nonzero(on_moved)
    if not row.size:
        return np.zeros(len(home), bool)
    across = np.abs((column - home.column[:, None] + width / 2) % width - width / 2)
    nearest = np.hypot(row - home.row[:, None], across).min(axis=1)
    return nearest <= home.size


def _timed(call: Callable[..., np.ndarray], seconds: Counter[str], *given: object) -> np.ndarray:
    """Return what a call gives, its time counted as rendering."""
    began = time.process_time()
    made = call(*given)
    seconds["rendering"] += time.process_time() - began
    return made


def print_pairs(number: int, width: int) -> None:
    """Print what pairs come to."""
    made = [pair(i, width) for i in range(number)]
    good = [p for p in made if p.accepted]
    print(f"{number} pairs up to 3 m apart, {width}x{width // 4}: {len(good)} accepted")
    bearings = np.concatenate([p.bearings for p in good])
    heading, direction = (np.array([getattr(p, k) for p in good]) for k in ("heading", "direction"))
    print(
        f"  matched landmarks a pair: {np.median([p.bearings.size for p in good]):.0f} (median)\n"
        f"  bearings:  median {np.median(bearings):.3f} deg (goal 0.1), "
        f"95 % {np.quantile(bearings, 0.95):.2f}\n"
        f"  heading:   median {np.median(heading):.3f} deg, "
        f"95 % {np.quantile(heading, 0.95):.3f} (goal 0.1)\n"
        f"  direction: median {np.median(direction):.3f} deg, "
        f"95 % {np.quantile(direction, 0.95):.3f} (goal 0.3)\n"
        f"  NEES of (heading, direction): mean {np.mean([p.nees for p in good]):.2f}, median "
        f"{np.median([p.nees for p in good]):.2f} (honest: 2 and 1.39)"
    )


def print_homings(first: int, number: int, width: int) -> None:
    """Print how homings end."""
    made = []
    with Pool(PROCESSES) as pool:
        numbers = range(first, first + number)
        for one in pool.imap(partial(homing, width=width), numbers):
            made.append(one)
            sure = "" if one.sure else ", not sure"
            print(f"  {one.words}, {100 * one.distance:.1f} cm from home{sure}", flush=True)
    distance = np.array([h.distance for h in made])
    good = distance < NEAR_HOME
    falsely = sum(h.sure and h.distance >= NEAR_HOME for h in made)
    judged = [v for h in made for (where, _), v in h.verdicts.items() if where == MOVED]
    boxes = [v for v in judged if v[True] + v[False] >= FEWEST]
    nees = np.concatenate([h.nees for h in made if h.nees.size] or [[math.nan]])
    images, cost = sum(h.images for h in made), sum((h.seconds for h in made), Counter())
    of = {
        (w, v): sum(h.count(w, v) for h in made)
        for w in (MOVED, EDGE, STILL)
        for v in (True, False, None)
    }
    print(
        f"{number} homings from up to 4 m, {width}x{width // 4}: "
        f"{good.sum()} within {100 * NEAR_HOME:.0f} cm (goal 49 of 50), "
        f"{np.sum(distance < 0.05)} within 5 cm; median {100 * np.median(distance):.1f} cm; "
        f"sure of a home that is none: {falsely}\n"
        f"  NEES where sure: mean {nees.mean():.1f}, median {np.median(nees):.1f} (honest 3, 2.4), "
        f"beyond 4 sigma {np.mean(nees > FAR_OFF):.1%}\n"
        f"  landmarks on moved boxes: {of[MOVED, True]} of {of[MOVED, True] + of[MOVED, False]} "
        f"judged are named, {of[MOVED, None]} not judged\n"
        f"  beside them, showing their edge: {of[EDGE, True]} of "
        f"{of[EDGE, True] + of[EDGE, False]}, {of[EDGE, None]} not judged\n"
        f"  on what stayed: {of[STILL, True]} of {of[STILL, True] + of[STILL, False]} judged are "
        f"named wrongly, {of[STILL, None]} not judged\n"
        f"  moved boxes with at least {FEWEST} landmarks judged: "
        f"{sum(v[True] > v[False] for v in boxes)} of {len(boxes)} named\n"
        f"  {images / number:.0f} images a homing; an image takes "
        f"{1000 * cost['rendering'] / images:.0f} ms to render, and "
        f"{1000 * (cost['all'] - cost['rendering']) / images:.0f} ms to see and to localise"
    )


def print_speed(width: int, repeats: int = 30) -> None:
    """Print how long a picture takes on one core."""
    opencv().setNumThreads(1)
    each = []
    for number in range(len(PLANS)):
        eye = Eye(scenario(number, width, (1.0, 4.0), moved=3))
        robot = eye.scenario.start.in_home_frame(eye.scenario.home.pose)
        times = []
        for k in range(repeats):
            began = time.process_time()
            eye.look(0.0, robot, k + 1)
            times.append(time.process_time() - began)
        each.append((1000 * min(times), 1000 * float(np.median(times))))
    best, median = np.median(each, axis=0)
    print(
        f"a picture of {width}x{width // 4}: best {best:.1f} ms, median {median:.1f} ms of one core"
        f"{' (goal 20)' if width == 512 else ''}"
    )


def main() -> None:
    """Print every figure."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pairs", type=int, default=60)
    parser.add_argument("--homings", type=int, default=50)
    parser.add_argument("--first", type=int, default=0, help="number of the first homing")
    parser.add_argument("--width", type=int, nargs="*", default=[1024])
    parser.add_argument("--speed", type=int, nargs="*", default=[512, 1024, 2048])
    options = parser.parse_args()
    for width in options.speed:
        print_speed(width)
    for width in options.width:
        if options.pairs:
            print_pairs(options.pairs, width)
        if options.homings:
            print_homings(options.first, options.homings, width)


if __name__ == "__main__":
    main()
