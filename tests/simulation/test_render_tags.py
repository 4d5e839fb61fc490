"""A camera that looks ahead into a rendered room, and the tags in it."""

import numpy as np
import pytest
import yaml

from homeward.angles import wrap
from homeward.errors import InputError
from homeward.frames import Pose, compose
from homeward.simulation.render.dataset import write_rendered
from homeward.simulation.render.eye import Eye
from homeward.simulation.render.loop import ImageLoop, camera_of
from homeward.simulation.render.rays.raycast import cast, trace
from homeward.simulation.render.room.presets import load_room
from homeward.simulation.render.scene import tag_places
from homeward.simulation.render.shading.picture import grid_of
from homeward.vision.recorded.recording import see_recording
from homeward.vision.tags.front_end import TagFrontEnd

AHEAD = {
    "camera.projection": "pinhole",
    "camera.width": "640",
    "camera.height": "400",
    "camera.field_of_view": "1.4",
    "tags.size": "0.25",
    "tags.walls": "16",
}


@pytest.fixture(scope="module")
def eye():
    return Eye(load_room("bedroom", 0, AHEAD))


def test_windows_of_a_pinhole_lose_nothing(eye):
    grid, view = grid_of(eye.scenario.camera), eye.view(Pose(0.1, 0.2, 0.7), 1)
    surfaces, _ = eye.now.at(0.0, view)
    quick, every = cast(surfaces, view, grid), trace(surfaces, view, grid.directions)
    assert (quick.surface == every.surface).all()
    np.testing.assert_allclose(quick.distance, every.distance, rtol=1e-9)


def test_rays_are_those_of_the_lens(eye):
    camera, settings = camera_of(eye), eye.scenario.camera
    rows, columns = np.indices((settings.height, settings.width)).reshape(2, -1)
    azimuth, elevation = camera.directions(columns, rows)
    x, y, z = grid_of(settings).directions.reshape(-1, 3).T
    np.testing.assert_allclose(azimuth, np.arctan2(y, x), atol=1e-12)
    np.testing.assert_allclose(elevation, np.arctan2(z, np.hypot(x, y)), atol=1e-12)


def test_tags_are_seen_where_they_hang(eye):
    front_end, many = TagFrontEnd(camera_of(eye)), 0
    hung = {str(tag.number): tag.centre for tag in tag_places(eye.scenario, at_home=False)}
    for k, heading in enumerate(np.linspace(-3, 3, 6)):
        robot = Pose(0.2, 0.1, heading)
        seen = front_end.see(eye.look(0.0, robot, k + 1))
        camera = compose(eye.scenario.home.pose, robot)
        for name, bearing in seen.bearings.items():
            x, y, _ = hung[name]
            true = np.arctan2(y - camera.y, x - camera.x) - camera.heading
            assert abs(wrap(bearing - true)) < np.radians(0.03)
            many += 1
    assert many > 12


def test_tags_go_with_their_boxes(eye):
    then, now = (tag_places(eye.scenario, at_home) for at_home in (True, False))
    moved = {a.thing for a, b in zip(then, now, strict=True) if (a.centre != b.centre).any()}
    boxes = eye.scenario.boxes.items()
    assert moved == {name for name, box in boxes if box.stood is not None}
    assert len(moved) == 3


def test_a_rendered_record_is_seen(tmp_path):
    changes = {**AHEAD, "rates.bearings": "0.5", "trajectory.duration": "8"}
    made = write_rendered(Eye(load_room("bedroom", 0, changes)), tmp_path)
    told = yaml.safe_load((tmp_path / "images.yaml").read_text())
    assert (told["tags"], told["camera"]["model"]) == ("36h11", "plumb_bob")
    drive = see_recording(tmp_path)
    assert made.images == len(list((tmp_path / "images").iterdir())) >= 4
    assert len(drive.home) >= 3
    assert drive.sightings.t.size >= 4


def test_a_pinhole_without_tags_cannot_come_home():
    changes = {k: v for k, v in AHEAD.items() if not k.startswith("tags")}
    with pytest.raises(InputError, match="needs tags"):
        ImageLoop(Eye(load_room("bedroom", 0, changes)))


def test_more_tags_than_a_family_has():
    with pytest.raises(InputError, match="16h5 has 30 tags, too few"):
        Eye(load_room("bedroom", 0, {**AHEAD, "tags.family": "16h5"}))
