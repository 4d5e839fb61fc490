"""Kinds of values by annotation, such as ``Annotated[float, Field(gt=0)] | None``.

A kind is the one description of what an annotation allows: its check, its JSON schema, and the
models that it contains.
"""

from __future__ import annotations

import copy
import enum
import math
import re
import types
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
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
Schema = dict[str, Any]
_TRUE, _FALSE = ({"true", "yes", "on", "t", "y", "1"}, {"false", "no", "off", "f", "n", "0"})
_YAML_INFINITY = re.compile(r"\s*([+-]?)\.inf\s*", re.IGNORECASE)
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


class Limit(NamedTuple):
    """A limit of values."""

    fits: Callable[[Any, Any], bool]
    words: str
    schema: str
    """Its name in a JSON schema."""


LIMITS = {
    "gt": Limit(lambda v, limit: v > limit, "must be greater than {:g}", "exclusiveMinimum"),
    "ge": Limit(lambda v, limit: v >= limit, "must be at least {:g}", "minimum"),
    "lt": Limit(lambda v, limit: v < limit, "must be less than {:g}", "exclusiveMaximum"),
    "le": Limit(lambda v, limit: v <= limit, "must be at most {:g}", "maximum"),
    "min_length": Limit(lambda v, limit: len(v) >= limit, "needs at least {0} {1}", "min"),
    "max_length": Limit(lambda v, limit: len(v) <= limit, "takes at most {0} {1}", "max"),
    "pattern": Limit(lambda v, form: re.search(form, v) is not None, "must match {}", "pattern"),
}
_LENGTHS = {"string": "Length", "array": "Items", "object": "Properties"}


class FieldInfo:
    """Default, limits and examples of a field.

    `gt`, `ge`, `lt` and `le` limit numbers, `min_length` and `max_length` texts, lists and
    mappings; a text must match `pattern`. `discriminator` is the key that selects the model of a
    union.
    """

    kind: ValueKind
    """Of the annotation of the field, with these limits."""

    def __init__(
        self,
        default: Any = REQUIRED,
        *,
        examples: list[Any] | None = None,
        discriminator: str | None = None,
        allow_inf_nan: bool = True,
        **limits: Any,
    ) -> None:
        self.default, self.examples, self.discriminator = default, examples, discriminator
        self.allow_inf_nan, self.limits = allow_inf_nan, limits

    def make_default(self) -> Any:
        """Return the default, which no other instance shares; `REQUIRED` without one."""
        return copy.copy(self.default) if isinstance(self.default, dict) else self.default

    def restrict(self, value: Any, given: Any) -> Any:
        """Return a value within the limits; problems show it as it was given."""
        if isinstance(value, float) and not (self.allow_inf_nan or math.isfinite(value)):
            refuse("must be finite", given)
        for name, limit in self.limits.items():
            if not LIMITS[name].fits(value, limit):
                parts = "characters" if isinstance(value, str) else "values"
                refuse(LIMITS[name].words.format(limit, parts), given)
        return value

    def schema(self, schema: Schema) -> Schema:
        """Return the JSON schema of values with these limits."""
        ends = {name: _LENGTHS[schema["type"]] for name in self.limits if "length" in name}
        limits = self.limits.items()
        return schema | {LIMITS[name].schema + ends.get(name, ""): limit for name, limit in limits}


Field: Any = FieldInfo
"""`FieldInfo`, as the value of a field or within ``Annotated``."""


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


class ValueKind(NamedTuple):
    """What an annotation allows."""

    check: Check
    schema: Callable[[Schema], Schema]
    """Returns its JSON schema, and adds those of its models, by name, to the argument."""
    models: tuple[tuple[str, Any], ...] = ()
    """The models that it contains, each with the path to it: ``.``, or ``.*.`` in a container."""


ANY = "*"
"""Wildcard in a path, for a name or an index."""


def json_schema(annotation: Any) -> Schema:
    """Return the schema of an annotation; models are in its ``$defs``."""
    models: Schema = {}
    return {**kind_of(annotation).schema(models), "$defs": models}


def kind_of(annotation: Any) -> ValueKind:
    """Return the kind of an annotation."""
    origin, parts = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return annotated(*parts)
    if origin is Literal:
        schema = {"const": parts[0]} if len(parts) == 1 else {"enum": list(parts)}
        return ValueKind(partial(_literal, choices=parts), lambda _: schema)
    if origin is None and hasattr(annotation, "model_validate"):
        return ValueKind(
            annotation.model_validate, annotation.schema_reference, ((".", annotation),)
        )
    if isinstance(annotation, type) and issubclass(annotation, enum.Enum):
        choices = tuple(member.value for member in annotation)
        check = partial(_enum, kind=annotation, choices=choices)
        return ValueKind(check, lambda _: {"enum": list(choices)})
    if origin is None:
        return _SIMPLE[annotation]
    kinds = [kind_of(part) for part in parts if part is not ...]
    within = tuple(found for kind in kinds for found in kind.models)
    if origin in (Union, types.UnionType):
        checks = [kind.check for kind in kinds if kind is not _NONE]
        check = partial(_union, checks=checks, null=_NONE in kinds)
        return ValueKind(check, lambda models: {"anyOf": [k.schema(models) for k in kinds]}, within)
    within = tuple((f".{ANY}{path}", model) for path, model in within)
    if origin is dict:
        check = partial(_dict, of_key=kinds[0].check, of_value=kinds[1].check)
        of_value = kinds[1].schema
        return ValueKind(
            check,
            lambda models: {"type": "object", "additionalProperties": of_value(models)},
            within,
        )
    if origin is tuple and parts[-1] is not ...:
        check = partial(_tuple, checks=[kind.check for kind in kinds])
        return ValueKind(check, partial(_tuple_schema, kinds=kinds), within)
    check = partial(_list, check=kinds[0].check, made=origin)
    of_item = kinds[0].schema
    return ValueKind(check, lambda models: {"type": "array", "items": of_item(models)}, within)


def annotated(annotation: Any, *marks: Any) -> ValueKind:
    """Return the kind of an annotation with limits and validators."""
    check, schema, models = kind_of(annotation)
    before, after = list[Callable[[Any], Any]](), list[Callable[[Any, Any], Any]]()
    for mark in marks:
        if isinstance(mark, BeforeValidator):
            before.append(mark.function)
        elif isinstance(mark, AfterValidator):
            after.append(partial(_converted, mark.function))
        elif mark.discriminator is not None:
            check = partial(_tagged, key=mark.discriminator, models=_by_tag(mark, models))
        elif mark.limits or not mark.allow_inf_nan:
            after.append(mark.restrict)
            schema = partial(_limited, of=schema, mark=mark)

    def validated(given: Any, strict: bool) -> Any:
        for convert in before:
            given = called(convert, given)
        value = check(given, strict)
        for restrict in after:
            value = restrict(value, given)
        return value

    return ValueKind(validated if before or after else check, schema, models)


def _converted(function: Callable[[Any], Any], value: Any, given: Any) -> Any:
    return called(function, value)


def _limited(models: Schema, of: Callable[[Schema], Schema], mark: FieldInfo) -> Schema:
    return mark.schema(of(models))


def _by_tag(mark: FieldInfo, models: Iterable[tuple[str, Any]]) -> dict[str, Any]:
    """Return the models of a union by the values of the key that selects one."""
    fields = ((model, model.model_fields[mark.discriminator]) for _, model in models)
    tags = ((model, field.kind.schema({})) for model, field in fields)
    return {tag: model for model, one in tags for tag in one.get("enum") or [one["const"]]}


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
    problem = "must be a number"
    if not isinstance(value, (bool, complex)):
        infinite = _YAML_INFINITY.fullmatch(value) if isinstance(value, str) else None
        with suppress(TypeError, ValueError, OverflowError):
            number = float(value if infinite is None else f"{infinite[1]}inf")
            if not strict or isinstance(value, int):
                return number
            problem += " without quotes"
    refuse(problem, value)


def _int(value: Any, strict: bool) -> int:
    if isinstance(value, int) and not isinstance(value, bool):
        return value
    if not strict and not isinstance(value, bool):
        is_whole = isinstance(value, str) and _WHOLE.fullmatch(value)
        with suppress(TypeError, ValueError, OverflowError):
            number = int(value.partition(".")[0] if is_whole else value)
            if isinstance(value, str) or number == value:
                return number
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


def _enum(value: Any, strict: bool, kind: type[enum.Enum], choices: tuple[Any, ...]) -> Any:
    return value if isinstance(value, kind) else kind(_literal(value, strict, choices))


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


def _list(value: Any, strict: bool, check: Check, made: type[Any] = list) -> Any:
    if not isinstance(value, (list, tuple, set, frozenset)):
        refuse("must be a list", value)
    return made(_each(((k, check, part) for k, part in enumerate(value)), strict))


def _tuple(value: Any, strict: bool, checks: list[Check]) -> tuple[Any, ...]:
    values = _list(value, strict, _any)
    if len(values) > len(checks):
        refuse(f"takes at most {len(checks)} values")
    if len(values) < len(checks):
        absent = range(len(values), len(checks))
        raise ValidationError(Problem((k,), "is required") for k in absent)
    return tuple(_each(zip(range(len(checks)), checks, values, strict=True), strict))


def _tuple_schema(models: Schema, kinds: list[ValueKind]) -> Schema:
    items = [kind.schema(models) for kind in kinds]
    return {"type": "array", "prefixItems": items, "minItems": len(items), "items": False}


def _dict(value: Any, strict: bool, of_key: Check, of_value: Check) -> dict[Any, Any]:
    if not isinstance(value, Mapping):
        refuse("must be keys and values", value)
    names = _each(((k, of_key, k) for k in value), strict)
    values = _each(((k, of_value, v) for k, v in value.items()), strict)
    return dict(zip(names, values, strict=True))


def _plain(check: Check, **schema: str) -> ValueKind:
    return ValueKind(check, lambda _: dict(schema))


_NONE = _plain(_none, type="null")
_SIMPLE: dict[Any, ValueKind] = {
    Any: _plain(_any),
    float: _plain(_float, type="number"),
    int: _plain(_int, type="integer"),
    bool: _plain(_bool, type="boolean"),
    str: _plain(_str, type="string"),
    Path: _plain(_path, type="string"),
    type(None): _NONE,
    None: _NONE,
}
