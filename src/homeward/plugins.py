"""What other packages bring, by ``package.module:attribute`` or by the name of an entry point."""

from __future__ import annotations

import importlib
import os
import sys
import traceback
from collections.abc import Callable, Iterable
from importlib.metadata import entry_points
from typing import Any

from homeward.errors import HomewardError, InputError

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
