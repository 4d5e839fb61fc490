"""Advice on the horizon: how often it is false on right settings, and given on wrong ones.

`python -m benchmarks.horizon [--pairs 1000] [--wrong 100] [--seed 0]` draws panoramas of random
rooms from random places, near home to across the room, and compares each with home's: with the
right horizon, and cut above or below so that the horizon is elsewhere.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

from homeward.vision.cameras.panoramic import Equirectangular
from homeward.vision.checks.camera_settings import better_settings
from homeward.vision.comparison import compare
from homeward.vision.features.detection import look

sys.path.append(str(Path(__file__).parents[1] / "tests" / "vision"))
from vision_scene import Room, make_room
from vision_scene import look as draw

PER_ROOM = 10
CUT = 0.62
"""Share of the height that is left of a cut panorama."""


def pair(room: Room, rng: np.random.Generator) -> list[np.ndarray]:
    """Return home's panorama and another from 0.02 to 3 m away."""
    home = rng.uniform((2.5, 2.0), (5.5, 4.0))
    far, way = 10.0 ** rng.uniform(-1.7, 0.48), rng.uniform(-np.pi, np.pi)
    there = np.clip(home + far * np.array([np.cos(way), np.sin(way)]), (0.5, 0.5), (7.5, 5.5))
    places = [(*home, rng.uniform(-3, 3)), (*there, rng.uniform(-3, 3))]
    return [draw(room, *place, seed=int(rng.integers(2**31))) for place in places]


def advice(pictures: list[np.ndarray]) -> tuple[bool, str | None]:
    """Return whether two panoramas were matched, and the advice."""
    camera = Equirectangular()
    greys = [camera.panorama(picture) for picture in pictures]
    views = look(greys[0], camera), look(greys[1], camera)
    seen = compare(*views, camera)
    return seen.accepted, better_settings(seen, (greys[0], greys[1]), views, camera)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pairs", type=int, default=1000)
    parser.add_argument("--wrong", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    false = matched = 0
    reported = {"cut below": 0, "cut above": 0}
    for k in range(max(options.pairs, options.wrong)):
        rng = np.random.default_rng([k, options.seed])
        pictures = pair(make_room(1000 * options.seed + k // PER_ROOM), rng)
        if k < options.pairs:
            accepted, words = advice(pictures)
            matched += accepted
            if words is not None:
                false += 1
                print(f"pair {k}: {words}")
        if k < options.wrong:
            rows = int(CUT * len(pictures[0]))
            reported["cut below"] += advice([p[:rows] for p in pictures])[1] is not None
            reported["cut above"] += advice([p[-rows:] for p in pictures])[1] is not None
    print(f"right horizon: {options.pairs} pairs, {matched} matched, {false} with false advice")
    for name, count in reported.items():
        print(f"wrong horizon, {name}: advice on {count} of {options.wrong} pairs")


if __name__ == "__main__":
    main()
