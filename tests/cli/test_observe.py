"""`homeward plan --landmarks` as a user would call it."""

import numpy as np
import pytest
import yaml
from commands import call, done

from homeward.lab.report.observe import draw_drive_view, drive_summary
from homeward.lab.studies.observing import observe_drive
from homeward.runs.single_run import RunSettings, prepare


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (
            ("--landmarks", 2),
            ["4 of the 5", "circle through itself, L1 and L2", "bearings to"],
        ),
        (("--landmarks", 2, "--compass"), ["5 of the 5", "Everything is observable"]),
        (
            ("--landmarks", 5, "--unknown", "speed-scale"),
            ["13 of 14", "speed's scale and all distances"],
        ),
    ],
)
def test_a_model(tmp_path, options, words):
    out = tmp_path / "out"
    answer = done(call("plan", *options, "--out", out))
    for part in words:
        assert part in answer.stdout
    assert {p.name for p in out.iterdir()} == {
        "observe.html",
        "observe.png",
        "observe.svg",
        "observe.yaml",
    }
    page = (out / "observe.html").read_text()
    assert page.count("wrong sign") == 3
    assert "9 of 9, all" in page
    assert "http" not in page.replace("http-equiv", "").replace("http://www.w3.org", "")


def test_the_sample_drive(tmp_path):
    out = tmp_path / "out"
    answer = done(call("plan", "--drive", "sample", "--window", 60, "--out", out))
    assert "In single windows" in answer.stdout
    assert yaml.safe_load((out / "observe.yaml").read_text())["window"] == 60.0


def test_an_empty_drive_is_drawn_too():
    drive, _, _ = prepare(RunSettings(drive="sample"))
    two = {k: v for k, v in drive.home.items() if k in ("L03", "L04")}
    view = observe_drive(
        type(drive)(drive.name, drive.odometry, drive.sightings, two, drive.settings, drive.truth),
        90.0,
    )
    assert np.isinf(view.whole.position_sigma)
    assert (
        "together do not determine the pose: home may lie anywhere on the circle"
        in drive_summary(view)
    )
    figure = draw_drive_view(view)
    figure.draw_without_rendering()
    above = figure.bbox.y1 - figure.axes[0].get_window_extent().y1
    assert above < 0.3 * figure.dpi, "room is left above the map"
