"""Homing by tags that a forward camera sees in rendered rooms: pixels in, home reached.

    python -m benchmarks.tags --homings 20

Every room that comes with homeward in turn, furnished by the seed, with tags on its boxes and round
its walls. The camera looks ahead (115 degrees, 1280x640), the heading at the start is not known,
three boxes were moved with their tags since home was stored, someone walks through, and home is one
picture. A homing is good when it ends within 2 cm. Bearings are compared with where the tags hang:
their errors, and their NEES, which is 1 where deviations are honest.
"""

from __future__ import annotations

import argparse
import math
import time
from dataclasses import dataclass
from multiprocessing import Pool

import numpy as np

from benchmarks.render import room_number
from homeward.angles import wrap
from homeward.drives.text.settings import validated
from homeward.errors import InputError
from homeward.frames import compose
from homeward.registry import make_estimator
from homeward.simulation.render.eye import Eye
from homeward.simulation.render.loop import ImageLoop
from homeward.simulation.render.room.presets import PLANS
from homeward.simulation.render.room.settings import RenderScenario
from homeward.simulation.render.scene import tag_places

NEAR_HOME = 0.02
"""A homing is good when it ends this near [m]."""
CAMERA = {"projection": "pinhole", "width": 1280, "height": 640, "field_of_view": 2.0}
"""With 1.4 rad the localiser maps too few of the tags in its first arc, of 0.5 m round: 3 of 3 such
robots drove into something before they knew where home is."""
TAGS = {"size": 0.2, "walls": 24}


def scenario(number: int) -> RenderScenario:
    """Room number `number`."""
    tree = room_number(number, (1.0, 4.0), 3)
    tree["camera"], tree["tags"] = CAMERA, TAGS
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


def home_from(number: int) -> Homing:
    """Drive home in room number `number`."""
    began, eye = time.process_time(), Eye(scenario(number))
    loop = ImageLoop(eye)
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
    asked = parser.parse_args()
    done = []
    with Pool(2) as pool:
        for one in pool.imap(home_from, range(asked.first, asked.first + asked.homings)):
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
