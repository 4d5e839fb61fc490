"""What turns with the camera is left out, and only that."""

# ruff: noqa: E402 (nothing is imported where OpenCV is missing)
import numpy as np
import pytest
from cli.commands import call, refused

cv2 = pytest.importorskip("cv2")

from vision_scene import look as draw
from vision_scene import make_room, write_pictures

from homeward.drives.opening import open_drive
from homeward.errors import InputError
from homeward.geometry.angles import wrap
from homeward.vision import Equirectangular, Mask, compare, extract
from homeward.vision.cameras.image_files import read_mask
from homeward.vision.cameras.ring import Ring
from homeward.vision.front_end import FrontEnd
from homeward.vision.recorded.settings import read_image_settings

CAMERA = Equirectangular()
HEIGHT, WIDTH = 128, 512
TURN = 1.2
"""Of the camera since home [rad]."""
HORIZON, MAST = 2 * HEIGHT // 3, (250, 270)
DECK = np.zeros((HEIGHT, WIDTH), bool)
"""What the robot hides: the lower third and a mast."""
DECK[HORIZON:] = True
DECK[:, slice(*MAST)] = True
PAINTED = np.where(DECK, 0, 255).astype(np.uint8)


def on_robot(image):
    """Return a panorama with the robot's own texture in it, the same at the same pixels."""
    cells = np.random.default_rng(5).integers(0, 255, (HEIGHT // 8, WIDTH // 8))
    return np.where(DECK, np.kron(cells, np.ones((8, 8))), image).astype(np.uint8)


@pytest.fixture(scope="module")
def pictures():
    """Home, and 0.98 m from it, turned by `TURN`."""
    room = make_room(7)
    places = ((3.0, 3.0, 0.4), (3.9, 3.4, 0.4 + TURN))
    return [on_robot(draw(room, *place, seed=k)) for k, place in enumerate(places)]


@pytest.fixture(scope="module")
def files(pictures, tmp_path_factory):
    path = tmp_path_factory.mktemp("masked")
    for name, image in zip(("home", "now", "mask"), (*pictures, PAINTED), strict=True):
        cv2.imwrite(str(path / f"{name}.png"), image)
    return path


def test_what_turns_with_the_camera_is_taken_for_home(pictures):
    """The defect that masks are for."""
    home, now = (extract(image, CAMERA) for image in pictures)
    seen = compare(home, now, CAMERA)
    assert abs(seen.heading) < np.radians(0.1)


def test_with_a_mask_heading_and_direction_are_right(pictures):
    mask = Mask.of(PAINTED)
    home, now = (extract(image, CAMERA, mask) for image in pictures)
    seen = compare(home, now, CAMERA)
    assert abs(wrap(seen.heading - TURN)) < np.radians(0.5)
    assert abs(wrap(seen.direction - (np.arctan2(0.4, 0.9) - 0.4))) < np.radians(2.0)


def turning(k):
    """Return frame k of a robot that turns on the spot, 0.1 rad a frame."""
    return on_robot(draw(make_room(7), 3.0, 3.0, 0.4 + 0.1 * k, seed=k))


def test_the_front_end_masks_frames_as_home_was():
    """Home is another room: frames are compared with each other, and turn all the same."""
    home = on_robot(draw(make_room(1), 3.0, 3.0, 0.4))
    front_end = FrontEnd(extract(home, CAMERA, Mask.of(PAINTED)), CAMERA)
    before, *_, last = [front_end.see(turning(k)).bearings for k in range(14)][-3:]
    turned = [wrap(before[name] - last[name]) for name in before.keys() & last.keys()]
    assert len(turned) > 10
    assert turned == pytest.approx([0.2] * len(turned), abs=0.05)


@pytest.mark.parametrize("width", [512, 256])
def test_no_feature_and_no_corner_is_left_out_in_part(pictures, width):
    """Also where a picture of few columns is enlarged."""
    image, painted = (
        cv2.resize(a, (width, width // 4), interpolation=cv2.INTER_AREA)
        for a in (pictures[0], PAINTED)
    )
    view, without = extract(image, CAMERA, Mask.of(painted)), extract(image, CAMERA)
    row, column = np.nonzero(painted < 128)
    for part, other in ((view.patches[0], without.patches[0]), (features(view), features(without))):
        assert nearest(part, column, row, width) > 0
        assert nearest(other, column, row, width) < 0
        assert len(part) > 20


def features(view):
    return np.column_stack([view.column, view.row, view.size])


def nearest(patches, column, row, width):
    """Return the distance of the patch nearest to a pixel [px]."""
    across = np.abs(patches[:, :1] - column)
    off = np.hypot(np.minimum(across, width - across), patches[:, 1:2] - row)
    return (off.min(axis=1) - patches[:, 2] / 2).min()


def test_what_is_left_out_is_near_across_the_seam():
    painted = np.full((64, 256), 255, np.uint8)
    painted[:, :2] = 0
    mask = Mask.of(painted)
    at = np.array([255.0, -0.4, 250.0, 128.0])
    clear = mask.clear_at(at, np.full(4, 30.0), np.full(4, 3.0))
    assert clear.tolist() == [False, False, True, True]


def test_the_strongest_corner_is_not_one_that_is_left_out():
    """Else a deck of high contrast leaves no corner in a dim room."""
    image = np.random.default_rng(0).integers(100, 110, (HEIGHT, WIDTH)).astype(np.uint8)
    image[HORIZON:] = np.kron(np.indices((5, 64)).sum(0) % 2 * 255, np.ones((9, 8)))[:43]
    corners = [len(extract(image, CAMERA, m).corners()) for m in (None, Mask.of(PAINTED))]
    assert corners[1] > 2 * corners[0]


def test_a_mask_of_a_ring_is_unwrapped_as_its_pictures_are(tmp_path):
    ring = Ring(centre=(250, 240), inner=50, outer=220, elevations=(-0.9, 0.3), mirrored=False)
    painted = np.full((480, 500), 255, np.uint8)
    cv2.ellipse(painted, (250, 240), (240, 240), 0, -100, -80, 0, -1)  # above the centre
    cv2.imwrite(str(tmp_path / "mask.png"), painted)
    mask = read_mask(tmp_path / "mask.png", ring, painted.shape)
    row, column = np.nonzero(mask.room == 0)
    azimuth, _ = ring.directions(column, row, mask.room.shape)
    assert np.degrees([azimuth.min(), azimuth.max()]) == pytest.approx([80, 100], abs=1)


def test_compare_takes_a_mask(files, tmp_path):
    pair = files / "home.png", files / "now.png", "--out", tmp_path
    assert "Heading change: 0.0" in call("compare", *pair).output
    result = call("compare", *pair, "--mask", files / "mask.png")
    assert "Heading change: 68." in result.output, result.output


def test_compare_takes_the_mask_next_to_images_yaml(files, tmp_path):
    (files / "images.yaml").write_text("mask: mask.png\n")
    assert read_image_settings(files / "images.yaml").mask == files / "mask.png"
    options = "--camera", files / "images.yaml", "--out", tmp_path
    result = call("compare", files / "home.png", files / "now.png", *options)
    assert "Heading change: 68." in result.output, result.output


def test_nothing_that_turns_with_the_robot_is_a_landmark_of_a_drive(tmp_path):
    """On the spot, turning: only what belongs to the robot keeps its bearing."""
    frames = 13
    write_pictures(tmp_path, [turning(k) for k in range(frames)], 1.0)
    (tmp_path / "odometry.csv").write_text(f"t,v,omega\n0,0,0.1\n{frames},0,0\n")
    cv2.imwrite(str(tmp_path / "mask.png"), PAINTED)
    still = []
    for words in ("home: 0.png\n", "home: 0.png\nmask: mask.png\n"):
        (tmp_path / "images.yaml").write_text(words)
        seen = open_drive(tmp_path).sightings
        assert len(set(seen.landmark)) > 10
        spread = [np.ptp(np.unwrap(seen.bearing[seen.landmark == n])) for n in set(seen.landmark)]
        still.append(sum(s < 0.1 for s in spread))
    assert still[0] > 10
    assert still[1] == 0


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda f: None, "cannot be read"),
        (lambda f: f.write_text("no image"), "not an image"),
        (lambda f: cv2.imwrite(str(f), PAINTED[:, :256]), "256x128 pixels: a mask must"),
        (lambda f: cv2.imwrite(str(f), 0 * PAINTED), "the mask is black everywhere"),
    ],
)
def test_a_mask_that_cannot_be_used_is_named_in_one_line(files, tmp_path, make, words):
    mask = tmp_path / "deck.png"
    make(mask)
    line = refused(call("compare", files / "home.png", files / "now.png", "--mask", mask))
    assert f"{mask}: {words}" in line


def test_a_mask_of_another_shape_is_refused_online(pictures):
    with pytest.raises(InputError, match="a mask of 256x128 pixels for a panorama of 512x128"):
        extract(pictures[0], CAMERA, Mask.of(PAINTED[:, :256]))
