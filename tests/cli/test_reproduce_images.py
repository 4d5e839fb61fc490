"""`homeward study paper --set measurements=images`, and the worlds behind it."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from commands import call, done
from lab.studies.chores import in_this_process

from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose, bearing
from homeward.lab.studies.paper.cases import DEAD_RECKONING, run_filter
from homeward.lab.studies.paper.layouts import Question, run_block
from homeward.lab.studies.paper.settings import Assumed, Imaged, PaperSettings

pytest.importorskip("cv2", reason="images need the extra `vision`")
from homeward.lab.report.paper.page import draw_panorama
from homeward.lab.studies.paper.images import draw_image_world

ONE = Assumed(faults=1, longest=2.0)
SETTINGS = PaperSettings(measurements="images", images=Imaged(width=512), assumed=ONE, runs=1)


@pytest.fixture(scope="module")
def world():
    return draw_image_world("2", SETTINGS, 0)


def test_landmarks_are_features_that_home_saw(world):
    assert world.landmarks.shape == (7, 2)
    assert len(set(world.sight.landmarks.tolist())) == 7
    stored = world.sight.home.azimuth[world.sight.landmarks]
    np.testing.assert_allclose(wrap(world.stored - stored), 0.0, atol=1e-9)


def test_faults_are_those_of_the_moved_boxes(world):
    assert world.moved.sum() <= SETTINGS.assumed.faults
    assert np.abs(world.faults[~world.moved]).max() < 0.02
    assert (np.abs(world.faults[world.moved]) > 0.02).all()


def test_images_show_the_landmarks_where_they_stand(world):
    measured, seen = world.sight.measure(0, np.array(world.start), 0.05)
    assert seen.sum() >= 4
    true = bearing(Pose(*world.start), world.landmarks[:, 0], world.landmarks[:, 1])
    assert np.median(np.abs(wrap(measured - true))[seen > 0]) < 0.02


def test_between_images_nothing_is_seen(world):
    assert world.sight.every == 4
    for sample in (1, 2, 3, 5):
        assert not world.sight.measure(sample, np.array(world.start), 0.05)[1].any()


def test_inside_of_a_wall_nothing_is_seen(world):
    assert not world.sight.measure(0, np.array([9.0, 0.0, 0.0]), 0.05)[1].any()


def test_a_filter_runs_on_images(world):
    run = run_filter("EKF", "2", world, SETTINGS)
    assert len(run.t) == 40
    assert np.isfinite(run.errors).all()
    # Some images were used: the bearings' variances have shrunk.
    assert run.variance[-1, 3:].min() < run.variance[0, 3:].min()


@pytest.mark.parametrize("moved", [0, 1, 7])
def test_the_panorama_s_legend_names_what_is_drawn(world, moved):
    some = replace(world, moved=np.arange(7) < moved)
    figure = draw_panorama(SimpleNamespace(shown={"2": SimpleNamespace(world=some)}), "2")
    named = [text.get_text() for text in figure.legends[0].get_texts()]
    assert named == ["features", *["landmarks"] * (moved < 7), *["moved"] * (moved > 0)]


def test_the_page_has_the_panorama(tmp_path, monkeypatch):
    monkeypatch.setattr("homeward.lab.studies.blocks.finish.on_processes", in_this_process)
    out = tmp_path / "paper"
    words = ["--set", "measurements=images", "--runs", "1", "--set", "images.width=512"]
    changes = ("longest=0.2", "circle_time=0.2", "faults=0", "single_fault=0", "several_faults=[]")
    words += [part for change in changes for part in ("--set", f"assumed.{change}")]
    answer = done(call("study", "paper", "--out", out, *words))
    assert (out / "panorama_case_2.png").read_bytes().startswith(b"\x89PNG")
    page = (out / "paper.html").read_text()
    assert "extracted features" in page
    assert "rendered panoramas of 512" in page
    assert "Case 2: 0 moved landmarks requested, 0 in one run obtained." in answer.stdout
    assert "Requested and obtained faults" in page


def test_dead_reckoning_looks_at_no_image(world):
    blind = replace(world, sight=SimpleNamespace())  # which cannot measure
    assert np.isfinite(run_filter(DEAD_RECKONING, "2", blind, SETTINGS).errors).all()


def test_faults_obtained_are_counted_where_fewer_came_than_were_asked_for(world, monkeypatch):
    """Rooms decide how many landmarks lie on moved boxes; the blocks keep the number."""
    some = replace(world, moved=np.arange(7) < 1)
    monkeypatch.setattr("homeward.lab.studies.paper.layouts.draw", lambda *_: some)
    block = Question(SETTINGS, "2", (DEAD_RECKONING,), 1)
    assert run_block(block)["moved"].tolist() == [1]
    assert len(Question(SETTINGS, "2", (DEAD_RECKONING,), 3).blocks()) == 3
