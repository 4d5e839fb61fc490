"""C compiler of the system: search, version, and calls with a time limit."""

from __future__ import annotations

import os
import platform
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from homeward.errors import HomewardError

CANDIDATES = ("cc", "gcc", "clang")
"""Tried in this order where ``CC`` does not name one."""
VERSION_S = 10.0
"""Time limit for the version [s]."""
COMPILE_S = 300.0
"""Time limit for compiling a program [s]."""
FLAGS = (
    *("-std=gnu11", "-O3", "-fPIC", "-shared", "-w"),
    *("-ffp-contract=fast", "-fno-math-errno", "-fno-trapping-math"),
)
"""No -ffast-math: the programs use NaN and infinity."""


class NativeError(HomewardError):
    """Reason why there is no compiled code, in one line."""


@dataclass(frozen=True)
class Compiler:
    """C compiler with its version."""

    command: tuple[str, ...]
    version: str

    @property
    def identity(self) -> str:
        """Everything but the source that determines the code: compiler, flags and processor."""
        return "\n".join([*self.command, self.version, *flags(), processor()])

    def compile(self, source: Path, library: Path) -> None:
        """Compile a C file into a shared library.

        `NativeError` where that fails, takes too long, or writes no file.
        """
        call = [*self.command, *flags(), "-o", str(library), str(source), "-lm"]
        code, output = _call(call, COMPILE_S)
        if code != 0:
            raise NativeError(f"{shlex.join(self.command)} failed: {_first_line(output)}")
        if not library.is_file():
            raise NativeError(f"{shlex.join(self.command)} wrote no file")


def find_compiler() -> Compiler:
    """Return the compiler that ``CC`` names, else the first of `CANDIDATES` that is installed.

    `NativeError` where there is none, or it fails.
    """
    return _find(os.environ.get("CC", ""), os.environ.get("PATH", ""))


@lru_cache(maxsize=8)
def _find(named: str, path: str) -> Compiler:
    try:
        command = tuple(shlex.split(named))
    except ValueError:
        raise NativeError(f"CC={named!r} is not a command") from None
    if command:
        found = shutil.which(command[0], path=path)
        if found is None:
            raise NativeError(f"CC={named!r} is not an executable command")
        return _with_version((found, *command[1:]))
    for name in CANDIDATES:
        if (found := shutil.which(name, path=path)) is not None:
            return _with_version((found,))
    raise NativeError("no C compiler found: install gcc or clang")


def _with_version(command: tuple[str, ...]) -> Compiler:
    code, output = _call([*command, "--version"], VERSION_S)
    if code != 0:
        raise NativeError(f"{shlex.join(command)} --version failed: {_first_line(output)}")
    return Compiler(command, output)


def flags() -> tuple[str, ...]:
    """Return the compiler's flags for this machine's own processor."""
    arm = platform.machine().lower() in ("aarch64", "arm64")
    return (*FLAGS, "-mcpu=native" if arm else "-march=native")


@lru_cache(maxsize=1)
def processor() -> str:
    """Return an identification of this processor, different where the code would differ."""
    facts = [platform.machine(), platform.processor(), sys.platform]
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        lines = []
    for key in ("model name", "flags", "CPU implementer", "CPU part", "Features"):
        facts += [line for line in lines if line.startswith(key)][:1]
    return "\n".join(facts)


def _call(command: list[str], seconds: float) -> tuple[int, str]:
    """Run a command with a time limit for it and its children; return exit status and output."""
    # A file, not a pipe: a child that outlives the command would keep a pipe open.
    with tempfile.TemporaryFile() as output:
        try:
            process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
        except OSError as error:
            raise NativeError(f"{shlex.join(command[:1])}: {error.strerror}") from None
        try:
            code = process.wait(seconds)
        except subprocess.TimeoutExpired:
            raise NativeError(f"{command[0]} took more than {seconds:g} s") from None
        finally:
            _end(process)
        output.seek(0)
        return code, output.read(20_000).decode(errors="replace")


def _end(process: subprocess.Popen[bytes]) -> None:
    """End a command and its children."""
    try:
        os.killpg(process.pid, signal.SIGKILL)
    except (OSError, AttributeError):
        process.kill()
    process.wait()


def _first_line(output: str) -> str:
    lines = [line.strip() for line in output.splitlines() if line.strip()]
    errors = [line for line in lines if "error" in line.lower()]
    return (errors or lines or ["no output"])[0][:200]
