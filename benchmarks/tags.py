"""Homing by tags that a forward camera sees in rendered rooms: pixels in, home reached.

    python -m benchmarks.tags --homings 20
    python -m benchmarks.tags --homings 10 --view 1.4 --spin

Every room that comes with homeward in turn, furnished by the seed, with tags on its boxes and round
its walls. The camera looks ahead (115 degrees, 1280x640), the heading at the start is not known,
three boxes were moved with their tags since home was stored, someone walks through, and home is one
picture, or with `--spin` a turn on the spot. A homing is good when it ends within 2 cm. Bearings
are compared with where the tags hang: their errors, and their NEES, which is 1 where deviations are
honest.
"""

from __future__ import annotations

import argparse
import math
import time
from dataclasses import dataclass
from functools import partial
from multiprocessing import Pool

import numpy as np

from benchmarks.render import room_number
from homeward.angles import wrap
from homeward.control import Twist
from homeward.drives.drive import HomeBearing, Odometry, Sightings
from homeward.drives.home.spin import spin
from homeward.drives.text.settings import validated
from homeward.errors import InputError
from homeward.frames import compose
from homeward.registry import make_estimator
from homeward.simulation.course import before
from homeward.simulation.render.eye import Eye
from homeward.simulation.render.loop import ImageLoop, camera_of
from homeward.simulation.render.room.presets import PLANS
from homeward.simulation.render.room.settings import RenderScenario
from homeward.simulation.render.scene import tag_places
from homeward.simulation.sensing import Wheels
from homeward.vision.tags.front_end import TagFrontEnd

NEAR_HOME = 0.02
"""A homing is good when it ends this near [m]."""
CAMERA = {"projection": "pinhole", "width": 1280, "height": 640}
SPIN = 0.5
"""Home's turn [rad/s]."""
FIRST_OF_SPIN = 1_000_000
"""Pictures of home's turn are numbered from here."""
TAGS = {"size": 0.2, "walls": 24}


def scenario(number: int, view: float = 2.0) -> RenderScenario:
    """Room number `number`, for a camera with so much of a view [rad]."""
    tree = room_number(number, (1.0, 4.0), 3)
    tree["camera"], tree["tags"] = CAMERA | {"field_of_view": view}, TAGS
    tree["rates"]["bearings"] = 2.5
    return validated(RenderScenario, tree)


@dataclass
class Homing:
    """What a homing came to."""

    name: str
    ended: str
    distance: float
    home: int
    """Tags that home saw."""
    errors: np.ndarray
    """Of all bearings on the way [rad]."""
    sigmas: np.ndarray
    took: float
    """Computing [s]."""


def turned_at_home(eye: Eye) -> dict[str, HomeBearing]:
    """Return what a turn on the spot at home, a rest before and after it, tells of home."""
    course, front_end = eye.scenario, TagFrontEnd(camera_of(eye), eye.scenario.tags.family)
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


def home_from(number: int, view: float, turns: bool) -> Homing:
    """Drive home in room number `number`."""
    began, eye = time.process_time(), Eye(scenario(number, view))
    loop = ImageLoop(eye, home=turned_at_home(eye) if turns else None)
    home = len(loop.drive.home)
    name = f"{eye.scenario.name} {number // len(PLANS)}"
    nothing = np.empty(0)
    try:
        made = loop.run(make_estimator("robust", loop.drive))
    except InputError as error:
        took = time.process_time() - began
        return Homing(name, error.what, math.inf, home, nothing, nothing, took)
    hung = {str(tag.number): tag.centre for tag in tag_places(eye.scenario, at_home=False)}
    seen, truth = made.drive.sightings, made.drive.truth
    camera = compose(compose(eye.scenario.home.pose, truth.at(seen.t)), eye.scenario.sensor.pose)
    at = np.array([hung[name] for name in seen.landmark]).reshape(-1, 3)
    true = np.arctan2(at[:, 1] - camera.y, at[:, 0] - camera.x) - camera.heading
    took = time.process_time() - began
    errors = np.asarray(wrap(seen.bearing - true))
    return Homing(name, made.ending.value, made.final_distance, home, errors, seen.sigma, took)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--homings", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--view", type=float, default=2.0, help="of the camera [rad]")
    parser.add_argument("--spin", action="store_true", help="home is a turn, not a picture")
    parser.add_argument("--processes", type=int, default=2)
    asked = parser.parse_args()
    done = []
    drive = partial(home_from, view=asked.view, turns=asked.spin)
    with Pool(asked.processes) as pool:
        for one in pool.imap(drive, range(asked.first, asked.first + asked.homings)):
            done.append(one)
            print(
                f"{one.name:16} {one.home:3d} tags at home, {100 * one.distance:6.2f} cm "
                f"({one.ended}), {one.errors.size:5d} bearings, {one.took:4.0f} s",
                flush=True,
            )
    good = sum(one.distance < NEAR_HOME for one in done)
    print(f"{good} of {len(done)} homings within {100 * NEAR_HOME:g} cm")
    errors, sigmas = (np.concatenate([getattr(o, k) for o in done]) for k in ("errors", "sigmas"))
    off = np.degrees(np.abs(errors))
    print(
        f"bearings: median {np.median(off):.4f} deg, 95 % {np.quantile(off, 0.95):.4f} deg, RMS "
        f"{np.sqrt(np.mean(off**2)):.4f} deg; NEES {np.mean((errors / sigmas) ** 2):.2f}, median "
        f"{np.median((errors / sigmas) ** 2) / 0.4549:.2f}"
    )


if __name__ == "__main__":
    main()
