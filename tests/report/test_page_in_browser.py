"""The page as a reader meets it, in Chromium."""

import pytest
from browser import needs_chromium, open_page
from made_up_run import SETTINGS, made_up

from homeward.report.run_folder import write_run

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
  said: document.getElementById("said").textContent,
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
    assert before["said"].startswith("mapping: ")
    assert early["robot"] != late["robot"]
    assert early["ellipse"] == late["ellipse"] == 49
    assert (early["clock"], early["cursors"]) == ("6.0 s", [6])
    assert (late["clock"], late["cursors"]) == ("15.0 s", [15])
    assert early["rays"] == 4
    assert "localised" in late["said"]
    assert "coasting" in coasting["said"]


@needs_chromium
def test_a_landmark_takes_the_colour_of_what_was_thought_of_it_then(desktop):
    _, early, late, _ = desktop["at"]
    assert early["fills"][0] != late["fills"][0]
    assert late["fills"][0] == "#d55e00"
    assert early["fills"][3] == "#00000000", "not mapped yet"


@needs_chromium
def test_names_are_text_and_never_markup(desktop):
    assert desktop["title"] == "made up <b> · homeward"
    assert HOSTILE[0] in desktop["at"][2]["said"]


@needs_chromium
def test_a_landmark_tells_of_itself_when_hovered(played):
    assert played["wrong"] == []
    tip = " ".join(played["tips"])
    assert HOSTILE[0] in tip
    assert "moved since home was stored (moved with probability over 99 %)" in tip
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
