"""The page as a reader meets it, in Chromium."""

import math

import pytest
from browser import needs_chromium, open_page
from made_up_run import MOUNTS, SETTINGS, made_up, of_two_cameras
from made_up_study import made_up_study

from homeward.geometry.frames import Pose, compose
from homeward.lab.observability.study import observe
from homeward.lab.planning.analysis import analyse
from homeward.lab.planning.settings import load_plan
from homeward.lab.report.observe import write_model_view
from homeward.lab.report.plan import write_plan
from homeward.lab.report.study.page import write_study
from homeward.runs.report.folder import write_run

HOSTILE = ("</script><script>document.title='owned'</script>", "$$x^2$$", "<b>bold</b>", "棚🚚")

LOOK = """
const all = [...Bokeh.documents[0].all_models], model = (name) => all.find((m) => m.name === name);
const slider = document.getElementById("moment");
const look = () => ({
  robot: [model("robot").data.x[0], model("robot").data.y[0]],
  ellipse: model("ellipse").data.x.length,
  rays: model("rays").data.x0.length,
  fills: [...model("landmarks").data.fill],
  cursors: [...new Set(all.filter((m) => m.tags.includes("cursor")).map((m) => m.location))],
  clock: document.getElementById("clock").textContent,
  state: document.getElementById("state").textContent,
});
found.at = [];
for (const moment of [0, 60, 150, 190]) {
  slider.value = moment;
  slider.dispatchEvent(new Event("input"));
  await frame();
  found.at.push(look());
}
found.title = document.title;
found.fetched = performance.getEntriesByType("resource").map((e) => e.name);
found.heights = [...document.querySelectorAll("figure")].map((f) => f.offsetHeight);
found.wide = [document.documentElement.scrollWidth, innerWidth];
"""

HOVER = """
const map = [...Bokeh.documents[0].all_models].find((m) => m.match_aspect);
const view = Bokeh.index.find_one_by_id(map.id), [x, y] = [1.0, 2.0];
const box = view.canvas_view.events_el.getBoundingClientRect();
const at = {
  clientX: box.left + view.frame.x_scale.compute(x),
  clientY: box.top + view.frame.y_scale.compute(y),
};
for (const kind of ["pointerenter", "pointermove", "mouseenter", "mousemove"]) {
  const E = kind.startsWith("pointer") ? PointerEvent : MouseEvent;
  view.canvas_view.events_el.dispatchEvent(
    new E(kind, { ...at, bubbles: true, composed: true, pointerType: "mouse", isPrimary: true }));
}
await frame(); await frame();
const texts = (root) => [...root.querySelectorAll("*")].flatMap((e) => [
  ...(e.shadowRoot ? texts(e.shadowRoot) : []),
  ...(e.matches("[class*=ooltip]") ? [e.shadowRoot?.textContent ?? e.textContent] : []),
]);
found.tips = texts(document);
"""

CLICK = """
const plots = [...Bokeh.documents[0].all_models].filter((m) => m.type === "Figure");
const error = plots.find((m) => m.left[0].axis_label === "x error [m]");
error.trigger_event({event_name: "tap", x: 12.34});
await frame();
found.clicked = document.getElementById("clock").textContent;
"""

PLAY = """
const slider = document.getElementById("moment");
slider.value = 0;
document.getElementById("play").click();
for (let i = 0; i < 5; i++) await frame();
found.moved = Number(slider.value);
document.getElementById("play").click();
await frame();
const stopped = Number(slider.value);
await frame(); await frame();
found.stopped = Number(slider.value) === stopped;
"""


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    out = tmp_path_factory.mktemp("run")
    write_run(out, *made_up(HOSTILE), SETTINGS)
    return out / "report.html"


@pytest.fixture(scope="module")
def desktop(page, tmp_path_factory):
    return open_page(page, LOOK, tmp_path_factory.mktemp("desktop"))


@pytest.fixture(scope="module")
def played(page, tmp_path_factory):
    return open_page(page, HOVER + CLICK + PLAY, tmp_path_factory.mktemp("played"))


@needs_chromium
def test_nothing_goes_wrong_and_nothing_is_fetched(desktop):
    assert desktop["wrong"] == []
    assert desktop["fetched"] == []
    assert len(desktop["heights"]) == 4
    assert min(desktop["heights"]) > 100


@needs_chromium
def test_the_slider_moves_the_robot_and_the_cursors(desktop):
    before, early, late, coasting = desktop["at"]
    assert before["robot"] == [None, None], "no pose yet"
    assert before["state"].startswith("mapping: ")
    assert early["robot"] != late["robot"]
    assert early["ellipse"] == late["ellipse"] == 49
    assert (early["clock"], early["cursors"]) == ("6.0 s", [6])
    assert (late["clock"], late["cursors"]) == ("15.0 s", [15])
    assert early["rays"] == 4
    assert "localised" in late["state"]
    assert "coasting" in coasting["state"]


RAYS = """
const slider = document.getElementById("moment");
slider.value = 100;
slider.dispatchEvent(new Event("input"));
await frame();
const {x0, y0, x1, y1} = [...Bokeh.documents[0].all_models].find((m) => m.name === "rays").data;
found.rays = [...x0].map((x, k) => [x, y0[k], Math.atan2(y1[k] - y0[k], x1[k] - x)]);
"""


@needs_chromium
def test_rays_begin_at_their_camera_and_have_its_direction(tmp_path):
    drive, track = of_two_cameras()
    write_run(tmp_path / "run", drive, track, SETTINGS)
    rays = open_page(tmp_path / "run" / "report.html", RAYS, tmp_path)["rays"]
    robot = Pose(track.x[100], track.y[100], track.heading[100])
    front, rear = (compose(robot, mount) for mount in MOUNTS.values())
    for ray, camera in zip(rays, (front, front, rear, rear), strict=True):
        assert ray[:2] == pytest.approx(camera[:2], abs=1e-3)
        assert math.cos(ray[2] - camera.heading) == pytest.approx(1.0, abs=1e-6)


@needs_chromium
def test_a_landmark_takes_the_colour_of_what_was_thought_of_it_then(desktop):
    _, early, late, _ = desktop["at"]
    assert early["fills"][0] != late["fills"][0]
    assert late["fills"][0] == "#d55e00"
    assert early["fills"][3] == "#00000000", "not mapped yet"


@needs_chromium
def test_names_are_text_and_never_markup(desktop):
    assert desktop["title"] == "made up <b> · homeward"
    assert HOSTILE[0] in desktop["at"][2]["state"]


@needs_chromium
def test_a_landmark_has_a_tooltip(played):
    assert played["wrong"] == []
    tip = " ".join(played["tips"])
    assert HOSTILE[0] in tip
    assert "moved since home was stored (probability of having moved: over 99 %)" in tip
    assert "40 sightings used" in tip
    assert "RMS, mean NIS" in tip


@needs_chromium
def test_a_click_on_a_plot_over_time_takes_the_slider_there(played):
    assert played["clicked"] == "12.4 s"


@needs_chromium
def test_it_plays_and_stops(played):
    assert played["moved"] > 2
    assert played["stopped"]


@needs_chromium
def test_it_fits_a_phone(page, tmp_path):
    found = open_page(page, LOOK, tmp_path, width=390)
    assert found["wrong"] == []
    assert found["wide"][0] <= found["wide"][1]


SCREEN = """
const box = (id) => document.getElementById(id).getBoundingClientRect();
found.map = box("plot-map").toJSON();
found.player = document.querySelector(".player").getBoundingClientRect().toJSON();
found.state = box("state").toJSON();
found.screen = [innerWidth, innerHeight];
const slider = document.getElementById("moment");
found.opening = [Number(slider.value), Number(slider.max)];
found.robot = [...Bokeh.documents[0].all_models].find((m) => m.name === "robot").data.x[0];
found.wide = [document.documentElement.scrollWidth, innerWidth];
"""


@needs_chromium
@pytest.mark.parametrize("screen", [(1366, 768), (1280, 720), (1366, 640)])
def test_map_and_slider_fit_one_screen_and_show_the_robot_mid_drive(page, tmp_path, screen):
    found = open_page(page, SCREEN, tmp_path, *screen)
    assert found["wrong"] == []
    assert found["map"]["top"] >= 0
    assert found["map"]["height"] > 0.55 * found["screen"][1], "as large as there is room for"
    assert found["player"]["top"] >= found["map"]["bottom"]
    assert found["state"]["bottom"] <= found["screen"][1]
    moment, last = found["opening"]
    assert abs(moment - last / 2) <= 1
    assert found["robot"] is not None
    assert found["wide"][0] <= found["wide"][1]


LOOKS = """
const style = (e) => getComputedStyle(e);
found.ground = style(document.body).backgroundColor;
found.ink = style(document.body).color;
found.drawings = [...document.querySelectorAll("figure > svg")].map((e) => style(e).filter);
found.anchors = [...document.querySelectorAll("h2")].map((h) => {
  const a = h.querySelector("a"), box = a.getBoundingClientRect();
  return [h.id, a.getAttribute("href"), box.width > 4 && style(a).visibility === "visible"];
});
found.scrolling = [...document.querySelectorAll(".scroll, pre, figure:has(> svg)")].map(
  (e) => style(e).backgroundAttachment);
found.wide = [document.documentElement.scrollWidth, innerWidth];
"""


def brightness(colour):
    """Return that of "rgb(r, g, b)", 0 to 255."""
    return sum(map(int, colour[4:-1].split(","))) / 3


@pytest.fixture(scope="module")
def pages(page, tmp_path_factory):
    out = tmp_path_factory.mktemp("pages")
    write_plan(out / "plan", analyse(load_plan("warehouse").model_copy(update={"grid": 2.0})))
    write_model_view(out / "observe", observe(2), {"landmarks": 2})
    write_study(out / "study", made_up_study(out))
    return [page, *(out / name / f"{name}.html" for name in ("plan", "observe", "study"))]


@pytest.fixture(scope="module")
def narrow(pages, tmp_path_factory):
    """Each page as a phone shows it, by name."""
    profile = tmp_path_factory.mktemp("narrow")
    return {file.name: open_page(file, LOOKS, profile, width=390) for file in pages}


def check_colours(name, found, dark):
    assert found["wrong"] == [], name
    ground, ink = brightness(found["ground"]), brightness(found["ink"])
    assert (ground < 60 and ink > 180) if dark else (ground > 240 and ink < 60), name
    assert {"invert" in filtered for filtered in found["drawings"]} <= {dark}, name


@needs_chromium
def test_every_page_follows_dark_and_light(pages, narrow, tmp_path):
    for name, found in narrow.items():
        check_colours(name, found, dark=False)
    for file in pages:
        check_colours(file.name, open_page(file, LOOKS, tmp_path, dark=True), dark=True)


@needs_chromium
def test_every_section_has_an_anchor_and_what_scrolls_a_sign(narrow):
    for name, found in narrow.items():
        assert len(found["anchors"]) >= 3, name
        assert all(href == f"#{anchor}" and seen for anchor, href, seen in found["anchors"]), name
        assert len({anchor for anchor, _, _ in found["anchors"]}) == len(found["anchors"]), name
        assert found["scrolling"], name
        for attachment in found["scrolling"]:
            assert {"local", "scroll"} <= set(attachment.split(", ")), name
        assert found["wide"][0] <= found["wide"][1], name


@needs_chromium
def test_an_address_leads_to_its_section(page, tmp_path):
    name = "moved-landmarks"
    where = f'found.top = document.getElementById("{name}").getBoundingClientRect().top'
    found = open_page(page, where, tmp_path, address=f"#{name}")
    assert found["wrong"] == []
    assert abs(found["top"]) < 60
