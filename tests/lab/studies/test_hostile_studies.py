"""Studies whose names are odd, whose blocks are damaged, and whose disk is full."""

import json
import subprocess
import sys

import numpy as np
import pytest
from cli.commands import done
from lab.studies.chores import draw_no_figures, in_this_process
from lab.studies.test_study import QUICK, call, computed, plan_of, written

from homeward.drives.opening import open_drive
from homeward.errors import InputError
from homeward.io.writing import check_output
from homeward.lab.report.study.page import PAGE, write_study
from homeward.lab.studies.blocks.store import MARKER, BlockStore, store_of
from homeward.lab.studies.study.plan import block_name
from homeward.lab.studies.study.results import _gather
from homeward.runs.report.canvas import plain
from homeward.runs.single_run import sample_drive

SETTINGS = {"runs": 1}


ODD = [r"$\frac$", "$x", r"\$\alpha$", "\x1b[31mred", "two\nlines", "<b>"]


def test_labels_are_plain_text_wherever_they_are_drawn(tmp_path):
    entries = [{"estimator": "ekf", "label": label} for label in ODD]
    grid = {ODD[0]: {ODD[1]: {"seed": 1}}}
    plan = plan_of(tmp_path, runs=1, estimators=entries, grid=grid)
    folder = tmp_path / "out"
    write_study(folder, computed(plan, folder))
    page = (folder / PAGE).read_text()
    drawn = "".join(part.partition("</svg>")[0] for part in page.split("<svg")[1:])
    for label in (r"$\frac$", "$x", r"\$\alpha$", r"\x1b[31mred", r"two\nlines", "&lt;b&gt;"):
        assert label in drawn
    assert len(list(folder.glob("*.png"))) == 3


@pytest.fixture
def light(monkeypatch):
    """Compute blocks in this process, and draw no figures."""
    monkeypatch.setattr("homeward.lab.studies.blocks.finish.on_processes", in_this_process)
    draw_no_figures(monkeypatch)


@pytest.mark.usefixtures("light")
def test_a_label_is_printed_so_that_a_terminal_does_nothing_else(tmp_path):
    label = "\x1b[2J\nhome"
    file = written(tmp_path, runs=1, grid={}, estimators=[{"estimator": "ekf", "label": label}])
    result = done(call("study", file, "--out", tmp_path / "out"))
    assert r"\x1b[2J\nhome" in result.stdout
    assert "\x1b" not in result.stdout


def test_a_label_without_a_formula_is_drawn_as_it_is():
    assert plain("A-EKF, größer") == "A-EKF, größer"
    assert plain("5 $") == r"5 \$"


def zeroed(data):
    at = len(data) // 3
    return data[:at] + bytes(40) + data[at + 40 :]


@pytest.mark.parametrize(
    "spoil",
    [
        lambda data: b"",
        lambda data: data[: len(data) // 2],
        zeroed,
        lambda data: data.replace(b"\x08\x00", b"\x63\x00"),
        lambda data: b"\x93NUMPY\x01\x00" + data,
        lambda data: b"PK\x03\x04" + bytes(100),
    ],
)
def test_a_damaged_block_counts_as_missing(tmp_path, spoil):
    store = BlockStore(tmp_path / "out", SETTINGS, MARKER)
    store.save("b", {"x": np.arange(1000.0), "words": np.array(["", "why"])})
    file = tmp_path / "out" / "blocks" / "b.npz"
    file.write_bytes(spoil(file.read_bytes()))
    assert "b" not in store
    with pytest.raises(InputError, match="missing or damaged"):
        store.load("b")


@pytest.mark.parametrize("arrays", [{}, {"position_rmse": np.zeros((7, 7))}])
def test_a_whole_block_of_something_else_is_told_of(tmp_path, arrays):
    plan = plan_of(tmp_path)
    store = store_of(plan.study, tmp_path / "out")
    store.save(block_name(0, 0), arrays)
    with pytest.raises(InputError, match="is not of this study"):
        _gather(plan, store)


CHILD = """
import resource, sys
sys.dont_write_bytecode = True  # Python 3.11 leaves half a file, and imports it the next time
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[1]),) * 2)
from homeward.cli.main import app
app(sys.argv[2:])
"""


def with_a_full_disk(size, *words):
    """Call a command that cannot write more than so many bytes into any file."""
    # -B: Python would keep compiled modules that were cut off, and break every later test.
    words = [sys.executable, "-B", "-c", CHILD, str(size), *map(str, words)]
    done = subprocess.run(words, capture_output=True, text=True)
    assert done.returncode == 2, done.stderr
    # matplotlib has a line of its own for a cache that it cannot write.
    told = [line for line in done.stderr.strip().splitlines() if "font_manager" not in line]
    assert len(told) == 1, told
    (line,) = told
    assert "cannot be written" in line
    return line


@pytest.mark.parametrize("name", ["x.db3", "x.mcap", "x.bag", "drive"])
def test_a_full_disk_leaves_no_half_of_a_drive(tmp_path, name):
    with_a_full_disk(20_000, "convert", sample_drive(), tmp_path / name)
    assert not list(tmp_path.iterdir())
    done(call("convert", sample_drive(), tmp_path / name))
    assert open_drive(tmp_path / name).odometry.t.size == 3604


@pytest.mark.usefixtures("light")
@pytest.mark.parametrize("size", [300, 20_000, 41_000])
def test_a_study_goes_on_when_there_is_room_again(tmp_path, size):
    """Whatever was to be written when there was none left: marker, manifest, block or results."""
    file, out = written(tmp_path, runs=1, grid={}, estimators=["ekf"]), tmp_path / "out"
    words = ("study", file, "--out", out)
    with_a_full_disk(size, *words, "--workers", "1")
    check_output(out, MARKER)
    assert not out.exists() or not [p for p in out.rglob("*") if "writing" in p.name]
    done(call(*words))
    assert json.loads((out / "blocks" / "manifest.json").read_text())["name"] == QUICK["name"]
