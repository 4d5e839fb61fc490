"""The site as a reader meets it: built without a complaint, and opened as files in Chromium."""

import os
import re
import subprocess
import sys
from pathlib import Path
from urllib.parse import unquote, urlparse

import pytest
from browser import Page, needs_chromium, open_page

ROOT = Path(__file__).resolve().parents[2]

DRAG = """
const svg = document.querySelector(".lesson svg");
const output = document.querySelector(".lesson output");
const box = svg.getBoundingClientRect();
const radios = [...document.querySelectorAll(".lesson input")];
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
    if "HOMEWARD_SITE" in os.environ:  # built before, by `make docs`
        return Path(os.environ["HOMEWARD_SITE"])
    folder = tmp_path_factory.mktemp("site")
    # Not --quiet: it hides warnings from what makes them fail.
    words = [sys.executable, "-m", "mkdocs", "build", "--site-dir", folder]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return folder


@pytest.fixture
def lesson(site, tmp_path):
    def look(name, script, **options):
        page = site / "learn" / f"{name}.html"
        found = open_page(page, DRAG + script, tmp_path, **options)
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
    found = open_page(page, script, tmp_path, width=width, dark=dark)
    assert found["wrong"] == []
    assert any("glossary.html" in hit for hit in found["hits"])
    assert {"Learn", "Do", "Understand", "Look up"} <= set(found["tabs"])
    assert found["scheme"] == ("slate" if dark else "default")
    assert found["wide"][0] <= found["wide"][1]
    assert all(address.startswith("file:") for address in found["fetched"])


@needs_chromium
def test_no_page_scrolls_sideways_on_a_phone_and_none_leads_nowhere(site, tmp_path):
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


LESSONS = {
    "a bearing stays along its line, and keys move, too": (
        "one-bearing",
        """drag("robot", 0, 0); drag("heading of the robot", 1, 0);
        drag("landmark", 1, 1); found.near = say();
        drag("landmark", 2, 2); found.far = say();
        const up = new KeyboardEvent("keydown", {key: "ArrowUp", bubbles: true});
        handle("landmark").dispatchEvent(up); found.key = say();""",
        {
            "labels": [r"^\['robot, to drag'"],
            "near": ["bearing of 45°", "1.4 m away"],
            "far": ["bearing of 45°", "2.8 m away"],
            "key": ["2.9 m away"],
        },
    ),
    "on a circle two landmarks are equally far apart": (
        "two-landmarks",
        """drag("landmark A", -2, 0); drag("landmark B", 2, 0);
        drag("robot", 0, 2); found.top = say();
        drag("robot", 2 * Math.cos(1), 2 * Math.sin(1)); found.side = say();""",
        {"top": ["seen 90° apart"], "side": ["seen 90° apart"]},
    ),
    "on the circle through three the position is undetermined": (
        "three-landmarks",
        """drag("landmark A", -2, 0); drag("landmark B", 0, 2); drag("landmark C", 2, 0);
        drag("robot", 0, 0.5); found.inside = say();
        drag("robot", 0, -2); found.on = say();""",
        {
            "inside": ["meet in one point"],
            "on": ["position along them is undetermined", "more than 10 m"],
        },
    ),
    "five name the moved one, four do not, three never know": (
        "moved-landmark",
        """found.five = say(); radios[1].click(); found.four = say();
        radios[0].click(); found.three = say();
        radios[2].click(); drag("landmark C", 2.4, 2); found.back = say();""",
        {
            "five": ["Only without C"],
            "four": ["four cannot name it"],
            "three": ["nothing can contradict"],
            "back": ["where it was stored"],
        },
    ),
    "parallax determines a distance aside": (
        "parallax",
        """drag("the robot before", -4, 0); drag("the robot now", -2, 0);
        drag("landmark", 3, 0); found.ahead = say();
        drag("landmark", -2, 3); found.aside = say();""",
        {"ahead": ["drive sideways"], "aside": ["Its distance is 3.0 m ± 0.1 m"]},
    ),
    "near home and in line the polar filter is singular": (
        "polar-filter",
        """drag("robot", -1.5, -2.6); found.far = say();
        drag("robot", -1.5, -0.8); found.near = say();
        drag("landmark", 1, 0.4); drag("robot", 0.25, 0.1); found.line = say();""",
        {
            "far": ["R is 2.0", "turns θ by 6° a second"],
            "near": ["turns θ by 5[67]° a second"],
            "line": ["distance is undetermined"],
        },
    ),
    "evidence names the moved one unless noise hides it": (
        "which-are-wrong",
        """found.sharp = say(); radios[2].click(); found.noisy = say();
        radios[0].click(); drag("landmark C", 2.4, 2); found.back = say();""",
        {
            "sharp": ["C moved: 100 %"],
            "noisy": ["^((?!then).)*nothing moved"],
            "back": ["^((?!then).)*nothing moved"],
        },
    ),
    "half the noise is overconfident": (
        "how-sure",
        "radios[0].click(); found.half = say(); radios[2].click(); found.double = say();",
        {"before": [r"Consistent\.$"], "half": ["Overconfident"], "double": ["Conservative"]},
    ),
}
"""Page, script, and what its findings contain."""
SHAPES = {"three-landmarks": {"width": 500, "dark": True}}
"""Pages that are opened on a phone."""


@needs_chromium
@pytest.mark.parametrize(("page", "script", "expected"), LESSONS.values(), ids=LESSONS)
def test_a_lesson(lesson, page, script, expected):
    found = lesson(page, script, **SHAPES.get(page, {}))
    for name, patterns in expected.items():
        for pattern in patterns:
            assert re.search(pattern, str(found[name])), name


@needs_chromium
def test_the_size_of_the_world_changes_no_direction(lesson):
    found = lesson("free-scale", 'drag("size of the world", 0, -2.4); found.small = say();')
    assert found["before"].split("directions")[1] == found["small"].split("directions")[1]
    assert "0.92 times as large" in found["small"]


@needs_chromium
def test_a_wrong_home_bearing_spoils_home_and_not_the_map(lesson):
    script = """
    found.right = say(); radios[1].click(); found.elsewhere = say();
    radios[0].click(); drag("the robot before", 2, -2.2); found.narrow = say();
    """
    found = lesson("map-first", script, width=500, dark=True)
    worst = [found[key].split(" m (green)")[0] for key in ("right", "elsewhere", "narrow")]
    assert worst[0] == worst[1] != worst[2]
    assert "the map is not" in found["elsewhere"]
    assert "the map is not" not in found["right"]
