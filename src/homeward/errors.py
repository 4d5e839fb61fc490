"""The errors that homeward raises on purpose."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


def printable(text: str) -> str:
    r"""Return text as one line, with control characters escaped: ``\x1b``, ``\n``, ``\u202e``.

    Names in hostile files may contain sequences that clear a screen or move the cursor.
    """
    return "".join(c if c.isprintable() else repr(c)[1:-1] for c in text)


def as_typed(path: str | os.PathLike[str]) -> str:
    """Return a path in the current folder relative to it, as it is typed; others unchanged."""
    try:
        here = os.getcwd() + os.sep
    except OSError:  # the folder was removed
        return os.fspath(path)
    return os.fspath(path).removeprefix(here) or os.fspath(path)


class HomewardError(Exception):
    """An error that is reported in one line: bad input (`InputError`) or no result."""

    def __init__(self, message: str) -> None:
        super().__init__(printable(message))


class InternalError(HomewardError):
    """A bug of homeward, reported in one line with its `consequence`."""

    def __init__(self, error: Exception, consequence: str) -> None:
        super().__init__(f"internal error, {consequence}: {type(error).__name__}: {error}")


class InputError(HomewardError):
    """A file or an option that cannot be used: ``FILE, row ROW: PART: PROBLEM; ADVICE``.

    Parameters
    ----------
    problem : str
        The fault, with the value and its unit.
    file : Path, optional
        The file at fault.
    row : int, optional
        Line number in that file, counted from 1 with the header.
    part : str, optional
        The column, topic, key or option at fault.
    advice : str, optional
        What to do, as an imperative.
    """

    def __init__(
        self,
        problem: str,
        file: Path | None = None,
        row: int | None = None,
        *,
        part: str | None = None,
        advice: str | None = None,
    ) -> None:
        super().__init__(problem)
        self.problem, self.file, self.row, self.part, self.advice = problem, file, row, part, advice

    @property
    def what(self) -> str:
        """The message without the file and the row."""
        part = "" if self.part is None else f"{self.part}: "
        return part + self.problem + ("" if self.advice is None else f"; {self.advice}")

    def __str__(self) -> str:
        if self.file is None:
            return printable(self.what)
        row = "" if self.row is None else f", row {self.row}"
        return printable(f"{as_typed(self.file)}{row}: {self.what}")

    def at(self, file: Path | None = None, part: str | None = None) -> None:
        """Name a file and a part, if the error names none."""
        self.file, self.part = self.file or file, self.part or part


@contextmanager
def naming_file(file: Path | None = None, part: str | None = None) -> Iterator[None]:
    """Add a file, and a part of it, to an `InputError` that names none."""
    try:
        yield
    except InputError as error:
        error.at(file, part)
        raise


_EXTRAS = {
    "casadi": ("the paper's filters, and symbolic models,", "filters"),
    **dict.fromkeys(("bokeh", "markupsafe", "matplotlib"), ("pages and pictures", "report")),
    **dict.fromkeys(("backports", "lz4", "rosbags"), ("ROS logs", "bags")),
    **dict.fromkeys(("PIL", "shapely"), ("images and rendered rooms", "vision")),
    **dict.fromkeys(("dask", "distributed", "h5netcdf", "xarray"), ("studies", "scale")),
    "paho": ("places shared over MQTT", "fleet"),
    "websockets": ("WebSockets", "live"),
}
"""By package: its purpose, as a plural, and the extra that installs it."""


def missing_extra_error(error: ModuleNotFoundError) -> InputError | None:
    """Return the error for a missing package; None where no extra installs it."""
    known = _EXTRAS.get((error.name or "").partition(".")[0])
    return None if known is None else needs_extra(*known)


def needs_start_prior(estimator: str) -> InputError:
    """Return the error of an estimator that needs a start prior and has none."""
    ways = "start in drive.yaml, --start R,THETA,ALPHA of a run, or a live message of type start"
    return InputError(f"{estimator} needs a start prior; give one by {ways}")


def needs_extra(what: str, extra: str) -> InputError:
    """Return the error for a feature, `what` as a plural, whose `extra` is not installed."""
    return InputError(
        f"{what} need the extra {extra}, which is not installed: in the folder with "
        f"homeward's pyproject.toml, run: pip install -c constraints.txt -e '.[{extra}]'"
    )
