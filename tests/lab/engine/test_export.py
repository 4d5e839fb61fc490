"""The exported C, compared with Python: on this machine, and on an emulated Cortex-M4F."""

import shutil
import subprocess
from pathlib import Path

import pytest
from cli.commands import call, done, refused

BOARD = Path(__file__).parent / "cortex_m4f"
ARM = ("arm-none-eabi-gcc", "qemu-system-arm")
WARNINGS = ("-Wall", "-Wextra", "-Werror", "-Wno-unused-parameter", "-Wdouble-promotion")
FLASH, RAM = 100_000, 24_000
"""Limits for 12 landmarks in floats, with the C library [bytes]."""
pytestmark = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")


def sources(folder):
    return [folder / "homeward_ekf.c", folder / "main.c"]


@pytest.mark.parametrize(
    ("q", "precision"), [(1, "double"), (12, "float"), (12, "double"), (32, "float")]
)
def test_the_example_has_the_pose_of_python(tmp_path, q, precision):
    """Its main compares to 1e-4 in floats, and to 1e-9 in doubles."""
    out = tmp_path / "out"
    done(call("export", "ekf", "--landmarks", q, "--precision", precision, "--out", out))
    assert {p.name for p in out.iterdir()} == {"homeward_ekf.c", "homeward_ekf.h", "main.c"}
    exe = tmp_path / "main"
    command = ["cc", "-std=c99", "-O1", *WARNINGS, *sources(out), "-lm", "-o", exe]
    subprocess.run(command, check=True)
    ran = subprocess.run([exe], capture_output=True, text=True)
    assert ran.returncode == 0, ran.stdout
    assert ran.stdout.startswith("x 0.6")


@pytest.mark.skipif(not all(map(shutil.which, ARM)), reason=f"not installed: {ARM}")
def test_it_fits_a_cortex_m4f_and_has_the_pose_of_python_there(tmp_path):
    done(call("export", "ekf", "--landmarks", 12, "--out", tmp_path / "out"))
    flags = ("-std=c99", "-Os", "-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=hard")
    flags += ("-mfpu=fpv4-sp-d16", "-ffunction-sections", "-fdata-sections", "-Wl,--gc-sections")
    image = tmp_path / "main.elf"
    board = [BOARD / "startup.c", "-T", BOARD / "mps2_an386.ld", "--specs=rdimon.specs", "-lm"]
    files = [*sources(tmp_path / "out"), *board, "-o", image]
    subprocess.run([ARM[0], *flags, *WARNINGS, *files], check=True)
    size = subprocess.run(["arm-none-eabi-size", image], capture_output=True, text=True, check=True)
    text, data, bss = map(int, size.stdout.splitlines()[1].split()[:3])
    assert text + data < FLASH, text + data
    assert data + bss < RAM, data + bss
    machine = "qemu-system-arm -M mps2-an386 -display none -serial none -monitor none"
    semihosting = ["-semihosting-config", "enable=on,target=native", "-kernel", image]
    assert subprocess.run([*machine.split(), *semihosting], timeout=60).returncode == 0


def test_settings_are_compiled_in(tmp_path):
    changes = ("--set", "gate=null", "--set", "speed_sigma=0.5")
    done(call("export", "ekf", "--landmarks", 3, "--out", tmp_path / "out", *changes))
    text = (tmp_path / "out" / "homeward_ekf.c").read_text()
    assert "gate = (homeward_real)INFINITY" in text
    assert "(homeward_real)0.25 / dt" in text


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["ekf", "--landmarks", "0"], "1 to 32 landmarks, not 0"),
        (["ekf", "--landmarks", "33"], "1 to 32 landmarks, not 33"),
        (["ekf", "--landmarks", "7", "--set", "gate=2"], "gate"),
        (["ekf", "--landmarks", "7", "--set", "nonsense=1"], "nonsense"),
        (["robust", "--landmarks", "7"], "robust"),
    ],
)
def test_what_cannot_be_exported_is_said(tmp_path, words, message):
    answer = call("export", *words, "--out", tmp_path / "out")
    assert answer.exit_code == 2
    assert message in answer.output
    assert not (tmp_path / "out").exists()


def test_exporting_again_keeps_the_files_of_the_user(tmp_path):
    words = "export", "ekf", "--landmarks", 3, "--out", tmp_path / "lib"
    done(call(*words))
    written = list((tmp_path / "lib").iterdir())
    (tmp_path / "lib" / "mine.c").write_text("mine")
    for file in written:
        file.write_text("stale")
    done(call(*words))
    assert (tmp_path / "lib" / "mine.c").read_text() == "mine"
    assert all(file.read_text() != "stale" for file in written)


def test_a_folder_of_others_is_left_alone(tmp_path):
    (tmp_path / "mine.txt").write_text("mine")
    answer = call("export", "ekf", "--landmarks", 7, "--out", tmp_path)
    assert "contains other files" in refused(answer)
    assert [p.name for p in tmp_path.iterdir()] == ["mine.txt"]
