"""Images of several cameras of one robot become one drive."""

import shutil

import cv2
import numpy as np
import pytest
from cli.commands import call, done, refused
from test_tags import PINHOLE, SHAPE, drawn
from vision_scene import write_pictures

from benchmarks.rooms import changed_room
from homeward.drives.folder import read_folder
from homeward.drives.opening import open_drive
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose, compose
from homeward.lab.simulation.render.drive import Eye, write_rendered
from homeward.lab.simulation.render.scene import tag_places
from homeward.vision.recorded.recording import see_recording

EXTRINSICS = "sensor: {x: 0.15, y: 0.0, yaw: 0.0}\ncameras: {rear: {x: -0.15, y: 0.05, yaw: 3.0}}\n"
CALIBRATION = "camera: {fx: 250, fy: 252, cx: 161, cy: 118, model: plumb_bob}\n"


@pytest.fixture
def robot(tmp_path):
    """Images of a front camera and a video of a rear one, with a home image each."""
    folder = tmp_path / "robot"
    for name, first in (("front", 0), ("rear", 10)):
        (folder / name).mkdir(parents=True)
        seen = [drawn(PINHOLE, first + k, (1.0 + 0.1 * k, 0.2, 0.1), seed=k)[0] for k in range(2)]
        write_pictures(folder / name, seen, 0.5)
        cv2.imwrite(str(folder / name / "home.png"), drawn(PINHOLE, first)[0])
        (folder / name / "images.yaml").write_text(CALIBRATION)
    rear, kind = folder / "rear", cv2.VideoWriter.fourcc(*"MJPG")
    video = cv2.VideoWriter(str(rear / "drive.avi"), kind, 4.0, SHAPE[::-1])
    for k in range(2):
        video.write(cv2.imread(str(rear / f"{k}.png")))
    video.release()
    (rear / "drive.csv").write_text("t\n0.25\n0.5\n")
    (rear / "images.csv").unlink()
    (folder / "odometry.csv").write_text("t,v,omega\n0,0.1,0\n1,0.1,0\n")
    (folder / "drive.yaml").write_text(EXTRINSICS)
    return folder


def see(folder, *more):
    return call("see", folder, "--tags", "36h11", "--out", folder.parent / "drive", *more)


def test_images_and_a_video_of_two_cameras_become_one_drive(robot):
    assert "4 sightings of four landmarks in four images" in done(see(robot)).stdout
    seen = read_folder(robot.parent / "drive")
    rows = zip(seen.sightings.t, seen.sightings.landmark, seen.sightings.camera, strict=True)
    expected = [(0.0, "0", "front"), (0.25, "10", "rear"), (0.5, "1", "front"), (0.5, "11", "rear")]
    assert list(rows) == expected
    assert {name: bearing.camera for name, bearing in seen.home.items()} == {
        "0": "front",
        "10": "rear",
    }


def test_rendered_tags_have_the_bearings_from_their_camera(tmp_path):
    (tmp_path / "drive.yaml").write_text(EXTRINSICS)
    mounts = {"front": (0.15, 0.0, 0.0), "rear": (-0.15, 0.05, 3.0)}
    camera = {"projection": "pinhole", "width": "640", "height": "400", "field_of_view": "1.4"}
    changes = {"tags.size": "0.25", "tags.walls": "16", "rates.bearings": "1"}
    changes |= {f"camera.{key}": value for key, value in camera.items()}
    for name, mount in mounts.items():
        (tmp_path / name).mkdir()
        given = {f"sensor.{key}": str(v) for key, v in zip(("x", "y", "yaw"), mount, strict=True)}
        room = changed_room("bedroom", {**changes, **given, "trajectory.duration": "3"})
        eye = Eye(room)
        write_rendered(eye, tmp_path / name)
    for file in ("odometry.csv", "truth.csv"):
        shutil.copy(tmp_path / "front" / file, tmp_path / file)
    drive = see_recording(tmp_path)
    hung = {str(tag.number): tag.centre for tag in tag_places(eye.scenario, at_home=False)}
    seen, errors = drive.sightings, []
    for t, name, bearing, by in zip(seen.t, seen.landmark, seen.bearing, seen.camera, strict=True):
        robot = Pose(*(float(part) for part in drive.truth.at(t)))
        place = compose(compose(eye.scenario.home.pose, robot), Pose(*mounts[by]))
        x, y, _ = hung[name]
        errors.append(wrap(np.arctan2(y - place.y, x - place.x) - place.heading - bearing))
    assert np.abs(errors).max() < np.radians(0.05)
    assert set(seen.camera) == set(mounts)
    # Home images show boxes where they were then, and each tag once.
    assert {bearing.camera for bearing in drive.home.values()} == set(mounts)


@pytest.mark.parametrize("level", ["front", "rear"])
def test_of_a_tag_in_two_home_images_the_more_accurate_bearing_counts(robot, level):
    """A tilt of the camera changes the bearing of a tag above or below it."""
    for name in ("front", "rear"):
        height = 0.0 if name == level else 0.3
        cv2.imwrite(str(robot / name / "home.png"), drawn(PINHOLE, 0, (1.0, 0.2, height))[0])
    done(see(robot))
    home = read_folder(robot.parent / "drive").home
    assert [(name, seen.camera) for name, seen in home.items()] == [("0", level)]


def test_a_camera_without_a_home_image_is_noted(robot):
    (robot / "rear" / "home.png").unlink()
    assert "camera without a home image: 'rear'" in done(see(robot)).output
    assert set(read_folder(robot.parent / "drive").home) == {"0"}


def test_home_csv_of_all_cameras_replaces_the_home_images(robot):
    for name in ("front", "rear"):
        (robot / name / "home.png").unlink()
    (robot / "home.csv").write_text("landmark,bearing,camera\n0,0.1,front\n10,0.2,rear\n")
    done(see(robot))
    assert read_folder(robot.parent / "drive").home["10"].camera == "rear"


def test_a_run_opens_the_folder_of_the_cameras(robot):
    for name in ("front", "rear"):
        (robot / name / "images.yaml").write_text(CALIBRATION + "tags: 36h11\n")
    assert set(open_drive(robot).sightings.camera) == {"front", "rear"}
    answer = done(call("info", robot)).stdout
    assert "front/images.csv" in answer
    assert f"homeward see {robot}" in answer


def test_pictures_without_a_tag_are_counted_by_camera(robot):
    cv2.imwrite(str(robot / "front" / "0.png"), np.full(SHAPE, 200, np.uint8))
    assert "1 pictures without a tag of camera 'front'" in " ".join(done(see(robot)).output.split())


def without_calibration(robot):
    (robot / "rear" / "images.yaml").unlink()


def with_another_video(robot):
    shutil.copy(robot / "rear" / "drive.avi", robot / "rear" / "other.avi")


def with_a_name_that_is_no_id(robot):
    (robot / "front").rename(robot / "front ")


def without_odometry(robot):
    (robot / "odometry.csv").unlink()


def on_another_clock(robot):
    (robot / "rear" / "drive.csv").write_text("t\n100.25\n100.5\n")


def without_a_tag_at_home(robot):
    for name in ("front", "rear"):
        cv2.imwrite(str(robot / name / "home.png"), np.full(SHAPE, 200, np.uint8))


def with_mirrored_images_at_home(robot):
    for name in ("front", "rear"):
        file = str(robot / name / "home.png")
        cv2.imwrite(file, cv2.imread(file, cv2.IMREAD_GRAYSCALE)[:, ::-1])


def with_dark_images_at_home(robot):
    for name in ("front", "rear"):
        file = str(robot / name / "home.png")
        cv2.imwrite(file, cv2.imread(file, cv2.IMREAD_GRAYSCALE) // 25)


def with_an_image_of_another_size(robot):
    cv2.imwrite(str(robot / "front" / "0.png"), np.full((80, 100), 200, np.uint8))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (with_mirrored_images_at_home, "no tag in the home image; the images are mirrored"),
        (with_dark_images_at_home, "no tag in the home image; the images are dark; use"),
        (with_an_image_of_another_size, "100x80 pixels, but the image before has 320x240"),
        (without_calibration, "rear/images.yaml: no calibration of this camera; set camera"),
        (with_another_video, "rear: 2 videos of one camera; keep one"),
        (with_a_name_that_is_no_id, "front : not a valid name of a camera; rename the folder"),
        (without_odometry, "odometry.csv: cannot be read"),
        (on_another_clock, "the first of the images of camera 'rear' is 99.2 s after the last of"),
        (without_a_tag_at_home, "rear/home.png: no tag in the home image"),
    ],
)
def test_bad_input_is_refused_in_one_line(robot, change, message):
    change(robot)
    assert message in refused(see(robot))
    assert not (robot.parent / "drive").exists()


def test_several_cameras_need_tags(robot):
    made = call("see", robot, "--out", robot.parent / "drive")
    assert "pictures of several cameras are only used with tags" in refused(made)


def test_a_turn_at_home_needs_the_extrinsics_of_all_cameras(robot):
    (robot / "drive.yaml").write_text("sensor: {x: 0.15, y: 0.0, yaw: 0.0}\n")
    message = "cameras 'front' and 'rear': only one may have the extrinsics under sensor:"
    assert message in refused(see(robot, "--home", "spin:0,1"))
