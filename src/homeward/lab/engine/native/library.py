"""C functions in this process: from the cache, or compiled, tested and cached."""

from __future__ import annotations

import ctypes
import subprocess
import sys
import tempfile
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

from homeward.io.writing import scratch_folder
from homeward.lab.engine.native.cache import Cache, default_folder, key_of
from homeward.lab.engine.native.compiler import Compiler, NativeError, find_compiler

TEST_S = 60.0
"""Time limit for loading and calling a new library in another process [s]."""
_TEST = "import ctypes, sys; print(ctypes.CDLL(sys.argv[1]).homeward_lanes())"


class Library(NamedTuple):
    """Compiled code in this process."""

    functions: ctypes.CDLL
    lanes: int
    """Number of runs that the code computes in parallel."""
    notes: tuple[str, ...]
    """Notes for the user."""


def is_kept(source: str) -> bool:
    """Whether the compiled code of a source is in the cache; `NativeError` without a compiler."""
    cache = Cache(default_folder())
    return cache.problem() is None and cache.find(_key(source, find_compiler())) is not None


def load(source: str) -> Library:
    """Return the compiled code of a C source; `NativeError` without a compiler or if it fails."""
    return _load(source, find_compiler(), default_folder())


@lru_cache(maxsize=64)
def _load(source: str, compiler: Compiler, folder: Path) -> Library:
    cache, key = Cache(folder), _key(source, compiler)
    if (problem := cache.problem()) is not None:
        return _uncached(source, compiler, problem)
    try:
        if (found := cache.find(key)) is None:
            with scratch_folder(folder) as scratch:
                found = cache.keep(key, _compiled(source, compiler, scratch))
    except OSError as error:
        return _uncached(source, compiler, f"{folder}: {error.strerror}")
    return _opened(found, ())


def _key(source: str, compiler: Compiler) -> str:
    return key_of(source, compiler.identity)


def _uncached(source: str, compiler: Compiler, problem: str) -> Library:
    """Compile for this process only; the file can be deleted once loaded."""
    note = f"Compiled code cannot be cached, so each run compiles again: {problem}."
    try:
        with tempfile.TemporaryDirectory(prefix="homeward-") as scratch:
            return _opened(_compiled(source, compiler, Path(scratch)), (note,))
    except OSError as error:
        raise NativeError(f"no folder to compile in: {error.strerror}") from None


def _compiled(source: str, compiler: Compiler, scratch: Path) -> Path:
    text, library = scratch / "program.c", scratch / "program.so"
    text.write_text(source, encoding="utf-8")
    compiler.compile(text, library)
    _test(library, compiler)
    return library


def _test(library: Path, compiler: Compiler) -> None:
    """Test in another process that a library can be loaded."""
    failure = f"the library from {compiler.command[0]} cannot be loaded"
    try:
        test = subprocess.run(
            [sys.executable, "-I", "-S", "-c", _TEST, str(library)],
            capture_output=True,
            timeout=TEST_S,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired):
        raise NativeError(failure) from None
    if test.returncode != 0 or not test.stdout.strip().isdigit():
        raise NativeError(failure)


def _opened(file: Path, notes: tuple[str, ...]) -> Library:
    try:
        functions = ctypes.CDLL(str(file))
        return Library(functions, int(functions.homeward_lanes()), notes)
    except (OSError, AttributeError):
        raise NativeError(f"{file} cannot be loaded") from None
