"""What is wrong with settings, in plain words: pydantic's errors are for programmers."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, TypeVar

from pydantic import TypeAdapter, ValidationError
from pydantic_core import ErrorDetails, from_json

from homeward.errors import InputError
from homeward.io.keys import Strict, closest
from homeward.io.table import quoted

Message = TypeVar("Message")
LONGEST = 60
"""Longer keys and values are cut [characters]."""
_PLAIN = {
    **dict.fromkeys(("float_type", "float_parsing"), "must be a number"),
    **dict.fromkeys(("int_type", "int_parsing", "int_from_float"), "must be a whole number"),
    "int_parsing_size": "must be a smaller whole number",
    **dict.fromkeys(("bool_type", "bool_parsing"), "must be true or false"),
    **dict.fromkeys(("string_type", "string_unicode", "path_type"), "must be text"),
    "finite_number": "must be finite",
    "greater_than": "must be greater than {gt:g}",
    "greater_than_equal": "must be at least {ge:g}",
    "less_than": "must be less than {lt:g}",
    "less_than_equal": "must be at most {le:g}",
    "literal_error": "must be {expected}",
    "union_tag_invalid": "{discriminator} must be one of {expected_tags}, not {tag}",
    **dict.fromkeys(("tuple_type", "list_type"), "must be a list"),
    **dict.fromkeys(
        ("dict_type", "model_type", "model_attributes_type"), "must be keys and values"
    ),
    "too_short": "too few values: at least {min_length} needed",
    "too_long": "takes {max_length} values or fewer",
    "missing": "is needed",
    "json_invalid": "not JSON: {error}",
    "union_tag_not_found": "needs the key {discriminator}",
    "value_error": "{error}",
}
"""By pydantic's type of an error; `str.format` fills in its context."""
_WITHOUT_VALUE = (
    *("missing", "too_short", "too_long", "value_error"),
    *("union_tag_not_found", "union_tag_invalid", "json_invalid"),
)
"""The value itself would explain nothing."""


def message(adapter: TypeAdapter[Message], text: str | bytes) -> Message:
    """Return a message from its JSON; `InputError` says in one line what is wrong with it.

    A text or a truth value is no number, as the schema has it: what sends one is broken.
    """
    try:
        return adapter.validate_json(text, strict=True)
    except ValidationError as error:
        try:
            values = from_json(text)
        except ValueError:
            values = {}
        raise InputError(complaint(error, None, values)) from None


def complaint(error: ValidationError, model: type[Strict] | None, values: Any) -> str:
    """Return in one line what is wrong first of all, with the key in front.

    Keys of `model` are suggested for one that is not known.
    """
    details = error.errors(include_url=False)
    # A key that is not known explains another that is missing.
    first = next((e for e in details if e["type"] == "extra_forbidden"), details[0])
    key = _key(first, values)
    if first["type"] == "extra_forbidden":
        refused = f"{_shown(key)}: there is no such key"
        if model is None:
            return refused
        meant = closest(key, model)
        way = f"did you mean {meant}?" if meant else "homeward settings lists those that there are"
        if meant == key:  # of another of several models
            way = "it is for something else"
        return f"{refused}; {way}"
    # A value that may be one thing or another is refused once for each: the nearest miss counts.
    first = next((e for e in details if _key(e, values).startswith(f"{key}.")), first)
    key = _key(first, values)
    head, *others = dict.fromkeys(_words(e) for e in details if _key(e, values) == key)
    words = " or ".join([head, *(way.removeprefix("must be ") for way in others)])
    if first["type"] not in _WITHOUT_VALUE and isinstance(first["input"], (str, int, float)):
        words += f", not {_shown(str(first['input']))}"
    return f"{_shown(key)}: {words}" if key else words


def _words(error: ErrorDetails) -> str:
    context: Mapping[str, Any] = error.get("ctx", {})
    plain = _PLAIN.get(error["type"])
    if plain is None:
        return error["msg"].replace("Input should be", "must be")
    quotes = ("expected", "expected_tags", "discriminator")
    return plain.format_map(
        {k: v.replace("'", "") if k in quotes else v for k, v in context.items()}
    )


def _shown(text: str) -> str:
    plain = 0 < len(text) <= LONGEST and text.isprintable() and " " not in text
    return text if plain else quoted(text)


def _key(error: ErrorDetails, values: Any) -> str:
    """Return a key in dots, without the tags of unions, which pydantic puts between the keys."""
    parts: list[str] = []
    location: Iterable[int | str] = error["loc"]
    *_, last = error["loc"] or [None]
    tagged: Any = None
    for part in location:
        if isinstance(values, dict):
            if part == values.get("type") and part != last and tagged is not values:
                tagged = values
                continue  # a tag, which may be called as a key is
            absent = part not in values
            if absent and not (part == last and error["type"] == "missing"):
                continue
            values = values.get(part)
        elif isinstance(values, (list, tuple)) and isinstance(part, int):
            values = values[part] if part < len(values) else None
        else:
            continue
        parts.append(str(part))
    return ".".join(parts)
