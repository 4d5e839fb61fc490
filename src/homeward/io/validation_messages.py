"""Plain messages for users from the problems of settings models."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from typing import Any

from homeward.errors import InputError
from homeward.io.checks import Check, Problem, ValidationError, check_of
from homeward.io.keys import Strict, closest
from homeward.io.naming import listing
from homeward.io.table import quoted

MAX_LENGTH = 60
"""Keys and values are cut to this length [characters]."""
MAX_KEYS = 30
"""Maximum number of keys that are listed instead of an unknown one."""
_check_of = cache(check_of)


def parsed(kind: Any, text: str | bytes) -> Any:
    """Return a message of an annotation parsed from JSON; `InputError` reports its first problem.

    Parsing is strict, as the schema is: a text or a boolean is no number.
    """
    check: Check = _check_of(kind)
    try:
        return check(json.loads(text), True)
    except ValidationError as error:
        raise refused(error) from None
    except json.JSONDecodeError as error:
        where = f"line {error.lineno} column {error.colno}"
        raise InputError(f"not JSON: {error.msg} at {where}") from None
    except (ValueError, RecursionError) as error:
        raise InputError(f"not JSON: {error}") from None


def refused(
    error: ValidationError, model: type[Strict] | None = None, file: Path | None = None
) -> InputError:
    """Return the first problem of values, with its key.

    For an unknown key, the most similar key of `model` is suggested, or those of its block.
    """
    # An unknown key comes first, since it explains a missing one.
    first = next((p for p in error.problems if p.known), error.problems[0])
    key = _key(first)
    if first.known:
        similar = None if model is None else closest(key, model)
        advice = f"did you mean {similar}?"
        if similar in (None, key):  # the key of another member of a union
            advice = f"the keys here are {listing(first.known, MAX_KEYS)}"
        return InputError(first.words, file, part=_shown(key), advice=advice)
    # A union reports one problem for each member: the most specific one counts.
    first = next((p for p in error.problems if _key(p).startswith(f"{key}.")), first)
    key = _key(first)
    head, *others = dict.fromkeys(p.words for p in error.problems if _key(p) == key)
    words = " or ".join([head, *(other.removeprefix("must be ") for other in others)])
    if isinstance(first.value, (str, int, float)):
        words += f", not {_shown(str(first.value))}"
    return InputError(words, file, part=_shown(key) if key else None)


def _shown(text: str) -> str:
    plain = 0 < len(text) <= MAX_LENGTH and text.isprintable() and " " not in text
    return text if plain else quoted(text)


def _key(problem: Problem) -> str:
    return ".".join(map(str, problem.place))
