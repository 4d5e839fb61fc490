"""Homing by images in rendered sparse rooms, and the runtime of a picture.

The rooms of `benchmarks.rooms` in turn, furnished according to the seed: from up to 4 m with
unknown heading, three boxes moved since home, a person walking through; in four of five the camera
has another tilt in each picture. `benchmarks.vision` compares pairs of pictures.

    python -m benchmarks.render --homings 50 --width 1024

`--first 1000` uses rooms with other furniture: for the development of methods.
"""

import math
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from multiprocessing import Pool
from typing import TypeVar

import numpy as np

from benchmarks import monte_carlo
from benchmarks.rooms import PLANS, room
from homeward.errors import InputError
from homeward.estimator import Status
from homeward.lab.simulation.course import Ending
from homeward.lab.simulation.render.drive import Eye, ImageLoop, things_seen
from homeward.lab.simulation.render.room.settings import RenderScenario
from homeward.registry import make_estimator
from homeward.runs.scoring import errors
from homeward.track import track_of
from homeward.vision.features.detection import Features
from homeward.vision.opencv import opencv

MAX_END_M = 0.02  # maximum distance from home at the end of a successful homing [m]
CHI_SQUARE_4_SIGMA = 22.06
"""Chi-square with three degrees of freedom that is exceeded as rarely as 4 sigma."""
MIN_TESTED = 2  # minimum number of tested features of a moved box that should be detected
MOVED, EDGE, STATIC = "moved", "edge", "static"
"""Position of a landmark: on a moved box, at the edge of one, elsewhere."""
IMAGES_PER_S = 2.5  # about one every 6 cm
TILTS = (0.0, 0.01, 0.02, 0.02, 0.03)
"""Standard deviation of roll and pitch in all pictures of the five homings of each room [rad]."""
T = TypeVar("T")


def scenario(number: int, width: int) -> RenderScenario:
    """Return room number `number`, in which `robust` drives home by images of `width` columns."""
    names = list(PLANS)
    made = room(names[number % len(names)], number // len(names))
    camera = made.camera.model_copy(update={"width": width, "height": width // 4})
    return made.model_copy(update={"camera": camera, "estimator": "robust"})


def moved_boxes(eye: Eye) -> frozenset[str]:
    return frozenset(n for n, box in eye.scenario.boxes.items() if box.stood is not None)


def timed(add: Callable[[float], object], call: Callable[..., T], *given: object) -> T:
    """Return the result of a call, and pass its processor time [s] to `add`."""
    began = time.process_time()
    made = call(*given)
    add(time.process_time() - began)
    return made


@dataclass
class Homing:
    """Result of one homing by images."""

    words: str
    distance: float = math.inf  # from home at the end [m]; infinite if the drive failed
    done: bool = False  # whether the robot reported to be home
    counts: dict[tuple[str, str], Counter[bool | None]] = field(default_factory=dict)
    """By position and object: the number of home's landmarks with each value of `moved`."""
    nees: np.ndarray = field(default_factory=lambda: np.empty(0))
    """Of (x, y, heading), at each image where the robot was localised."""
    rendering: list[float] = field(default_factory=list)  # processor time of each image [s]
    seconds: float = 0.0  # processor time of everything
    images: int = 0

    def count(self, where: str, moved: bool | None) -> int:
        return sum(v[moved] for (place, _), v in self.counts.items() if place == where)


def homing(number: int, width: int) -> Homing:
    opencv().setNumThreads(1)
    made = scenario(number, width)
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
        loop.eye.look = partial(timed, result.rendering.append, loop.eye.look)  # type: ignore[method-assign]
        estimator = make_estimator("robust", loop.drive)
        drive = loop.run(estimator)
    except InputError as error:
        result.words += f": {error}"
        return result
    result.seconds, result.images = time.process_time() - began, drive.images
    result.words += f": {drive.ending.value}"
    result.distance, result.done = drive.final_distance, drive.ending is Ending.DONE
    if drive.drive.truth is not None:
        localised = [e for e in drive.estimates if e.status is Status.LOCALISED]
        result.nees = errors(track_of(estimator, localised), drive.drive.truth).nees
    home, moved = loop.front_end.home, moved_boxes(loop.eye)
    things, edge = things_seen(loop.eye, home), at_edge(loop.eye, home, moved)
    for landmark in drive.landmarks:
        if landmark.landmark.startswith("h") and landmark.sightings:
            row = int(landmark.landmark[1:])
            thing = things[row]
            where = MOVED if thing in moved else EDGE if edge[row] else STATIC
            if not thing.startswith("mover"):
                result.counts.setdefault((where, thing), Counter())[landmark.moved] += 1
    return result


def at_edge(eye: Eye, home: Features, moved: frozenset[str]) -> np.ndarray:
    """Return which features of home's picture are on or next to a moved box.

    Next to it means nearer than their size: they show the edge of the box and the static wall.
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


def print_homings(first: int, number: int, width: int) -> None:
    made = []
    with Pool(2) as pool:
        for one in pool.imap(partial(homing, width=width), range(first, first + number)):
            made.append(one)
            done = "" if one.done else ", not reported"
            print(f"  {one.words}, {100 * one.distance:.1f} cm from home{done}", flush=True)
    distance = np.array([h.distance for h in made])
    false = sum(h.done and h.distance >= MAX_END_M for h in made)
    nees = np.concatenate([h.nees for h in made if h.nees.size] or [[math.nan]])
    print(
        f"{number} homings from up to 4 m, {width}x{width // 4}: "
        f"{np.sum(distance < MAX_END_M)} within {100 * MAX_END_M:.0f} cm (goal 49 of 50), "
        f"{np.sum(distance < 0.05)} within 5 cm; median {100 * np.median(distance):.1f} cm; "
        f"home reported elsewhere: {false}\n"
        f"  NEES while localised: mean {nees.mean():.1f} (expected 3), median "
        f"{np.median(nees):.1f} (2.4), beyond 4 sigma {np.mean(nees > CHI_SQUARE_4_SIGMA):.1%}"
    )
    for where, words in (
        (MOVED, "landmarks on moved boxes"),
        (EDGE, "landmarks at their edges"),
        (STATIC, "static landmarks (false detections)"),
    ):
        yes, no, none = (sum(h.count(where, v) for h in made) for v in (True, False, None))
        print(f"  {words}: {yes} of {yes + no} detected as moved, {none} not tested")
    tested = [v for h in made for (where, _), v in h.counts.items() if where == MOVED]
    boxes = [v for v in tested if v[True] + v[False] >= MIN_TESTED]
    images, rendering = sum(h.images for h in made), sum(sum(h.rendering) for h in made)
    rest = sum(h.seconds for h in made) - rendering
    print(
        f"  moved boxes with at least {MIN_TESTED} tested landmarks: "
        f"{sum(v[True] > v[False] for v in boxes)} of {len(boxes)} detected\n"
        f"  {images / number:.0f} images per homing; processor time per image: "
        f"{1000 * rendering / images:.0f} ms for rendering, {1000 * rest / images:.0f} ms for "
        "front-end and localiser"
    )


def print_speed(width: int) -> None:
    opencv().setNumThreads(1)
    each = []
    for number in range(len(PLANS)):
        eye = Eye(scenario(number, width))
        robot = eye.scenario.start.in_home_frame(eye.scenario.home.pose)
        times: list[float] = []
        for k in range(30):
            timed(times.append, eye.look, 0.0, robot, k + 1)
        each.append((1000 * min(times), 1000 * float(np.median(times))))
    best, median = np.median(each, axis=0)
    print(
        f"a picture of {width}x{width // 4}: best {best:.1f} ms, median {median:.1f} ms of one core"
        f"{' (goal 20)' if width == 512 else ''}"
    )


def main() -> None:
    options = monte_carlo.parsed(
        __doc__, homings=50, first=0, width=[1024], speed=[512, 1024, 2048]
    )
    for width in options.speed:
        print_speed(width)
    for width in options.width if options.homings else ():
        print_homings(options.first, options.homings, width)


if __name__ == "__main__":
    main()
