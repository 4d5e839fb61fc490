"""The system's C compiler: found, asked for its version, and called with a time limit."""

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
from importlib.util import find_spec
from pathlib import Path

from homeward.errors import HomewardError

CANDIDATES = ("cc", "gcc", "clang")
"""Tried in this order where ``CC`` does not name one."""
VERSION_S = 10.0
"""The compiler must tell its version within this time [s]."""
COMPILE_S = 300.0
"""And compile a program within this one [s]."""
FLAGS = (
    *("-std=gnu11", "-O3", "-fPIC", "-shared", "-w"),
    *("-ffp-contract=fast", "-fno-math-errno", "-fno-trapping-math"),
)
"""No -ffast-math: NaN and infinity mean something here."""
PORTABLE_FLAGS = (*FLAGS, "-DFOR_ALL_PROCESSORS")
"""For all processors of a kind, as a wheel serves them; see program.h."""


class NativeError(HomewardError):
    """Why there is no compiled code, in one line."""


@dataclass(frozen=True)
class Compiler:
    """A C compiler that has told its version."""

    command: tuple[str, ...]
    version: str

    @property
    def identity(self) -> str:
        """Everything but the source that decides what comes out: compiler, flags and processor."""
        return "\n".join([*self.command, self.version, *flags(), processor()])

    def compile(self, source: Path, library: Path, options: tuple[str, ...] | None = None) -> None:
        """Compile a C file into a shared library.

        Parameters
        ----------
        source, library : Path
            What to read, and what to write.
        options : tuple of str, optional
            Flags; default: `flags`.

        Raises
        ------
        NativeError
            When that fails, takes too long, or leaves no file.
        """
        told = flags() if options is None else options
        call = [*self.command, *told, "-o", str(library), str(source), "-lm"]
        code, words = _call(call, COMPILE_S)
        if code != 0:
            raise NativeError(f"{shlex.join(self.command)} failed: {_first_line(words)}")
        if not library.is_file():
            raise NativeError(f"{shlex.join(self.command)} wrote no file")


def find_compiler() -> Compiler:
    """Return the compiler that ``CC`` names, else the first of `CANDIDATES` there is, else Zig's.

    The last is of the extra ``compiler``, and needs nothing of the system.

    Raises
    ------
    NativeError
        When there is none, or it does not answer.
    """
    return _find(os.environ.get("CC", ""), os.environ.get("PATH", ""))


@lru_cache(maxsize=8)
def _find(named: str, path: str) -> Compiler:
    try:
        command = tuple(shlex.split(named))
    except ValueError:
        raise NativeError(f"CC={named!r} is no command") from None
    if command:
        found = shutil.which(command[0], path=path)
        if found is None:
            raise NativeError(f"CC={named!r} is no command that can be run")
        return _asked((found, *command[1:]))
    for name in CANDIDATES:
        if (found := shutil.which(name, path=path)) is not None:
            return _asked((found,))
    if (package := find_spec("ziglang")) is not None and package.origin is not None:
        # Its program itself: python -m would look for it in the folder where it is run, too.
        return _asked((str(Path(package.origin).with_name("zig")), "cc"))
    raise NativeError("no C compiler found")


def _asked(command: tuple[str, ...]) -> Compiler:
    code, words = _call([*command, "--version"], VERSION_S)
    if code != 0:
        raise NativeError(f"{shlex.join(command)} --version failed: {_first_line(words)}")
    return Compiler(command, words)


def flags() -> tuple[str, ...]:
    """Return the compiler's flags for this machine's own processor."""
    arm = platform.machine().lower() in ("aarch64", "arm64")
    return (*FLAGS, "-mcpu=native" if arm else "-march=native")


@lru_cache(maxsize=1)
def processor() -> str:
    """Return what tells this processor from others that would need other code."""
    told = [platform.machine(), platform.processor(), sys.platform]
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        lines = []
    for key in ("model name", "flags", "CPU implementer", "CPU part", "Features"):
        told += [line for line in lines if line.startswith(key)][:1]
    return "\n".join(told)


def _call(command: list[str], seconds: float) -> tuple[int, str]:
    """Run a command with all its children, at most so long; return its code and its words."""
    # A file, not a pipe: a child that outlives the command would keep a pipe open.
    with tempfile.TemporaryFile() as said:
        try:
            process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=said,
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
        said.seek(0)
        return code, said.read(20_000).decode(errors="replace")


def _end(process: subprocess.Popen[bytes]) -> None:
    """End a command and whatever it started."""
    try:
        os.killpg(process.pid, signal.SIGKILL)
    except (OSError, AttributeError):
        process.kill()
    process.wait()


def _first_line(words: str) -> str:
    lines = [line.strip() for line in words.splitlines() if line.strip()]
    telling = [line for line in lines if "error" in line.lower()]
    return (telling or lines or ["it says nothing"])[0][:200]
