"""Pictures as arrays: valid formats give the same picture; others are refused with one line."""

# ruff: noqa: E402 (nothing is imported where OpenCV is missing)
import numpy as np
import pytest

cv2 = pytest.importorskip("cv2")

from vision_scene import look as draw
from vision_scene import make_room

from homeward.errors import InputError
from homeward.vision import Equirectangular, Mask, compare, extract
from homeward.vision.cameras.grey import as_grey
from homeward.vision.cameras.ring import Ring, find_ring
from homeward.vision.front_end import FrontEnd

CAMERA = Equirectangular()
RING = Ring(centre=(64, 64), inner=20, outer=60, elevations=(-0.5, 0.5))
ROOM = make_room(1)
PICTURE = draw(ROOM, 3.0, 3.0, 0.4, seed=1)
WIDE = np.repeat(PICTURE, 2, axis=1)


@pytest.mark.parametrize(
    "same",
    [
        PICTURE,
        np.stack([PICTURE] * 3, -1),
        np.stack([PICTURE] * 3 + [np.full_like(PICTURE, 7)], -1),
        PICTURE[:, :, None],
        PICTURE.astype(np.uint16) << 8 | 0xFF,
        np.stack([PICTURE.astype(np.uint16) << 4] * 3, -1),
        PICTURE.astype(">u2"),
        PICTURE.astype(np.int64),
        PICTURE.tolist(),
        WIDE[:, ::2],  # not contiguous
        PICTURE[::-1][::-1],
        np.asfortranarray(PICTURE),
    ],
)
def test_what_is_the_same_picture_gives_the_same_features(same):
    np.testing.assert_allclose(as_grey(same), PICTURE, atol=0)
    one, other = extract(PICTURE, CAMERA), extract(same, CAMERA)
    np.testing.assert_array_equal(one.descriptor, other.descriptor)


def test_a_grey_picture_is_not_copied():
    assert as_grey(PICTURE) is PICTURE


def test_colours_come_in_the_order_of_opencv():
    blue = np.zeros((64, 256, 3), np.uint8)
    blue[..., 0] = 200
    assert (as_grey(blue) == 23).all()


def hole(image):
    """Return a picture of floats with one that is not a number."""
    image = image / 255.0
    image[3, 5] = np.nan
    return image


NO_PICTURES = [
    (None, "check that its file exists"),
    ("home.png", "shape"),
    (PICTURE / 255.0, "floating-point"),
    (hole(PICTURE), "floating-point"),
    (PICTURE > 100, "type bool"),
    (PICTURE.astype(complex), "type complex"),
    (PICTURE.astype(object), "type object"),
    (PICTURE.astype(np.int32) - 300, "exceed 16 bits"),
    (PICTURE.astype(np.uint32) << 10, "exceed 16 bits"),
    (np.zeros((128, 512, 2), np.uint8), "shape"),
    (np.zeros((2, 128, 512, 3), np.uint8), "shape"),
    (np.zeros(512, np.uint8), "shape"),
    (np.zeros((0, 0), np.uint8), "0x0 pixels"),
    (np.zeros((128, 0, 3), np.uint8), "0x128 pixels"),
    (np.zeros((1, 1), np.uint8), "1x1 pixels"),
    (np.lib.stride_tricks.as_strided(PICTURE, (9000, 9000), (0, 0)), "64 million"),
    ([[1, 2], [3]], "rows differ in length"),
    ([], "shape"),
]


@pytest.mark.parametrize(("image", "words"), NO_PICTURES)
@pytest.mark.parametrize(
    "take",
    [
        lambda image: extract(image, CAMERA),
        lambda image: CAMERA.panorama(image),
        RING.panorama,
        find_ring,
        Mask.of,
        FrontEnd(extract(PICTURE, CAMERA), CAMERA).see,
    ],
)
def test_what_is_no_picture_is_refused_in_one_line(take, image, words):
    with pytest.raises(InputError, match=words) as caught:
        take(image)
    assert "\n" not in str(caught.value)


def test_a_frame_of_another_size_than_home_is_refused_and_changes_nothing():
    home = extract(PICTURE, CAMERA)
    front_end, other = FrontEnd(home, CAMERA), FrontEnd(home, CAMERA)
    small = cv2.resize(PICTURE, (256, 64), interpolation=cv2.INTER_AREA)
    with pytest.raises(InputError, match="256x64 pixels where home has 512x128"):
        compare(home, extract(small, CAMERA), CAMERA)
    for k in range(7):
        with pytest.raises(InputError, match="256x64 pixels where home has 512x128"):
            front_end.see(small)
        frame = draw(ROOM, 3.2 + 0.1 * k, 3.1, 0.3, seed=k)
        one, same = front_end.see(np.stack([frame] * 3, -1)), other.see(frame)
        assert one.bearings == same.bearings
        assert one.reason == same.reason
    assert one.bearings
