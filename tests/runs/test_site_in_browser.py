"""The site as a reader meets it: built without a complaint, and opened as files in Chromium."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from urllib.parse import unquote, urlparse

import pytest
from browser import needs_chromium, open_page

ROOT = Path(__file__).resolve().parents[2]

DRAG = """
const svg = document.querySelector(".lesson svg");
const output = document.querySelector(".lesson output");
const box = svg.getBoundingClientRect();
found.before = output.textContent;
found.labels = [...svg.querySelectorAll("[role=button]")].map((g) => g.getAttribute("aria-label"));
const at = (x, y) => ({clientX: box.x + box.width * (0.5 + x / 640 * 60), pointerId: 1,
  clientY: box.y + box.height * (0.5 - y / 460 * 60), bubbles: true, isPrimary: true});
window.handle = (name) => svg.querySelector(`[aria-label="${name}, to drag"]`);
window.drag = (name, x, y) => {
  const g = handle(name);
  let held = false;
  g.setPointerCapture = () => { held = true; };
  g.hasPointerCapture = () => held;
  g.dispatchEvent(new PointerEvent("pointerdown", at(0, 0)));
  g.dispatchEvent(new PointerEvent("pointermove", at(x, y)));
};
window.say = () => output.textContent;
found.wide = [document.documentElement.scrollWidth, innerWidth];
found.fetched = performance.getEntriesByType("resource").map((e) => e.name);
"""


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    pytest.importorskip("mkdocs", reason="the site needs the extra `docs`")
    folder = tmp_path_factory.mktemp("site")
    if "HOMEWARD_SITE" in os.environ:  # built before, by `make docs`
        # A copy for each worker, as pages with a script are written next to those of the site.
        return shutil.copytree(os.environ["HOMEWARD_SITE"], folder, dirs_exist_ok=True)
    # Not --quiet: it hides warnings from what makes them fail.
    words = [sys.executable, "-m", "mkdocs", "build", "--site-dir", folder]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return folder


@pytest.fixture
def lesson(site, tmp_path):
    def look(name, script, **options):
        page = site / "learn" / f"{name}.html"
        found = open_page(page, DRAG + script, tmp_path, beside=True, **options)
        assert found["wrong"] == []
        assert found["wide"][0] <= found["wide"][1]
        assert all(address.startswith("file:") for address in found["fetched"])
        return found

    return look


def test_all_settings_are_on_their_page(site):
    def page(name):
        return (site / "look-up" / f"{name}.html").read_text(encoding="utf-8")

    assert 'id="homeward.localizer.localizer.Localizer.bearings"' in page("python")
    assert "--home-noise-deg" in page("commands")
    assert "speed_scale_sigma" in page("settings")
    assert "two landmarks" not in page("statuses")
    assert "bearing is outside the gate" in page("statuses")
    assert 'id="home-bearing"' in page("glossary")


@needs_chromium
@pytest.mark.parametrize(("width", "dark"), [(1200, False), (500, True)])
def test_pages_are_found_read_and_left(site, tmp_path, width, dark):
    script = """
    const input = document.querySelector("[data-md-component=search-query]");
    document.querySelector("#__search").checked = true;
    document.querySelector("#__search").dispatchEvent(new Event("change"));
    input.focus();
    input.value = "coasting";
    input.dispatchEvent(new Event("keyup"));
    const hits = () => [...document.querySelectorAll(".md-search-result__link")].map((a) => a.href);
    for (let k = 0; k < 60 && !hits().length; k++) await frame();
    found.hits = hits();
    found.tabs = [...document.querySelectorAll(".md-nav--primary > ul > li > a, " +
      ".md-tabs__link")].map((a) => a.textContent.trim());
    found.scheme = document.body.dataset.mdColorScheme;
    found.wide = [document.documentElement.scrollWidth, innerWidth];
    found.fetched = performance.getEntriesByType("resource").map((e) => e.name);
    """
    page = site / "index.html"
    found = open_page(page, script, tmp_path, width=width, dark=dark, beside=True)
    assert found["wrong"] == []
    assert any("glossary.html" in hit for hit in found["hits"])
    assert {"Learn", "Do", "Understand", "Look up"} <= set(found["tabs"])
    assert found["scheme"] == ("slate" if dark else "default")
    assert found["wide"][0] <= found["wide"][1]
    assert all(address.startswith("file:") for address in found["fetched"])


@needs_chromium
def test_no_page_scrolls_sideways_on_a_phone_and_none_leads_nowhere(site, tmp_path):
    pytest.importorskip("websockets", reason="Chromium is controlled by its own protocol")
    from studio.chromium import Page

    script = """[document.documentElement.scrollWidth - innerWidth, [...document.querySelectorAll(
      'a[href]')].map((a) => a.href.split('#')[0]).filter((link) => link.startsWith('file:'))]"""
    phone = Page(tmp_path, (site / "index.html").as_uri(), width=390, dark=True)
    try:
        for page in {*site.rglob("*.html")} - {site / "404.html"}:
            phone.open(page.as_uri())
            wider, links = phone.find(script)
            assert wider <= 0, page
            gone = [link for link in set(links) if not Path(unquote(urlparse(link).path)).exists()]
            assert not gone, page
        assert phone.errors == []
    finally:
        phone.close()


@needs_chromium
def test_a_bearing_stays_along_its_line_and_keys_move_too(lesson):
    script = """
    drag("robot", 0, 0); drag("heading of the robot", 1, 0);
    drag("landmark", 1, 1); found.near = say();
    drag("landmark", 2, 2); found.far = say();
    handle("landmark").dispatchEvent(new KeyboardEvent("keydown", {key: "ArrowUp", bubbles: true}));
    found.key = say();
    """
    found = lesson("one-bearing", script)
    assert found["labels"][0] == "robot, to drag"
    assert "bearing of 45°" in found["near"]
    assert "1.4 m away" in found["near"]
    assert "bearing of 45°" in found["far"]
    assert "2.8 m away" in found["far"]
    assert "2.9 m away" in found["key"]


@needs_chromium
def test_on_a_circle_two_landmarks_are_equally_far_apart(lesson):
    script = """
    drag("landmark A", -2, 0); drag("landmark B", 2, 0);
    drag("robot", 0, 2); found.top = say();
    drag("robot", 2 * Math.cos(1), 2 * Math.sin(1)); found.side = say();
    """
    found = lesson("two-landmarks", script)
    assert "seen 90° apart" in found["top"]
    assert "seen 90° apart" in found["side"]


@needs_chromium
def test_on_the_circle_through_three_the_position_is_undetermined(lesson):
    script = """
    drag("landmark A", -2, 0); drag("landmark B", 0, 2); drag("landmark C", 2, 0);
    drag("robot", 0, 0.5); found.inside = say();
    drag("robot", 0, -2); found.on = say();
    """
    found = lesson("three-landmarks", script, width=500, dark=True)
    assert "meet in one point" in found["inside"]
    assert "position along them is undetermined" in found["on"]
    assert "more than 10 m" in found["on"]


@needs_chromium
def test_five_name_the_moved_one_four_do_not_three_never_know(lesson):
    script = """
    found.five = say();
    const radios = [...document.querySelectorAll(".lesson input")];
    radios[1].click(); found.four = say();
    radios[0].click(); found.three = say();
    radios[2].click(); drag("landmark C", 2.4, 2); found.back = say();
    """
    found = lesson("moved-landmark", script)
    assert "Only without C" in found["five"]
    assert "four cannot name it" in found["four"]
    assert "nothing can contradict" in found["three"]
    assert "where it was stored" in found["back"]


@needs_chromium
def test_parallax_and_scale(lesson):
    found = lesson(
        "parallax",
        """drag("the robot before", -4, 0); drag("the robot now", -2, 0);
        drag("landmark", 3, 0); found.ahead = say();
        drag("landmark", -2, 3); found.aside = say();""",
    )
    assert "drive sideways" in found["ahead"]
    assert "Its distance is 3.0 m ± 0.1 m" in found["aside"]
    found = lesson("free-scale", 'drag("size of the world", 0, -2.4); found.small = say();')
    assert found["before"].split("directions")[1] == found["small"].split("directions")[1]
    assert "0.92 times as large" in found["small"]


@needs_chromium
def test_near_home_and_in_line_the_polar_filter_is_singular(lesson):
    script = """
    drag("robot", -1.5, -2.6); found.far = say();
    drag("robot", -1.5, -0.8); found.near = say();
    drag("landmark", 1, 0.4); drag("robot", 0.25, 0.1); found.line = say();
    """
    found = lesson("polar-filter", script)
    assert "R is 2.0" in found["far"]
    assert "turns θ by 6° a second" in found["far"]
    assert re.search("turns θ by 5[67]° a second", found["near"])
    assert "distance is undetermined" in found["line"]


@needs_chromium
def test_a_wrong_home_bearing_spoils_home_and_not_the_map(lesson):
    script = """
    found.right = say();
    document.querySelectorAll(".lesson input")[1].click(); found.elsewhere = say();
    document.querySelectorAll(".lesson input")[0].click();
    drag("the robot before", 2, -2.2); found.narrow = say();
    """
    found = lesson("map-first", script, width=500, dark=True)
    worst = [found[key].split(" m (green)")[0] for key in ("right", "elsewhere", "narrow")]
    assert worst[0] == worst[1] != worst[2]
    assert "the map is not" in found["elsewhere"]
    assert "the map is not" not in found["right"]


@needs_chromium
def test_evidence_names_the_moved_one_unless_noise_hides_it(lesson):
    script = """
    found.sharp = say();
    const radios = [...document.querySelectorAll(".lesson input")];
    radios[2].click(); found.noisy = say();
    radios[0].click(); drag("landmark C", 2.4, 2); found.back = say();
    """
    found = lesson("which-are-wrong", script)
    assert "C moved: 100 %" in found["sharp"]
    assert "nothing moved" in found["noisy"].split("then")[0]
    assert "nothing moved" in found["back"].split("then")[0]


@needs_chromium
def test_half_the_noise_is_overconfident(lesson):
    script = """
    const radios = [...document.querySelectorAll(".lesson input")];
    radios[0].click(); found.half = say(); radios[2].click(); found.double = say();
    """
    found = lesson("how-sure", script)
    assert found["before"].endswith("Consistent.")
    assert "Overconfident" in found["half"]
    assert "Conservative" in found["double"]
