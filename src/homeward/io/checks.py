"""Checks of values against annotations, such as ``Annotated[float, Field(gt=0)] | None``."""

from __future__ import annotations

import copy
import enum
import math
import re
import types
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, NoReturn, Union, get_args, get_origin

REQUIRED: Any = type("Required", (), {"__repr__": lambda self: "needed"})()
"""Default of a field that must be given."""
NOTHING: Any = object()
"""Value of a problem whose message shows no value."""
Check = Callable[[Any, bool], Any]
"""Returns a checked and converted value, or raises `ValidationError`. With the second argument it
is strict: a text or a boolean is no number."""
_TRUE, _FALSE = ({"true", "yes", "on", "t", "y", "1"}, {"false", "no", "off", "f", "n", "0"})
_WHOLE = re.compile(r"\s*[+-]?\d+\.0*\s*")


class Problem(NamedTuple):
    """A problem of a value."""

    place: tuple[Any, ...]
    """Keys and indices from the outermost model on."""
    words: str
    value: Any = NOTHING
    known: tuple[str, ...] = ()
    """Of an unknown key: the keys that its block has."""


class ValidationError(ValueError):
    """Values that do not fit a model."""

    def __init__(self, problems: Iterable[Problem]) -> None:
        self.problems = tuple(problems)
        parts = (f"{'.'.join(map(str, p.place))}: {p.words}" for p in self.problems)
        super().__init__("; ".join(part.removeprefix(": ") for part in parts))

    def __reduce__(self) -> Any:
        return type(self), (self.problems,)

    def at(self, *place: Any) -> Iterator[Problem]:
        """Yield the problems as those of an outer value."""
        return (p._replace(place=place + p.place) for p in self.problems)


def refuse(words: str, value: Any = NOTHING) -> NoReturn:
    """Raise the problem of a value."""
    raise ValidationError([Problem((), words, value)])


def Field(default: Any = REQUIRED, **options: Any) -> Any:
    """Return a `FieldInfo`, as the value of a field or within ``Annotated``."""
    return FieldInfo(default, **options)


class FieldInfo:
    """Default, limits and examples of a field.

    `gt`, `ge`, `lt` and `le` limit numbers, `min_length` and `max_length` texts, lists and
    mappings; a text must match `pattern`. `discriminator` is the key that selects the model of a
    union, `alias` the key of the field in files.
    """

    def __init__(
        self,
        default: Any = REQUIRED,
        *,
        default_factory: Callable[[], Any] | None = None,
        alias: str | None = None,
        examples: list[Any] | None = None,
        discriminator: str | None = None,
        allow_inf_nan: bool = True,
        **limits: Any,
    ) -> None:
        self.default, self.default_factory, self.alias = default, default_factory, alias
        self.examples, self.discriminator = examples, discriminator
        self.allow_inf_nan, self.limits = allow_inf_nan, limits
        self.annotation: Any = None
        self.check: Check = _any

    @property
    def is_required(self) -> bool:
        """Whether the field has no default."""
        return self.default is REQUIRED and self.default_factory is None

    def make_default(self) -> Any:
        """Return the default, which no other instance shares; `REQUIRED` without one."""
        if self.default_factory is not None:
            return self.default_factory()
        return copy.copy(self.default) if isinstance(self.default, dict) else self.default

    def restrict(self, value: Any, given: Any) -> Any:
        """Return a value within the limits; problems show it as it was given."""
        if isinstance(value, float) and not (self.allow_inf_nan or math.isfinite(value)):
            refuse("must be finite", given)
        for name, limit in self.limits.items():
            fits, words = _LIMITS[name]
            if not fits(value, limit):
                parts = "characters" if isinstance(value, str) else "values"
                refuse(words.format(limit, parts), given)
        return value


_LIMITS: dict[str, tuple[Callable[[Any, Any], bool], str]] = {
    "gt": (lambda value, limit: value > limit, "must be greater than {:g}"),
    "ge": (lambda value, limit: value >= limit, "must be at least {:g}"),
    "lt": (lambda value, limit: value < limit, "must be less than {:g}"),
    "le": (lambda value, limit: value <= limit, "must be at most {:g}"),
    "min_length": (lambda value, limit: len(value) >= limit, "needs at least {0} {1}"),
    "max_length": (lambda value, limit: len(value) <= limit, "takes at most {0} {1}"),
    "pattern": (lambda value, form: re.search(form, value) is not None, "must match {}"),
}


class BeforeValidator(NamedTuple):
    """Within ``Annotated``: a function of the given value; it may raise ValueError."""

    function: Callable[[Any], Any]


class AfterValidator(NamedTuple):
    """Within ``Annotated``: a function of the converted value; it may raise ValueError."""

    function: Callable[[Any], Any]


def called(function: Callable[..., Any], *values: Any) -> Any:
    """Return the result of a validator; its ValueError becomes a problem."""
    try:
        return function(*values)
    except ValidationError:
        raise
    except ValueError as error:
        raise ValidationError([Problem((), str(error))]) from error


def _converted(function: Callable[[Any], Any], value: Any, given: Any) -> Any:
    return called(function, value)


def check_of(kind: Any) -> Check:
    """Return the check of an annotation."""
    origin, parts = get_origin(kind), get_args(kind)
    if origin is Annotated:
        return annotated(*parts)
    if origin in (Union, types.UnionType):
        return partial(
            _union,
            checks=[check_of(p) for p in parts if p is not type(None)],
            null=type(None) in parts,
        )
    if origin is Literal:
        return partial(_literal, choices=parts)
    if origin is dict:
        return partial(_dict, of_key=check_of(parts[0]), of_value=check_of(parts[1]))
    if origin is list:
        return partial(_list, check=check_of(parts[0]))
    if origin is tuple:
        return partial(
            _tuple, checks=[check_of(p) for p in parts if p is not ...], any_length=parts[-1] is ...
        )
    if hasattr(kind, "model_validate"):
        check: Check = kind.model_validate
        return check
    if isinstance(kind, type) and issubclass(kind, enum.Enum):
        return partial(_enum, kind=kind)
    return _SIMPLE[kind]


def annotated(kind: Any, *marks: Any) -> Check:
    """Return the check of an annotation with limits and validators."""
    check = check_of(kind)
    before, after = list[Callable[[Any], Any]](), list[Callable[[Any, Any], Any]]()
    for mark in marks:
        if isinstance(mark, BeforeValidator):
            before.append(mark.function)
        elif isinstance(mark, AfterValidator):
            after.append(partial(_converted, mark.function))
        elif mark.discriminator is not None:
            key = mark.discriminator
            check = partial(_tagged, key=key, models=_by_tag(kind, key))
        elif mark.limits or not mark.allow_inf_nan:
            after.append(mark.restrict)

    def validated(given: Any, strict: bool) -> Any:
        for convert in before:
            given = called(convert, given)
        value = check(given, strict)
        for restrict in after:
            value = restrict(value, given)
        return value

    return validated if before or after else check


def _by_tag(kind: Any, key: str) -> dict[Any, Any]:
    """Return the models of a union by the values of a key."""
    models = [m for part in get_args(kind) for m in (get_args(part) or (part,))]
    return {tag: m for m in models for tag in get_args(m.model_fields[key].annotation)}


def _tagged(value: Any, strict: bool, key: str, models: dict[Any, Any]) -> Any:
    if isinstance(value, tuple(set(models.values()))):
        return value
    if not isinstance(value, Mapping):
        refuse("must be keys and values", value)
    if key not in value:
        refuse(f"needs the key {key}")
    tag = value[key]
    if not isinstance(tag, str) or tag not in models:
        refuse(f"{key} must be one of {', '.join(map(str, models))}, not {tag}")
    return models[tag].model_validate(value, strict)


def _union(value: Any, strict: bool, checks: list[Check], null: bool) -> Any:
    """Return the value by the first member that it fits exactly, or else that converts it."""
    if null and value is None:
        return None
    problems: list[Problem] = []
    for is_exact in (True,) if strict else (True, False):
        problems.clear()
        for check in checks:
            try:
                return check(value, is_exact)
            except ValidationError as error:
                problems += error.problems
    raise ValidationError(problems)


def _any(value: Any, strict: bool) -> Any:
    return value


def _float(value: Any, strict: bool) -> float:
    if isinstance(value, float):
        return value
    if not isinstance(value, (bool, complex)) and not (strict and not isinstance(value, int)):
        try:
            return float(value)
        except (TypeError, ValueError, OverflowError):
            pass
    refuse("must be a number", value)


def _int(value: Any, strict: bool) -> int:
    if isinstance(value, int) and not isinstance(value, bool):
        return value
    if not strict and not isinstance(value, bool):
        text = (
            value.partition(".")[0] if isinstance(value, str) and _WHOLE.fullmatch(value) else value
        )
        try:
            number = int(text)
            if isinstance(value, str) or number == value:
                return number
        except (TypeError, ValueError, OverflowError):
            pass
    refuse("must be a whole number", value)


def _bool(value: Any, strict: bool) -> bool:
    if isinstance(value, bool):
        return value
    word = str(value).lower()
    if not strict and isinstance(value, (str, int)) and word in _TRUE | _FALSE:
        return word in _TRUE
    refuse("must be true or false", value)


def _str(value: Any, strict: bool) -> str:
    is_text = isinstance(value, str) and not isinstance(value, enum.Enum)
    if not is_text or (not value.isascii() and any("\ud800" <= c <= "\udfff" for c in value)):
        refuse("must be text", value)
    return str(value)


def _path(value: Any, strict: bool) -> Path:
    return value if isinstance(value, Path) else Path(_str(value, strict))


def _none(value: Any, strict: bool) -> None:
    if value is not None:
        refuse("must be absent", value)


def _literal(value: Any, strict: bool, choices: tuple[Any, ...]) -> Any:
    for choice in choices:
        if type(choice) is type(value) and choice == value:
            return choice
    *others, last = map(str, choices)
    refuse(f"must be {', '.join(others)} or {last}" if others else f"must be {last}", value)


def _enum(value: Any, strict: bool, kind: type[enum.Enum]) -> Any:
    try:
        return kind(value)
    except ValueError:
        return _literal(value, strict, tuple(member.value for member in kind))


def _each(parts: Iterable[tuple[Any, Check, Any]], strict: bool) -> list[Any]:
    """Return the checked parts of a value, given as places, checks and values."""
    made, problems = [], list[Problem]()
    for place, check, value in parts:
        try:
            made.append(check(value, strict))
        except ValidationError as error:
            problems += error.at(place)
    if problems:
        raise ValidationError(problems)
    return made


def _list(value: Any, strict: bool, check: Check) -> list[Any]:
    if not isinstance(value, (list, tuple, set, frozenset)):
        refuse("must be a list", value)
    return _each(((k, check, part) for k, part in enumerate(value)), strict)


def _tuple(value: Any, strict: bool, checks: list[Check], any_length: bool) -> tuple[Any, ...]:
    if any_length:
        return tuple(_list(value, strict, checks[0]))
    values = _list(value, strict, _any)
    if len(values) > len(checks):
        refuse(f"takes at most {len(checks)} values")
    absent = [Problem((k,), "is required") for k in range(len(values), len(checks))]
    if absent:
        raise ValidationError(absent)
    return tuple(_each(zip(range(len(checks)), checks, values, strict=True), strict))


def _dict(value: Any, strict: bool, of_key: Check, of_value: Check) -> dict[Any, Any]:
    if not isinstance(value, Mapping):
        refuse("must be keys and values", value)
    names = _each(((k, of_key, k) for k in value), strict)
    return dict(
        zip(names, _each(((k, of_value, v) for k, v in value.items()), strict), strict=True)
    )


_SIMPLE: dict[Any, Check] = {
    Any: _any,
    float: _float,
    int: _int,
    bool: _bool,
    str: _str,
    Path: _path,
    type(None): _none,
    None: _none,
}
