"""`homeward simulate --images` as a user would call it."""

import csv
import math

import pytest
import yaml
from commands import call, done

from homeward.drives.folder import read_folder
from homeward.lab.simulation.render.room.settings import load_room

cv2 = pytest.importorskip("cv2", reason="pictures need the extra `vision`")
SMALL = ("camera.width=128", "camera.height=32", "trajectory.duration=2", "rates.bearings=2")


def render(*words, changes=SMALL):
    options = [part for change in changes for part in ("--set", change)]
    return call("simulate", *words, "--images", *options)


def rows(path):
    with path.open() as stream:
        return list(csv.DictReader(stream))


def test_a_data_set_is_written_whole_and_repeats(tmp_path):
    answer = done(render("living-room", "--out", tmp_path / "a", "--seed", "3"))
    assert "4 images of 128x32, 3 boxes moved" in answer.output
    moved = {r["thing"] for r in rows(tmp_path / "a" / "things.csv") if r["moved"] == "1"}
    boxes = " ".join(answer.output.split()).split("Moved since the home image: ")[1]
    assert all(box in boxes.split(";")[0] for box in moved)
    assert "the home image shows" in boxes
    a, b = tmp_path / "a", tmp_path / "b"
    assert render(a / "scenario.yaml", "--out", b, changes=()).exit_code == 0
    files = sorted(p.relative_to(a) for p in a.rglob("*") if p.is_file())
    assert files == sorted(p.relative_to(b) for p in b.rglob("*") if p.is_file())
    for file in files:
        assert (a / file).read_bytes() == (b / file).read_bytes(), file
    listed = rows(a / "images.csv")
    assert [float(row["t"]) for row in listed] == [0.0, 0.5, 1.0, 1.5]
    for row in listed:
        assert cv2.imread(str(a / row["file"])).shape == (32, 128, 3)
    assert sum(row["moved"] == "1" for row in rows(a / "things.csv")) == 3


def test_ground_truth_starts_at_the_start_of_the_scenario(tmp_path):
    render("living-room", "--out", tmp_path / "a")
    first, start = rows(tmp_path / "a" / "truth.csv")[0], load_room("living-room").start
    assert math.hypot(float(first["x"]), float(first["y"])) == pytest.approx(start.R, abs=1e-3)
    assert float(first["heading"]) == pytest.approx(start.alpha, abs=1e-3)


def test_a_shorter_drive_replaces_a_longer_one_with_all_its_images(tmp_path):
    out = tmp_path / "a"
    render("living-room", "--out", out)
    render("living-room", "--out", out, changes=(*SMALL, "trajectory.duration=1"))
    assert sorted(p.name for p in (out / "images").iterdir()) == [f"{i:06d}.png" for i in (1, 2)]


def test_the_camera_is_given_in_images_yaml(tmp_path):
    changes = (*SMALL, "camera.projection=cylindrical", "camera.roll=0.1")
    assert render("living-room", "--out", tmp_path / "a", changes=changes).exit_code == 0
    result = yaml.safe_load((tmp_path / "a" / "images.yaml").read_text())
    assert result["camera"]["model"] == "cylindrical"
    assert result["camera"]["roll"] == 0.1


def test_the_loop_is_closed_by_images(tmp_path):
    """The sightings are an ordinary drive, next to their images."""
    out = tmp_path / "a"
    changes = ("camera.width=256", "camera.height=64", "trajectory.duration=2")
    done(render("living-room", "--out", out, "--estimator", "robust", changes=changes))
    drive = read_folder(out / "drive")
    assert drive.home
    assert set(drive.sightings.t) <= {float(row["t"]) for row in rows(out / "images.csv")}
    assert (out / "odometry.csv").read_bytes() == (out / "drive" / "odometry.csv").read_bytes()
    # The features that are seen again lie where home's lie, but for what moved.
    assert {i for i in drive.sightings.landmark if i.startswith("h")} <= set(drive.home)
