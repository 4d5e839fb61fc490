"""Several estimators over one drive, on one page; tables for papers."""

import csv

import pytest
from cli.commands import call, done, first_seconds

from homeward.runs.report.files import latex, markdown, write_tables

BAD = """
from homeward.estimator import Counts
class Bad:
    name, notes = "bad", ()
    def __init__(self, drive): self.counts = Counts()
    def odometry(self, t, v, omega): raise ValueError("<b>no</b>")
    def bearings(self, t, sightings, sigmas=None): pass
    def estimate(self, t): pass
    def landmarks(self): return []
"""


@pytest.fixture
def short(tmp_path):
    return first_seconds(tmp_path / "short", 8.0)


@pytest.fixture
def bad(tmp_path, monkeypatch):
    (tmp_path / "bad_one.py").write_text(BAD)
    monkeypatch.syspath_prepend(tmp_path)
    return "bad_one:Bad"


@pytest.mark.usefixtures("lab")
def test_several_estimators_share_a_page_and_one_that_fails_ends_nothing(short, bad, tmp_path):
    out = tmp_path / "out"
    result = done(call("run", short, "--estimator", f"robust, ekf,{bad}", "--out", out))
    assert "bad_one:Bad: odometry at 0 s raised ValueError: <b>no</b>" in result.stdout
    assert {p.name for p in out.iterdir()} == {
        *("estimators.html", "table.csv", "table.md", "table.tex"),
        *("paths.png", "errors.png", "robust", "ekf"),
    }
    page = (out / "estimators.html").read_text()
    assert 'href="ekf/report.html"' in page
    assert "&lt;b&gt;no" in page
    with (out / "table.csv").open() as stream:
        _, ekf, failed = csv.DictReader(stream)
    assert failed["unavailable"] == "1.0"
    assert failed["RMSE [m]"] == ""
    assert 0 < float(ekf["RMSE [m]"]) < 5
    done(call("run", out / "ekf" / "run.yaml", "--out", tmp_path / "again"))
    same = [(f / "estimate.csv").read_bytes() for f in (out / "ekf", tmp_path / "again")]
    assert same[0] == same[1]
    # The same command again replaces its own output.
    done(call("run", short, "--estimator", "ekf,robust", "--out", out))


def test_without_any_pose_the_exit_status_is_1(short, bad, tmp_path):
    twin = (tmp_path / "bad_one.py").read_text()
    (tmp_path / "bad_two.py").write_text(twin)
    words = ["run", short, "--estimator", f"{bad},bad_two:Bad", "--out", tmp_path / "out"]
    assert call(*words).exit_code == 1


@pytest.mark.usefixtures("lab")
def test_without_truth_the_page_shows_sigmas(short, tmp_path):
    (short / "truth.csv").unlink()
    out = tmp_path / "out"
    done(call("run", short, "--estimator", "robust,ekf", "--out", out))
    assert "position sigma" in (out / "estimators.html").read_text()


def test_tables_escape_what_their_formats_mean_otherwise(tmp_path):
    rows = [["a|b", "c_d"], ["50 %", "x\\y"]]
    assert markdown(rows).splitlines()[0] == "| a\\|b | c_d |"
    assert markdown(rows).splitlines()[1] == "| --- | --: |"
    text = latex(rows)
    assert r"a|b & c\_d \\" in text
    assert r"50 \% & x\textbackslash{}y \\" in text
    write_tables(tmp_path, rows, [["a,b", "n"], ["x", float("nan")], ["y", 0.1]])
    assert (tmp_path / "table.csv").read_text() == '"a,b",n\nx,\ny,0.1\n'
