"""The keys of a settings model: names, defaults and meanings."""

from __future__ import annotations

import ast
import inspect
import textwrap
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from difflib import SequenceMatcher
from functools import cache
from types import MappingProxyType
from typing import Any, get_args, get_origin

from homeward.io.checks import REQUIRED
from homeward.io.models import Strict as Strict
from homeward.io.models import jsonable

ANY = "*"
"""Wildcard in a key, for a name or an index."""
MIN_SIMILARITY = 0.7
"""Minimum similarity (`difflib`) of a key to the one that is suggested instead [1]."""


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
        full = head + (field.alias or name)
        inner = list[Key]()
        for path, part in _models(field.annotation):
            if part in elsewhere:
                inner.append(Key(f"{full}{path}{ANY}", "", f"as {elsewhere[part]}"))
            else:
                inner += keys(part, full + path, own, elsewhere)
        for key in inner or [Key(full, _as_yaml(own), known.get(name, ""))]:
            if key.name not in seen and key not in of_bases:
                seen.add(key.name)
                yield key


def closest(name: str, model: type[Strict]) -> str | None:
    """Return the key, or prefix of keys, that is most similar to a wrong one; None if none is."""

    def similarity(known: str) -> tuple[float, float]:
        last, known_last = (text.rpartition(".")[2] for text in (name, known))
        pairs = (last, known_last), (name, known)
        of_last, of_all = (SequenceMatcher(None, a, b).ratio() for a, b in pairs)
        return of_last, of_all

    known = (key.name.split(".") for key in keys(model))
    heads = (".".join(k[: n + 1]) for k in known for n in range(len(k)))
    best = max(heads, key=similarity, default="")
    if similarity(best)[0] < MIN_SIMILARITY:
        return None
    given, parts = name.split("."), best.split(".")
    if len(given) == len(parts):
        parts = [mine if part == ANY else part for mine, part in zip(given, parts, strict=True)]
    return ".".join(parts)


def _models(annotation: Any, path: str = ".") -> Iterator[tuple[str, type[Strict]]]:
    """Yield the models in the annotation of a field, and the path to each."""
    if isinstance(annotation, type) and issubclass(annotation, Strict):
        yield path, annotation
    several = get_origin(annotation) in (tuple, dict, list)
    for part in get_args(annotation):
        yield from _models(part, f".{ANY}." if several else path)


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
