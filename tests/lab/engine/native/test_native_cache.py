"""Compiled code as it is kept: once, for its owner alone, and never trusted blindly."""

import os
import stat
import subprocess
import sys

import numpy as np
import pytest
from native_rig import answer, toy

from homeward.lab.engine.native import compiler, library
from homeward.lab.engine.native.cache import Cache, default_folder
from homeward.lab.engine.native.source import NativeProgram


def test_code_is_compiled_once_and_kept_for_its_owner_alone(cache, monkeypatch):
    assert answer(toy()) == pytest.approx(2 * np.sin(0.5), abs=1e-15)
    kept = list(cache.glob("*"))
    assert len(kept) == 1
    assert stat.S_IMODE(cache.stat().st_mode) == 0o700
    library._load.cache_clear()
    monkeypatch.setattr(compiler.Compiler, "compile", None)
    assert answer(toy()) == pytest.approx(2 * np.sin(0.5), abs=1e-15)
    with pytest.raises(TypeError):
        answer(toy(3.0))


@pytest.mark.parametrize("harm", ["cut", "foreign", "empty", "folder"])
def test_a_file_that_is_not_what_it_was_is_never_loaded(cache, harm, tmp_path):
    answer(toy())
    file = next(cache.glob("*.so"))
    good = file.read_bytes()
    file.unlink()
    if harm == "folder":
        file.mkdir()
    else:
        foreign = good.replace(b"homeward_part", b"homeward_trap")
        file.write_bytes({"cut": good[: len(good) // 2], "foreign": foreign, "empty": b""}[harm])
    library._load.cache_clear()
    assert answer(toy()) == pytest.approx(2 * np.sin(0.5), abs=1e-15)


@pytest.mark.parametrize("harm", ["open", "file", "link", "foreign", "read-only"])
def test_a_cache_that_cannot_be_trusted_is_not_used(cache, harm, tmp_path, monkeypatch):
    cache.parent.mkdir()
    if harm == "open":
        cache.mkdir()
        cache.chmod(0o777)
    elif harm == "file":
        cache.write_text("")
    elif harm == "link":
        (tmp_path / "elsewhere").mkdir(mode=0o700)
        cache.symlink_to(tmp_path / "elsewhere")
    elif harm == "foreign":
        monkeypatch.setattr(os, "getuid", lambda: 12345)
    else:
        cache.mkdir(mode=0o700)
        asked = os.access
        monkeypatch.setattr(os, "access", lambda p, *m: p != cache and asked(p, *m))
    native = NativeProgram(toy())
    assert "cannot be cached" in native.library.notes[0]
    assert "\n" not in native.library.notes[0]
    native.variables["x"][:] = 0.5
    native.do("part")
    assert native.variables["y"][0] == pytest.approx(2 * np.sin(0.5), abs=1e-15)
    assert not list(tmp_path.rglob("*.so"))


def test_processes_that_compile_at_once_agree(cache, tmp_path):
    program = "import native_rig as r, sys; sys.stdout.write(repr(r.answer(r.toy(5.0))))"
    given = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    several = [
        subprocess.Popen([sys.executable, "-c", program], env=given, stdout=subprocess.PIPE)
        for _ in range(3)
    ]
    answers = {p.communicate(timeout=100)[0] for p in several}
    assert [float(a) for a in answers] == [pytest.approx(5 * np.sin(0.5), abs=1e-15)]
    assert all(Cache(cache).find(f.stem.split("-")[0]) for f in cache.glob("*.so"))
    assert not list(cache.glob(".writing-*"))


def test_the_cache_folder_follows_the_platform(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", "relative/is/ignored")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert default_folder() == tmp_path / ".cache" / "homeward"
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "x"))
    assert default_folder() == tmp_path / "x" / "homeward"
