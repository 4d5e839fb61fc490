"""Files that are not what they seem: one line, at once, and nothing of them is given away."""

import os
from pathlib import Path

import pytest
from cli.commands import call
from drives.refusals import refusal
from drives.valid_drive import put

from homeward.drives.folder import read_folder
from homeward.drives.importers.mrclam import read_mrclam
from homeward.drives.opening import open_drive
from homeward.drives.ros.settings import LogSettings
from homeward.drives.settings import DriveSettings
from homeward.errors import HomewardError, InputError, printable
from homeward.geometry.frames import Pose
from homeward.io import settings as yaml_text
from homeward.io.settings import MAX_DEPTH, MAX_SETTINGS_BYTES, nested, read_settings, read_tree
from homeward.lab.planning.settings import load_plan
from homeward.lab.simulation.render.room.settings import load_room
from homeward.lab.simulation.simulate import load_scenario
from homeward.lab.studies.study.plan import load_study
from homeward.runs.single_run import load_run
from homeward.vision.recorded.settings import read_image_settings

SETTINGS_READERS = {
    "drive.yaml": lambda file: read_settings(file, DriveSettings),
    "--topics": lambda file: read_settings(file, LogSettings),
    "--camera, images.yaml": read_image_settings,
    "study": lambda file: load_study(str(file)),
    "plan": lambda file: load_plan(str(file)),
    "simulate": lambda file: load_scenario(str(file)),
    "render": lambda file: load_room(str(file)),
    "run.yaml": load_run,
}
EVERY = pytest.mark.parametrize("read", SETTINGS_READERS.values(), ids=SETTINGS_READERS)
TYPED = pytest.mark.parametrize("read", [load_run, lambda file: load_study(str(file))])


@EVERY
def test_settings_come_from_regular_files_alone(tmp_path, read):
    os.mkfifo(fifo := tmp_path / "fifo.yaml")
    for odd in (fifo, Path("/dev/zero"), tmp_path):
        assert "not a regular file" in refusal(read, odd)
    (loop := tmp_path / "loop.yaml").symlink_to(loop)
    assert "symbolic links" in refusal(read, loop)
    with (huge := tmp_path / "huge.yaml").open("wb") as stream:
        stream.truncate(2**40)
    assert "too large for settings: more than 1 MiB" in refusal(read, huge)


@EVERY
@pytest.mark.parametrize(
    "text",
    [
        "a: " + "[" * 100_000,
        "{" * 3000,
        "a: &a [*a]",
        "a0: &a0 [x, x]\n" + "".join(f"a{i}: &a{i} [*a{i - 1}, *a{i - 1}]\n" for i in range(1, 40)),
        "a0: &a0 {k: 1}\n"
        + "".join(f"a{i}: &a{i} {{<<: [*a{i - 1}, *a{i - 1}]}}\n" for i in range(1, 40)),
        'a: "\\ud800"',
        "\x00",
        "- " * 60,
    ],
)
def test_yaml_that_is_a_trap(tmp_path, read, text):
    (file := tmp_path / "trap.yaml").write_text(text)
    assert len(text) < MAX_SETTINGS_BYTES
    assert len(refusal(read, file)) < 300


@EVERY
@pytest.mark.parametrize(
    "text", ["name: a\nname: b\n", "name: {x: 1, y: 2, x: 3}\n", "- {a: 1}\n- {b: 2, 'b': 2}\n"]
)
def test_a_key_given_twice_is_refused(tmp_path, read, text):
    (file := tmp_path / "twice.yaml").write_text(text)
    line = refusal(read, file)
    assert "is given twice, first in row" in line
    assert line.startswith(f", row {len(text.splitlines())}: ")


@TYPED
@pytest.mark.parametrize(
    "value",
    [
        '!!int ""',
        "!!int x",
        "!!float x",
        "!!timestamp x",
        "!!binary x",
        "!!set {x}",
        "!!bool maybe",
        "9" * 5000,
        "0x" + "f" * 5000,
        "1:" * 5000 + "1",
        "1" * 50,
        "{[1]: 2}",
    ],
)
def test_values_that_are_not_what_their_tag_says(tmp_path, read, value):
    (file := tmp_path / "odd.yaml").write_text(f"seed: {value}\n")
    assert refusal(read, file)


def test_so_many_values_and_no_more(tmp_path, monkeypatch):
    monkeypatch.setattr(yaml_text, "MAX_VALUES", 1000)
    (file := tmp_path / "x.yaml").write_text("a: [" + "1," * 997 + "]")
    assert len(read_tree(file)["a"]) == 997
    file.write_text("a: [" + "1," * 998 + "]")
    assert "more than 1,000 values" in refusal(read_tree, file)
    file.write_text("a: &a [" + "1," * 329 + "]\nb: [*a, *a]")
    assert read_tree(file)["b"] == [[1] * 329] * 2
    file.write_text("a: &a [" + "1," * 400 + "]\nb: [*a, *a]")
    assert "row 2: more than 1,000 values, aliases expanded" in refusal(read_tree, file)


def test_a_date_is_text(tmp_path):
    (file := tmp_path / "x.yaml").write_text("a: 2001-99-99\nb: 2001-01-01\nc: [1, 2.5, true, ~]\n")
    assert read_tree(file) == {"a": "2001-99-99", "b": "2001-01-01", "c": [1, 2.5, True, None]}


def test_keys_in_dots_lie_only_so_deep():
    assert nested({"a.b.c": 1}) == {"a": {"b": {"c": 1}}}
    with pytest.raises(InputError, match="no key has more than 50 levels"):
        nested({"a" + ".a" * MAX_DEPTH: 1})


@pytest.mark.parametrize("name", ["drive.yaml", "truth.csv", "odometry.csv", "images.csv"])
def test_a_link_that_leads_nowhere_is_not_taken_for_absent(tmp_path, name):
    folder = put(tmp_path / "drive", drive_yaml=None, truth_csv=None, odometry_csv=None)
    (folder / name).symlink_to(folder / name)
    if name == "images.csv":
        (folder / "bearings.csv").unlink()
        (folder / "odometry.csv").write_text("t,v,omega\n0,0,0\n")
    elif name != "odometry.csv":
        (folder / "odometry.csv").write_text("t,v,omega\n0,0,0\n")
    told = refusal(open_drive, folder)
    assert name in told
    assert "symbolic links" in told


SECRET = "warden:Sesame:0:0 magpie"


@pytest.mark.parametrize("name", ["odometry.csv", "bearings.csv", "home.csv", "truth.csv"])
def test_the_first_line_of_a_table_is_never_told(tmp_path, name):
    folder = put(tmp_path / "drive")
    (secret := tmp_path / "elsewhere").write_text(f"{SECRET}\nmore, of it\n")
    (folder / name).unlink()
    (folder / name).symlink_to(secret)
    told = refusal(read_folder, folder)
    assert "no column" in told
    assert "in the header; use homeward import" in told
    assert not any(word in told for word in SECRET.replace(":", " ").split() if len(word) > 2)


def test_nor_is_that_of_a_file_without_a_header(tmp_path):
    (tmp_path / "Barcodes.dat").write_text("1 5\n")
    (tmp_path / "Robot1_Odometry.dat").write_text("0 0 0\n")
    (secret := tmp_path / "secret").write_text("token Sesame 0 0 0\n")
    (tmp_path / "Landmark_Groundtruth.dat").symlink_to(secret)
    told = refusal(read_mrclam, tmp_path, 1, Pose(0.0, 0.0, 0.0))
    assert "subject: must be a finite number" in told
    assert "token" not in told


def test_tables_come_from_regular_files_with_lines_that_end(tmp_path):
    folder = put(tmp_path / "drive")
    (table := folder / "bearings.csv").unlink()
    os.mkfifo(table)
    assert "not a regular file" in refusal(read_folder, folder)
    table.unlink()
    with table.open("wb") as stream:
        stream.write(b"t,landmark,bearing\n")
        stream.truncate(2**40)
    assert "characters or more" in refusal(read_folder, folder)


def test_the_row_of_what_is_no_text_is_told(tmp_path):
    for ends in (b"\n", b"\r\n", b"\r"):
        rows = [b"t,landmark,bearing", "0.1,ä,0.5".encode(), b"0.2,\xff,0.5", b"0.3,a,0.5"]
        folder = put(tmp_path / "drive", bearings_csv=ends.join(rows))
        assert "bearings.csv, row 3: not UTF-8" in refusal(read_folder, folder)


def test_errors_print_what_a_terminal_would_act_on():
    told = str(InputError("no topic /\x1b[2J\n\u202eodom", Path("a\tb\udcff")))
    assert told == r"a\tb\udcff: no topic /\x1b[2J\n\u202eodom"
    assert str(HomewardError("one\nline")) == r"one\nline"
    assert printable("door 7, größer") == "door 7, größer"


@pytest.mark.parametrize(
    "words",
    [
        ["simulate", "x" * 5000, "--out", "{out}"],
        ["study", "x" * 5000, "--out", "{out}"],
        ["plan", "x" * 5000, "--out", "{out}"],
        ["simulate", "x" * 5000, "--images", "--out", "{out}"],
        ["info", "x" * 5000],
        ["convert", "x" * 5000, "{out}"],
        ["run", "x" * 5000 + ".yaml", "--out", "{out}"],
        ["run", "sample", "--out", "{tmp}/" + "x" * 300],
        ["run", "{tmp}/loop", "--out", "{out}"],
        ["run", "sample", "--set", "a=[" + "[" * 2000, "--out", "{out}"],
        ["run", "sample", "--set", "a." * 5000 + "a=1", "--out", "{out}"],
        ["run", "sample", "--set", "a=2001-99-99", "--out", "{out}"],
        ["run", "sample", "--set", "gate=!!int", "--out", "{out}"],
        ["simulate", "circle", "--set", "a." * 5000 + "a=1", "--out", "{out}"],
        ["simulate", "circle", "--set", "name=" + "9" * 5000, "--out", "{out}"],
        ["simulate", "circle", "--set", "seed=" + "9" * 4000, "--out", "{out}"],
    ],
    ids=lambda words: f"{words[0]} {words[1][:8]} {words[-2][:6]}",
)
def test_from_the_command_line_one_line_and_nothing_written(tmp_path, words):
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    words = [word.format(tmp=tmp_path, out=tmp_path / "out") for word in words]

    result = call(*words)
    assert result.exit_code == 2, (result.output, result.exception)
    assert len(result.stderr.strip().splitlines()) == 1
    assert sorted(p.name for p in tmp_path.iterdir()) == ["loop"]
