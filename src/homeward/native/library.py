"""C functions in this process: from the cache, or compiled, tested and cached."""

from __future__ import annotations

import ctypes
import platform
import shutil
import subprocess
import sys
import tempfile
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

from homeward.io.writing import scratch_folder
from homeward.native.cache import Cache, default_folder, key_of
from homeward.native.compiler import PORTABLE_FLAGS, Compiler, NativeError, find_compiler

TEST_S = 60.0
"""Time limit for loading and calling a new library in another process [s]."""
PREBUILT = "prebuilt.so"
"""File with compiled code in a wheel, next to the sources of a program."""
ELF_MACHINES = {62: "x86_64", 183: "aarch64"}
"""Machine numbers in the header of a Linux library, for the machines of the wheels."""
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


def source_in(folder: Path) -> str:
    """Return the C code of a folder as one text: program.h, headers, programs, sorted by name."""
    common = Path(__file__).with_name("program.h")
    files = [common, *sorted(folder.glob("*.h")), *sorted(folder.glob("*.c"))]
    return "\n".join(file.read_text(encoding="utf-8") for file in files)


def prebuild(folder: Path, library: Path) -> str:
    """Compile the C code of a folder for all processors of an architecture, for a wheel.

    Returns the architecture. If a cross compiler makes it another one than this machine's, the
    library is not tested. `NativeError` where there is no compiler, or it fails.
    """
    with tempfile.TemporaryDirectory() as scratch:
        source, compiler = source_in(folder), find_compiler()
        made = _untested(source, compiler, Path(scratch), PORTABLE_FLAGS)
        if (machine := _machine(made)) == platform.machine():
            _test(made, compiler)
        shutil.copyfile(made, library)
    return machine


def prebuilt(folder: Path) -> Library | None:
    """Return the compiled code that a wheel contains for a folder, or None."""
    try:
        return _opened(folder / PREBUILT, ())
    except NativeError:
        return None


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
    library = _untested(source, compiler, scratch)
    _test(library, compiler)
    return library


def _untested(
    source: str, compiler: Compiler, scratch: Path, flags: tuple[str, ...] | None = None
) -> Path:
    text, library = scratch / "program.c", scratch / "program.so"
    text.write_text(source, encoding="utf-8")
    compiler.compile(text, library, flags)
    return library


def _machine(library: Path) -> str:
    """Return the machine type of a library from its header, by default that of this machine."""
    header = library.read_bytes()[:20]
    number = int.from_bytes(header[18:], "little") if header.startswith(b"\x7fELF") else 0
    return ELF_MACHINES.get(number, platform.machine())


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
