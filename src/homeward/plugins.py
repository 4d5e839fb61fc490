"""Code of others by name: found, imported, held to its protocol; its faults are one line each."""

from __future__ import annotations

import importlib
import os
import sys
import traceback
from collections.abc import Callable, Iterable, Mapping
from importlib.metadata import entry_points
from typing import Any

import numpy as np

from homeward.errors import HomewardError, InputError
from homeward.estimator import Counts, Estimate, Estimator, Innovation, LandmarkEstimate, Status
from homeward.reasons import Rejection

ESTIMATORS, LAWS = "homeward.estimators", "homeward.laws"
"""Groups of entry points."""
FAULTS = (Exception, SystemExit)
"""What code of others may raise; Ctrl-C is not theirs."""
_OURS = (os.path.dirname(__file__) + os.sep, "<frozen", os.path.dirname(importlib.__file__))


def installed(group: str) -> tuple[str, ...]:
    """Return the names of a group's entry points, sorted; nothing is imported."""
    return tuple(sorted(entry_points(group=group).names))


def load(group: str, name: str, known: Iterable[str]) -> Callable[..., Any]:
    """Return what a name stands for.

    Parameters
    ----------
    group : str
        Of entry points.
    name : str
        One of its entry points, or ``package.module:attribute``; modules are looked for in the
        current folder, too.
    known : iterable of str
        Names that the caller knows itself, for the message.

    Raises
    ------
    InputError
        When nothing is called so, it cannot be imported, or is not callable.
    """
    found = entry_points(group=group, name=name)
    module, _, attribute = next(iter(found)).value.partition(":") if found else name.partition(":")
    if not module or not attribute:
        there = ", ".join([*known, *installed(group)])
        kind = group.partition(".")[2].removesuffix("s")
        raise InputError(f"no {kind} {name!r}: there are {there}, and package.module:attribute")
    try:
        thing: Any = _imported(module)
        for part in attribute.split("."):
            thing = getattr(thing, part)
    except ModuleNotFoundError as error:
        missing = error.name or ""
        by = "" if f"{module}.".startswith(f"{missing}.") else f", which {module} imports"
        raise InputError(f"{name}: there is no module {missing}{by}") from None
    except AttributeError as error:
        if where(error):
            raise fault(f"{name}: importing {module}", error) from error
        raise InputError(f"{name}: {module} has no {attribute}") from None
    except FAULTS as error:
        raise fault(f"{name}: importing {module}", error) from error
    if not callable(thing):
        raise InputError(f"{name} is a {type(thing).__name__}, which cannot be called")
    return thing  # type: ignore[no-any-return]


def fault(doing: str, error: BaseException) -> HomewardError:
    """Return what code of others raised as one line; what is such a line already, as it is."""
    if isinstance(error, HomewardError):
        return error
    return InputError(f"{doing} raised {type(error).__name__}: {error}{where(error)}")


def where(error: BaseException) -> str:
    """Return the line of the others' code from which an error came; empty where it was ours."""
    for frame in traceback.extract_tb(error.__traceback__):
        if not frame.filename.startswith(_OURS):
            return f" ({os.path.basename(frame.filename)}, line {frame.lineno})"
    return ""


def _imported(module: str) -> Any:
    here = os.getcwd()
    if here not in sys.path:  # as `python -m` has it; at the end, so that it hides nothing
        sys.path.append(here)
    return importlib.import_module(module)


MEMBERS = ("name", "counts", "notes", "odometry", "bearings", "estimate", "landmarks")
"""Of the protocol."""


class Guest:
    """An `Estimator` whose calls go to one of somebody else, and whose answers are checked.

    Parameters
    ----------
    word : str
        What the user calls it.
    make : callable
        Makes it.

    Raises
    ------
    InputError
        Here when it cannot be made or is no `Estimator`; in any call when that raises, or answers
        what the protocol does not have.
    """

    def __init__(self, word: str, make: Callable[[], Any]) -> None:
        self._word = word
        self._inner: Estimator = self._call("making it", make)
        kind = type(self._inner).__name__
        if missing := [name for name in MEMBERS if not hasattr(self._inner, name)]:
            lacks = ", ".join(missing)
            raise InputError(f"{word} made a {kind}, which is no Estimator: it has no {lacks}")
        self.name = str(self._inner.name)

    @property
    def counts(self) -> Counts:
        """See `Estimator`."""
        counts = self._call("counts", lambda: self._inner.counts)
        sound = isinstance(counts, Counts) and all(
            isinstance(r, Rejection) for r in counts.rejected
        )
        self._require(sound, "counts is no Counts by Rejection")
        return counts  # type: ignore[no-any-return]

    @property
    def notes(self) -> tuple[str, ...]:
        """See `Estimator`."""
        return tuple(map(str, self._call("notes", lambda: self._inner.notes)))

    def odometry(self, t: float, v: float, omega: float) -> None:
        """See `Estimator`."""
        self._call(f"odometry at {t:.10g} s", self._inner.odometry, t, v, omega)

    def bearings(
        self, t: float, sightings: Mapping[str, float], sigmas: Mapping[str, float] | None = None
    ) -> Estimate:
        """See `Estimator`."""
        doing = f"bearings at {t:.10g} s"
        return self._checked(doing, self._call(doing, self._inner.bearings, t, sightings, sigmas))

    def estimate(self, t: float) -> Estimate:
        """See `Estimator`."""
        doing = f"estimate at {t:.10g} s"
        return self._checked(doing, self._call(doing, self._inner.estimate, t))

    def landmarks(self) -> list[LandmarkEstimate]:
        """See `Estimator`."""
        known = self._call("landmarks", lambda: list(self._inner.landmarks()))
        self._require(
            all(isinstance(m, LandmarkEstimate) for m in known),
            "landmarks did not answer LandmarkEstimates",
        )
        return known  # type: ignore[no-any-return]

    def _call(self, doing: str, function: Callable[..., Any], *values: Any) -> Any:
        try:
            return function(*values)
        except FAULTS as error:
            raise fault(f"{self._word}: {doing}", error) from error

    def _require(self, holds: bool, words: str) -> None:
        if not holds:
            raise InputError(f"{self._word}: {words}")

    def _checked(self, doing: str, answer: Any) -> Estimate:
        """Return an answer that is one."""
        if not isinstance(answer, Estimate):
            raise InputError(
                f"{self._word}: {doing} answered a {type(answer).__name__}, not an Estimate"
            )
        self._require(isinstance(answer.status, Status), f"{doing} answered no Status")
        sound = all(isinstance(i, Innovation) for i in answer.innovations)
        self._require(sound, f"{doing} answered innovations that are none")
        if answer.pose is None and answer.covariance is None:
            return answer
        words = "no pose of three finite numbers with a covariance of three by three; None is none"
        finite = self._call(doing, _finite, answer.pose, answer.covariance)
        self._require(finite, f"{doing} answered {words}")
        return answer


def _finite(pose: Any, covariance: Any) -> bool:
    if pose is None or covariance is None or np.shape(covariance) != (3, 3):
        return False
    return bool(np.isfinite(pose).all() and np.isfinite(covariance).all())
