"""The page and its figures: self-contained, safe with any name, sensible with little to show."""

import csv
import dataclasses
import re
from html.parser import HTMLParser

import numpy as np
import pytest
from made_up_run import FILES, SETTINGS, made_up

from homeward.estimator import LandmarkEstimate
from homeward.report.canvas import png, thin
from homeward.report.map_figure import draw_map, undrawn
from homeward.report.run_folder import write_run
from homeward.report.summary import summarise
from homeward.scoring import score
from homeward.track import Innovations

HOSTILE = [
    "<script>x()</script>",
    "$x^2$",
    "line\nbreak",
    "a\rb",
    'com,"ma',
    "&amp;",
    "$",
    "棚🚚",
    "",
]


class Page(HTMLParser):
    """Collects tags, addresses and text, and checks that every tag is closed in order."""

    VOID = ("meta", "link", "br")

    def __init__(self, html):
        super().__init__()
        self.open, self.tags, self.addresses, self.text = [], [], [], ""
        self.feed(html)
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.addresses += [v for k, v in attrs if k in ("src", "href", "xlink:href", "action")]
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.addresses += [v for k, v in attrs if k in ("src", "href", "xlink:href")]

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text += f" {data}"


@pytest.fixture(scope="module")
def html(tmp_path_factory):
    out = tmp_path_factory.mktemp("run")
    write_run(out, *made_up(), SETTINGS)
    return (out / "report.html").read_text(encoding="utf-8")


def test_page_fetches_nothing_and_runs_nothing(html):
    assert not re.search(r"https?://|//\w+\.\w", html)
    assert "@import" not in html
    read = Page(html)
    assert "script" not in read.tags
    assert all(a.startswith(("#", "data:")) for a in read.addresses)
    assert html.count("<svg") == 4
    assert len(html) < 1_000_000


def test_page_says_what_happened(html):
    text = " ".join(Page(html).text.split())
    drive, track = made_up()
    summary = summarise(drive, track, score(track, drive.truth))
    for said in (summary, "made up <b>", "The scale rests on <odometry>.", "</pre><script>"):
        assert said in text
    assert "equal odometry stamps 7" in text
    assert "outside the gate 3" in text


def test_hostile_names_survive_every_file(tmp_path):
    drive, track = made_up(HOSTILE)
    write_run(tmp_path, drive, track, SETTINGS)
    with (tmp_path / "landmarks.csv").open(encoding="utf-8", newline="") as stream:
        assert [r["landmark"] for r in csv.DictReader(stream)] == HOSTILE
    html = (tmp_path / "report.html").read_text(encoding="utf-8")
    read = Page(html)
    assert "script" not in read.tags
    for shown in ("<script>x()</script>", "$x^2$", "line�break", 'com,"ma', "&amp;", "棚🚚"):
        assert read.text.count(shown) >= 3, "in the table and in two figures"


@pytest.mark.parametrize("truth", [True, False])
@pytest.mark.parametrize("rows", [0, 1, 2])
def test_short_tracks_make_a_page_too(tmp_path, rows, truth):
    drive, track = made_up(truth=truth)
    short = dataclasses.replace(
        track,
        **{k: getattr(track, k)[:rows] for k in ("t", "x", "y", "heading", "covariance")},
        status=track.status[:rows],
        reason=track.reason[:rows],
        innovations=Innovations(*(np.empty(0, kind) for kind in (float, str, float, float, bool))),
        update_seconds=track.update_seconds[:0],
        landmarks=[],
    )
    assert write_run(tmp_path, drive, short, {})
    assert {p.name for p in tmp_path.iterdir()} == FILES


def test_thinning_keeps_extremes_and_breaks():
    values = np.sin(np.arange(100_000) / 50)
    values[51234], values[777], values[30000:30010] = 9.0, -9.0, np.nan
    rows = thin(values)
    assert rows.size < 3000
    assert {51234, 777, 0, 99_999} <= set(rows.tolist())
    assert np.isnan(values[rows]).any()


def test_a_vague_or_distant_landmark_does_not_shrink_the_map():
    drive, track = made_up()
    far = LandmarkEstimate("far", 500.0, 0.0, 500.0, 1.0)
    vague = LandmarkEstimate("vague", 1.0, 1.0, 1.4, 3.0)
    track = dataclasses.replace(track, landmarks=[*track.landmarks, far, vague])
    assert undrawn(track, drive.truth) == ["far", "vague"]
    assert draw_map(track, drive.truth).axes[0].get_xlim()[1] < 10


def test_figures_are_pictures_too():
    drive, track = made_up()
    assert png(draw_map(track, drive.truth)).startswith(b"\x89PNG")
