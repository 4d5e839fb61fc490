"""`homeward view` as a user would call it."""

import shutil
import sys

import pytest
from commands import call, done, first_seconds, refused

pytest.importorskip("rerun", reason="the extra view is not installed")


@pytest.fixture(scope="module")
def short(tmp_path_factory):
    """The first half minute of the sample drive."""
    return first_seconds(tmp_path_factory.mktemp("drives") / "short", 30.0)


@pytest.fixture(scope="module")
def ran(short, tmp_path_factory):
    out = tmp_path_factory.mktemp("out") / "run"
    done(call("run", short, "--out", out))
    return out


def test_a_run_becomes_a_recording(ran, tmp_path):
    file = tmp_path / "new" / "run.rrd"
    result = done(call("view", ran, "--rerun", file))
    assert result.stdout == f"Recording: {file}\n"
    assert file.read_bytes()[:3] == b"RRF"


def test_it_says_when_the_run_no_longer_repeats(ran, tmp_path):
    old = tmp_path / "old"
    shutil.copytree(ran, old)
    text = (old / "estimate.csv").read_text()
    (old / "estimate.csv").write_text(text.replace("localised", "unverified", 1))
    result = done(call("view", old, "--rerun", tmp_path / "run.rrd"))
    assert "has changed since" in result.stdout


def test_a_drive_that_is_gone_is_named(ran, tmp_path):
    old = tmp_path / "old"
    shutil.copytree(ran, old)
    text = (old / "run.yaml").read_text()
    (old / "run.yaml").write_text(text.replace("drive: ", "drive: /nowhere", 1))
    assert "no such file" in refused(call("view", old, "--rerun", tmp_path / "run.rrd"))
    assert not (tmp_path / "run.rrd").exists()


def test_a_wrong_name_is_refused_before_anything_is_run(tmp_path):
    refused(call("view", "sample", "--rerun", tmp_path / "run.txt"))


def test_without_the_extra_it_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "rerun", None)
    monkeypatch.delitem(sys.modules, "homeward.report.viewer.recording", raising=False)
    monkeypatch.delattr("homeward.report.viewer.recording", raising=False)
    assert "pip install -c constraints.txt -e '.[view]'" in refused(call("view", "sample"))
