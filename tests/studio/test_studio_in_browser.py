"""The page as a hand and a keyboard meet it, in Chromium."""

import base64
import io
import tarfile
import time

import numpy as np
import pytest
from chromium import studio
from places.visited import new_place, room, visit_data
from runs.browser import needs_chromium

from homeward.places.files import save_place
from homeward.places.visiting import merged

pytest.importorskip("websockets", reason="the studio's pages need the extra `live`")
pytestmark = needs_chromium


def choose(page, name, value):
    page.find(
        f"(() => {{ const s = document.querySelector('#{name}'); s.value = '{value}';"
        " s.dispatchEvent(new Event('change')); })()"
    )


def words(page, rival):
    return page.find(f"document.querySelector('.rival[data-rival={rival}]').innerText")


def test_a_landmark_is_dragged_while_it_drives_and_robust_names_it(tmp_path):
    with studio(tmp_path, "--estimator", "robust,ekf") as page:
        choose(page, "pace", 8)
        x, y = page.find("studio.scene.landmarks.L06")
        page.drag("landmark L06", 60, -60)
        page.until(f"Math.abs(studio.scene.landmarks.L06[0] - {x}) > 0.3")
        previous = page.find("studio.scene.previous.L06")
        assert previous == pytest.approx([x, y], abs=1e-6)
        assert page.find("document.querySelectorAll('[data-previous=L06]').length") == 1
        page.until("studio.frame.rivals.robust.moved.L06 > 0.9")
        assert "L06" in words(page, "robust").split("Moved since home")[1]
        assert "Moved" not in words(page, "ekf")
        page.find("document.querySelector('#undo').click()")
        page.until(f"Math.abs(studio.scene.landmarks.L06[0] - {x}) < 1e-6")


def test_keys_choose_and_move_and_drive(tmp_path):
    with studio(tmp_path, "paper-homing", width=390, height=800, dark=True) as page:
        labels = page.find(
            "[...document.querySelectorAll('.handle')].map((g) => g.getAttribute('aria-label'))"
        )
        assert {label.partition(",")[0] for label in labels} >= {"home", "robot", "landmark L1"}
        x, _ = page.find("studio.scene.landmarks.L1")
        page.find("document.querySelector('[data-id=L1]').focus()")
        page.key("ArrowRight", "ArrowRight")
        page.until(f"studio.scene.landmarks.L1[0] > {x} + 0.01")
        page.find("document.activeElement.blur()")
        page.key("ArrowUp", "ArrowUp")
        page.until("studio.scene.steer.by === 'keys'")
        before = page.find("studio.frame.robot")
        time.sleep(0.5)
        assert page.find("studio.frame.robot") != before
        page.key("ArrowUp", "ArrowUp", down=False)
        page.until("document.querySelector('#by').value === 'keys'")


def test_a_scene_travels_by_its_link_and_leaves_as_pictures(tmp_path):
    with studio(tmp_path, "paper-homing") as page:
        page.drag("landmark L2", 40, 40)
        page.until("studio.scene.undo > 0")
        page.find("document.querySelector('#link').click()")
        shared = "import('/sharing.js').then((s) => s.fromFragment(location.hash))"
        moved = page.find(f"{shared}.then((scene) => scene.landmarks.at.L2)")
        page.find("document.querySelector('#again').click()")
        page.reload()
        page.until("window.studio && studio.frame && studio.scene.undo > 2")
        assert page.find("studio.scene.landmarks.L2") == pytest.approx(moved)
        sizes = page.find(
            "import('/sharing.js').then(async (s) => { const svg = document.querySelector('svg');"
            " const text = s.svgText(svg), image = await s.png(svg);"
            " return [text.includes('xmlns'), text.includes('touch'), image.size]; })"
        )
        assert sizes[:2] == [True, False]
        assert sizes[2] > 10_000


def test_a_film_is_a_tar_of_pictures_in_which_it_drives_on(tmp_path):
    with studio(tmp_path, "paper-homing") as page:
        text = page.find(
            "import('/sharing.js').then((s) => s.film(document.querySelector('svg'), () => {}, 4))"
            ".then((tar) => new Promise((done) => { const r = new FileReader();"
            " r.onload = () => done(r.result); r.readAsDataURL(tar); }))"
        )
    with tarfile.open(fileobj=io.BytesIO(base64.b64decode(text.partition(",")[2]))) as tar:
        pictures = [tar.extractfile(name).read() for name in tar.getnames()]
    assert all(picture.startswith(b"\x89PNG") for picture in pictures)
    assert len(pictures) == 4
    assert pictures[0] != pictures[-1]  # two in a row are equal where the machine is busy


def test_visits_of_a_place_are_slid_through(tmp_path):
    rng, places = np.random.default_rng(0), room()
    first = new_place(places, rng)
    places["L0"] = places["L0"] + (0.5, -0.4)
    save_place(merged(first, visit_data(places, rng, 1.0)), tmp_path / "hall")
    with studio(tmp_path, str(tmp_path / "hall"), width=390, dark=True) as page:
        odd = "[...document.querySelectorAll('.landmark.odd')].map((c) => c.parentNode.dataset.id)"
        assert page.find(odd) == ["L0"]
        assert "1 moved (L0)" in page.find("document.querySelector('#text').textContent")
        page.key("ArrowLeft", "ArrowLeft")
        page.until(f"!{odd}.length")
        assert "a new place" in page.find("document.querySelector('#text').textContent")
        assert page.find("document.querySelectorAll('.handle[tabindex]').length") == 0


def test_a_drive_is_scrubbed_and_run_with_another_camera(tmp_path):
    with studio(tmp_path, "sample", "--estimator", "ekf") as page:
        slide = (
            "(() => {{ const s = document.querySelector('#{}'); s.value = {};"
            " s.dispatchEvent(new Event('input')); }})()"
        )
        page.find(slide.format("moment", 900))
        page.until("Math.abs(studio.frame.t - 90) < 1")
        assert page.find("document.querySelectorAll('[data-ray]').length") > 0
        odd = "[...document.querySelectorAll('.landmark.odd')].map((c) => c.parentNode.dataset.id)"
        assert page.find(odd) == []  # the EKF calls none moved
        first = words(page, "ekf")
        page.find(slide.format("set-yaw", 20))
        page.until("document.querySelector('#text').textContent.includes('other settings')")
        page.find(slide.format("moment", 900))
        assert words(page, "ekf") != first
