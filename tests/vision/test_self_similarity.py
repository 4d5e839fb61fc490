"""Tiled floors look alike in all rooms that have them: they alone make no two rooms one."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("cv2")

import cv2
from test_geometry import SIGMA, made_up
from vision_scene import look as draw
from vision_scene import make_room

from benchmarks.rooms import room
from homeward.geometry.angles import wrap
from homeward.lab.simulation.render.drive import Eye
from homeward.vision import Equirectangular, compare, extract
from homeward.vision.features.matching import self_similar, thinned
from homeward.vision.geometry.a_contrario import assess, assess_unrepeated
from homeward.vision.geometry.epipolar import Motion
from homeward.vision.geometry.ransac import estimate_motion

CAMERA = Equirectangular()
TILED = ("kitchen", 2), ("corridor", 0), ("hall", 1)


def seen_in(name, seed):
    """Return the eye in a room, and what home and start look like: large pictures."""
    made = room(name, seed, distance=(0.5, 2.0), moved=0)
    camera = made.camera.model_copy(update={"width": 2048, "height": 512})
    eye = Eye(made.model_copy(update={"camera": camera}))
    start = eye.scenario.start.in_home_frame(eye.scenario.home.pose)
    home, now = (extract(p, CAMERA) for p in (eye.home_picture(), eye.look(0.0, start, 1)))
    return start.heading, home, now


@pytest.fixture(scope="module")
def tiled():
    return [seen_in(*which) for which in TILED]


def test_rooms_with_the_same_tiles_have_not_enough_in_common(tiled):
    for i, (_, home, _) in enumerate(tiled):
        for j, (_, _, now) in enumerate(tiled):
            assert i == j or not compare(home, now, CAMERA).accepted, (i, j)


def test_a_tiled_room_is_known_by_what_else_is_in_it(tiled):
    for heading, home, now in tiled:
        seen = compare(home, now, CAMERA)
        assert seen.accepted, seen.acceptance.reason
        assert seen.has_direction
        assert abs(wrap(seen.heading - heading)) < 0.01


def test_tiles_recur_and_furniture_does_not(tiled):
    for _, home, _ in tiled:
        tiles = thinned(np.flatnonzero(home.elevation < np.radians(-20)), 50)
        others = thinned(np.flatnonzero(home.elevation > 0), 50)
        assert self_similar(home, tiles, CAMERA).mean() > 0.8
        assert self_similar(home, others, CAMERA).mean() < 0.3


def painted(at, times):
    """Return a bare room whose floor or ceiling is a painting, repeated several times each way."""
    bare = make_room(5, boxes=0)
    cells = np.random.default_rng(0).uniform(20, 240, (60 // times, 80 // times))
    painting = cv2.resize(np.tile(cells, (times, times)), (480, 360), interpolation=cv2.INTER_CUBIC)
    bare.faces = [
        (axis, end, painting.astype(np.float32) if (axis, end) == (2, at) else 0 * image + 150)
        for axis, end, image in bare.faces
    ]
    return bare


def test_a_ceiling_recurs_where_its_painting_does():
    view = extract(draw(painted(2.8, 4), 4.0, 3.0, 0.3, width=1024, height=512), CAMERA)
    overhead = thinned(np.flatnonzero(view.elevation > np.radians(40)), 50)
    assert len(overhead) == 50
    assert self_similar(view, overhead, CAMERA).mean() > 0.8


def test_a_painted_floor_alone_is_known_again_where_it_is_painted_but_once():
    floor = painted(0.0, 1)
    places = (3.0, 3.0, 0.4), (3.6, 3.1, 1.4)
    home, now = (extract(draw(floor, *p, width=1024, height=512), CAMERA) for p in places)
    seen = compare(home, now, CAMERA)
    assert seen.accepted, seen.acceptance.reason
    assert abs(wrap(seen.heading - 1.0)) < 0.02


def test_nothing_to_ask_and_nothing_to_compare_with():
    plain = extract(np.full((128, 512), 90, np.uint8), CAMERA)
    assert self_similar(plain, np.zeros(0, int), CAMERA).shape == (0,)


@pytest.mark.parametrize(("repeated", "accepted"), [(0, True), (14, True), (24, True), (36, False)])
def test_where_much_repeats_itself_the_others_must_be_enough(repeated, accepted):
    pairs = made_up(Motion(1.0, 0.8), n=40, seed=0, noise=SIGMA)
    fit = estimate_motion(pairs, np.ones(40), 0.005)
    fit = replace(fit, inlier=np.ones(40, bool))
    acceptance = assess(fit, pairs)
    assert acceptance.accepted
    rows = np.random.default_rng(1).permutation(40)
    found = assess_unrepeated(acceptance, fit, pairs, rows, np.arange(40) < repeated)
    assert found.accepted == accepted
    assert ("repeating patterns" in found.reason) != accepted
    assert "40 of 40 matches agree" in found.reason
