"""The exported C, compared with Python: on this machine, and on an emulated Cortex-M4F."""

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from cli.commands import call, done, refused

from benchmarks.mcu import (
    LIMITS,
    REPLAY,
    arm_build,
    emulation,
    end_errors,
    export,
    figures,
    host_build,
    missing,
    replayed,
    samples,
    scene,
)
from homeward.lab.engine.export.source import FUNCTIONS, max_cost
from homeward.lab.filters.settings import FilterSettings

HERE = Path(__file__).parent
pytestmark = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")


@pytest.mark.parametrize(
    ("q", "moved", "single"),
    [(1, 0, False), (12, 0, True), (12, 2, False), (32, 3, False), (32, 3, True)],
)
def test_the_c_is_the_python_filter(tmp_path, q, moved, single):
    drive = samples(scene(q, moved, seed=3).drive)
    export(tmp_path, q, single)
    found = replayed([host_build(tmp_path)], drive.text).numbers
    assert (found[:, 2] == 0).all()
    assert np.abs(found[:, 4:] - drive.python).max() < (2e-4 if single else 1e-9)


def test_gaps_and_turned_back_stamps_are_python_s(tmp_path):
    """Odometry is missing for three seconds; one sample of each kind comes late."""
    drive = scene(7, 0, seed=1).drive
    o = drive.odometry
    keep = (o.t < 2) | (o.t > 5)
    object.__setattr__(drive, "odometry", type(o)(o.t[keep], o.v[keep], o.omega[keep]))
    given = samples(drive)
    export(tmp_path, 7, single=False)
    exe = host_build(tmp_path)
    found = replayed([exe], given.text).numbers
    assert np.abs(found[:, 4:] - given.python).max() < 1e-9
    late = replayed([exe], given.text + "o 10 9.0 9.0\nb 10 1 0 0.5 0\no 60000000 nan 0\n").numbers
    assert late[-3:, 2].tolist() == [1, 1, 2]
    assert (late[-3:, 4:] == late[-4, 4:]).all()


def test_stamps_may_wrap_round(tmp_path):
    given = samples(scene(7, 0, seed=1).drive)
    head, *rows = given.text.splitlines()
    shifted = [row.split(" ", 2) for row in rows]
    turned = [f"{k} {(int(t) + 2**32 - 3_000_000) % 2**32} {rest}" for k, t, rest in shifted]
    export(tmp_path, 7, single=False)
    exe = host_build(tmp_path)
    wrapped = replayed([exe], "\n".join([head, *turned])).numbers
    assert (wrapped == replayed([exe], given.text).numbers).all()


def test_only_the_named_functions_are_called(tmp_path):
    export(tmp_path, 12, single=True)
    done = tmp_path / "ekf.o"
    subprocess.run(
        ["cc", "-std=c99", "-O2", "-c", tmp_path / "src" / "homeward_ekf.c", "-o", done], check=True
    )
    called = subprocess.run(["nm", "-u", done], capture_output=True, text=True, check=True).stdout
    allowed = {f + "f" for f in FUNCTIONS} | {"memcpy", "memset"}
    allowed |= {"sincosf", "__stack_chk_fail", "_GLOBAL_OFFSET_TABLE_"}  # what compilers make of it
    assert set(called.split()) - {"U"} <= allowed


@pytest.mark.skipif(shutil.which("c++") is None, reason="no C++ compiler")
@pytest.mark.parametrize("q", [3, 7, 12])
def test_the_printed_work_is_what_is_done(tmp_path, q):
    export(tmp_path, q, single=False)
    source = tmp_path / "src"
    header = (source / "homeward_ekf.h").read_text()
    (source / "homeward_ekf.h").write_text(
        header.replace('extern "C"', 'extern "C++"').replace(
            "typedef double", '#include "counting.h"\ntypedef Counting'
        )
    )
    replay = REPLAY.read_text().replace(
        "static uint32_t begin(void) { return 0; }",
        "long arithmetic, functions;\n"
        "static uint32_t begin(void) { return arithmetic = functions = 0; }",
    )
    replay = replay.replace(
        "instructions(uint32_t since) { return since; }",
        "instructions(uint32_t since) { return since + (uint32_t)arithmetic; }",
    ).replace("stack(void) { return 0; }", "stack(void) { return (uint32_t)functions; }")
    (tmp_path / "replay.cpp").write_text(replay)
    files = [tmp_path / "replay.cpp", "-x", "c++", source / "homeward_ekf.c"]
    folders = ["-I", source, "-I", HERE, "-o", tmp_path / "replay"]
    subprocess.run(["c++", "-std=c++20", "-w", "-O1", *folders, *files], check=True)
    drive = scene(q, 0, seed=3).drive
    marks = " ".join(f"{i} {0.1 * i} 0" for i in range(q))
    head = samples(drive).text.splitlines()[0]
    lines = [head, "o 0 0.1 0", f"b 0 {q} {marks}", "o 50000 0.1 0", f"b 100000 {q} {marks}"]
    found = replayed([tmp_path / "replay"], "\n".join([*lines, "o 90000000 0.1 0"]))
    counted = [tuple(map(int, row[:2])) for row in found.numbers]
    most = max_cost(q, FilterSettings())
    assert counted[2] == most["odometry"]
    assert counted[3] == most["bearings"]
    assert counted[4] == most["odometry, longest"]
    solved = replayed([tmp_path / "replay"], samples(drive, 1.0).text).answers[-1, :2]
    assert (solved <= most["solve"]).all()
    assert (solved > 0.9 * np.array(most["solve"])).all() or q < 7


@pytest.mark.parametrize(("q", "moved"), [(7, 1), (12, 2)])
def test_a_moved_landmark_is_left_out(tmp_path, q, moved):
    runs = end_errors(tmp_path, q, moved, range(100, 110))
    assert runs.right.mean() >= 0.9
    assert runs.rms("exported") < 1.5 * runs.rms("bound")
    assert runs.rms("ekf") > 3 * runs.rms("exported")


def test_an_export(tmp_path):
    out = tmp_path / "out"
    words = "export", "ekf", "--landmarks", 12, "--out", out, "--set", "gate=null"
    assert "maximum per call" in done(call(*words)).stdout
    names = {p.name for p in out.iterdir()}
    assert names == {"library.json", "library.properties", "src", "examples"}
    assert "gate = INFINITY" in (out / "src" / "homeward_ekf.c").read_text()
    done(call("export", "ekf", "--landmarks", 7, "--out", out))
    files = [out / "src" / "homeward_ekf.c", out / "examples" / "cortex_m4f" / "main.c"]
    exe = tmp_path / "main"
    flags = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-I", out / "src"]
    subprocess.run(["cc", *flags, *files, "-lm", "-o", exe], check=True)
    assert subprocess.run([exe]).returncode == 0


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["ekf", "--landmarks", "0"], "1 to 32 landmarks, not 0"),
        (["ekf", "--landmarks", "33"], "1 to 32 landmarks, not 33"),
        (["ekf", "--landmarks", "7", "--set", "gate=2"], "gate"),
        (["ekf", "--landmarks", "7", "--set", "nonsense=1"], "nonsense"),
        (["robust", "--landmarks", "7"], "robust"),
        (["ekf", "--landmarks", "7", "--target", "rust"], "rust"),
    ],
)
def test_what_cannot_be_exported_is_said(tmp_path, words, message):
    answer = call("export", *words, "--out", tmp_path / "out")
    assert answer.exit_code == 2
    assert message in answer.output
    assert not (tmp_path / "out").exists()


def test_exporting_again_keeps_the_files_of_the_user(tmp_path):
    words = "export", "ekf", "--landmarks", 7, "--out", tmp_path / "lib"
    assert call(*words).exit_code == 0
    written = {p for p in (tmp_path / "lib").rglob("*") if p.is_file()}
    mine = [tmp_path / "lib" / name for name in ("src/mine.c", "examples/own/main.c", "notes.md")]
    for file in mine:
        file.parent.mkdir(exist_ok=True)
        file.write_text("mine")
    for file in written:
        file.write_text("stale")
    (tmp_path / "lib" / "library.properties").write_text("name=homeward")
    assert call(*words).exit_code == 0
    assert all(file.read_text() == "mine" for file in mine)
    assert all(file.read_text() != "stale" for file in written)


def test_a_folder_of_others_is_left_alone(tmp_path):
    (tmp_path / "mine.txt").write_text("mine")
    answer = call("export", "ekf", "--landmarks", 7, "--out", tmp_path)
    assert "contains other files" in refused(answer)
    assert [p.name for p in tmp_path.iterdir()] == ["mine.txt"]


@pytest.mark.skipif(bool(missing()), reason=f"not installed: {', '.join(missing())}")
class TestOnTheCortexM4F:
    def test_every_sample_is_python_s(self, tmp_path):
        drive = samples(scene(12, 2, seed=3).drive)
        for single, tolerance in ((True, 2e-4), (False, 1e-9)):
            export(tmp_path, 12, single)
            image = arm_build(tmp_path, REPLAY)
            found = replayed(emulation(image), drive.text).numbers
            assert np.abs(found[:, 4:] - drive.python).max() < tolerance

    def test_the_example_finds_out_the_moved_landmark(self, tmp_path):
        export(tmp_path, 12, single=True)
        image = arm_build(tmp_path, tmp_path / "examples" / "cortex_m4f" / "main.c")
        assert subprocess.run(emulation(image), timeout=60).returncode == 0

    def test_it_fits(self, tmp_path):
        found = figures(tmp_path)
        assert set(found) == set(LIMITS)
        assert not [k for k, limit in LIMITS.items() if not 0 < found[k] <= limit], found
