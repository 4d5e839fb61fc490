"""Third-party estimators and control laws: found by name, imported, and checked."""

from __future__ import annotations

import importlib
import os
import shlex
import sys
import traceback
from collections.abc import Callable, Collection, Iterable, Mapping
from importlib.metadata import entry_points
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from homeward.errors import HomewardError, InputError
from homeward.estimator import (
    Counts,
    Estimate,
    Estimator,
    Innovation,
    LandmarkEstimate,
    Status,
    add_twist,
    takes_sideways,
)
from homeward.reasons import Rejection

ESTIMATORS, LAWS = "homeward.estimators", "homeward.laws"
"""Groups of entry points."""
FAULTS = (Exception, SystemExit)
"""Exceptions of plugins that are reported in one line; Ctrl-C is not among them."""
_OWN_CODE = (os.path.dirname(__file__) + os.sep, "<frozen", os.path.dirname(importlib.__file__))


MAX_OPTIONS = 8
"""Number of options that an error message suggests."""


def require_confirmed(
    named: Iterable[tuple[str, str, str]], confirmed: Collection[str], file: Path
) -> None:
    """Refuse Python code that a file names; only the user may choose code to execute.

    Nothing is imported. Names without a colon are built-in, or entry points of packages that the
    user installed.

    Parameters
    ----------
    named : iterable of tuple
        For each estimator and law: its key in the file, its name, and the option of the command
        line that confirms the name.
    confirmed : collection of str
        Names that the user gave.
    file : Path
        The file, for the message.

    Raises
    ------
    InputError
        For a name ``package.module:attribute`` that is not `confirmed`.
    """
    refused = {
        f"{option}{shlex.quote(name)}": f"{key}: {name}"
        for key, name, option in named
        if ":" in name and name not in confirmed
    }
    if refused:
        raise InputError(
            f"{next(iter(refused.values()))} is Python code outside homeward; to execute it, repeat"
            f" the command with `{' '.join(islice(refused, MAX_OPTIONS))}`",
            file,
        )


def installed(group: str) -> tuple[str, ...]:
    """Return the names of a group's entry points, sorted; nothing is imported."""
    return tuple(sorted(entry_points(group=group).names))


def load(group: str, name: str, known: Iterable[str]) -> Callable[..., Any]:
    """Return the callable of that name; `InputError` where it cannot be imported or called.

    A name is an entry point of the group, or ``package.module:attribute``; modules in the current
    folder are found, too. `known` are built-in names, for the error message.
    """
    found = entry_points(group=group, name=name)
    module, _, attribute = next(iter(found)).value.partition(":") if found else name.partition(":")
    if not module or not attribute:
        names = ", ".join([*known, *installed(group)])
        kind = group.partition(".")[2].removesuffix("s")
        own = f"{Path(name).stem}:NAME" if name.endswith(".py") else "package.module:attribute"
        raise InputError(f"no {kind} {name!r}: use one of {names}, or {own}")
    try:
        found_object: Any = _imported(module)
        for part in attribute.split("."):
            found_object = getattr(found_object, part)
    except ModuleNotFoundError as error:
        missing = error.name or ""
        importer = "" if f"{module}.".startswith(f"{missing}.") else f", which {module} imports"
        raise InputError(f"{name}: there is no module {missing}{importer}") from None
    except AttributeError as error:
        if where(error):
            raise fault(f"{name}: importing {module}", error) from error
        raise InputError(f"{name}: {module} has no {attribute}") from None
    except FAULTS as error:
        raise fault(f"{name}: importing {module}", error) from error
    if not callable(found_object):
        raise InputError(f"{name} is a {type(found_object).__name__}, which cannot be called")
    return found_object  # type: ignore[no-any-return]


def fault(doing: str, error: BaseException) -> HomewardError:
    """Return an exception of a plugin as an error of one line; a `HomewardError` is unchanged."""
    if isinstance(error, HomewardError):
        return error
    return InputError(f"{doing} raised {type(error).__name__}: {error}{where(error)}")


def where(error: BaseException) -> str:
    """Return the line of the plugin that raised an error; empty where homeward itself raised it."""
    for frame in traceback.extract_tb(error.__traceback__):
        if not frame.filename.startswith(_OWN_CODE):
            return f" ({os.path.basename(frame.filename)}, line {frame.lineno})"
    return ""


def _imported(module: str) -> Any:
    here = os.getcwd()
    if here not in sys.path:  # as for `python -m`, but last, so that it hides no module
        sys.path.append(here)
    return importlib.import_module(module)


MEMBERS = ("name", "counts", "notes", "odometry", "bearings", "estimate", "landmarks")
"""Members of the protocol `Estimator`."""


class PluginEstimator:
    """Wrapper of a third-party estimator that checks its results.

    `make` returns the estimator that the user calls `label`. `InputError` where that fails or the
    result is no `Estimator`, and in any call that raises or violates the protocol.
    """

    def __init__(self, label: str, make: Callable[[], Any]) -> None:
        self._label = label
        self._inner: Estimator = self._call("making it", make)
        kind = type(self._inner).__name__
        if missing := [name for name in MEMBERS if not hasattr(self._inner, name)]:
            what = f"{label} returned a {kind} without {', '.join(missing)}"
            raise InputError(what, advice="docs/do/estimators.md has an example that runs")
        self.name = str(self._inner.name)
        self.uses_sideways = takes_sideways(self._inner)

    @property
    def counts(self) -> Counts:
        """See `Estimator`."""
        counts = self._call("counts", lambda: self._inner.counts)
        is_valid = isinstance(counts, Counts) and all(
            isinstance(r, Rejection) for r in counts.rejected
        )
        self._require(is_valid, "counts is not a Counts with keys of type Rejection")
        return counts  # type: ignore[no-any-return]

    @property
    def notes(self) -> tuple[str, ...]:
        """See `Estimator`."""
        return tuple(map(str, self._call("notes", lambda: self._inner.notes)))

    def odometry(self, t: float, v: float, omega: float, vy: float = 0.0) -> None:
        """See `Estimator`."""
        self._call(f"odometry at {t:.10g} s", add_twist, self._inner, t, v, omega, vy)

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
            "landmarks did not return a list of LandmarkEstimate",
        )
        return known  # type: ignore[no-any-return]

    def _call(self, doing: str, function: Callable[..., Any], *values: Any) -> Any:
        try:
            return function(*values)
        except FAULTS as error:
            raise fault(f"{self._label}: {doing}", error) from error

    def _require(self, is_met: bool, problem: str) -> None:
        if not is_met:
            raise InputError(f"{self._label}: {problem}")

    def _checked(self, doing: str, answer: Any) -> Estimate:
        """Return an answer that is a valid `Estimate`."""
        kind = type(answer).__name__
        self._require(isinstance(answer, Estimate), f"{doing} returned a {kind}, not an Estimate")
        self._require(isinstance(answer.status, Status), f"{doing} returned no Status")
        is_valid = all(isinstance(i, Innovation) for i in answer.innovations)
        self._require(is_valid, f"{doing} returned innovations of another type than Innovation")
        if answer.pose is None and answer.covariance is None:
            return answer  # type: ignore[no-any-return]
        finite = self._call(doing, _finite, answer.pose, answer.covariance)
        problem = "must return a finite pose with a finite 3 x 3 covariance, or None for both"
        self._require(finite, f"{doing} {problem}")
        return answer  # type: ignore[no-any-return]


def _finite(pose: Any, covariance: Any) -> bool:
    if pose is None or covariance is None or np.shape(covariance) != (3, 3):
        return False
    return bool(np.isfinite(pose).all() and np.isfinite(covariance).all())
