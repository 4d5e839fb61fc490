"""From C source to functions in this process: out of the cache, or compiled, proved and kept."""

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

PROOF_S = 60.0
"""A fresh library must load and answer in a process of its own within this time [s]."""
PREBUILT = "prebuilt.so"
"""What a wheel brings beside the sources of a program."""
ELF_MACHINES = {62: "x86_64", 183: "aarch64"}
"""What the header of a Linux library calls the machines that wheels are built for."""
_PROOF = "import ctypes, sys; print(ctypes.CDLL(sys.argv[1]).homeward_lanes())"


class Library(NamedTuple):
    """Compiled code in this process."""

    functions: ctypes.CDLL
    lanes: int
    """Runs side by side."""
    notes: tuple[str, ...]
    """What the user should know of how it came about."""


def is_kept(source: str) -> bool:
    """Return whether the compiled code of a source is at hand, without compiling.

    Raises
    ------
    NativeError
        When there is no compiler: what it would make of the source is not known then.
    """
    cache = Cache(default_folder())
    return cache.problem() is None and cache.find(_key(source, find_compiler())) is not None


def source_in(folder: Path) -> str:
    """Return the C of a folder as one text: program.h, its headers, its programs, by name."""
    common = Path(__file__).with_name("program.h")
    files = [common, *sorted(folder.glob("*.h")), *sorted(folder.glob("*.c"))]
    return "\n".join(file.read_text(encoding="utf-8") for file in files)


def prebuild(folder: Path, library: Path) -> str:
    """Compile the C of a folder for all processors of a kind, as a wheel brings it.

    Returns
    -------
    machine : str
        Which kind that is: another than this machine's where the compiler is for another, and
        then nothing has shown that the library can be loaded.

    Raises
    ------
    NativeError
        When there is no compiler, or it fails.
    """
    with tempfile.TemporaryDirectory() as workshop:
        source, compiler = source_in(folder), find_compiler()
        made = _unproved(source, compiler, Path(workshop), PORTABLE_FLAGS)
        if (machine := _machine(made)) == platform.machine():
            _prove(made, compiler)
        shutil.copyfile(made, library)
    return machine


def prebuilt(folder: Path) -> Library | None:
    """Return what a wheel brought for the C of a folder; None where there is nothing that loads."""
    try:
        return _opened(folder / PREBUILT, ())
    except NativeError:
        return None


def load(source: str) -> Library:
    """Return the compiled code of a C source.

    Raises
    ------
    NativeError
        When there is no compiler, or it fails.
    """
    return _load(source, find_compiler(), default_folder())


@lru_cache(maxsize=64)
def _load(source: str, compiler: Compiler, folder: Path) -> Library:
    cache, key = Cache(folder), _key(source, compiler)
    if (problem := cache.problem()) is not None:
        return _unkept(source, compiler, problem)
    try:
        if (found := cache.find(key)) is None:
            with scratch_folder(folder) as workshop:
                found = cache.keep(key, _compiled(source, compiler, workshop))
    except OSError as error:
        return _unkept(source, compiler, f"{folder}: {error.strerror}")
    return _opened(found, ())


def _key(source: str, compiler: Compiler) -> str:
    return key_of(source, compiler.identity)


def _unkept(source: str, compiler: Compiler, problem: str) -> Library:
    """Compile for this process alone; once loaded, the file may go."""
    note = f"Compiled code is not kept for next time: {problem}."
    try:
        with tempfile.TemporaryDirectory(prefix="homeward-") as workshop:
            return _opened(_compiled(source, compiler, Path(workshop)), (note,))
    except OSError as error:
        raise NativeError(f"no folder to compile in: {error.strerror}") from None


def _compiled(source: str, compiler: Compiler, workshop: Path) -> Path:
    library = _unproved(source, compiler, workshop)
    _prove(library, compiler)
    return library


def _unproved(
    source: str, compiler: Compiler, workshop: Path, flags: tuple[str, ...] | None = None
) -> Path:
    text, library = workshop / "program.c", workshop / "program.so"
    text.write_text(source, encoding="utf-8")
    compiler.compile(text, library, flags)
    return library


def _machine(library: Path) -> str:
    """Return for which kind of machine a library is; this one's if its header does not tell."""
    header = library.read_bytes()[:20]
    told = int.from_bytes(header[18:], "little") if header.startswith(b"\x7fELF") else 0
    return ELF_MACHINES.get(told, platform.machine())


def _prove(library: Path, compiler: Compiler) -> None:
    """Prove in another process that a library can be loaded at all."""
    try:
        proof = subprocess.run(
            [sys.executable, "-I", "-S", "-c", _PROOF, str(library)],
            capture_output=True,
            timeout=PROOF_S,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired):
        raise NativeError(f"what {compiler.command[0]} made cannot be loaded") from None
    if proof.returncode != 0 or not proof.stdout.strip().isdigit():
        raise NativeError(f"what {compiler.command[0]} made cannot be loaded")


def _opened(file: Path, notes: tuple[str, ...]) -> Library:
    try:
        functions = ctypes.CDLL(str(file))
        return Library(functions, int(functions.homeward_lanes()), notes)
    except (OSError, AttributeError):
        raise NativeError(f"{file} cannot be loaded") from None
