"""Exceptions of an estimator during a drive: reported and counted, and the drive goes on."""

from __future__ import annotations

import os
import traceback
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar, runtime_checkable

from homeward.errors import HomewardError, printable

REQUEST = (
    "This is a bug of homeward: please open an issue in its repository, with this message and the"
    " drive."
)

_PACKAGE = os.path.dirname(__file__) + os.sep


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
