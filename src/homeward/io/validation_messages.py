"""Plain messages for users from the validation errors of pydantic."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, TypeVar

from pydantic import TypeAdapter, ValidationError
from pydantic_core import ErrorDetails, from_json

from homeward.errors import InputError
from homeward.io.keys import Strict, closest
from homeward.io.table import quoted

Message = TypeVar("Message")
MAX_LENGTH = 60
"""Keys and values are cut to this length [characters]."""
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
    "too_short": "needs at least {min_length} values",
    "too_long": "takes at most {max_length} values",
    "missing": "is required",
    "json_invalid": "not JSON: {error}",
    "union_tag_not_found": "needs the key {discriminator}",
    "value_error": "{error}",
}
"""Messages by pydantic's error type; `str.format` fills in the context."""
_WITHOUT_VALUE = (
    *("missing", "too_short", "too_long", "value_error"),
    *("union_tag_not_found", "union_tag_invalid", "json_invalid"),
)
"""Error types whose messages do not show the value."""


def message(adapter: TypeAdapter[Message], text: str | bytes) -> Message:
    """Return a message parsed from JSON; `InputError` reports the first problem in one line.

    Parsing is strict, as the schema is: a text or a boolean is no number.
    """
    try:
        return adapter.validate_json(text, strict=True)
    except ValidationError as error:
        try:
            values = from_json(text)
        except ValueError:
            values = {}
        raise InputError(validation_message(error, None, values)) from None


def validation_message(error: ValidationError, model: type[Strict] | None, values: Any) -> str:
    """Return the first problem in one line, after its key.

    For an unknown key, the most similar key of `model` is suggested.
    """
    details = error.errors(include_url=False)
    # An unknown key comes first, since it explains a missing one.
    first = next((e for e in details if e["type"] == "extra_forbidden"), details[0])
    key = _key(first, values)
    if first["type"] == "extra_forbidden":
        problem = f"{_shown(key)}: unknown key"
        if model is None:
            return problem
        similar = closest(key, model)
        advice = f"did you mean {similar}?" if similar else "homeward settings lists all keys"
        if similar == key:  # a key of another member of a union
            advice = "it does not apply to this type"
        return f"{problem}; {advice}"
    # A union reports one error for each member: the most specific one counts.
    first = next((e for e in details if _key(e, values).startswith(f"{key}.")), first)
    key = _key(first, values)
    head, *others = dict.fromkeys(_words(e) for e in details if _key(e, values) == key)
    words = " or ".join([head, *(other.removeprefix("must be ") for other in others)])
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
    plain = 0 < len(text) <= MAX_LENGTH and text.isprintable() and " " not in text
    return text if plain else quoted(text)


def _key(error: ErrorDetails, values: Any) -> str:
    """Return a dotted key, without the tags of unions that pydantic inserts."""
    parts: list[str] = []
    location: Iterable[int | str] = error["loc"]
    *_, last = error["loc"] or [None]
    tagged: Any = None
    for part in location:
        if isinstance(values, dict):
            if part == values.get("type") and part != last and tagged is not values:
                tagged = values
                continue  # a tag, which may have the same name as a key
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
