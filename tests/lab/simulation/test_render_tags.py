"""A camera that looks ahead into a rendered room, and the tags in it."""

import numpy as np
import pytest
import yaml

from benchmarks.rooms import changed_room
from homeward.drives.cameras.camera import unit_vectors
from homeward.errors import InputError
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose, compose
from homeward.lab.simulation.render.drive import Eye, write_rendered
from homeward.lab.simulation.render.rays.raycast import points, trace
from homeward.lab.simulation.render.room.settings import RoomCamera
from homeward.lab.simulation.render.scene import tag_places
from homeward.lab.simulation.render.shading.picture import NOTHING, rays_of
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
    return Eye(changed_room("bedroom", AHEAD))


FISHEYE = {"projection": "fisheye", "field_of_view": 3.3, "distortion": (-0.02, 0.01, 0.0, 0.0)}
MODELS = [
    {"projection": "pinhole", "distortion": (-0.1, 0.03, 0.001, -0.002)},
    FISHEYE,
    {"projection": "ring", "width": 160},
    {"projection": "cylindrical"},
    {"projection": "equirectangular", "height": 80},
]


@pytest.mark.parametrize("changes", MODELS, ids=lambda m: m["projection"])
def test_a_pixel_shows_what_its_ray_in_the_camera_model_meets(eye, changes):
    """The point is projected back by the model that the front-end has, tilt and all."""
    tilted = {"width": 160, "height": 120, "roll": 0.1, "pitch": -0.05} | changes
    camera = RoomCamera(**tilted)
    seeing = Eye(eye.scenario.model_copy(update={"camera": camera}))
    robot = Pose(0.1, 0.2, 0.7)
    view, rays = seeing.view(robot, 1), rays_of(camera)
    hits = trace(seeing.now.surfaces, view, rays)
    x, y, z = (points(hits, view, rays) - view.position).reshape(-1, 3).T
    local = np.arctan2(y, x) - seeing.scenario.home.heading - robot.heading
    elevation, known = np.arctan2(z, np.hypot(x, y)), camera.known
    rows, columns = np.indices((camera.height, camera.width)).reshape(2, -1)
    seen = np.isfinite(hits.distance).ravel()
    assert (seen == (seeing.things(robot, 1).ravel() != NOTHING)).all()
    if camera.projection == "ring":  # the model speaks of the unwrapped picture
        assert 0.4 < seen.mean() < 0.8
        plain = camera.model_copy(update={"roll": 0.0, "pitch": 0.0})
        rays = unit_vectors(*plain.known.ring_directions(columns, rows))
        ahead = (np.stack([x, y, z], axis=1) @ view.rotation)[seen]
        ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
        np.testing.assert_allclose(ahead, rays[seen], atol=1e-9)
        return
    assert seen.mean() > 0.9
    at = known.pixels(wrap(local), elevation, (camera.height, camera.width))
    np.testing.assert_allclose(at[0][seen], columns[seen], atol=1e-6)
    np.testing.assert_allclose(at[1][seen], rows[seen], atol=1e-6)


def test_tags_are_seen_where_they_hang(eye):
    front_end, many = TagFrontEnd(eye.scenario.camera.known), 0
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
    made = write_rendered(Eye(changed_room("bedroom", changes)), tmp_path)
    told = yaml.safe_load((tmp_path / "images.yaml").read_text())
    assert (told["tags"], told["camera"]["model"]) == ("36h11", "plumb_bob")
    drive = see_recording(tmp_path)
    assert made.images == len(list((tmp_path / "images").iterdir())) >= 4
    assert len(drive.home) >= 3
    assert drive.sightings.t.size >= 4


def test_more_tags_than_a_family_has():
    with pytest.raises(InputError, match="16h5 has only 30 tags"):
        Eye(changed_room("bedroom", {**AHEAD, "tags.family": "16h5"}))
