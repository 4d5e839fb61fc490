"""The page as a file: self-contained, safe with any name, sensible with little to show."""

import csv
import dataclasses
import json
from html.parser import HTMLParser

import numpy as np
import pytest
from made_up_run import FILES, SETTINGS, first_rows, made_up

from homeward.estimator import LandmarkEstimate
from homeward.runs.report.folder import write_run
from homeward.runs.report.plots.look import thin, thin_dots
from homeward.runs.report.plots.map import map_limits, undrawn
from homeward.runs.report.plots.moments import MAX_MOMENTS, NEW, REJECTED, USED, moments
from homeward.runs.report.plots.time import chi_square_interval, windowed_nis
from homeward.runs.report.summary import sentence
from homeward.runs.scoring import score
from homeward.track import Innovations

HOSTILE = [
    "</script><script>x()</script>",
    "$x^2$",
    "line\nbreak",
    "a\rb",
    'com,"ma',
    "&amp;",
    "$",
    "棚🚚",
    "",
    "9" * 5000,
    "=cmd|' /C calc'!A0",
    "@SUM(A1)",
    "-2+3",
    "$\\frac$",
    "mark 10",
    "٣",
]


class Page(HTMLParser):
    """Collects tags, addresses, scripts and text, and checks that every tag is closed in order."""

    VOID = ("meta", "link", "br", "input")

    def __init__(self, html):
        super().__init__()
        self.open, self.tags, self.addresses, self.scripts, self.text = [], [], [], [], ""
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
        if self.open and self.open[-1] == "script":
            self.scripts.append(data)
        else:
            self.text += f" {data}"


@pytest.fixture(scope="module")
def html(tmp_path_factory):
    out = tmp_path_factory.mktemp("run")
    write_run(out, *made_up(), SETTINGS)
    return (out / "report.html").read_text(encoding="utf-8")


def test_page_fetches_nothing(html):
    read = Page(html)
    assert all(a.startswith(("#", "data:")) for a in read.addresses)
    assert "default-src 'none'" in html, "the browser refuses all requests of scripts"
    assert len(read.scripts) == 3
    assert len(html) < 2_000_000


def test_data_in_the_page_are_strict_json(html):
    def refuse(word):
        raise AssertionError(word)

    data = json.loads(Page(html).scripts[0], parse_constant=refuse)
    seen = data["moments"]
    assert sorted(data["roots"].values()) == ["consistency", "errors", "map", "timeline"]
    assert len(seen["t"]) == len(seen["pose"]) == 200


def test_page_contains_the_summary(html):
    text = " ".join(Page(html).text.split())
    drive, track = made_up()
    said_first = sentence(track, score(track, drive.truth))
    for said in (said_first, "made up <b>", "The scale rests on <odometry>.", "</pre><script>"):
        assert said in text
    head = text[: text.index("Map #")]
    for number in ("20 s", "90 %", "RMSE", "1 of the four landmarks"):
        assert head.count(number) == 1
    assert "equal odometry stamps 7" in text
    assert "bearing is outside the gate 3" in text


def test_hostile_names_survive_every_file(tmp_path):
    drive, track = made_up(HOSTILE)
    write_run(tmp_path, drive, track, SETTINGS)
    with (tmp_path / "landmarks.csv").open(encoding="utf-8", newline="") as stream:
        written = [r["landmark"] for r in csv.DictReader(stream)]
    # An apostrophe makes a formula a text for spreadsheets.
    assert written == [f"'{name}" if name[:1] in {*"=@-"} else name for name in HOSTILE]
    html = (tmp_path / "report.html").read_text(encoding="utf-8")
    read = Page(html)
    assert len(read.scripts) == 3
    names = json.loads(read.scripts[0])["moments"]["names"]
    for shown in (
        "</script><script>x()</script>",
        "$x^2$",
        "line�break",
        'com,"ma',
        "&amp;",
        "棚🚚",
    ):
        assert shown in read.text
        assert shown in names


@pytest.mark.parametrize("truth", [True, False])
@pytest.mark.parametrize("rows", [0, 1, 2])
def test_short_tracks_make_a_page_too(tmp_path, rows, truth):
    drive, track = made_up(truth=truth)
    assert write_run(tmp_path, drive, first_rows(track, rows), {})
    assert {p.name for p in tmp_path.iterdir()} == FILES


def test_thinning_keeps_extremes_and_breaks():
    values = np.sin(np.arange(100_000) / 50)
    values[51234], values[777], values[30000:30010] = 9.0, -9.0, np.nan
    rows = thin(values)
    assert rows.size < 3000
    assert {51234, 777, 0, 99_999} <= set(rows.tolist())
    assert np.isnan(values[rows]).any()


def test_thinning_of_dots_keeps_the_greatest():
    size = np.abs(np.sin(np.arange(50_000)))
    size[[7, 31_234]] = 9.0
    rows = thin_dots(size, 1000)
    assert {7, 31_234} <= set(rows.tolist())
    assert 900 < rows.size <= 1000
    assert np.all(np.diff(rows) > 0)


def test_a_vague_or_distant_landmark_does_not_shrink_the_map():
    drive, track = made_up()
    far = LandmarkEstimate("far", 500.0, 0.0, 500.0, 1.0)
    vague = LandmarkEstimate("vague", 1.0, 1.0, 1.4, 3.0)
    track = dataclasses.replace(track, landmarks=[*track.landmarks, far, vague])
    assert undrawn(track, drive.truth) == ["far", "vague"]
    assert map_limits(track, drive.truth)[1] < 10


def test_moments_have_the_use_of_each_bearing():
    drive, track = made_up()
    scored = track.innovations
    unknown = dataclasses.replace(
        track,
        innovations=Innovations(*(getattr(scored, f.name)[4:] for f in dataclasses.fields(scored))),
    )
    result = moments(drive, unknown)
    assert [fate for _, _, fate, _ in result["seen"][0]] == [NEW] * 4
    fates = [fate for seen in result["seen"][1:] for _, _, fate, _ in seen]
    assert set(fates) == {USED, REJECTED}
    assert fates.count(REJECTED) == int((~scored.accepted[4:]).sum())
    assert result["pose"][19] is None
    assert result["pose"][20] == pytest.approx(
        [track.x[20], track.y[20], track.heading[20]], abs=1e-4
    )
    assert result["known"][19] == -1
    row = result["history"][result["known"][-1]]
    assert row[0] == [1.0, 2.0, 10]
    assert row[3] is None


def test_a_long_drive_has_no_more_moments_than_a_page_holds():
    drive, track = made_up(seconds=3600.0)
    result = moments(drive, track)
    assert len(result["t"]) <= MAX_MOMENTS + 2
    assert result["t"][0] == 0.0
    assert result["t"][-1] == pytest.approx(track.t[-1] - track.t[0], abs=1e-3)
    assert max(np.diff(result["t"])) < 2 * 3600 / MAX_MOMENTS


def test_mean_nis_lies_in_its_interval_as_often_as_it_should():
    rng = np.random.default_rng(3)
    for n in (10, 40, 300):
        low, high = chi_square_interval(np.array(n))
        mean = (rng.standard_normal((4000, n)) ** 2).mean(axis=1)
        assert np.mean((mean >= low) & (mean <= high)) == pytest.approx(0.95, abs=0.012)


def test_windows_of_nis_hold_every_sighting_used_once():
    _, track = made_up(seconds=60.0)
    spans, number, mean = windowed_nis(track)
    seen = track.innovations
    nis = (seen.value / seen.sigma)[seen.accepted] ** 2
    assert number.sum() == nis.size
    assert number.min() >= 10
    assert number @ mean == pytest.approx(nis.sum())
    assert np.all(spans[1:, 0] >= spans[:-1, 1])
