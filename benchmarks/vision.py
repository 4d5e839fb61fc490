"""The camera front-end on images: direction home, heading, NEES, false accepts, runtime.

`python -m benchmarks.vision [--part NAME ...] [--seeds 6]` prints the figures of these parts:
antworld, route, speed, still, rooms, strangers, exposure, tilt. The data sets antworld_rendered and
alife_outdoor_panoramas are read from HOMEWARD_DATA, else from ../shared/data; rooms are rendered.
"""

import csv
import math
from collections.abc import Callable, Iterable, Sequence
from functools import cache, partial
from itertools import product
from typing import NamedTuple

import numpy as np

from benchmarks import monte_carlo
from benchmarks.mrclam import data
from benchmarks.rooms import PLANS, room
from benchmarks.timing import clock, in_turns
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose
from homeward.lab.simulation.render.drive import Eye
from homeward.lab.simulation.render.rays.raycast import points, trace
from homeward.runs.scoring import normalised_squared
from homeward.vision import Comparison, Equirectangular, compare, extract
from homeward.vision.cameras.image_files import read_grey
from homeward.vision.opencv import opencv

ANTWORLD = Equirectangular(horizon=0.8, tilt_sigma=0.005)
"""Rendered without tilt; the horizon was read from the pictures."""
NORTH = math.pi / 2  # direction of the middle column of these pictures
SAME, EXPOSURE, STILL = "same exposure", "other exposure", "nothing moved"
"""Exposure of the two pictures: equal to 5 %, or both with a standard deviation of 50 %; and rooms
without moved boxes."""
TILTS = {"tilt of 2 deg": 0.035, "tilt of 5 deg": 0.087}
"""Standard deviation of roll and pitch of both pictures [rad]."""
MIN_TILT = 0.005
ROUTE = Equirectangular(tilt_sigma=0.05)
CHI_SQUARE_2_95 = 5.991


def errors(
    name: str, seen: Iterable[tuple[Comparison, np.ndarray]]
) -> tuple[np.ndarray, np.ndarray]:
    """Print the share of accepted pairs; return errors of direction and heading, and covariances.

    A pair has a comparison and true direction and heading (2,) [rad].
    """
    rows = list(seen)
    accepted = [(c, truth) for c, truth in rows if c.has_direction]
    off = np.array([wrap(np.array([c.direction, c.heading]) - truth) for c, truth in accepted])
    low, high = (np.degrees(np.quantile(np.abs(off), q, axis=0)) for q in (0.5, 0.95))
    print(
        f"{name}: {len(accepted)} of {len(rows)} pairs accepted; heading {low[1]:.2f} median, "
        f"{high[1]:.2f} deg at 95 %; direction {low[0]:.2f} median, {high[0]:.2f} deg at 95 %",
        flush=True,
    )
    return off, np.array([c.covariance for c, _ in accepted])


def antworld(count: int = 200) -> None:
    """Print the errors on a grid of rendered panoramas, by the distance of pairs."""
    folder = data() / "antworld_rendered"
    with (folder / "grid.csv").open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream, skipinitialspace=True))
    place = np.array([[float(row["X [mm]"]), float(row["Y [mm]"])] for row in rows]) / 1e3
    cell = np.rint((place - place.min(axis=0)) / 0.1).astype(int)
    at = {tuple(c): k for k, c in enumerate(cell.tolist())}
    grid = folder / "grid"
    view = cache(lambda k: extract(read_grey(grid / rows[k]["Filename"].strip()), ANTWORLD))
    for steps in (1, 2, 3, 5):
        rng, pairs = np.random.default_rng(0), list[tuple[int, int]]()
        ways = ((steps, 0), (-steps, 0), (0, steps), (0, -steps))
        while len(pairs) < count:
            a, way = rng.integers(0, 31, 2), ways[int(rng.integers(4))]
            if (b := (int(a[0]) + way[0], int(a[1]) + way[1])) in at:
                pairs.append((at[tuple(a.tolist())], at[b]))

        def seen(pair: tuple[int, int]) -> tuple[Comparison, np.ndarray]:
            home, now = pair
            x, y = place[now] - place[home]
            truth = np.array([math.atan2(y, x) - NORTH, 0.0])
            return compare(view(home), view(now), ANTWORLD), truth

        errors(f"antworld, {steps / 10:.1f} m", map(seen, pairs))


def route() -> None:
    """Print the direction back on a real outdoor route of 6.8 m, 120 x 25 pixels.

    The only ground truth is that earlier positions are behind the robot.
    """
    folder = data() / "alife_outdoor_panoramas" / "robot_data"
    count = len(list(folder.glob("snapshot_*.png")))
    views = [extract(read_grey(folder / f"snapshot_{k}.png"), ROUTE) for k in range(0, count, 2)]
    for gap in (5, 10, 20):
        right = [
            abs(seen.home_direction) > math.pi / 2
            for k in range(gap, len(views))
            if (seen := compare(views[k - gap], views[k], ROUTE)).has_direction
        ]
        total = len(views) - gap
        print(
            f"outdoor route, {2 * gap * 6.8 / count:.2f} m back: a direction in {len(right)} of "
            f"{total} frames ({len(right) / total:.0%}), correct sense in {np.mean(right):.0%}"
        )


def speed(rounds: int = 15) -> None:
    """Print the runtime of a frame, alternating with that of SIFT alone."""
    opencv().setNumThreads(1)
    plain, camera = opencv().SIFT_create(), Equirectangular()
    for width, most in ((512, 35), (768, 60)):
        pair = rendered("office", 1, width)
        home, now = pair.home, pair.now
        first, second = extract(home, camera), extract(now, camera)
        calls: dict[str, Callable[[], object]] = {
            "SIFT": partial(plain.detectAndCompute, now, None),
            "features": partial(extract, now, camera),
            "comparison": partial(compare, first, second, camera),
            "picture": partial(pair.eye.look, 0.0, pair.robot, 1),
        }
        taken = in_turns({name: partial(clock, call) for name, call in calls.items()}, rounds)
        frame = taken["features"] + taken["comparison"]
        print(
            f"{width}x{width // 4}: {1e3 * np.median(frame):.0f} ms per frame, best "
            f"{1e3 * frame.min():.0f} (goal {most}): features "
            f"{1e3 * np.median(taken['features']):.0f}, comparison "
            f"{1e3 * np.median(taken['comparison']):.0f}; {np.median(frame / taken['SIFT']):.2f} "
            "times SIFT alone (detectAndCompute with OpenCV's defaults); a rendered picture "
            f"{1e3 * np.median(taken['picture']):.0f}{' (goal 20)' if width == 512 else ''}"
        )


def rooms(seeds: int, kinds: Sequence[str], widths: Sequence[int] = (1024, 512)) -> None:
    """Print the errors in rendered sparse rooms with three boxes moved since home."""
    for kind, width in product(kinds, widths):
        camera = Equirectangular(tilt_sigma=TILTS.get(kind, MIN_TILT))
        seen, bearings = [], list[np.ndarray]()
        for name, seed in product(PLANS, range(seeds)):
            pair = rendered(name, seed, width, kind)
            home, now = (extract(image, camera) for image in (pair.home, pair.now))
            seen.append((found := compare(home, now, camera), pair.truth))
            if kind == STILL and found.accepted:
                bearings.append(bearing_errors(pair, found))
        nees = normalised_squared(*errors(f"rooms, {kind}, {width}x{width // 4}", seen))
        # The sum of n values with two degrees of freedom each is nearly normal.
        low, high = 2 + np.array([-1.96, 1.96]) * 2 / math.sqrt(len(nees))
        inside = (nees < CHI_SQUARE_2_95).mean()
        print(
            f"  NEES mean {nees.mean():.2f} (expected 2, 95 %: {low:.2f} to {high:.2f}), median "
            f"{np.median(nees):.2f} (1.39), in the 95 % region {inside:.0%}"
        )
        if bearings:
            median, most = np.degrees(np.quantile(np.concatenate(bearings), [0.5, 0.95]))
            print(f"  error of bearings: median {median:.3f} deg (goal 0.1), 95 % {most:.3f}")


def strangers(seeds: int, kind: str) -> None:
    """Print the false accepts between rooms that only share kinds of texture."""
    camera = Equirectangular()
    views = [
        (name, seed, *(extract(p, camera) for p in rendered(name, seed, 512, kind)[:2]))
        for name, seed in product(PLANS, range(seeds))
    ]
    pairs = [(a, b) for k, a in enumerate(views) for b in views[:k]]
    false = [
        f"{a[0]} {a[1]}, {b[0]} {b[1]}"
        for a, b in pairs
        if compare(b[2], a[2 if kind == SAME else 3], camera).accepted
    ]
    print(f"unrelated rooms, {kind}: {len(false)} false accepts of {len(pairs)} {false}")


class Rendered(NamedTuple):
    """Home's image and another one from up to 3 m away, with ground truth."""

    home: np.ndarray
    now: np.ndarray
    truth: np.ndarray  # (2,), direction and heading [rad]
    eye: Eye
    robot: Pose


@cache
def rendered(name: str, seed: int, width: int, kind: str = SAME) -> Rendered:
    """Return a pair of images in a room."""
    scenario = room(name, seed, distance=(0.3, 3.0), moved=0 if kind == STILL else 3)
    changes = {"width": width, "height": width // 4, "tilt_sigma": TILTS.get(kind, MIN_TILT)}
    if kind == EXPOSURE:
        changes["exposure_sigma"] = 0.5
    camera = scenario.camera.model_copy(update=changes)
    eye = Eye(scenario.model_copy(update={"camera": camera}))
    robot = eye.scenario.start.in_home_frame(eye.scenario.home.pose)
    images = eye.home_picture(), eye.look(0.0, robot, 1)
    home, now = eye.home_view, eye.view(robot, 1)
    way = home.rotation.T @ (now.position - home.position)
    turn = home.rotation.T @ now.rotation
    truth = np.array([math.atan2(way[1], way[0]), math.atan2(turn[1, 0], turn[0, 0])])
    grey = [np.rint(image @ [0.114, 0.587, 0.299]).astype(np.uint8) for image in images]
    return Rendered(grey[0], grey[1], truth, eye, robot)


def bearing_errors(pair: Rendered, seen: Comparison) -> np.ndarray:
    """Return the errors of the bearings of the inliers [rad], from the points that they show."""
    home, now = pair.eye.home_view, pair.eye.view(pair.robot, 1)
    rays = seen.pairs.home_vectors[seen.agrees]
    hits = trace(pair.eye.then.surfaces, home, rays)
    x, y, _ = ((points(hits, home, rays) - now.position) @ now.rotation).T
    return np.abs(wrap(seen.pairs.now[seen.agrees, 0] - np.arctan2(y, x)))


def exposure(seeds: int) -> None:
    rooms(seeds, [EXPOSURE], [1024])
    strangers(seeds, EXPOSURE)


def main() -> None:
    parts: dict[str, Callable[[int], None]] = {
        "antworld": lambda _: antworld(),
        "route": lambda _: route(),
        "speed": lambda _: speed(),
        "still": lambda seeds: rooms(seeds, [STILL], [1024]),
        "rooms": lambda seeds: rooms(seeds, [SAME]),
        "strangers": lambda seeds: strangers(seeds, SAME),
        "exposure": exposure,
        "tilt": lambda seeds: rooms(seeds, list(TILTS), [1024]),
    }
    options = monte_carlo.parsed(__doc__, seeds=6, part=parts)
    for part in options.part:
        parts[part](options.seeds)


if __name__ == "__main__":
    main()
