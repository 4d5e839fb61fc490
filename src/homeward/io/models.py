"""Settings models: classes whose annotated fields are checked and converted when they are made.

The subset of pydantic 2 that homeward uses, so that robots need neither its compiled part nor its
version: Ubuntu 24.04 and Debian 12 have pydantic 1, which ignores limits inside annotations. The
docstring below a field is the meaning of its key.
"""

from __future__ import annotations

import ast
import enum
import inspect
import json
import math
import sys
import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from types import MappingProxyType
from typing import Any, ClassVar, Literal, Self, TypeVar, get_origin

from homeward.io.checks import (
    ANY,
    REQUIRED,
    FieldInfo,
    Problem,
    Schema,
    ValidationError,
    annotated,
    called,
    refuse,
)

Method = TypeVar("Method")


def model_validator(*, mode: Literal["before", "after"]) -> Callable[[Method], Method]:
    """Mark a class method of the given values (before), or a method of the finished model."""

    def mark(method: Method) -> Method:
        _function(method).validates = mode
        return method

    return mark


def _function(method: Any) -> Any:
    return getattr(method, "__func__", method)


class Strict:
    """A settings model that refuses unknown keys and cannot be changed."""

    model_fields: ClassVar[dict[str, FieldInfo]] = {}
    """The fields by name."""
    model_fields_set: set[str]
    """Names of the fields that were given."""
    _validators: ClassVar[tuple[str, ...]] = ()

    def __init__(self, **values: Any) -> None:
        made = type(self).model_validate(values)
        self.__dict__.update(made.__dict__)

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        bases = [base for base in reversed(cls.__mro__[1:]) if issubclass(base, Strict)]
        cls.model_fields = {n: field for base in bases for n, field in base.model_fields.items()}
        frame = sys._getframe(1)
        names = {**vars(sys.modules[cls.__module__]), **frame.f_locals}
        for name, words in inspect.get_annotations(cls).items():
            kind = eval(words, names) if isinstance(words, str) else words  # the class's own source
            if kind is ClassVar or get_origin(kind) is ClassVar:
                continue
            given = cls.__dict__.get(name, REQUIRED)
            if name in cls.__dict__:
                delattr(cls, name)
            field = given if isinstance(given, FieldInfo) else FieldInfo(given)
            field.kind = annotated(kind, field)
            cls.model_fields[name] = field
        inherited = [name for base in bases for name in base._validators]
        marked = [n for n, m in vars(cls).items() if hasattr(_function(m), "validates")]
        cls._validators = tuple(dict.fromkeys([*inherited, *marked]))

    @classmethod
    def model_validate(cls, values: Any, strict: bool = False) -> Self:
        """Return the model of a mapping; a model is returned as it is; else `ValidationError`."""
        if isinstance(values, cls):
            return values
        for validate in cls._marked("before"):
            values = called(validate, values)
        if not isinstance(values, Mapping):
            refuse("must be keys and values", values)
        problems: list[Problem] = []
        made: dict[str, Any] = {}
        for name, field in cls.model_fields.items():
            if name not in values:
                made[name] = field.make_default()
                if made[name] is REQUIRED:
                    problems.append(Problem((name,), "is required"))
                continue
            try:
                made[name] = field.kind.check(values[name], strict)
            except ValidationError as error:
                problems += error.at(name)
        known = tuple(cls.model_fields) or ("none",)
        unknown = [key for key in values if key not in cls.model_fields]
        problems += (Problem((key,), "unknown key", known=known) for key in unknown)
        if problems:
            raise ValidationError(problems)
        model = cls._of(made, made.keys() & values.keys())
        for validate in cls._marked("after"):
            model = called(validate, model)
        return model

    @classmethod
    def schema_reference(cls, models: Schema) -> Schema:
        """Return a reference to the JSON schema of the model, which is added to `models`."""
        if cls.__name__ not in models:
            models[cls.__name__] = {}
            words = meanings(cls)  # type: ignore[arg-type]
            properties: Schema = {}
            for name, field in cls.model_fields.items():
                properties[name] = field.kind.schema(models)
                if name in words:
                    properties[name] = properties[name] | {"description": words[name]}
                if field.default is not REQUIRED:
                    properties[name] = properties[name] | {"default": jsonable(field.default)}
            required = [n for n, field in cls.model_fields.items() if field.default is REQUIRED]
            models[cls.__name__] |= {
                "type": "object",
                "description": inspect.getdoc(cls),
                "properties": properties,
                "required": required,
                "additionalProperties": False,
            }
        return {"$ref": f"#/$defs/{cls.__name__}"}

    @classmethod
    def _of(cls, values: dict[str, Any], given: set[str]) -> Self:
        model = object.__new__(cls)
        model.__dict__.update(values, model_fields_set=given)
        return model

    @classmethod
    def _marked(cls, mode: str) -> Iterator[Callable[..., Any]]:
        return (m for m in (getattr(cls, n) for n in cls._validators) if m.validates == mode)

    def model_copy(self, *, update: Mapping[str, Any] | None = None) -> Self:
        """Return a copy with other values, which are not checked."""
        update = update or {}
        return self._of(vars(self) | dict(update), self.model_fields_set | set(update))

    def model_dump(
        self,
        *,
        mode: Literal["python", "json"] = "python",
        include: Iterable[str] | None = None,
        exclude: Iterable[str] = (),
        exclude_unset: bool = False,
        exclude_none: bool = False,
    ) -> dict[str, Any]:
        """Return the fields, also those of inner models, as a dictionary; for JSON, plain ones."""
        names = type(self).model_fields if include is None else include
        options = {"exclude_unset": exclude_unset, "exclude_none": exclude_none}
        return {
            name: _dumped(getattr(self, name), mode, options)
            for name in type(self).model_fields
            if name in names
            and name not in exclude
            and (name in self.model_fields_set or not exclude_unset)
            and not (exclude_none and getattr(self, name) is None)
        }

    def model_dump_json(self, *, exclude_none: bool = False) -> str:
        """Return the fields as JSON; numbers that are not finite become null."""
        tree = self.model_dump(mode="json", exclude_none=exclude_none)
        write = partial(json.dumps, separators=(",", ":"), ensure_ascii=False, allow_nan=False)
        try:
            return write(tree)
        except ValueError:
            return write(_finite(tree))

    def __iter__(self) -> Iterator[tuple[str, Any]]:
        return ((name, getattr(self, name)) for name in type(self).model_fields)

    def __setattr__(self, name: str, value: Any) -> None:
        raise AttributeError(f"{type(self).__name__} cannot be changed; use model_copy")

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Strict) and type(self) is type(other) and list(self) == list(other)

    def __hash__(self) -> int:
        return hash((type(self), *(value for _, value in self)))

    def __repr__(self) -> str:
        return f"{type(self).__name__}({', '.join(f'{n}={v!r}' for n, v in self)})"


def jsonable(value: Any) -> Any:
    """Return a value of settings as numbers, texts, lists and dictionaries."""
    return _dumped(value, "json", {})


def _dumped(value: Any, mode: Literal["python", "json"], options: Mapping[str, Any]) -> Any:
    inner = partial(_dumped, mode=mode, options=options)
    if isinstance(value, Strict):
        return value.model_dump(mode=mode, **options)
    if isinstance(value, dict):
        return {inner(k): inner(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        items = map(inner, value)
        return tuple(items) if isinstance(value, tuple) and mode == "python" else list(items)
    if mode == "json" and isinstance(value, enum.Enum):
        return value.value
    return str(value) if mode == "json" and isinstance(value, Path) else value


def _finite(tree: Any) -> Any:
    if isinstance(tree, dict):
        return {k: _finite(v) for k, v in tree.items()}
    if isinstance(tree, list):
        return [_finite(v) for v in tree]
    return None if isinstance(tree, float) and not math.isfinite(tree) else tree


@dataclass(frozen=True)
class Key:
    """A key of a settings model."""

    name: str
    """Name with dots between the levels."""
    default: str
    """Default as YAML; "needed" for a required key."""
    meaning: str
    """Description with its unit; empty where the name is sufficient."""


def keys(
    model: type[Strict],
    head: str = "",
    given: Any = None,
    elsewhere: Mapping[type[Strict], str] = MappingProxyType({}),
) -> Iterator[Key]:
    """Yield the keys of a model and of nested models, each name once, with the prefix `head`.

    Defaults are the values of `given` where that is an instance of the model. The keys of models
    that are listed `elsewhere`, by the place that lists them, are one key each: all of them are
    nested in `model` or its bases. A key of a base with another default here is listed.
    """
    known, seen = meanings(model), set[str]()  # type: ignore[arg-type]
    of_bases = set[Key]()
    for base in model.__bases__:
        if base in elsewhere:
            yield Key(f"{head}{ANY}", "", f"as {elsewhere[base]}")
            of_bases |= {*keys(base, head), *keys(base, head, None, elsewhere)}
    for name, field in model.model_fields.items():
        own = getattr(given, name) if isinstance(given, model) else field.make_default()
        full = head + name
        inner = list[Key]()
        for path, part in field.kind.models:
            if part in elsewhere:
                inner.append(Key(f"{full}{path}{ANY}", "", f"as {elsewhere[part]}"))
            else:
                inner += keys(part, full + path, own, elsewhere)
        for key in inner or [Key(full, _as_yaml(own), known.get(name, ""))]:
            if key.name not in seen and key not in of_bases:
                seen.add(key.name)
                yield key


def _as_yaml(value: Any) -> str:
    if value is REQUIRED:
        return "needed"
    return str(jsonable(value)).replace("'", "") if value is not None else "null"


@cache
def meanings(model: type[Strict]) -> dict[str, str]:
    """Return the docstrings below the fields of a model and of its base models."""
    found: dict[str, str] = {}
    for kind in reversed([k for k in model.__mro__ if issubclass(k, Strict)]):
        (body,) = ast.parse(textwrap.dedent(inspect.getsource(kind))).body
        assert isinstance(body, ast.ClassDef)
        for field, words in zip(body.body, body.body[1:], strict=False):
            match field, words:
                case (
                    ast.AnnAssign(target=ast.Name(id=name)),
                    ast.Expr(value=ast.Constant(value=str(text))),
                ):
                    found[name] = " ".join(text.split())
    return found
