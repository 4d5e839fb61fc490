"""The base of all settings models, and their keys: names, defaults and meanings."""

from __future__ import annotations

import ast
import inspect
import textwrap
from collections.abc import Iterator
from dataclasses import dataclass
from difflib import SequenceMatcher
from functools import cache
from typing import Any, get_args, get_origin

from pydantic import BaseModel, ConfigDict
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined, to_jsonable_python


class Strict(BaseModel):
    """A settings model that refuses unknown keys and cannot be changed."""

    model_config = ConfigDict(extra="forbid", frozen=True)


ANY = "*"
"""Stands in a key for the name or the number of one of several."""
LIKE = 0.7
"""Names are taken for each other from this similarity on (`difflib`) [1]."""


@dataclass(frozen=True)
class Key:
    """One thing that can be set."""

    name: str
    """With dots between the levels."""
    default: str
    """As YAML; "needed" where there is none."""
    meaning: str
    """With its unit; empty where its name says all."""


def keys(model: type[Strict], head: str = "", given: Any = None) -> Iterator[Key]:
    """Yield the keys of a model, of models within it too, each name once, with `head` before it.

    Defaults are the values of `given` where that is such a model, else those of the fields.
    """
    meanings, seen = _meanings(model), set[str]()
    for name, field in model.model_fields.items():
        own = getattr(given, name) if isinstance(given, model) else _default(field)
        full = head + (field.alias or name)
        inner = [k for way, m in _models(field.annotation) for k in keys(m, full + way, own)]
        for key in inner or [Key(full, _as_yaml(own), meanings.get(name, ""))]:
            if key.name not in seen:
                seen.add(key.name)
                yield key


def closest(name: str, model: type[Strict]) -> str | None:
    """Return the key, or head of keys, that a wrong one was meant to be; None: none is like it."""

    def likeness(known: str) -> tuple[float, float]:
        last, known_last = (text.rpartition(".")[2] for text in (name, known))
        pairs = (last, known_last), (name, known)
        near, near_in_all = (SequenceMatcher(None, a, b).ratio() for a, b in pairs)
        return near, near_in_all

    known = (key.name.split(".") for key in keys(model))
    heads = (".".join(k[: n + 1]) for k in known for n in range(len(k)))
    best = max(heads, key=likeness, default="")
    if likeness(best)[0] < LIKE:
        return None
    given, parts = name.split("."), best.split(".")
    if len(given) == len(parts):
        parts = [mine if part == ANY else part for mine, part in zip(given, parts, strict=True)]
    return ".".join(parts)


def _models(annotation: Any, way: str = ".") -> Iterator[tuple[str, type[Strict]]]:
    """Yield the models among which the value of a field is one, or holds some, and how to it."""
    if isinstance(annotation, type) and issubclass(annotation, Strict):
        yield way, annotation
    several = get_origin(annotation) in (tuple, dict, list)
    for part in get_args(annotation):
        yield from _models(part, f".{ANY}." if several else way)


def _default(field: FieldInfo) -> Any:
    if field.is_required():
        return PydanticUndefined
    return field.get_default(call_default_factory=True, validated_data={})


def _as_yaml(value: Any) -> str:
    if value is PydanticUndefined:
        return "needed"
    return str(to_jsonable_python(value)).replace("'", "") if value is not None else "null"


@cache
def _meanings(model: type[Strict]) -> dict[str, str]:
    """Return the docstrings below the fields of a model and of those that it extends."""
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
