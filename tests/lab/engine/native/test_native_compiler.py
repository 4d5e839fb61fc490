"""Which compiler is found, everything that one can do wrong, and what runs without one."""

import time

import numpy as np
import pytest
from native_rig import COMPILER, answer, toy
from test_steps import run

from homeward.lab.engine.estimators.runner import filter_machine
from homeward.lab.engine.native import compiler
from homeward.lab.engine.native.compiler import NativeError, find_compiler
from homeward.lab.engine.native.source import choose
from homeward.lab.filters.ekf import ExtendedKalmanFilter
from homeward.lab.model import PolarModel

REAL = COMPILER.command[0]


def fake_compiler(folder, monkeypatch, body):
    """Make CC a shell script; $OUT in it is the library that is asked for."""
    script = folder / "fake-cc"
    asked = 'if [ "$1" = --version ]; then echo fake 1.0; exit 0; fi\n'
    find = 'while [ "$1" != -o ]; do shift; done; OUT=$2\n'
    script.write_text("#!/bin/sh\n" + asked + find + body + "\n")
    script.chmod(0o755)
    monkeypatch.setenv("CC", str(script))


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ("echo 'x.c:1: error: no space left' >&2; exit 1", "no space left"),
        ("exit 0", "wrote no file"),
        ("echo garbage > $OUT", "cannot be loaded"),
        ("head -c 300 /bin/sh > $OUT", "cannot be loaded"),
        ("mkdir $OUT", "wrote no file"),
        ("sleep 60 & sleep 60", "took more than"),
        ("kill -9 $$", "failed"),
        (f"echo 'int x;' > $OUT.c; {REAL} -shared -o $OUT $OUT.c", "cannot be loaded"),
    ],
)
def test_a_compiler_that_fails_is_said_to_and_leaves_nothing(
    cache, body, words, tmp_path, monkeypatch
):
    monkeypatch.setattr(compiler, "COMPILE_S", 0.5)
    fake_compiler(tmp_path, monkeypatch, body)
    began = time.monotonic()
    with pytest.raises(NativeError, match=words) as caught:
        answer(toy())
    assert "\n" not in str(caught.value)
    assert time.monotonic() - began < 30
    assert list(cache.glob("*")) == []


@pytest.mark.parametrize("named", ["/nowhere/cc", "/", "'unbalanced", "/etc/passwd"])
def test_a_compiler_that_is_none_is_said_to_be(named, monkeypatch):
    monkeypatch.setenv("CC", named)
    with pytest.raises(NativeError, match="CC="):
        find_compiler()


def test_a_compiler_with_arguments_is_called_with_them(cache, monkeypatch):
    monkeypatch.setenv("CC", f"{REAL} -g0")
    assert answer(toy()) == pytest.approx(2 * np.sin(0.5), abs=1e-15)


def test_a_version_that_hangs_is_not_waited_for(cache, tmp_path, monkeypatch):
    script = tmp_path / "slow-cc"
    script.write_text("#!/bin/sh\nsleep 60\n")
    script.chmod(0o755)
    monkeypatch.setenv("CC", str(script))
    monkeypatch.setattr(compiler, "VERSION_S", 0.3)
    with pytest.raises(NativeError, match="took more than"):
        find_compiler()


def test_without_a_compiler_the_interpreter_runs_with_a_note(cache, tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CC", raising=False)
    kind = ExtendedKalmanFilter(PolarModel(3))
    asked = filter_machine(kind, "native")
    assert asked.engine == "interpreter"
    assert len(asked.notes) == 1
    assert "no C compiler found" in asked.notes[0]
    assert filter_machine(kind, "auto", steps=10**8).notes == asked.notes
    # A short run would not have been compiled anyway.
    assert filter_machine(kind, "auto", steps=100).notes == ()
    assert run(kind, asked, 3, 50, 1, np.inf, 1) < 1e-9


def test_auto_compiles_where_it_pays_and_uses_what_is_there(cache):
    kind = ExtendedKalmanFilter(PolarModel(3))
    assert filter_machine(kind, "auto", steps=100).engine == "interpreter"
    assert not cache.exists()
    assert filter_machine(kind, "auto", steps=10**7).engine == "native"
    assert filter_machine(kind, "auto", steps=1).engine == "native"
    assert filter_machine(kind, "interpreter", steps=10**7).engine == "interpreter"


def test_the_choice_passes_other_errors_on():
    def broken():
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        choose("native", 0.0, broken, "")
