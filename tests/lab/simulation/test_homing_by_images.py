"""Image in, homing out: a robot comes home, and does not call home what is none."""

import pytest

pytest.importorskip("cv2", reason="pictures need the extra `vision`")

from benchmarks.rooms import room
from homeward.estimator import Status
from homeward.lab.simulation.course import Ending
from homeward.lab.simulation.render.drive import Eye, ImageLoop, panorama_of
from homeward.lab.simulation.simulate import changed_scenario
from homeward.registry import make_estimator
from homeward.vision.features.detection import extract
from homeward.vision.front_end import FrontEnd


def eye(name, seed, **changes):
    made = room(name, seed, distance=(0.7, 0.9), moved=1)
    return Eye(changed_scenario(made, {"estimator": "robust", "rates.bearings": 2.5} | changes))


def test_a_robot_comes_home_by_its_images_and_is_sure_of_it():
    loop = ImageLoop(eye("gallery", 100))
    drive = loop.run(make_estimator("robust", loop.drive))
    assert drive.ending is Ending.DONE
    assert drive.final_distance < 0.02
    assert drive.estimates[-1].status is Status.LOCALISED
    moved = [m for m in drive.landmarks if m.moved is not None]
    assert len(moved) > 10


AHEAD = {"camera.width": 1280, "camera.height": 640, "tags": {"size": 0.2, "walls": 24}}
CAMERAS = {
    "ring": {"camera.width": 512, "camera.height": 512},
    "fisheye": AHEAD | {"camera.field_of_view": 3.2},
}


@pytest.mark.parametrize("projection", CAMERAS)
def test_a_camera_of_another_kind_comes_home(projection):
    loop = ImageLoop(eye("office", 0, **{"camera.projection": projection} | CAMERAS[projection]))
    drive = loop.run(make_estimator("robust", loop.drive))
    assert drive.ending is Ending.DONE
    assert drive.final_distance < 0.03


def test_in_another_room_home_is_never_found():
    here, there = eye("classroom", 100, **{"trajectory.duration": 6.0}), eye("gallery", 100)
    loop, camera = ImageLoop(here), panorama_of(there)
    loop.front_end = FrontEnd(extract(there.home_picture(), camera), camera)
    drive = loop.run(make_estimator("robust", loop.drive))
    assert drive.ending is Ending.TIME_UP
    assert not any(e.status is Status.LOCALISED for e in drive.estimates)
