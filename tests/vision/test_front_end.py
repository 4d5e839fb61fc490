"""An image folder becomes a drive; identities last; faults of a folder are reported."""

# ruff: noqa: E402 (nothing is imported where OpenCV is missing)
import re
import shutil
from collections import defaultdict
from functools import cache

import numpy as np
import pytest
from cli.commands import call, done, refused

cv2 = pytest.importorskip("cv2")

from vision_scene import look as draw
from vision_scene import make_room, write_pictures

from homeward.drives.folder import read_folder
from homeward.drives.images import REPEATED_IMAGES, read_images
from homeward.drives.opening import open_drive
from homeward.geometry.angles import wrap
from homeward.vision import Equirectangular, extract
from homeward.vision.front_end import MIN_SIGHTINGS, FrontEnd
from homeward.vision.recorded.folder import home_image, see_folder
from homeward.vision.recorded.settings import ImageSettings

FRAMES = 15
HOME = (3.0, 3.0, 0.4)


@cache
def frame(seed, k):
    """Return frame k of the drive through a room."""
    return draw(make_room(seed), *way(k), seed=k)


def way(k):
    """Return x [m], y [m] and heading [rad] of frame k in the room."""
    return 3.2 + 0.1 * k, 3.1 + 0.03 * k, 0.3


@pytest.fixture(scope="module")
def room():
    return make_room(1)


@pytest.fixture(scope="module")
def folder(room, tmp_path_factory):
    path = tmp_path_factory.mktemp("images")
    (path / "pictures").mkdir()
    cv2.imwrite(str(path / "home.png"), draw(room, *HOME, seed=99))
    write_pictures(path, [frame(1, k) for k in range(FRAMES)], 0.5, "pictures/")
    (path / "odometry.csv").write_text("t,v,omega\n0,0.2088,0\n7,0,0\n")
    return path


@pytest.fixture(scope="module")
def drive(folder):
    return open_drive(folder)


def misses(lines):
    """By how much each line (x, y, direction), (n, 3), misses the point in which all meet [rad]."""
    x, y, a = np.array(lines).T
    normal = np.column_stack([-np.sin(a), np.cos(a)])
    point = np.linalg.lstsq(normal, np.sum(normal * np.column_stack([x, y]), axis=1))[0]
    return np.abs(wrap(np.arctan2(point[1] - y, point[0] - x) - a))


def test_landmarks_are_mostly_where_their_bearings_point(drive):
    """Every landmark's bearings, with the true poses, meet in one point."""
    s, lines = drive.sightings, defaultdict(list)
    assert s.t.size > 40
    for t, name, bearing in zip(s.t, s.landmark, s.bearing, strict=True):
        lines[name].append(way(round(t / 0.5)) + np.array([0.0, 0.0, bearing]))
    off = np.concatenate([misses(each) for each in lines.values()])
    assert np.median(off) < np.radians(0.3)
    assert np.mean(off > np.radians(2)) < 0.1


def test_home_bearings_come_from_the_home_image(drive, folder):
    home = extract(cv2.imread(str(folder / "home.png"), 0), Equirectangular())
    assert len(drive.home) > 10
    for name, seen in drive.home.items():
        assert seen.bearing == pytest.approx(home.azimuth[int(name[1:])])
        assert seen.sigma > 0


def test_the_written_drive_is_the_one_that_was_read(folder, drive, tmp_path):
    result = done(call("see", folder, "--out", tmp_path / "drive"))
    assert re.search(r"home saw \d+ of these landmarks", result.output)
    again = read_folder(tmp_path / "drive")
    assert (again.sightings.bearing == drive.sightings.bearing).all()
    assert again.home == drive.home


def test_run_takes_an_image_folder(folder, tmp_path):
    result = call("run", folder, "--out", tmp_path / "run")
    assert result.exit_code == 1, result.output
    assert (tmp_path / "run" / "estimate.csv").exists()


def test_landmarks_keep_their_names_where_home_is_out_of_sight(room):
    """Home is of another room: only the chain of keyframes is left, and it holds."""
    camera = Equirectangular()
    front_end = FrontEnd(extract(draw(make_room(7), *HOME), camera), camera)
    glances = [front_end.see(frame(1, k)) for k in range(FRAMES)]
    assert not front_end.home_bearings
    last, before = set(glances[-1].bearings), set(glances[-3].bearings)
    assert len(last & before) > 5


def test_what_is_followed_by_keyframes_is_no_surer_than_home_saw_it():
    """How far a keyframe's patch is from home's point lasts: it is in every sigma from there on."""
    camera, last, followed = Equirectangular(), {}, 0
    front_end = FrontEnd(extract(draw(make_room(3), 3.0, 3.0, 0.4), camera), camera)
    for k in range(FRAMES):
        seen = front_end.see(frame(3, k))
        by_home = seen.home.home_row[seen.home.agrees | seen.home.moved] if seen.home else []
        for name, sigma in seen.sigmas.items():
            if name[0] == "h" and int(name[1:]) in by_home:
                last[name] = sigma
            elif name in last:
                assert sigma >= last[name]
                followed += 1
    assert followed > 10


def test_a_blind_frame_gives_nothing_and_harms_nothing(room):
    camera = Equirectangular()
    front_end = FrontEnd(extract(draw(room, *HOME), camera), camera)
    for k in range(MIN_SIGHTINGS + 1):
        seen = front_end.see(frame(1, k))
    blind = front_end.see(np.full((128, 512), 50, np.uint8))
    assert seen.bearings
    assert not blind.bearings
    assert "matches nothing" in blind.reason
    assert front_end.see(frame(1, MIN_SIGHTINGS + 1)).bearings


@pytest.fixture
def copy(folder, tmp_path):
    return shutil.copytree(folder, tmp_path / "copy")


def broken(copy, tmp_path, change):
    change(copy)
    words = refused(call("see", copy, "--out", tmp_path / "out"))
    assert not (tmp_path / "out").exists()
    return words


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        (
            lambda f: (f / "pictures" / "3.png").unlink(),
            "images.csv: image 'pictures/3.png' does not exist",
        ),
        (
            lambda f: (f / "images.csv").write_text("t,file\n0,../elsewhere.png\n"),
            "outside the folder",
        ),
        (
            lambda f: cv2.imwrite(str(f / "pictures" / "2.png"), np.zeros((64, 256), np.uint8)),
            "256x64 pixels where home has 512x128",
        ),
        (lambda f: (f / "home.png").unlink(), "no home image"),
        (lambda f: (f / "images.csv").unlink(), "not a folder of images: it has no images.csv"),
        (lambda f: (f / "odometry.csv").unlink(), "odometry.csv"),
    ],
)
def test_a_folder_that_lacks_something_is_refused_in_one_line(copy, tmp_path, change, complaint):
    assert complaint in broken(copy, tmp_path, change)


@pytest.mark.parametrize("key", ["home", "mask"])
@pytest.mark.parametrize("name", ["../elsewhere.png", "/elsewhere.png", "link.png"])
def test_home_and_mask_outside_the_folder_are_refused(copy, tmp_path, key, name):
    elsewhere = tmp_path / "elsewhere.png"
    shutil.copy(copy / "home.png", elsewhere)

    def change(copy):
        (copy / "link.png").symlink_to(elsewhere)
        value = str(elsewhere) if name.startswith("/") else name
        (copy / "images.yaml").write_text(f"{key}: {value}\n")

    words = broken(copy, tmp_path, change)
    assert f"images.yaml: {key} " in words
    assert "is outside the folder" in words


@pytest.mark.parametrize("key", ["home", "mask"])
@pytest.mark.parametrize(
    ("name", "complaint"),
    [("none.png", "does not exist"), ("a" * 5000, "cannot be"), ('"a\\0b"', "cannot be")],
)
def test_home_and_mask_that_are_no_files(copy, tmp_path, key, name, complaint):
    words = broken(copy, tmp_path, lambda f: (f / "images.yaml").write_text(f"{key}: {name}\n"))
    assert f"images.yaml: {key} " in words
    assert complaint in words


def test_a_home_image_that_is_a_link_out_of_the_folder_is_refused(copy, tmp_path):
    def change(copy):
        (copy / "home.png").rename(tmp_path / "elsewhere.png")
        (copy / "home.png").symlink_to(tmp_path / "elsewhere.png")

    assert "home 'home.png' is outside the folder" in broken(copy, tmp_path, change)


def test_home_is_found_in_capitals(folder, tmp_path):
    (tmp_path / "HOME.PNG").write_bytes((folder / "home.png").read_bytes())
    (tmp_path / "home.csv").touch()
    assert home_image(tmp_path, ImageSettings()) == tmp_path / "HOME.PNG"


@pytest.mark.parametrize("command", ["see", "run"])
def test_images_of_another_clock_are_refused_before_they_are_looked_at(copy, tmp_path, command):
    (copy / "odometry.csv").write_text("t,v,omega\n5000,0.2,0\n5007,0,0\n")
    (copy / "pictures" / "3.png").write_text("no image: this would be reported first")
    words = refused(call(command, copy, "--out", tmp_path / "out"))
    assert "copy: the first of the odometry is 4,993.0 s after the last of the images" in words


def test_stamps_in_milliseconds_are_remarked(copy, tmp_path):
    rows = [f"{500 * k},pictures/{k}.png" for k in range(FRAMES)]
    (copy / "images.csv").write_text("\n".join(["t,file", *rows]))
    twists = [f"{100 * k},0.2,0" for k in range(70)]
    (copy / "odometry.csv").write_text("\n".join(["t,v,omega", *twists]))
    result = done(call("see", copy, "--out", tmp_path / "out"))
    assert "convert the stamps to seconds if they are in milliseconds" in result.output


def test_of_images_with_one_stamp_the_first_counts(copy, tmp_path):
    (copy / "images.csv").write_text("t,file\n0,pictures/0.png\n0,pictures/9.png\n1,home.png\n")
    remarks: dict[str, int] = {}
    images = read_images(copy, remarks)
    assert images.t.tolist() == [0, 1]
    assert [f.name for f in images.files] == ["0.png", "home.png"]
    assert remarks == {REPEATED_IMAGES: 1}
    assert see_folder(copy).remarks[REPEATED_IMAGES] == 1


def test_compare_writes_picture_matches_and_words(folder, tmp_path):
    result = call(
        "compare", folder / "home.png", folder / "pictures" / "12.png", "--out", tmp_path / "c"
    )
    assert result.exit_code == 0, result.output
    assert "Heading change" in result.output
    assert "Home lies" in result.output
    assert {f.name for f in (tmp_path / "c").iterdir()} == {
        "comparison.json",
        "comparison.png",
        "matches.csv",
    }


def test_compare_reports_when_there_is_not_enough_in_common(folder, tmp_path):
    cv2.imwrite(str(tmp_path / "other.png"), draw(make_room(7), 3, 3, 0))
    result = call("compare", folder / "home.png", tmp_path / "other.png", "--out", tmp_path / "c")
    assert result.exit_code == 1
    assert "not enough in common" in result.output
    assert (tmp_path / "c" / "comparison.png").exists()


def test_a_bearing_is_that_of_the_patch_that_home_saw(room):
    """Not of the feature that the frame finds by itself, which noise and size move about."""
    camera = Equirectangular()
    front_end = FrontEnd(extract(draw(room, *HOME, seed=99), camera), camera)
    for k in range(MIN_SIGHTINGS):
        glance = front_end.see(frame(1, k))
    seen = glance.home
    patch = {
        f"h{row}": angle
        for row, angle, good in zip(
            seen.home_row, seen.tilt.level(seen.pairs.now)[0], seen.agrees, strict=True
        )
        if good
    }
    passed_on = {name: b for name, b in glance.bearings.items() if name in patch}
    assert len(passed_on) > 10
    assert all(
        bearing == pytest.approx(patch[name], abs=1e-12) for name, bearing in passed_on.items()
    )


def test_names_are_handed_on_at_the_place_of_the_patch(room):
    """What keyframes hand on stays where it was: its bearings still meet in one point."""
    camera, lines = Equirectangular(), defaultdict(list)
    front_end = FrontEnd(extract(draw(make_room(7), *HOME), camera), camera)
    for k in range(FRAMES):
        for name, bearing in front_end.see(frame(1, k)).bearings.items():
            lines[name].append(way(k) + np.array([0.0, 0.0, bearing]))
    off = np.concatenate([misses(each) for each in lines.values() if len(each) > 6])
    assert len(off) > 50
    assert np.median(off) < np.radians(0.1)
