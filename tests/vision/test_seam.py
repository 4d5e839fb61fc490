"""Pictures that are no panorama are refused, and panoramas are not."""

import math
from functools import cache

import numpy as np
import pytest
from cli.commands import call
from vision_scene import look as draw
from vision_scene import make_room

cv2 = pytest.importorskip("cv2")

from homeward.errors import InputError  # noqa: E402
from homeward.vision import Equirectangular  # noqa: E402
from homeward.vision.cameras.image_files import read_grey  # noqa: E402
from homeward.vision.cameras.panoramic import Cylindrical  # noqa: E402
from homeward.vision.checks import MIN_EVIDENCE, require_panoramas, seam_evidence  # noqa: E402

SEEDS = range(12)
CAMERA = Equirectangular()


@cache
def panorama(seed):
    grey = draw(make_room(seed), 3.0, 2.5, 0.3, seed=seed)
    return grey if grey.ndim == 2 else cv2.cvtColor(grey, cv2.COLOR_BGR2GRAY)


def ordinary(whole, azimuth, ratio):
    """Return what a camera without lens errors sees of a panorama, 80 degrees across."""
    width, focal = 480, 240 / math.tan(math.radians(40.0))
    across, down = np.meshgrid(
        np.arange(width) - width / 2 + 0.5, np.arange(int(width / ratio)) - width / ratio / 2 + 0.5
    )
    angle = azimuth - np.arctan2(across, focal)
    below = np.arctan2(down, np.hypot(across, focal))
    height, columns = whole.shape
    step = 2 * math.pi / columns
    column = (columns / 2 - 0.5 - angle / step) % columns
    wide = cv2.copyMakeBorder(whole, 0, 0, 2, 2, cv2.BORDER_WRAP)
    row = height / 2 - 0.5 + below / step
    found = [np.float32(column + 2), np.float32(row)]
    return cv2.remap(wide, *found, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)


def double_fisheye(whole, margin):
    size = 256
    down, across = np.mgrid[0:size, 0:size] - size / 2 + 0.5
    out = np.hypot(across, down) / (size / 2 * (1 - margin))
    angle, turn = out * math.radians(95.0), np.arctan2(-down, across)
    x, y, z = np.cos(angle), -np.sin(angle) * np.cos(turn), np.sin(angle) * np.sin(turn)
    height, columns = whole.shape
    step = 2 * math.pi / columns
    sides = []
    for azimuth in (0.0, math.pi):
        column = (columns / 2 - 0.5 - (np.arctan2(y, x) + azimuth) / step) % columns
        row = height / 2 - 0.5 - np.arcsin(z) / step
        side = cv2.remap(
            whole,
            np.float32(column),
            np.float32(row),
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REPLICATE,
        )
        sides.append(np.where(out < 1.0, side, 0).astype(np.uint8))
    return np.hstack(sides)


def test_wherever_a_panorama_is_cut_it_is_one():
    for seed in SEEDS:
        grey = panorama(seed)
        for shift in range(0, grey.shape[1], 37):
            assert seam_evidence(np.roll(grey, shift, axis=1), CAMERA) < MIN_EVIDENCE


@pytest.mark.parametrize("ratio", [16 / 9, 2.0])
def test_pairs_of_ordinary_pictures_are_mostly_refused(ratio):
    refused = []
    for seed in SEEDS:
        pictures = [ordinary(panorama(seed), azimuth, ratio) for azimuth in (0.4, 2.5)]
        try:
            require_panoramas(pictures, Cylindrical())
        except InputError as error:
            refused.append(error.what)
    assert all("do not continue each other" in words and "--force" in words for words in refused)
    assert len(refused) >= 0.7 * len(SEEDS)


def test_a_picture_in_which_nothing_is_seen_is_no_evidence():
    rng = np.random.default_rng(0)
    wall = np.clip(rng.normal(128, 2, (128, 512)), 0, 255).astype(np.uint8)
    require_panoramas([wall, wall], CAMERA)
    require_panoramas([np.full((128, 512), 90, np.uint8)], CAMERA)


def test_other_exposure_beyond_the_seam_is_no_evidence():
    for seed in SEEDS:
        grey = panorama(seed).astype(float)
        gain = np.linspace(0.8, 1.15, grey.shape[1])
        require_panoramas([np.clip(gain * grey, 0, 255).astype(np.uint8)], CAMERA)


@pytest.mark.parametrize("margin", [0.0, 0.03])
def test_two_discs_are_refused_and_black_bands_are_not(margin):
    for seed in SEEDS:
        grey = panorama(seed)
        with pytest.raises(InputError, match="double fisheye"):
            require_panoramas([double_fisheye(grey, margin)] * 2, CAMERA)
        bands = np.zeros((grey.shape[1] // 2, grey.shape[1]), np.uint8)
        top = (len(bands) - len(grey)) // 2
        bands[top : top + len(grey)] = grey
        require_panoramas([bands, bands], CAMERA)


def test_real_panoramas_are_taken(data_dir):
    for pattern, horizon in (
        ("alife_outdoor_panoramas/robot_data/*.png", 0.5),
        ("antworld_rendered/grid/*.png", 0.8),
        ("scanvan_spherical_ccby/*.jpg", 0.5),
    ):
        files = sorted(data_dir.glob(pattern))
        greys = [read_grey(file) for file in files[:: max(len(files) // 30, 1)]]
        camera = Equirectangular(horizon=horizon)
        assert greys
        for pair in zip(greys, greys[1:] or greys, strict=False):
            require_panoramas(pair, camera)


def test_compare_refuses_them_unless_forced(tmp_path):
    for name, shift in (("home", 0), ("now", 9)):
        discs = double_fisheye(np.roll(panorama(1), shift, axis=1), 0.0)
        cv2.imwrite(str(tmp_path / f"{name}.png"), discs)
    given = ["compare", str(tmp_path / "home.png"), str(tmp_path / "now.png")]
    given += ["--out", str(tmp_path / "out")]
    refused = call(*given)
    assert refused.exit_code != 0
    assert not (tmp_path / "out").exists()
    call(*given, "--force")
    assert (tmp_path / "out").exists()
