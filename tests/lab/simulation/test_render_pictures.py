"""Rendered pictures: what they show, that they repeat, and what a room refuses."""

import math
import re
from pathlib import Path

import numpy as np
import pytest
import yaml
from rooms import scenario
from shapely import Polygon, contains_xy

from benchmarks.rooms import PLANS, room
from homeward.errors import InputError
from homeward.geometry.frames import Pose, Twist, advance, bearing, compose
from homeward.io.settings import validated
from homeward.lab.simulation.render.drive import Eye
from homeward.lab.simulation.render.rays.surfaces import footprint
from homeward.lab.simulation.render.room.boxes import with_boxes
from homeward.lab.simulation.render.room.settings import RenderScenario, load_room
from homeward.lab.simulation.render.shading.textures import (
    KINDS,
    LEVELS,
    PAD,
    Texture,
    build_atlas,
    paint,
)
from homeward.lab.simulation.trajectories import SEARCH_RADIUS

cv2 = pytest.importorskip("cv2", reason="pictures need the extra `vision`")
HERE = Pose(0.5, 0.3, 1.0)


def crate(**changes):
    return {"crate": {"at": [4.0, 2.0], "size": [0.6, 0.6, 0.9]} | changes}


def test_a_box_is_seen_where_it_stands_and_home_saw_it_where_it_stood():
    eye = Eye(scenario(boxes=crate(stood={"at": [2.0, 3.5]})))
    index = eye.now.things.index("crate")
    for things, place in (
        (eye.home_things(), Pose(0.0, 0.0, 0.0)),
        (eye.things(HERE, 1), HERE),
    ):
        columns = np.flatnonzero((things == index).any(axis=0))
        middle = math.pi - 2 * math.pi * (columns.mean() + 0.5) / 128
        local = (0.0, 1.5) if place is not HERE else (2.0, 0.0)
        assert middle == pytest.approx(float(bearing(place, *local)), abs=0.05)


def test_a_picture_changes_at_the_crate_alone_when_the_crate_moves():
    camera = {"width": 256, "height": 64, "noise": 0.0, "exposure_sigma": 0.0}
    there = Eye(scenario(boxes=crate(), camera=camera))
    gone = Eye(scenario(boxes=crate(at=[4.0, 3.4]), camera=camera))
    crates = [
        (eye.things(HERE, 1) == eye.now.things.index("crate")).any(axis=0) for eye in (there, gone)
    ]
    a, b = (eye.look(0.0, HERE, 1).astype(float) for eye in (there, gone))
    away = ~(crates[0] | crates[1])
    # The exposure changes a little all over.
    assert np.median(abs(a - b)[:, away]) <= 2
    assert np.median(abs(a - b)[:, crates[0]].max(axis=0)) > 15


def test_pictures_repeat_and_differ_only_by_noise():
    made = scenario(camera={"width": 128, "height": 32, "noise": 2.0})
    first, again = Eye(made).look(1.0, HERE, 4), Eye(made).look(1.0, HERE, 4)
    np.testing.assert_array_equal(first, again)
    other = Eye(made).look(1.0, HERE, 5)
    spread = (first.astype(float) - other).std()
    assert 2.0 < spread < 4.5
    seeded = Eye(made.model_copy(update={"seed": 1})).look(1.0, HERE, 4)
    assert np.any(seeded != first)


def test_the_seam_is_not_seen():
    """A picture turned by half the image shows across its seam what the other shows inside."""
    eye = Eye(scenario(boxes=crate()))
    ahead = eye.look(0.0, HERE, 1)
    back = eye.look(0.0, Pose(HERE.x, HERE.y, HERE.heading + math.pi), 1)
    difference = np.abs(np.roll(ahead, 64, axis=1).astype(int) - back)
    assert difference.max() <= 2


def test_edges_are_smoothed():
    """An edge at half a pixel has the grey between its sides."""
    eye = Eye(scenario(boxes=crate(texture="cardboard"), camera={"width": 512, "height": 32}))
    wide = Eye(scenario(boxes=crate(texture="cardboard"), camera={"width": 2048, "height": 128}))
    small, large = (e.look(0.0, HERE, 1).astype(float) for e in (eye, wide))
    shrunk = large.reshape(32, 4, 512, 4, 3).mean(axis=(1, 3))
    assert np.quantile(abs(small - shrunk), 0.99) < 12


@pytest.mark.parametrize("kind", KINDS)
def test_textures_repeat_without_a_seam(kind):
    tile = paint(Texture(kind, 3))
    inner = np.abs(np.diff(tile, axis=1)).mean(axis=(0, 2))
    seam = np.abs(tile[:, 0] - tile[:, -1]).mean()
    if kind != "print":  # a poster is shown once, with a frame round it
        assert seam <= inner.max() + 1e-6
    assert tile.min() >= 0.0
    assert tile.max() <= 1.0


def test_mip_levels_keep_the_mean():
    texture = Texture("cardboard", 5)
    atlas, mean = build_atlas((texture,)), paint(texture).mean()
    for level in range(LEVELS):
        n = paint(texture).shape[0] >> level
        x, y = int(atlas.left[0, level]), int(atlas.top[0, level])
        tile = atlas.image[y : y + n, x : x + n]
        assert tile.mean() / 255 == pytest.approx(mean, abs=0.005)
        # Across its edges a tile goes on as at the other side, both ways.
        np.testing.assert_array_equal(atlas.image[y : y + n, x - PAD : x], tile[:, -PAD:])
        np.testing.assert_array_equal(atlas.image[y + n : y + n + PAD, x : x + n], tile[:PAD])


@pytest.mark.parametrize("name", PLANS)
@pytest.mark.parametrize("seed", [0, 1])
def test_rooms_hold_what_they_say_and_leave_the_way_free(name, seed):
    made = room(name, seed)
    on_floor = [box for box in made.boxes.values() if box.base == 0]
    assert len(on_floor) == PLANS[name].boxes
    assert len(made.boxes) == PLANS[name].boxes + PLANS[name].pictures
    assert sum(box.stood is not None for box in on_floor) == 3
    home = made.home.pose
    start = compose(home, made.start.in_home_frame(home))
    for share in np.linspace(0, 1, 11):
        x, y = home.x + share * (start.x - home.x), home.y + share * (start.y - home.y)
        assert contains_xy(made.room.polygon, x, y)
        for box in on_floor:
            for stand in (box, box.stood or box):
                base = Polygon(footprint(stand.at, stand.yaw, box.size[:2]))
                assert not contains_xy(base, x, y)
                assert math.hypot(stand.at[0] - x, stand.at[1] - y) > 0.6
    for turned in np.linspace(0, 2 * math.pi, 30):
        on_arc = advance(start, Twist(0.1, 0.1 / SEARCH_RADIUS), turned * SEARCH_RADIUS / 0.1)
        for box in on_floor:
            size = (box.size[0] + 0.3, box.size[1] + 0.3)
            base = Polygon(footprint(box.at, box.yaw, size))
            assert not contains_xy(base, on_arc.x, on_arc.y)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"room": {"outline": [[0, 0], [4, 4], [4, 0], [0, 4]]}}, "cross"),
        ({"room": {"outline": [[0, 0], [4, 0]]}}, "outline"),
        ({"room": {"outline": [[0, 0], [0, 0], [4, 0], [4, 4]]}}, "are equal"),
        ({"room": {"outline": [[0, 0], [6, 0], [6, 4], [0, 4]], "walls": "gold"}}, "walls"),
        ({"room": {"outline": [[0, 0], [6, 0], [6, 4]], "height": float("nan")}}, "height"),
        ({"home": {"x": 9.0, "y": 2.0}}, "home: outside"),
        ({"camera": {"width": 100000}}, "width"),
        ({"camera": {"width": 128, "height": 128}}, "height"),
        ({"camera": {"above_floor": 3.0}}, "ceiling"),
        ({"boxes": {"b": {"at": [1, 1], "size": [0, 1, 1]}}}, "boxes.b.size"),
        ({"boxes": {"floor": {"at": [1, 1], "size": [1, 1, 1]}}}, "room has this name"),
        ({"trajectory": {"kind": "waypoints", "points": [[7, 7]]}}, "points.0: outside"),
        ({"trajectory": {"kind": "teach", "points": [[7, 7]]}}, "points.0: outside"),
        ({"trajectory": {"kind": "repeat", "place": "p", "route": "r"}}, "repeats no route"),
        ({"spam": 1}, "spam"),
    ],
)
def test_hostile_rooms_are_refused_in_one_line(changes, words):
    with pytest.raises(InputError, match=words) as caught:
        Eye(scenario(**changes))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("numbers", "words"),
    [((100, 0), "no place for"), ((0, 100), "no place for"), ((0, 0, 1), "former positions")],
)
def test_a_room_without_a_free_place_for_random_boxes_is_refused(numbers, words):
    with pytest.raises(InputError, match=words):
        with_boxes(scenario(), *numbers)


def test_hostile_files_are_refused_in_one_line(tmp_path):
    path = tmp_path / "room.yaml"
    for text, words in [("", "start"), ("[1]", "not a mapping"), ("a: [", "not YAML")]:
        path.write_text(text)
        with pytest.raises(InputError, match=words):
            load_room(str(path))
    with pytest.raises(InputError, match="neither a file nor one of the rooms"):
        load_room("cellar")


def test_running_into_a_box_is_said():
    eye = Eye(scenario(boxes=crate(at=[2.5, 2.3])))
    with pytest.raises(InputError, match="runs into crate"):
        eye.look(3.0, HERE, 1)
    with pytest.raises(InputError, match="runs into a wall"):
        eye.look(3.0, Pose(9.0, 0.0, 0.0), 1)
    with pytest.raises(InputError, match="home: in crate"):
        Eye(scenario(boxes=crate(stood={"at": [2.0, 2.0]})))


def test_the_room_in_the_docs_renders():
    text = (Path(__file__).resolve().parents[3] / "docs" / "do" / "rooms.md").read_text("utf-8")
    (example,) = re.findall(r"```yaml\n(.*?)```", text, re.DOTALL)
    eye = Eye(validated(RenderScenario, yaml.safe_load(example)))
    assert eye.home_picture().shape == (192, 768, 3)
    assert {name for name, box in eye.scenario.boxes.items() if box.stood} == {"cabinet"}
