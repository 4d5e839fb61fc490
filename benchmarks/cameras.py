"""Every camera from pixels to home in rendered rooms: bearings, NEES, homing, runtime.

    python -m benchmarks.cameras --homings 3
    python -m benchmarks.cameras --camera pinhole --homings 10 --view 1.4 --spin
    python -m benchmarks.cameras --overlaps 10

Rooms as in `benchmarks.render`. The heading at the start is unknown, three boxes were moved since
home was stored (with their tags), a person walks through, and each picture has a tilt of 0.01 rad.
Home is one picture or, with `--spin`, a rotation on the spot, which forward-looking cameras need.
`--view` is the field of view of these [rad]. A homing that ends within 2 cm is successful. Bearings
are compared with the true positions of tags, and of the points that home's features show; their
NEES should be 1. `--overlaps` instead compares pairs of pictures of forward-looking cameras without
tags, in this number of rooms.
"""

import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from benchmarks import monte_carlo
from benchmarks.render import (
    IMAGES_PER_S,
    MAX_END_M,
    feature_points,
    in_processes,
    motion_errors,
    moved_boxes,
    room_number,
    timed,
)
from benchmarks.rooms import PLANS
from homeward.drives.drive import HomeBearing, Odometry, Sightings
from homeward.drives.home.spin import spin
from homeward.errors import InputError
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose, Twist
from homeward.io.settings import validated
from homeward.lab.simulation.course import Wheels, before
from homeward.lab.simulation.render.drive import Eye, ImageLoop, panorama_of, things_seen
from homeward.lab.simulation.render.rays.raycast import Viewpoint
from homeward.lab.simulation.render.room.settings import RenderScenario
from homeward.lab.simulation.render.scene import tag_places
from homeward.registry import make_estimator
from homeward.vision.cameras.grey import as_grey
from homeward.vision.comparison import compare
from homeward.vision.features.detection import extract
from homeward.vision.opencv import opencv
from homeward.vision.tags.front_end import TagFrontEnd, family_of

MAX_SIGMAS = 4.0  # larger errors are counted [standard deviations]
CHI_SQUARE_MEDIAN = 0.4549  # with one degree of freedom
SPIN = 0.5  # yaw rate of home's rotation [rad/s]
FIRST_OF_SPIN = 1_000_000  # number of the first picture of home's rotation
TAGS = {"size": 0.2, "walls": 24}
AHEAD = {"width": 1280, "height": 640}
CAMERAS: dict[str, dict[str, Any]] = {
    "equirectangular": {"width": 1024, "height": 256},
    "cylindrical": {"width": 1024, "height": 256},
    "ring": {"width": 512, "height": 512},
    "fisheye": AHEAD | {"field_of_view": 3.2, "distortion": [-0.02, 0.01, -0.003, 0.0]},
    "pinhole": AHEAD | {"field_of_view": 2.0},
}
SMALL = {"width": 640, "height": 320}
FAR, TURNS = (0.3, 1.0), (0.0, 20.0, 40.0)
AHEAD_ONLY = ("fisheye", "pinhole")  # forward-looking, with tags


def scenario(number: int, camera: str, view: float | None) -> RenderScenario:
    """Return room number `number` for a camera, perhaps with a field of view [rad]."""
    tree = room_number(number, (1.0, 4.0), 3)
    tree["camera"] = {"projection": camera, "tilt_sigma": 0.01} | CAMERAS[camera]
    if camera in AHEAD_ONLY:
        tree["tags"] = TAGS
        if view is not None:
            tree["camera"]["field_of_view"] = view
    tree["rates"]["bearings"] = IMAGES_PER_S
    return validated(RenderScenario, tree)


@dataclass
class Homing:
    """Result of a homing."""

    name: str
    home: int  # number of home bearings
    ended: str = ""
    distance: float = math.inf
    errors: np.ndarray = field(default_factory=lambda: np.empty(0))  # of bearings on the way [rad]
    sigmas: np.ndarray = field(default_factory=lambda: np.empty(0))
    seeing: list[float] = field(default_factory=list)  # time of each picture in the front-end [s]
    plain: list[float] = field(default_factory=list)  # and in OpenCV's detector alone [s]


def turned_at_home(eye: Eye) -> dict[str, HomeBearing]:
    """Return the home bearings from a rotation on the spot at home, with rests around it."""
    course = eye.scenario
    front_end = TagFrontEnd(course.camera.known, course.tags.family)
    wheels, seconds = Wheels(course), math.tau / SPIN
    t = np.arange(-1.0, seconds + 1.0, 1.0 / course.rates.odometry)
    turns = np.where((t >= 0.0) & (t < seconds), SPIN, 0.0).tolist()
    v, omega = np.array([wheels.measure(Twist(0.0, turn)) for turn in turns]).T
    rows: list[tuple[float, str, float, float]] = []
    for k, stamp in enumerate(np.arange(t[0], t[-1], 1.0 / course.rates.bearings).tolist()):
        turned = SPIN * min(max(stamp, 0.0), seconds)
        seen = front_end.see(eye.home_picture(turned, FIRST_OF_SPIN + k))
        rows += [(stamp, name, b, seen.sigmas[name]) for name, b in seen.bearings.items()]
    settings = before(course, {}, None, course.view).settings
    return spin((t[0], t[-1]), Odometry(t, v, omega), Sightings.of_rows(rows), settings).home


def home_from(number: int, camera: str, view: float | None, turns: bool) -> Homing:
    opencv().setNumThreads(1)
    eye = Eye(scenario(number, camera, view))
    loop = ImageLoop(eye, home=turned_at_home(eye) if turns else None)
    done = Homing(f"{eye.scenario.name} {number // len(PLANS)}", len(loop.drive.home))
    places, views = landmarks(eye, loop), {}
    plain = plain_detection(eye)
    see = loop.front_end.see
    loop.front_end.see = partial(timed, done.seeing.append, see)  # type: ignore[method-assign]

    def keep(t: float, robot: Pose, picture: np.ndarray) -> None:
        views[t] = level_view(eye, robot, len(views) + 1)
        if len(views) % 10 == 1:
            timed(done.plain.append, plain, picture)

    try:
        made = loop.run(make_estimator("robust", loop.drive), keep)
    except InputError as error:
        done.ended = error.what
        return done
    done.ended, done.distance = made.ending.value, made.final_distance
    seen = made.drive.sightings
    rows = [k for k, name in enumerate(seen.landmark) if name in places]
    off = [seen.bearing[k] - azimuth(views[seen.t[k]], places[seen.landmark[k]]) for k in rows]
    done.errors, done.sigmas = np.asarray(wrap(np.array(off))), seen.sigma[rows]
    return done


def landmarks(eye: Eye, loop: ImageLoop) -> dict[str, np.ndarray]:
    """Return the positions of landmarks, (3,) [m]: tags, or features of static objects at home."""
    if isinstance(loop.front_end, TagFrontEnd):
        return {str(tag.number): tag.centre for tag in tag_places(eye.scenario, at_home=False)}
    home = loop.front_end.home
    place, went = feature_points(eye, home), moved_boxes(eye) | {*eye.scenario.movers}
    things = enumerate(things_seen(eye, home))
    return {f"h{k}": place[k] for k, thing in things if thing not in went}


def level_view(eye: Eye, robot: Pose, number: int) -> Viewpoint:
    """Return the position and frame of bearings.

    Those of tags are level except for an unknown tilt; those of features have home's tilt.
    """
    view = eye.view(robot, number)
    level = np.eye(3) if eye.scenario.tags is not None else eye.home_view.rotation
    turned = level.T @ view.rotation
    heading = math.atan2(turned[1, 0], turned[0, 0])
    if eye.scenario.tags is not None:  # the heading of the robot itself
        heading = eye.scenario.home.heading + robot.heading + eye.scenario.sensor.yaw
    c, s = math.cos(heading), math.sin(heading)
    return Viewpoint(view.position, level @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]))


def azimuth(view: Viewpoint, place: np.ndarray) -> float:
    x, y, _ = (place - view.position) @ view.rotation
    return math.atan2(y, x)


def plain_detection(eye: Eye) -> Callable[[np.ndarray], object]:
    cv2 = opencv()
    if eye.scenario.tags is None:
        sift = cv2.SIFT_create(nfeatures=5000, contrastThreshold=0.02)
        return lambda picture: sift.detectAndCompute(as_grey(picture), None)
    detector = cv2.aruco.ArucoDetector(family_of(eye.scenario.tags.family))
    return lambda picture: detector.detectMarkers(as_grey(picture))


def print_overlaps(rooms: int, view: float | None) -> None:
    """Print how often and how accurately a lens without tags recognises home's picture."""
    for camera in AHEAD_ONLY:
        for far in FAR:
            for turn in TURNS:
                seen = [s for k in range(rooms) if (s := overlap(k, camera, view, far, turn))]
                words = f"{camera}, {far:g} m away, rotated {turn:g} deg: {len(seen)} of {rooms}"
                if seen:
                    direction, heading, nees = np.abs(seen).T
                    words += f"; median error of heading {np.median(heading):.2f} deg, direction "
                    words += f"{np.median(direction):.1f}; worst {heading.max():.2f} and "
                    words += f"{direction.max():.0f}; NEES {nees.mean():.1f}"
                print(words, flush=True)


def overlap(
    number: int, camera: str, view: float | None, far: float, turn: float
) -> tuple[float, float, float] | None:
    """Return errors as of `motion_errors`, or None if home is not recognised.

    The camera is at a distance of `far` [m] from home in any direction, rotated by `turn` [deg].
    """
    made = scenario(number, camera, view)
    changes = {"tags": None, "camera": made.camera.model_copy(update=SMALL)}
    eye = Eye(made.model_copy(update=changes))
    wide, rng = panorama_of(eye), np.random.default_rng(number)
    now_picture = None
    while now_picture is None:
        theta = rng.uniform(-math.pi, math.pi)
        robot = Pose(far * math.cos(theta), far * math.sin(theta), math.radians(turn))
        with suppress(InputError):  # an object is in the way
            now_picture = eye.look(0.0, robot, 1)
    pictures = eye.home_picture(), now_picture
    home, now = (extract(wide.panorama(picture), wide, wide.seen) for picture in pictures)
    seen = compare(home, now, wide)
    return motion_errors(seen, robot) if seen.accepted else None


def main() -> None:
    asked = monte_carlo.parsed(
        __doc__, camera=CAMERAS, homings=10, view=float, spin=False, overlaps=int
    )
    if asked.overlaps:
        print_overlaps(asked.overlaps, asked.view)
        return
    for camera in asked.camera:
        turns = asked.spin and camera in AHEAD_ONLY
        drive = partial(home_from, camera=camera, view=asked.view, turns=turns)
        done = []
        for one in in_processes(drive, range(asked.homings)):
            done.append(one)
            print(
                f"  {one.name:16} {one.home:3d} landmarks at home, {100 * one.distance:6.2f} "
                f"cm ({one.ended}), {one.errors.size:5d} bearings",
                flush=True,
            )
        print(summary(camera, done), flush=True)


def summary(camera: str, done: list[Homing]) -> str:
    distance = np.array([one.distance for one in done])
    errors, sigmas, seeing, plain = (
        np.concatenate([getattr(one, key) for one in done])
        for key in ("errors", "sigmas", "seeing", "plain")
    )
    off, square = np.degrees(np.abs(errors)), (errors / sigmas) ** 2
    return (
        f"{camera}: {np.sum(distance < MAX_END_M)} of {len(done)} within {100 * MAX_END_M:g} cm, "
        f"median {100 * np.median(distance):.1f} cm; errors of {off.size} bearings: median "
        f"{np.median(off):.4f} deg, 95 % {np.quantile(off, 0.95):.4f} deg; NEES {square.mean():.2f}"
        f", median {np.median(square) / CHI_SQUARE_MEDIAN:.2f}, beyond {MAX_SIGMAS:g} sigma "
        f"{np.mean(square > MAX_SIGMAS**2):.2%}; per picture {1e3 * np.median(seeing):.0f} ms, "
        f"OpenCV alone {1e3 * np.median(plain):.0f} ms"
    )


if __name__ == "__main__":
    main()
