"""Formats of other packages: the example of docs/do/sources.md, and sources that fail."""

import json
import re
import sys
from pathlib import Path

import numpy as np
import pytest
from cli.commands import call, done, refused

from homeward.drives.opening import open_drive

PAGE = (Path(__file__).parents[2] / "docs" / "do" / "sources.md").read_text(encoding="utf-8")
(EXAMPLE,) = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
FAULTY = """
def tables(path): return None if path.suffix != ".jsonl" else TABLES
"""


def install(folder, monkeypatch, text):
    """Install a module as a source, as pip does."""
    (folder / "my_robot.py").write_text(text)
    info = folder / "my_robot-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: my-robot\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[homeward.sources]\nmy-robot = my_robot:tables\n")
    monkeypatch.syspath_prepend(folder)
    monkeypatch.delitem(sys.modules, "my_robot", raising=False)


def write(file):
    """Write the sample drive as the log of the example."""
    drive = open_drive("sample")
    lines = [{"type": "home", "tags": [_tag(i, s.bearing) for i, s in drive.home.items()]}]
    o = drive.odometry
    for t, v, omega in zip(o.t, o.v, np.degrees(o.omega), strict=True):
        lines.append({"type": "odometry", "ms": 1e3 * t, "speed": 1e3 * v, "turn": omega})
    for t, seen, _ in drive.sightings.stamps():
        lines.append({"type": "tags", "ms": 1e3 * t, "tags": [_tag(*s) for s in seen.items()]})
    file.write_text("\n".join(map(json.dumps, lines)))
    return drive


def _tag(name, bearing):
    return {"id": str(name), "azimuth": float(np.degrees(bearing))}


def test_the_example_imports_a_log_as_the_drive_that_it_is(tmp_path, monkeypatch):
    install(tmp_path, monkeypatch, EXAMPLE)
    drive = write(tmp_path / "log.jsonl")
    found = done(call("import", tmp_path / "log.jsonl", "--out", tmp_path / "drive"))
    assert "twist.linear.x [mm/s]" in found.output
    read = open_drive(tmp_path / "drive")
    assert read.odometry.omega == pytest.approx(drive.odometry.omega)
    assert read.odometry.v == pytest.approx(drive.odometry.v)
    assert read.sightings.bearing == pytest.approx(drive.sightings.bearing)
    assert read.home.keys() == drive.home.keys()


@pytest.mark.parametrize(
    ("tables", "words"),
    [
        ("1 / 0", "source my-robot: reading log.jsonl raised ZeroDivisionError"),
        ("{}", "source my-robot returned no table"),
        ("{'a': {'t': [1], 'v': [1, 2]}}", "columns of unequal length"),
        ("{'../a': {'t': [1]}}", "'../a' is no name of a table"),
        ("{'a.csv': {'t': [1, 2], 'hum': [1, None]}}", "log.jsonl/a.csv: not recognised"),
    ],
)
def test_a_source_that_fails_ends_in_one_line(tmp_path, monkeypatch, tables, words):
    install(tmp_path, monkeypatch, FAULTY.replace("TABLES", tables))
    (tmp_path / "log.jsonl").write_text("")
    assert words in refused(call("import", tmp_path / "log.jsonl"))
