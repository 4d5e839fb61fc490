"""Natural features through a lens: its pictures as parts of panoramas."""

import math

import numpy as np
import pytest

from benchmarks.rooms import changed_room
from homeward.drives.cameras.lens import Lens
from homeward.errors import InputError
from homeward.geometry.frames import Pose
from homeward.lab.simulation.render.drive import Eye, panorama_of, write_rendered
from homeward.vision.cameras.panoramic import PartialPanorama
from homeward.vision.comparison import compare
from homeward.vision.features.detection import extract
from homeward.vision.recorded.recording import see_recording

LENSES = {
    "pinhole": {"camera.width": "480", "camera.height": "240", "camera.field_of_view": "2.0"},
    "fisheye": {"camera.width": "480", "camera.height": "320", "camera.field_of_view": "3.2"},
}


def room(lens, **changes):
    camera = {"camera.projection": lens, **LENSES[lens]}
    return changed_room(
        "bedroom", camera | {k.replace("_", "."): v for k, v in changes.items()}, moved=0
    )


@pytest.mark.parametrize("model", ["plumb_bob", "equidistant"])
@pytest.mark.parametrize("tilt", [0.0, 0.15])
def test_a_spot_is_where_the_lens_maps_it(model, tilt):
    """A blurred spot in the picture has the same direction in the panorama, tilt and all."""
    size = {"width": 320, "height": 240, "cx": 161.0, "cy": 118.0}
    lens = Lens(model=model, fx=150, fy=151, distortion=(-0.05, 0.01, 0, 0), pitch=tilt, **size)
    wide = PartialPanorama.through(lens)
    rows, columns = np.indices((240, 320))
    for column, row in ((160.0, 120.0), (60.5, 77.25), (270.0, 180.0)):
        picture = 200 * np.exp(-((columns - column) ** 2 + (rows - row) ** 2) / 18)
        laid = wide.panorama(picture.astype(np.uint8)).astype(float)
        at = [np.sum(part * laid) / laid.sum() for part in np.indices(laid.shape)[::-1]]
        found = wide.directions(*(np.array([v]) for v in at), laid.shape)
        expected = lens.directions(np.array([column]), np.array([row]))
        np.testing.assert_allclose(found, expected, atol=0.1 / 150)


def test_what_the_lens_does_not_see_is_masked():
    lens = Lens(fx=150, fy=150, cx=160, cy=120, width=320, height=240)
    wide = PartialPanorama.through(lens)
    clear = wide.seen.clear(2.0)
    rows, columns = np.indices(clear.shape).reshape(2, -1)[:, clear.ravel()]
    column, row = lens.pixels(*wide.directions(columns, rows, clear.shape))
    assert column.min() > -0.5
    assert column.max() < 319.5
    assert row.min() > -0.5
    assert row.max() < 239.5
    assert clear.mean() > 0.1


def test_a_lens_without_a_size_needs_tags():
    with pytest.raises(InputError, match="needs width and height, or tags"):
        PartialPanorama.through(Lens(fx=150, fy=150, cx=160, cy=120))


@pytest.mark.parametrize("lens", LENSES)
def test_two_pictures_give_rotation_and_direction(lens):
    eye = Eye(room(lens))
    camera, robot = panorama_of(eye), Pose(0.1, 0.2, 0.15)
    home, now = (
        extract(camera.panorama(picture), camera, camera.seen)
        for picture in (eye.home_picture(), eye.look(0.0, robot, 1))
    )
    seen = compare(home, now, camera)
    assert seen.accepted
    assert abs(seen.heading - robot.heading) < max(4 * seen.heading_sigma, math.radians(0.3))
    direction = math.atan2(robot.y, robot.x)
    assert abs(seen.direction - direction) < max(4 * seen.direction_sigma, math.radians(3))


def test_a_record_without_tags_is_followed(tmp_path):
    ahead = {"start_R": "0.6", "start_theta": "3.1416", "start_alpha": "0.0"}
    short = {"rates_bearings": "5", "trajectory_duration": "4"}
    write_rendered(Eye(room("fisheye", **ahead, **short)), tmp_path)
    drive = see_recording(tmp_path)
    assert drive.sightings.t.size >= 50
    assert len(drive.home) >= 5
    assert not any("horizon" in remark for remark in drive.remarks)  # it is calibrated
