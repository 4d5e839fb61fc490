"""The errors that homeward raises on purpose, and exceptions that end no drive.

An exception of an estimator during a drive is reported and counted, and the drive goes on.
"""

from __future__ import annotations

import os
import traceback
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, TypeVar, runtime_checkable


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


REQUEST = (
    "This is a bug of homeward: please open an issue in its repository, with this message and the"
    " drive."
)

_PACKAGE = os.path.dirname(__file__) + os.sep


def require_kind(value: object, kind: type, advice: str) -> None:
    """Raise an `InputError` with advice where an argument is not of a class."""
    if not isinstance(value, kind):
        problem = f"a {kind.__name__} is needed, not a {type(value).__name__}"
        raise InputError(problem, advice=advice)


class InternalErrorWarning(UserWarning):
    """Warning of an `InternalFailure`, so that no program overlooks one."""


@dataclass(frozen=True)
class InternalFailure:
    """An exception that an estimator raised during a drive."""

    t: float
    """Stamp of the sample [s]."""
    error: str
    """The exception in one line, with the line of code that raised it."""
    traceback: str
    """The whole traceback."""

    def __str__(self) -> str:
        return f"internal error at {self.t:.10g} s: {self.error}"


@runtime_checkable
class Restartable(Protocol):
    """An estimator that can begin again in the middle of a drive, like a new one."""

    def restart(self) -> None:
        """Discard the whole state, including the start prior, but no counts and no settings."""


Result = TypeVar("Result")


class Attempts:
    """Calls of which an exception does not end a drive.

    After an exception the `estimator`, if given, is restarted; one that is not `Restartable` is
    called no more.
    """

    def __init__(self, estimator: object | None = None) -> None:
        self._estimator, self._has_ended = estimator, False
        self.failures: list[InternalFailure] = []
        """The exceptions, in order of time."""

    def attempt(
        self, t: float, otherwise: Result, function: Callable[..., Result], *values: Any
    ) -> Result:
        """Return the result of a function, called with `values` at a stamp `t` [s].

        After an exception, which is also given as a warning, return `otherwise`. A `HomewardError`
        is raised: it is made for the user.
        """
        if self._has_ended:
            return otherwise
        try:
            return function(*values)
        except HomewardError:
            raise
        except Exception as error:
            failure = InternalFailure(t, _in_one_line(error), traceback.format_exc())
        self.failures.append(failure)
        warnings.warn(str(failure), InternalErrorWarning, stacklevel=2)
        self._has_ended = not self._goes_on()
        return otherwise

    def _goes_on(self) -> bool:
        """Restart the estimator, if there is one; return whether it can be called again."""
        if self._estimator is None:
            return True
        if not isinstance(self._estimator, Restartable):
            return False
        try:
            self._estimator.restart()
        except Exception:  # of the same kind: the failure is counted already
            return False
        return True


def failure_notes(failures: Sequence[InternalFailure]) -> tuple[str, ...]:
    """Return a note for the user on the failures of an estimator, if there were any."""
    if not failures:
        return ()
    times = f"{len(failures)} times" if len(failures) > 1 else "once"
    return (
        f"The estimator failed {times}: {failures[0]}. After a failure the localiser begins again"
        f" without a map, and other estimators give no pose. {REQUEST}",
    )


def _in_one_line(error: Exception) -> str:
    """Return an exception, and the line of homeward that raised it, in one line."""
    frames = traceback.extract_tb(error.__traceback__)
    own = [frame for frame in frames if frame.filename.startswith(_PACKAGE)]
    where = (own or list(frames))[-1]
    place = f"{os.path.basename(where.filename)}, line {where.lineno}, in {where.name}"
    return printable(f"{type(error).__name__}: {error} ({place})")
