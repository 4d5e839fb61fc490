"""Every camera from pixels to home in rendered rooms: bearings, their deviations, homing, speed.

    python -m benchmarks.cameras --homings 3
    python -m benchmarks.cameras --camera pinhole --homings 10 --view 1.4 --spin

Every room that comes with homeward in turn, furnished by the seed. The heading at the start is not
known, three boxes were moved since home was stored (with their tags), someone walks through, and
each picture is tilted by 0.01 rad. Home is one picture, or with `--spin` a turn on the spot, which
a camera needs that looks ahead. A homing is good when it ends within 2 cm. Bearings are compared
with where the tags hang, and those of features with the point that home's picture shows there:
their errors, and their NEES, which is 1 where deviations are honest.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from multiprocessing import Pool
from typing import Any

import numpy as np

from benchmarks.render import room_number
from homeward.drives.cameras.camera import unit_vectors
from homeward.drives.drive import HomeBearing, Odometry, Sightings
from homeward.drives.home.spin import spin
from homeward.errors import InputError
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose, Twist
from homeward.io.settings import validated
from homeward.lab.simulation.course import Wheels, before
from homeward.lab.simulation.render.drive import Eye, ImageLoop, panorama_of, things_seen
from homeward.lab.simulation.render.rays.raycast import Viewpoint, points, trace
from homeward.lab.simulation.render.room.presets import PLANS
from homeward.lab.simulation.render.room.settings import RenderScenario
from homeward.lab.simulation.render.scene import tag_places
from homeward.registry import make_estimator
from homeward.vision.cameras.grey import as_grey
from homeward.vision.comparison import compare
from homeward.vision.features.detection import extract
from homeward.vision.opencv import opencv
from homeward.vision.tags.front_end import TagFrontEnd, family_of

NEAR_HOME = 0.02
"""A homing is good when it ends this near [m]."""
FAR_OFF = 4.0
"""Errors are counted beyond so many standard deviations."""
HALF_OF_SQUARES = 0.4549
"""Median of chi-square with one degree of freedom."""
SPIN = 0.5
"""Home's turn [rad/s]."""
FIRST_OF_SPIN = 1_000_000
"""Pictures of home's turn are numbered from here."""
TILT, IMAGES_PER_S = 0.01, 2.5
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
AHEAD_ONLY = ("fisheye", "pinhole")
"""These see tags."""


def scenario(number: int, camera: str, view: float | None) -> RenderScenario:
    """Return room number `number` for a camera, with so much of a view [rad]."""
    tree = room_number(number, (1.0, 4.0), 3)
    tree["camera"] = {"projection": camera, "tilt_sigma": TILT} | CAMERAS[camera]
    if camera in AHEAD_ONLY:
        tree["tags"] = TAGS
        if view is not None:
            tree["camera"]["field_of_view"] = view
    tree["rates"]["bearings"] = IMAGES_PER_S
    return validated(RenderScenario, tree)


@dataclass
class Homing:
    """What a homing came to."""

    name: str
    home: int
    """Landmarks that home saw."""
    ended: str = ""
    distance: float = math.inf
    errors: np.ndarray = field(default_factory=lambda: np.empty(0))
    """Of bearings on the way [rad]."""
    sigmas: np.ndarray = field(default_factory=lambda: np.empty(0))
    seeing: list[float] = field(default_factory=list)
    """Time of each picture in the front-end [s]."""
    plain: list[float] = field(default_factory=list)
    """And in OpenCV's detector alone [s]."""


def turned_at_home(eye: Eye) -> dict[str, HomeBearing]:
    """Return what a turn on the spot at home, a rest before and after it, tells of home."""
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
    """Drive home in room number `number`."""
    opencv().setNumThreads(1)
    eye = Eye(scenario(number, camera, view))
    loop = ImageLoop(eye, home=turned_at_home(eye) if turns else None)
    done = Homing(f"{eye.scenario.name} {number // len(PLANS)}", len(loop.drive.home))
    places, views = landmarks(eye, loop), {}
    plain = plain_detection(eye)
    see = loop.front_end.see
    loop.front_end.see = partial(timed, done.seeing, see)  # type: ignore[method-assign]

    def keep(t: float, robot: Pose, picture: np.ndarray) -> None:
        views[t] = level_view(eye, robot, len(views) + 1)
        if len(views) % 10 == 1:
            timed(done.plain, plain, picture)

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
    """Return where landmarks are now, (3,) [m]: tags, or features of home on what stayed."""
    if isinstance(loop.front_end, TagFrontEnd):
        return {str(tag.number): tag.centre for tag in tag_places(eye.scenario, at_home=False)}
    home, view = loop.front_end.home, eye.home_view
    rays = unit_vectors(home.azimuth, home.elevation)
    surfaces, _ = eye.then.at(eye.scenario.home_time, view)
    place = points(trace(surfaces, view, rays), view, rays)
    boxes, things = eye.scenario.boxes, things_seen(eye, home)
    went = {name for name, box in boxes.items() if box.stood is not None} | {*eye.scenario.movers}
    return {f"h{k}": place[k] for k, thing in enumerate(things) if thing not in went}


def level_view(eye: Eye, robot: Pose, number: int) -> Viewpoint:
    """Return where bearings are taken from, and in which frame they are.

    Those of tags are level, but for what is not known; those of features are as level as home's.
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
    """Return the azimuth at which a place lies [rad]."""
    x, y, _ = (place - view.position) @ view.rotation
    return math.atan2(y, x)


def plain_detection(eye: Eye) -> Callable[[np.ndarray], object]:
    """Return what OpenCV alone would do with a picture."""
    cv2 = opencv()
    if eye.scenario.tags is None:
        sift = cv2.SIFT_create(nfeatures=5000, contrastThreshold=0.02)
        return lambda picture: sift.detectAndCompute(as_grey(picture), None)
    detector = cv2.aruco.ArucoDetector(family_of(eye.scenario.tags.family))
    return lambda picture: detector.detectMarkers(as_grey(picture))


def timed(times: list[float], call: Callable[[np.ndarray], Any], picture: np.ndarray) -> Any:
    """Return what a call makes of a picture, its processor time put down."""
    began = time.process_time()
    made = call(picture)
    times.append(time.process_time() - began)
    return made


def print_overlaps(rooms: int, view: float | None) -> None:
    """Print how often a lens without tags knows home's picture again, and how well."""
    for camera in AHEAD_ONLY:
        for far in FAR:
            for turn in TURNS:
                seen = [s for k in range(rooms) if (s := overlap(k, camera, view, far, turn))]
                words = f"{camera}, {far:g} m off, turned {turn:g} deg: {len(seen)} of {rooms}"
                if seen:
                    heading, direction, nees = np.abs(seen).T
                    words += f"; heading {np.median(heading):.2f} deg, direction "
                    words += f"{np.median(direction):.1f}, at worst {heading.max():.2f} and "
                    words += f"{direction.max():.0f}; NEES {nees.mean():.1f}"
                print(words, flush=True)


def overlap(
    number: int, camera: str, view: float | None, far: float, turn: float
) -> tuple[float, float, float] | None:
    """Return errors of heading and direction [deg], and their NEES; None where home is not known.

    The camera is `far` [m] from home, on any side of it, and turned by so much [deg].
    """
    made = scenario(number, camera, view)
    changes = {"tags": None, "camera": made.camera.model_copy(update=SMALL)}
    eye = Eye(made.model_copy(update=changes))
    wide, rng = panorama_of(eye), np.random.default_rng(number)
    now_picture = None
    while now_picture is None:
        theta = rng.uniform(-math.pi, math.pi)
        robot = Pose(far * math.cos(theta), far * math.sin(theta), math.radians(turn))
        with suppress(InputError):  # something stands there
            now_picture = eye.look(0.0, robot, 1)
    pictures = eye.home_picture(), now_picture
    home, now = (extract(wide.panorama(picture), wide, wide.seen) for picture in pictures)
    seen = compare(home, now, wide)
    if not seen.accepted:
        return None
    error = wrap(np.array([seen.direction - theta, seen.heading - robot.heading]))
    nees = float(error @ np.linalg.solve(seen.covariance, error))
    direction, heading = np.degrees(error).tolist()
    return heading, direction, nees


def main() -> None:
    """Print a line a homing, and one for each camera."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--camera", nargs="*", choices=CAMERAS, default=[*CAMERAS])
    parser.add_argument("--homings", type=int, default=10)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--view", type=float, help="of a camera that looks ahead [rad]")
    parser.add_argument("--spin", action="store_true", help="such a one's home is a turn")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--overlaps", type=int, help="rooms; pictures of lenses without tags")
    asked = parser.parse_args()
    if asked.overlaps:
        print_overlaps(asked.overlaps, asked.view)
        return
    for camera in asked.camera:
        turns = asked.spin and camera in AHEAD_ONLY
        drive = partial(home_from, camera=camera, view=asked.view, turns=turns)
        done = []
        with Pool(asked.processes) as pool:
            for one in pool.imap(drive, range(asked.first, asked.first + asked.homings)):
                done.append(one)
                print(
                    f"  {one.name:16} {one.home:3d} landmarks at home, {100 * one.distance:6.2f} "
                    f"cm ({one.ended}), {one.errors.size:5d} bearings",
                    flush=True,
                )
        print(summary(camera, done), flush=True)


def summary(camera: str, done: list[Homing]) -> str:
    """Return in words what the homings of one camera came to."""
    distance = np.array([one.distance for one in done])
    errors, sigmas, seeing, plain = (
        np.concatenate([getattr(one, key) for one in done])
        for key in ("errors", "sigmas", "seeing", "plain")
    )
    off, square = np.degrees(np.abs(errors)), (errors / sigmas) ** 2
    return (
        f"{camera}: {np.sum(distance < NEAR_HOME)} of {len(done)} within {100 * NEAR_HOME:g} cm, "
        f"median {100 * np.median(distance):.1f} cm; {off.size} bearings: median "
        f"{np.median(off):.4f} deg, 95 % {np.quantile(off, 0.95):.4f} deg; NEES {square.mean():.2f}"
        f", median {np.median(square) / HALF_OF_SQUARES:.2f}, beyond {FAR_OFF:g} sigma "
        f"{np.mean(square > FAR_OFF**2):.2%}; a picture {1e3 * np.median(seeing):.0f} ms, "
        f"OpenCV alone {1e3 * np.median(plain):.0f} ms"
    )


if __name__ == "__main__":
    main()
