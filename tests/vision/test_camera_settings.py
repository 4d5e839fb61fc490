"""`see` and `run` doubt what a folder of pictures is: no panoramas, or mirrored."""

# ruff: noqa: E402 (nothing is imported where OpenCV is missing)
import pytest
from cli.commands import call

cv2 = pytest.importorskip("cv2", reason="pictures need the extra `vision`")

from test_seam import ordinary
from vision_scene import look as draw
from vision_scene import make_room, write_pictures

FRAMES = 6


def folder_of(path, home, pictures):
    path.mkdir()
    cv2.imwrite(str(path / "home.png"), home)
    write_pictures(path, pictures, 0.5)
    (path / "odometry.csv").write_text("t,v,omega\n0,0.2,0\n3,0,0\n")
    return path


@pytest.fixture(scope="module")
def panoramas():
    room = make_room(4)
    way = [(3.6 + 0.1 * k, 3.3, -0.7) for k in range(FRAMES)]
    home, *rest = [draw(room, *at, seed=k) for k, at in enumerate([(3.0, 3.0, 0.4), *way])]
    return home, rest


@pytest.fixture
def pinholes(tmp_path):
    whole = draw(make_room(3), 3.0, 2.5, 0.3, seed=3)
    home, *rest = [ordinary(whole, 0.9 * k, 2.0) for k in range(FRAMES + 1)]
    return folder_of(tmp_path / "pinholes", home, rest)


def answer(*words):
    result = call(*words)
    return result.exit_code, " ".join(result.output.split())


@pytest.mark.parametrize("command", ["see", "run"])
def test_pictures_that_are_no_panoramas_are_refused(pinholes, tmp_path, command):
    code, words = answer(command, pinholes, "--out", tmp_path / "out")
    assert code == 2
    assert "left and right edge do not continue each other" in words
    assert "force: true in images.yaml" in words
    assert not (tmp_path / "out").exists()


def test_they_are_taken_with_force(pinholes, tmp_path):
    words = [answer("see", pinholes, "--out", tmp_path / "forced", "--force")[1]]
    assert (tmp_path / "forced" / "bearings.csv").exists()
    (pinholes / "images.yaml").write_text("force: true\n")
    words += [answer(each, pinholes, "--out", tmp_path / each)[1] for each in ("see", "run")]
    assert (tmp_path / "see" / "bearings.csv").exists()
    # They show landmarks or not, but each of them was looked at.
    assert all("match no earlier image" in said for said in words)
    assert not any("do not continue each other" in said for said in words)


@pytest.mark.parametrize("command", ["see", "run"])
def test_mirrored_pictures_are_reported(panoramas, tmp_path, command):
    home, rest = panoramas
    images = folder_of(tmp_path / "mirrored", home, [p[:, ::-1] for p in rest])
    words = answer(command, images, "--out", tmp_path / "out")[1]
    assert "only if one of them is mirrored" in words


@pytest.mark.parametrize("command", ["see", "run"])
def test_right_settings_are_not_doubted(panoramas, tmp_path, command):
    images = folder_of(tmp_path / "right", *panoramas)
    words = answer(command, images, "--out", tmp_path / "out")[1]
    assert "mirrored" not in words
