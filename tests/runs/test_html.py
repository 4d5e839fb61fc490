"""The parts of pages: text is escaped, and parts without content are left out."""

import json
import re

import pytest
from markupsafe import Markup

from homeward.runs.report import html

HOSTILE = "</script><b>&amp;"
SAFE = "&lt;/script&gt;&lt;b&gt;&amp;amp;"


@pytest.mark.parametrize(
    "part",
    [
        html.header(HOSTILE),
        html.section(HOSTILE, html.note("a")),
        html.summary(HOSTILE),
        html.paragraph(HOSTILE),
        html.note("a", HOSTILE),
        html.facts({HOSTILE: HOSTILE}),
        html.bullets([HOSTILE]),
        html.details("a", HOSTILE),
        html.table("l", [["head"], [HOSTILE]]),
        html.plot("map", HOSTILE),
    ],
)
def test_text_is_escaped_and_markup_is_not(part):
    assert SAFE in part
    assert HOSTILE not in part
    assert html.note(Markup("<em>a</em>")) == '<p class="note"><em>a</em></p>'


def test_parts_without_content_are_left_out():
    parts = [html.note(""), html.note("", ""), html.paragraph(""), html.bullets([])]
    parts += [
        html.table("lr", [["head", "n"]]),
        html.section("empty", html.EMPTY, html.bullets([])),
    ]
    assert set(parts) == {""}


def test_columns_and_rows_have_their_classes():
    table = html.table("wr", [["name", "n"], ["a", 1], ["b", 2]], marked=[1])
    assert '<th>name</th><th class="n">n</th>' in table
    assert '<tr><td class="wide">a</td><td class="n">1</td></tr>' in table
    assert '<tr class="moved"><td class="wide">b</td>' in table
    with pytest.raises(ValueError, match="zip"):
        html.table("wr", [["name", "n"], ["a"]])


def test_contents_lead_to_every_section():
    body = [html.section("RMSE [m] & more", html.note("a")), html.figures([("Map", "<svg></svg>")])]
    links = html.contents(body)
    assert re.findall('<a href="#(.*?)">(.*?)</a>', links) == [
        ("rmse-m-more", "RMSE [m] &amp; more"),
        ("map", "Map"),
    ]
    assert all(f'id="{at}"' in "".join(body) for at in ("rmse-m-more", "map"))


def test_data_cannot_end_their_element():
    page = html.page("a", data=json.dumps({"name": HOSTILE}), scripts=["run();"])
    data = re.search('<script type="application/json" id="data">(.*?)</script>', page)[1]
    assert json.loads(data) == {"name": HOSTILE}
    assert "script-src" in page
    assert "script-src" not in html.page("a", html.note("b"))


@pytest.mark.parametrize("package", ["homeward.runs.report", "homeward.lab.report"])
def test_texts_are_closed_html(package):
    for name, own in html.texts(package).items():
        for key, text in own.items():
            tags = re.findall("<(/?)([a-z]+)>", text)
            opened = [tag for closing, tag in tags if not closing]
            assert opened == [tag for closing, tag in tags if closing], (name, key)
