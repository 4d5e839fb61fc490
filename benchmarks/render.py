"""Homing by images in rendered sparse rooms.

The rooms of `benchmarks.rooms`, with boxes drawn from the seed: from up to 4 m with unknown
heading, three boxes moved since home; in four of five seeds the camera has another tilt in each
picture. `benchmarks.vision` compares pairs of pictures.

    python -m benchmarks.render [--rooms NAME ...] [--seeds 5] [--width 1024]

Rows are rooms: shares of homings that end within 2 and 5 cm (goal of the first: 0.98) and that
report home elsewhere; the distance from home; NEES of (x, y, heading) while localised (3 expected),
and its share beyond 4 sigma; landmarks detected as moved, of those tested, on moved boxes, at their
edges, and elsewhere; the moved boxes of which most landmarks are; processor time of an image.
`--first 100` uses rooms with other boxes: for the development of methods.
"""

import time
from collections import Counter, defaultdict

import numpy as np

from benchmarks.measures import Figures
from benchmarks.monte_carlo import Column, Run, benchmark
from benchmarks.rooms import PLANS, room
from homeward.errors import InputError
from homeward.estimator import LandmarkEstimate, Status
from homeward.lab.simulation.course import Ending
from homeward.lab.simulation.render.drive import Eye, ImageLoop, moved_boxes, things_seen
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
COLUMNS = (
    Column("within 2 cm", "near", np.nanmean, 2),
    Column("5 cm", "within5", np.nanmean, 2),
    Column("elsewhere", "false", np.nanmean, 2),
    Column("distance [cm]", "distance", digits=1),
    Column("worst", "distance", np.nanmax, 1),
    Column("NEES", "nees", np.nanmean, 1),
    Column("beyond", "beyond", np.nanmean, 3),
    *(Column(where, by=np.nanmean, digits=2) for where in (MOVED, EDGE, STATIC)),
    Column("boxes", by=np.nanmean, digits=2),
    Column("images", by=np.nanmean, digits=0),
    Column("rendering [ms]", "rendering", np.nanmean, 0),
    Column("others [ms]", "rest", np.nanmean, 0),
)


def timed_look(eye: Eye) -> list[float]:
    """Return a list to which each later image of an eye adds its processor time [s]."""
    taken, look = list[float](), eye.look

    def timed(*given: object) -> np.ndarray:
        began = time.process_time()
        picture = look(*given)  # type: ignore[arg-type]
        taken.append(time.process_time() - began)
        return picture

    eye.look = timed  # type: ignore[method-assign]
    return taken


def homing(run: Run, width: int) -> Figures:
    """Return the figures of one homing by images."""
    opencv().setNumThreads(1)
    made = room(run.scenario, run.seed)
    camera = {"width": width, "height": width // 4, "tilt_sigma": TILTS[run.seed % len(TILTS)]}
    changes = {
        "rates": made.rates.model_copy(update={"bearings": IMAGES_PER_S}),
        "camera": made.camera.model_copy(update=camera),
        "estimator": "robust",
    }
    began = time.process_time()
    try:
        loop = ImageLoop(Eye(made.model_copy(update=changes)))
        rendering = timed_look(loop.eye)
        estimator = make_estimator("robust", loop.drive)
        drive = loop.run(estimator)
    except InputError:
        return {"near": 0.0, "within5": 0.0, "false": 0.0, "distance": np.inf}
    seconds, near = time.process_time() - began, drive.final_distance < MAX_END_M
    found: Figures = {
        "near": near,
        "within5": drive.final_distance < 0.05,
        "false": drive.ending is Ending.DONE and not near,
        "distance": 100.0 * drive.final_distance,
        "images": drive.images,
        "rendering": 1e3 * sum(rendering) / drive.images,
        "rest": 1e3 * (seconds - sum(rendering)) / drive.images,
    }
    localised = [e for e in drive.estimates if e.status is Status.LOCALISED]
    if localised and drive.drive.truth is not None:
        nees = errors(track_of(estimator, localised), drive.drive.truth).nees
        found |= {"nees": nees.mean(), "beyond": np.mean(nees > CHI_SQUARE_4_SIGMA)}
    counts = tested(loop, drive.landmarks)
    for where in (MOVED, EDGE, STATIC):
        yes, no = (sum(c[v] for (w, _), c in counts.items() if w == where) for v in (True, False))
        found[where] = yes / (yes + no) if yes + no else None
    boxes = [c for (where, _), c in counts.items() if where == MOVED and c.total() >= MIN_TESTED]
    found["boxes"] = np.mean([c[True] > c[False] for c in boxes]) if boxes else None
    return found


def tested(loop: ImageLoop, landmarks: list[LandmarkEstimate]) -> dict[tuple[str, str], Counter]:
    """Return the number of tested landmarks that moved or did not, by position and object."""
    home, moved = loop.front_end.home, moved_boxes(loop.eye)
    things, edge = things_seen(loop.eye, home), at_edge(loop.eye, home, frozenset(moved))
    counts = defaultdict[tuple[str, str], Counter](Counter)
    for mark in landmarks:
        if mark.landmark.startswith("h") and mark.sightings and mark.moved is not None:
            row = int(mark.landmark[1:])
            where = MOVED if things[row] in moved else EDGE if edge[row] else STATIC
            counts[where, things[row]][mark.moved] += 1
    return counts


def at_edge(eye: Eye, home: Features, moved: frozenset[str]) -> np.ndarray:
    """Return which features of home's picture are on or next to a moved box.

    Next to it means nearer than their size: they show the edge of the box and the static wall.
    """
    things = eye.home_things()
    width = things.shape[1]
    on_moved = np.isin(things, [i for i, n in enumerate(eye.then.things) if n in moved])
    row, column = np.nonzero(on_moved)
    if not row.size:
        return np.zeros(len(home), bool)
    across = np.abs((column - home.column[:, None] + width / 2) % width - width / 2)
    nearest = np.hypot(row - home.row[:, None], across).min(axis=1)
    return nearest <= home.size


def main() -> None:
    benchmark(__doc__, homing, [*PLANS], COLUMNS, seeds=5, names="rooms", width=1024)


if __name__ == "__main__":
    main()
