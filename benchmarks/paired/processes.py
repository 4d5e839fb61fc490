"""Processes of variants, environments with an older version of homeward, and kept results."""

import io
import json
import os
import subprocess
import sys
import sysconfig
import tarfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path
from queue import SimpleQueue
from tempfile import TemporaryFile
from types import TracebackType
from typing import Any, Self, TypeVar

from benchmarks.paired.drives import Input

T, R = TypeVar("T"), TypeVar("R")
ROOT = Path(__file__).resolve().parents[2]
ENVIRONMENTS = ROOT / "out" / "against"
PIP = ("-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-compile")


class VariantError(Exception):
    """A version cannot be installed, or its process cannot start."""


def commit_of(ref: str) -> str:
    """Return the commit of a tag or branch, abbreviated."""
    call = ["git", "rev-parse", "--verify", "--quiet", "--short=12", f"{ref}^{{commit}}"]
    done = subprocess.run(call, cwd=ROOT, capture_output=True, text=True, check=False)
    if done.returncode:
        raise VariantError(f"{ref} is no tag, branch or commit of this repository")
    return done.stdout.strip()


def environment(commit: str, folder: Path = ENVIRONMENTS) -> Path:
    """Return the Python of an environment with homeward at a commit; make it at the first call.

    It has the other packages of the running environment, by a path instead of copies. That path
    does not bring in an editable homeward, whose .pth files Python reads in its own folders only.
    """
    place = folder / commit
    python = place / "bin" / "python"
    site = place / "lib" / f"python{sysconfig.get_python_version()}" / "site-packages"
    if (site / "homeward").is_dir():
        return python
    source = folder / f"{commit}-source"
    archive = subprocess.run(["git", "archive", commit], cwd=ROOT, capture_output=True, check=True)
    with tarfile.open(fileobj=io.BytesIO(archive.stdout)) as files:
        files.extractall(source, filter="data")
    _call(sys.executable, "-m", "venv", "--without-pip", str(place))
    (site / "others.pth").write_text(sysconfig.get_path("purelib") + "\n")
    _call(sys.executable, *PIP, "--no-deps", "--target", str(site), str(source))
    return python


def _call(*command: str) -> None:
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise VariantError(f"{' '.join(command)}: {done.stderr[-2000:]}")


class Worker:
    """A variant in a process of its own; it starts again after a crash."""

    def __init__(self, python: Path | None = None, without: str = "") -> None:
        """`python` is that of an `environment`; None: the running one, with its packages."""
        self._python = sys.executable if python is None else str(python)
        self._is_present = python is None
        self._options = ["--without", without] if without else []
        self._errors = TemporaryFile("w+")  # noqa: SIM115 (closed with the process)
        self._process: subprocess.Popen[str] | None = None
        self.package = Path(self._started()["package"])
        """Folder of its homeward."""
        if python is not None and python.parents[1] not in self.package.parents:
            self.close()
            raise VariantError(f"{python} imports homeward from {self.package}")

    def _started(self) -> dict[str, Any]:
        paths = [str(ROOT), *(p for p in sys.path if p and self._is_present)]
        environ = os.environ | {"PYTHONPATH": os.pathsep.join(paths), "OPENBLAS_NUM_THREADS": "1"}
        self._process = subprocess.Popen(
            [self._python, "-m", "benchmarks.paired.worker", *self._options],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._errors,
            text=True,
            env=environ,
        )
        return self._line()

    def _line(self) -> dict[str, Any]:
        assert self._process is not None
        assert self._process.stdout is not None
        if line := self._process.stdout.readline():
            found: dict[str, Any] = json.loads(line)
            return found
        code, self._process = self._process.wait(), None
        self._errors.seek(0)
        raise VariantError(f"the process ended with code {code}: {self._errors.read()[-2000:]}")

    def run(self, given: Input, needs_truth: bool = False) -> dict[str, Any]:
        """Return the figures of a drive, or the error; with `needs_truth`, add ground truth."""
        moved = None if given.moved is None else sorted(given.moved)
        request = {"folder": str(given.folder), "moved": moved, "needs_truth": needs_truth}
        try:
            if self._process is None:
                self._started()
            assert self._process is not None
            assert self._process.stdin is not None
            print(json.dumps(request), file=self._process.stdin, flush=True)
            return self._line()
        except (VariantError, BrokenPipeError) as error:
            return {"error": str(error)}

    def close(self) -> None:
        """End the process."""
        if self._process is not None:
            self._process.communicate()
            self._process = None
        self._errors.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


def in_parallel(
    items: Sequence[T],
    make: Sequence[Callable[[], Worker]],
    one: Callable[[T, list[Worker]], R],
    jobs: int,
) -> Iterator[R]:
    """Yield the result of `one` for each item, in order; it gets a worker of each kind."""
    with ExitStack() as stack:
        free = SimpleQueue[list[Worker]]()
        for _ in range(min(jobs, len(items))):
            free.put([stack.enter_context(kind()) for kind in make])

        def each(item: T) -> R:
            workers = free.get()
            try:
                return one(item, workers)
            finally:
                free.put(workers)

        with ThreadPoolExecutor(jobs) as pool:
            yield from pool.map(each, items)


class Kept(dict[tuple[Any, ...], Any]):
    """Results by name, each appended to a file as a line of JSON."""

    def __init__(self, file: Path | None, key: Mapping[str, str]) -> None:
        """Read a file, which begins with `key`, the versions that it is of; None: no file."""
        super().__init__()
        self._file = file
        if file is None:
            return
        if not file.exists():
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(json.dumps(key) + "\n")
        first, *lines = file.read_text().splitlines()
        if json.loads(first) != key:
            raise VariantError(f"{file} is of other versions: {first}; delete it, or use another")
        for line in lines:
            name, result = json.loads(line)
            self[tuple(name)] = result

    def add(self, name: tuple[Any, ...], result: Any) -> None:
        """Add a result."""
        self[name] = result
        if self._file is not None:
            with self._file.open("a") as file:
                print(json.dumps([name, result]), file=file)
