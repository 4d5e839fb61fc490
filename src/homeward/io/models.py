"""Settings models: classes whose annotated fields are checked and converted when they are made.

The subset of pydantic 2 that homeward uses, so that robots need neither its compiled part nor its
version: Ubuntu 24.04 and Debian 12 have pydantic 1, which ignores limits inside annotations.
"""

from __future__ import annotations

import enum
import inspect
import json
import math
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self, TypeVar, get_origin

from homeward.io.checks import (
    REQUIRED,
    FieldInfo,
    Problem,
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
    _private: ClassVar[dict[str, Any]] = {}
    _validators: ClassVar[tuple[str, ...]] = ()

    def __init__(self, **values: Any) -> None:
        made = type(self).model_validate(values)
        self.__dict__.update(made.__dict__)

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        bases = [base for base in reversed(cls.__mro__[1:]) if issubclass(base, Strict)]
        cls.model_fields = {n: field for base in bases for n, field in base.model_fields.items()}
        cls._private = {n: default for base in bases for n, default in base._private.items()}
        frame = sys._getframe(1)
        names = {**vars(sys.modules[cls.__module__]), **frame.f_locals}
        for name, words in inspect.get_annotations(cls).items():
            kind = eval(words, names) if isinstance(words, str) else words  # the class's own source
            if kind is ClassVar or get_origin(kind) is ClassVar:
                continue
            given = cls.__dict__.get(name, REQUIRED)
            if name in cls.__dict__:
                delattr(cls, name)
            if name.startswith("_"):
                cls._private[name] = given
                continue
            field = given if isinstance(given, FieldInfo) else FieldInfo(given)
            marks = kind.__metadata__ if get_origin(kind) is Annotated else ()
            field.alias = next((m.alias for m in marks if isinstance(m, FieldInfo)), field.alias)
            field.annotation, field.check = kind, annotated(kind, field)
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
            key = field.alias or name
            if key not in values:
                made[name] = field.make_default()
                if made[name] is REQUIRED:
                    problems.append(Problem((key,), "is required"))
                continue
            try:
                made[name] = field.check(values[key], strict)
            except ValidationError as error:
                problems += error.at(key)
        known = tuple(field.alias or name for name, field in cls.model_fields.items())
        problems += (
            Problem((k,), "unknown key", known=known or ("none",)) for k in values if k not in known
        )
        if problems:
            raise ValidationError(problems)
        model = cls._of(made, {n for n, f in cls.model_fields.items() if (f.alias or n) in values})
        for validate in cls._marked("after"):
            model = called(validate, model)
        return model

    @classmethod
    def _of(cls, values: dict[str, Any], given: set[str]) -> Self:
        model = object.__new__(cls)
        model.__dict__.update(values, model_fields_set=given, **cls._private)
        return model

    @classmethod
    def _marked(cls, mode: str) -> Iterator[Callable[..., Any]]:
        return (m for m in (getattr(cls, n) for n in cls._validators) if m.validates == mode)

    def model_copy(self, *, update: Mapping[str, Any] | None = None) -> Self:
        """Return a copy with other values, which are not checked."""
        update = update or {}
        values = {name: self.__dict__[name] for name in type(self).model_fields} | dict(update)
        model = self._of(values, self.model_fields_set | set(update))
        model.__dict__.update({name: self.__dict__[name] for name in self._private})
        return model

    def model_dump(
        self,
        *,
        mode: Literal["python", "json"] = "python",
        include: Iterable[str] | None = None,
        exclude: Iterable[str] = (),
        exclude_unset: bool = False,
        exclude_none: bool = False,
        by_alias: bool = False,
    ) -> dict[str, Any]:
        """Return the fields, also those of inner models, as a dictionary; for JSON, plain ones."""
        names = type(self).model_fields if include is None else include
        options = {
            "exclude_unset": exclude_unset,
            "exclude_none": exclude_none,
            "by_alias": by_alias,
        }
        return {
            (by_alias and field.alias) or name: _dumped(getattr(self, name), mode, options)
            for name, field in type(self).model_fields.items()
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
        if name not in self._private:
            raise AttributeError(f"{type(self).__name__} cannot be changed; use model_copy")
        super().__setattr__(name, value)

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
