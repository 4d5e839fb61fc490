"""Image files that are empty, grey, turned, truncated, 16-bit, animated, or not images."""

import struct

import cv2
import numpy as np
import pytest
from PIL import ExifTags, Image

from homeward.errors import InputError
from homeward.vision.cameras.image_files import read_grey
from homeward.vision.cameras.panoramic import Equirectangular
from homeward.vision.comparison import compare
from homeward.vision.features.detection import extract, read_features


def picture(width=256, height=64, seed=0):
    rng = np.random.default_rng(seed)
    return np.kron(rng.integers(0, 255, (height // 8, width // 8)), np.ones((8, 8))).astype(
        np.uint8
    )


def test_a_grey_and_a_coloured_image_are_read(tmp_path):
    grey = picture()
    Image.fromarray(grey).save(tmp_path / "a.png")
    Image.fromarray(np.stack([grey] * 3, -1)).save(tmp_path / "b.png")
    assert (read_grey(tmp_path / "a.png") == grey).all()
    assert (read_grey(tmp_path / "b.png") == grey).all()


def test_sixteen_bits_are_scaled_by_the_bits_in_use(tmp_path):
    Image.fromarray(picture().astype(np.uint16) * 16).save(tmp_path / "a.png")
    assert (read_grey(tmp_path / "a.png") == picture()).all()


@pytest.mark.parametrize("kind", ["png", "tiff"])
@pytest.mark.parametrize("bits", [10, 12, 16])
def test_a_coloured_image_of_a_camera_with_more_than_8_bits_is_not_black(tmp_path, kind, bits):
    deep = np.stack([picture().astype(np.uint16)] * 3, -1) << (bits - 8)
    cv2.imwrite(str(file := tmp_path / f"a.{kind}"), deep)
    assert (read_grey(file) == picture()).all()
    file.write_bytes(file.read_bytes()[:-200])
    with pytest.raises(InputError):
        read_grey(file)


@pytest.mark.parametrize("kind", ["png", "tiff"])
@pytest.mark.parametrize(
    ("orientation", "shown"),
    [
        (2, picture()[:, ::-1]),
        (3, picture()[::-1, ::-1]),
        (4, picture()[::-1]),
    ],
)
def test_an_image_is_read_as_a_viewer_shows_it(tmp_path, kind, orientation, shown):
    exif = Image.Exif()
    exif[ExifTags.Base.Orientation] = orientation
    Image.fromarray(picture()).save(tmp_path / f"a.{kind}", exif=exif)
    assert (read_grey(tmp_path / f"a.{kind}") == shown).all()


def test_a_panorama_that_was_stored_on_its_side(tmp_path):
    exif = Image.Exif()
    exif[ExifTags.Base.Orientation] = 6
    Image.fromarray(np.rot90(picture()).copy()).save(tmp_path / "a.png", exif=exif)
    assert (read_grey(tmp_path / "a.png") == picture()).all()


def test_a_broken_orientation_is_passed_over(tmp_path):
    Image.fromarray(picture()).save(tmp_path / "a.png", exif=b"Exif\0\0junk")
    assert (read_grey(tmp_path / "a.png") == picture()).all()


def animation(file):
    frames = [Image.fromarray(picture(seed=k)) for k in range(3)]
    frames[0].save(file, "gif", save_all=True, append_images=frames[1:])


@pytest.mark.parametrize(
    ("write", "words"),
    [
        (lambda f: f.touch(), r"a\.png: empty file"),
        (lambda f: None, "cannot be read"),
        (lambda f: f.mkdir(), "not a regular file"),
        (lambda f: f.write_text("t,v,omega\n"), "not an image"),
        (animation, "3 frames"),
        # Refused before it is decoded.
        (lambda f: Image.new("1", (20000, 20000)).save(f), "64 million pixels"),
        (lambda f: Image.fromarray(picture(32, 16)).save(f), "32x16"),
    ],
)
def test_what_is_no_panorama_is_refused(tmp_path, write, words):
    write(tmp_path / "a.png")
    with pytest.raises(InputError, match=words):
        read_grey(tmp_path / "a.png")


@pytest.mark.parametrize("kind", ["png", "jpg", "tiff", "webp", "bmp"])
@pytest.mark.parametrize("share", [0.2, 0.6, 0.9])
def test_a_truncated_file(tmp_path, kind, share):
    file = tmp_path / f"a.{kind}"
    Image.fromarray(picture()).save(file)
    whole = file.read_bytes()
    file.write_bytes(whole[: int(len(whole) * share)])
    with pytest.raises(InputError, match=r"not a complete image|not an image"):
        read_grey(file)


def test_bytes_at_random_after_a_true_header(tmp_path):
    file = tmp_path / "a.png"
    Image.fromarray(picture()).save(file)
    data = bytearray(file.read_bytes())
    data[60:200] = np.random.default_rng(0).bytes(140)
    file.write_bytes(bytes(data))
    with pytest.raises(InputError):
        read_grey(file)


def test_another_size_than_home(tmp_path):
    pytest.importorskip("cv2")
    Image.fromarray(picture()).save(tmp_path / "home.png")
    Image.fromarray(picture(512, 128)).save(tmp_path / "a.png")
    _, home = read_features(tmp_path / "home.png", Equirectangular())
    with pytest.raises(InputError, match="512x128 pixels where home has 256x64"):
        read_features(tmp_path / "a.png", Equirectangular(), like=home)


def test_a_rotated_image(tmp_path):
    Image.fromarray(picture().T.copy()).save(tmp_path / "a.png")
    with pytest.raises(InputError, match=r"a\.png: 64x256 pixels: taller than wide"):
        read_features(tmp_path / "a.png", Equirectangular())


def test_nothing_but_grey_has_nothing_in_common():
    pytest.importorskip("cv2")
    camera = Equirectangular()
    grey, other = extract(np.full((64, 256), 99, np.uint8), camera), extract(picture(), camera)
    for a, b in ((grey, grey), (grey, other), (other, grey)):
        seen = compare(a, b, camera)
        assert not seen.accepted
        assert "not enough in common" in seen.acceptance.reason
        assert np.isnan(seen.heading)
        assert np.isnan(seen.home_direction)


@pytest.mark.parametrize("entries", [0, 1])
def test_a_tiff_without_dimensions_is_no_picture(tmp_path, entries):
    """Pillow raises a KeyError of it."""
    directory = struct.pack("<H", entries) + struct.pack("<HHII", 259, 3, 1, 1) * entries + bytes(4)
    (file := tmp_path / "x.tif").write_bytes(b"II*\x00" + struct.pack("<I", 8) + directory)
    with pytest.raises(InputError, match=r"not a complete image|not an image"):
        read_grey(file)
