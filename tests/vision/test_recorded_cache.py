"""What was found in pictures is used again, is the same, and is never used of other pictures."""

# ruff: noqa: E402 (nothing is imported where OpenCV is missing)
import os
import shutil
from dataclasses import fields, is_dataclass

import numpy as np
import pytest

cv2 = pytest.importorskip("cv2", reason="pictures need the extra `vision`")

from homeward.engine.native.cache import Cache
from homeward.simulation.files import changed_scenario
from homeward.simulation.render.dataset import write_rendered
from homeward.simulation.render.eye import Eye
from homeward.simulation.render.room.presets import room
from homeward.vision.front_end import FrontEnd
from homeward.vision.recorded import cache as kept
from homeward.vision.recorded.folder import see_folder


@pytest.fixture(scope="module")
def rendered(tmp_path_factory):
    path = tmp_path_factory.mktemp("bedroom")
    made = room("bedroom", 100, distance=(0.7, 0.9), moved=1)
    small = {"rates.bearings": 0.8, "camera.width": 256, "camera.height": 64}
    write_rendered(Eye(changed_scenario(made, small)), path)
    return path


@pytest.fixture
def folder(rendered, tmp_path, monkeypatch):
    """Return a copy of it, beside an empty cache."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return shutil.copytree(rendered, tmp_path / "drive")


@pytest.fixture
def looks(monkeypatch):
    """Return a list that grows whenever the images are looked at."""
    drives, take = [], FrontEnd.take

    def counted(front_end, view):
        if not any(front_end is other for other in drives):
            drives.append(front_end)
        return take(front_end, view)

    monkeypatch.setattr(FrontEnd, "take", counted)
    return drives


def files(folder):
    return sorted((folder.parent / "cache" / "homeward").glob("*.npz"))


def same(one, other):
    """Say whether two values are one to the last bit, whatever they are made of."""
    if type(one) is not type(other):
        return False
    if isinstance(one, np.ndarray):
        return (one.dtype == other.dtype and one.tolist() == other.tolist()) or np.array_equal(
            one, other, equal_nan=True
        )
    if is_dataclass(one):
        return all(same(getattr(one, f.name), getattr(other, f.name)) for f in fields(one))
    if isinstance(one, dict):
        return list(one) == list(other) and all(same(one[k], other[k]) for k in one)
    if isinstance(one, tuple):
        return len(one) == len(other) and all(map(same, one, other))
    return bool(one == other)


def test_the_second_look_takes_what_the_first_found(folder, looks):
    first, again = see_folder(folder), see_folder(folder)
    assert len(looks) == 1
    assert any(seen is not None and seen.accepted for _, seen in first.pictures)
    assert same(first, again)


def test_nothing_that_decides_nothing_makes_it_look_again(folder, looks):
    first = see_folder(folder)
    moved = folder.rename(folder.parent / "drive elsewhere")
    (moved / "truth.csv").unlink()
    assert same(see_folder(moved, force=True).sightings, first.sightings)
    assert len(looks) == 1


def one_pixel(folder):
    file = sorted(folder.glob("**/*.png"))[3]
    picture = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
    picture[5, 5] ^= 1
    cv2.imwrite(str(file), picture)


def home(folder):
    picture = cv2.imread(str(folder / "home.png"), cv2.IMREAD_UNCHANGED)
    picture[5, 5] ^= 1
    cv2.imwrite(str(folder / "home.png"), picture)


def told(folder, line):
    with (folder / "images.yaml").open("a") as stream:
        stream.write(f"{line}\n")


def mask(folder, row=60):
    told(folder, "mask: mask.png")
    picture = np.full((64, 256), 255, np.uint8)
    picture[row:] = 0
    cv2.imwrite(str(folder / "mask.png"), picture)


def order(folder):
    rows = (folder / "images.csv").read_text().splitlines()
    times, names = zip(*(row.split(",") for row in rows[1:]), strict=True)
    swapped = [names[1], names[0], *names[2:]]
    text = [rows[0], *(f"{t},{name}" for t, name in zip(times, swapped, strict=True))]
    (folder / "images.csv").write_text("\n".join(text) + "\n")


def turned(folder):
    rows = (folder / "odometry.csv").read_text().splitlines()
    t, v, omega = rows[1].split(",")
    rows[1] = f"{t},{v},{float(omega) + 0.1}"
    (folder / "odometry.csv").write_text("\n".join(rows) + "\n")


@pytest.mark.parametrize(
    "change",
    [one_pixel, home, mask, order, turned, lambda folder: told(folder, "landmarks: 20")],
    ids=["picture", "home", "mask", "order", "odometry", "settings"],
)
def test_whatever_decides_it_makes_it_look_again(folder, looks, change):
    see_folder(folder)
    change(folder)
    see_folder(folder)
    assert len(looks) == 2


def test_another_content_of_the_mask_makes_it_look_again(folder, looks):
    mask(folder)
    see_folder(folder)
    picture = np.full((64, 256), 255, np.uint8)
    picture[50:] = 0
    cv2.imwrite(str(folder / "mask.png"), picture)
    see_folder(folder)
    assert len(looks) == 2


def test_another_version_looks_again(folder, looks, monkeypatch):
    see_folder(folder)
    monkeypatch.setattr(kept, "algorithm", lambda: "another")
    see_folder(folder)
    assert len(looks) == 2


@pytest.mark.parametrize("damage", [lambda b: b[:-100], lambda b: b[:500] + b"x" + b[501:]])
def test_what_is_damaged_is_thrown_away(folder, looks, damage):
    first = see_folder(folder)
    (file,) = files(folder)
    file.write_bytes(damage(file.read_bytes()))
    assert same(see_folder(folder), first)
    assert same(see_folder(folder), first)
    assert len(looks) == 2


@pytest.mark.parametrize("held", [b"", b"PK\x03\x04", b"\x80\x04N."])
def test_what_is_none_of_ours_is_passed_over(folder, looks, held):
    """Its checksum is right, but what it holds is not."""
    first = see_folder(folder)
    (file,) = files(folder)
    key = file.name.split("-")[0]
    file.unlink()
    foreign = file.parent / "foreign"
    foreign.write_bytes(held)
    Cache(file.parent, ".npz").keep(key, foreign)
    assert same(see_folder(folder), first)
    assert len(looks) == 2


def test_without_a_folder_of_its_own_nothing_is_kept_and_all_goes_on(folder, looks):
    first = see_folder(folder)
    cache = files(folder)[0].parent
    cache.chmod(0o777)
    assert same(see_folder(folder), first)
    assert len(looks) == 2


def test_a_full_disk_leaves_nothing_half_written(folder, looks, monkeypatch):
    def full(file, **arrays):
        file.write_bytes(b"PK\x03\x04")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(kept.np, "savez", full)
    see_folder(folder)
    cache = folder.parent / "cache" / "homeward"
    assert not [f for f in cache.iterdir() if f.suffix == ".npz" or f.name.startswith("compiling")]


def test_pictures_that_change_meanwhile_are_not_kept(folder, monkeypatch):
    take = FrontEnd.take

    def changing(front_end, view):
        monkeypatch.setattr(FrontEnd, "take", take)  # once is enough
        one_pixel(folder)
        return take(front_end, view)

    monkeypatch.setattr(FrontEnd, "take", changing)
    see_folder(folder)
    assert not files(folder)


def test_no_more_is_kept_than_the_bound_and_what_was_used_last_stays(folder, monkeypatch):
    see_folder(folder)
    (first,) = files(folder)
    monkeypatch.setattr(kept, "MOST_BYTES", int(2.5 * first.stat().st_size))
    stale = [first.with_name(f"{k}-x.npz") for k in range(4)]
    for age, file in enumerate(stale):
        shutil.copy(first, file)
        os.utime(file, (1e9 - age, 1e9 - age))
    told(folder, "landmarks: 20")
    see_folder(folder)
    assert first in files(folder)
    assert len(files(folder)) == 2
