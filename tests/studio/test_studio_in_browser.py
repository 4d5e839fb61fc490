"""The page as a hand and a keyboard meet it, in Chromium."""

import base64
import io
import tarfile
import time

import pytest
from chromium import studio
from runs.browser import needs_chromium

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
        assert page.find("document.querySelectorAll('.odd, [data-previous]').length") == 0
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
