"""Settings models in YAML and messages in JSON: reading, writing, and reports of errors."""

from __future__ import annotations

import inspect
import json
import math
from collections.abc import Iterator
from difflib import SequenceMatcher
from functools import cache, cached_property
from pathlib import Path
from typing import Any, TypeVar

import yaml

from homeward.errors import InputError
from homeward.io.checks import ANY, Problem, ValidationError, kind_of
from homeward.io.models import Strict, jsonable, keys, meanings
from homeward.io.naming import listing
from homeward.io.reading import read_small
from homeward.io.table import quoted

MAX_VALUES = 50_000
"""Maximum number of keys and values, aliases expanded; this number takes seconds to parse."""
MAX_DEPTH = 50
"""Maximum nesting depth."""
TOO_DEEP = f"nested more than {MAX_DEPTH} levels deep"
MAX_DIGITS = 100
"""Maximum length of a number [characters]."""
MAX_INTEGER = 2**63
"""Limit of whole numbers, as in arrays and files."""
_PLAIN = ("null", "bool", "int", "float", "str", "seq", "map")


def parse_yaml(text: bytes | str, path: Path | None, typed: bool) -> Any:
    """Return the mappings, lists and texts of YAML; if `typed`, also numbers, booleans and null.

    Bytes are UTF-8; errors name `path`. Typed YAML reads 1:30 as 90. `InputError` where it is not
    YAML, or exceeds the limits of settings.
    """
    try:
        # Both loaders construct plain values only.
        return yaml.load(text, Loader=_Plain if typed else _Text)
    except yaml.MarkedYAMLError as error:
        row = None if error.problem_mark is None else error.problem_mark.line + 1
        what = "" if isinstance(error, _Refused) else "not YAML: "
        raise InputError(f"{what}{error.problem}", path, row) from error
    except (yaml.YAMLError, UnicodeError) as error:
        raise InputError(f"not YAML: {' '.join(str(error).split())}", path) from error
    except (ValueError, LookupError, TypeError, AttributeError, RecursionError) as error:
        # A value that does not fit its tag, as in ``!!int x``.
        raise InputError("not YAML: a value does not fit its tag", path) from error


class _Refused(yaml.MarkedYAMLError):
    """Valid YAML that settings do not allow."""

    def __init__(self, problem: str, node: Any = None) -> None:
        super().__init__(problem=problem, problem_mark=None if node is None else node.start_mark)


class _Bounded:
    """Limits the number and depth of values while they are parsed, aliases expanded."""

    values = depth = deepest = 0

    def compose_node(self, parent: Any, index: Any) -> Any:
        """Return the next node of the text."""
        event: Any = self.peek_event()  # type: ignore[attr-defined]
        before, above = self.values, self.deepest
        self.values, self.depth = before + 1, self.depth + 1
        self.deepest = self.depth
        self._require_few()
        node = super().compose_node(parent, index)  # type: ignore[misc]
        if isinstance(event, yaml.AliasEvent):
            # The node of a ring of aliases is not complete yet.
            size, height = self.sizes.get(node, (0, MAX_DEPTH))
            self.values, self.deepest = before + size, self.depth + height
            self._require_few(event)
        else:
            self.sizes[node] = self.values - before, self.deepest - self.depth
            if isinstance(node, yaml.ScalarNode):
                _check_scalar(node)
            elif isinstance(node, yaml.MappingNode):
                _refuse_duplicate_keys(node)
        self.depth, self.deepest = self.depth - 1, max(above, self.deepest)
        return node

    @cached_property
    def sizes(self) -> dict[yaml.Node, tuple[int, int]]:
        """Number of values and further depth of each complete node."""
        return {}

    def _require_few(self, alias: Any = None) -> None:
        if self.deepest > MAX_DEPTH:
            raise _Refused(TOO_DEEP, alias)
        if self.values > MAX_VALUES:
            expanded = "" if alias is None else ", aliases expanded"
            raise _Refused(f"more than {MAX_VALUES:,} values{expanded}", alias)


class _Text(_Bounded, yaml.BaseLoader):
    """Loads every value as text."""


class _Plain(_Bounded, yaml.SafeLoader):
    """Loads plain types only: no dates, sets or bytes."""

    yaml_constructors = {
        tag: make
        for tag, make in yaml.SafeLoader.yaml_constructors.items()
        if tag is None or tag.rpartition(":")[2] in _PLAIN
    }
    yaml_implicit_resolvers = {
        first: [(tag, form) for tag, form in forms if not tag.endswith(":timestamp")]
        for first, forms in yaml.SafeLoader.yaml_implicit_resolvers.items()
    }


def _whole(loader: Any, node: yaml.Node) -> int:
    value: int = loader.construct_yaml_int(node)
    if abs(value) >= MAX_INTEGER:
        raise _Refused("the number is too large", node)
    return value


_Plain.add_constructor("tag:yaml.org,2002:int", _whole)


def _refuse_duplicate_keys(mapping: yaml.MappingNode) -> None:
    """Refuse a duplicate key in a mapping: YAML libraries silently keep the last value."""
    first: dict[str, yaml.ScalarNode] = {}
    for key, _ in mapping.value:
        if isinstance(key, yaml.ScalarNode) and first.setdefault(key.value, key) is not key:
            row = first[key.value].start_mark.line + 1
            raise _Refused(f"key {key.value!r} is given twice, first in row {row}; keep one", key)


def _check_scalar(node: yaml.ScalarNode) -> None:
    is_number = node.tag.endswith((":int", ":float"))
    if is_number and len(node.value) > MAX_DIGITS:
        raise _Refused(f"a number of {len(node.value):,} characters", node)
    if any("\ud800" <= c <= "\udfff" for c in node.value):
        raise _Refused("an unpaired surrogate, which is not valid text", node)


Model = TypeVar("Model", bound=Strict)
MAX_SETTINGS_BYTES = 2**20
"""Maximum size of a settings file [byte]; hand-written ones have thousands."""


def read_settings(path: Path, model: type[Model]) -> Model:
    """Read a settings model from a YAML file in UTF-8; a key without a value counts as absent.

    `InputError` where the file is not YAML, or has an unknown key or a value out of range.
    """
    return parse_settings(_read(path), model, path)


def parse_settings(text: bytes | str, model: type[Model], path: Path) -> Model:
    """Parse the text of a settings model as `read_settings` does; errors name `path`."""
    # Values stay text: the model converts them.
    known = {head for key in keys(model) for head in _heads(key.name)}
    tree = _without_absent(parse_yaml(text, path, typed=False), known)
    if not isinstance(tree, dict):
        raise InputError("not a mapping of keys to values", path, advice="write KEY: VALUE lines")
    sections = {k: _without_absent(v, known, f"{k}.") for k, v in tree.items()}
    return validated(model, sections, path)


def read_tree(path: Path) -> dict[str, Any]:
    """Read a YAML file of keys and values, for settings that are checked later."""
    tree = parse_yaml(_read(path), path, typed=True)
    if not isinstance(tree, dict):
        raise InputError("not a mapping of keys to values", path)
    return tree


def validated(model: type[Model], values: Any, file: Path | None = None) -> Model:
    """Return the settings model of `values`, or raise an `InputError` that names the key."""
    try:
        return model.model_validate(values)
    except ValidationError as error:
        raise refused(error, model, file) from error


def nested(values: dict[str, Any]) -> dict[str, Any]:
    """Return the tree of dotted keys: ``{"a": {"b": 1}}`` for ``{"a.b": 1}``.

    `InputError` where a key is both a value and the prefix of other keys.
    """
    tree: dict[str, Any] = {}
    for key, value in values.items():
        *heads, last = key_parts(key)
        branch = tree
        for head in heads:
            branch = branch.setdefault(head, {})
            if not isinstance(branch, dict):
                raise InputError(f"{head} already has a value", part=key)
        branch[last] = value
    return tree


def key_parts(key: str) -> list[str]:
    """Return the parts of a dotted key, outermost first; `InputError` if there are too many."""
    parts = key.split(".")
    if len(parts) > MAX_DEPTH:
        raise InputError(f"no key has more than {MAX_DEPTH} levels", part=quoted(key))
    return parts


def settings_yaml(settings: Strict) -> str:
    """Return the keys of a settings model that were set, as YAML; empty if there are none."""
    tree = settings.model_dump(mode="json", exclude_unset=True, exclude_none=True)
    return yaml.safe_dump(tree, sort_keys=False) if tree else ""


def commented_yaml(settings: Strict) -> str:
    """Return YAML with all keys of a settings model; those that were not set are commented out.

    Each line has the value of a key, its default or one of its examples, and its meaning with the
    unit. A line is valid as soon as its first # is removed.
    """
    return "".join(f"{line}\n" for line in _commented(settings, ""))


def _commented(settings: Strict, indent: str) -> Iterator[str]:
    words = meanings(type(settings))  # type: ignore[arg-type]
    for name, field in type(settings).model_fields.items():
        value = getattr(settings, name)
        is_section = isinstance(value, Strict) and field.default is not None
        text = words.get(name, "") or inspect.getdoc(value) if is_section else words.get(name, "")
        meaning = (
            f"  # {' '.join(str(text).split()).partition('. ')[0].rstrip('.')}" if text else ""
        )
        if is_section:
            yield f"{indent}{name}:{meaning}"
            yield from _commented(value, f"{indent}  ")
            continue
        is_set = name in settings.model_fields_set and value is not None
        for shown in [value] if is_set or not field.examples else field.examples:
            yaml_value = yaml.safe_dump([jsonable(shown)], default_flow_style=True, width=math.inf)
            yield f"{'' if is_set else '#'}{indent}{name}: {yaml_value.strip()[1:-1]}{meaning}"


def _read(path: Path) -> bytes:
    return read_small(path, MAX_SETTINGS_BYTES, "settings")


def _heads(key: str) -> list[str]:
    """Return the prefixes of a dotted key, and the key itself: ``a``, ``a.b``, ``a.b.c``."""
    parts = key.split(".")
    return [".".join(parts[: n + 1]) for n in range(len(parts))]


def _without_absent(value: Any, known: set[str], of: str = "") -> Any:
    """Drop the known keys without a value of a mapping at `of`; an absent mapping is empty."""
    if value in (None, "", "null", "~"):
        return {}
    if isinstance(value, dict):
        return {
            k: v
            for k, v in value.items()
            if v not in ("", "null", "~") or known.isdisjoint((f"{of}{k}", f"{of}{ANY}"))
        }
    return value


MAX_LENGTH = 60
"""Keys and values are cut to this length [characters]."""
MAX_KEYS = 30
"""Maximum number of keys that are listed instead of an unknown one."""
MIN_SIMILARITY = 0.7
"""Minimum similarity (`difflib`) of a key to the one that is suggested instead [1]."""
_kind_of = cache(kind_of)


def parsed(kind: Any, text: str | bytes) -> Any:
    """Return a message of an annotation parsed from JSON; `InputError` reports its first problem.

    Parsing is strict, as the schema is: a text or a boolean is no number.
    """
    try:
        return _kind_of(kind).check(json.loads(text), True)
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
        alike = [known for known in first.known if key in known.split("_")]
        if len(alike) > 1:
            advice = f"did you mean {' or '.join(alike)}?"
        elif similar in (None, key):  # the key of another member of a union
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


def closest(name: str, model: type[Strict]) -> str | None:
    """Return the key, or prefix of keys, that is most similar to a wrong one; None if none is."""

    def similarity(known: str) -> tuple[float, float]:
        last, known_last = (text.rpartition(".")[2] for text in (name, known))
        pairs = (last, known_last), (name, known)
        of_last, of_all = (SequenceMatcher(None, a, b).ratio() for a, b in pairs)
        return of_last, of_all

    heads = (head for key in keys(model) for head in _heads(key.name))
    best = max(heads, key=similarity, default="")
    if similarity(best)[0] < MIN_SIMILARITY:
        return None
    given, parts = name.split("."), best.split(".")
    if len(given) == len(parts):
        parts = [mine if part == ANY else part for mine, part in zip(given, parts, strict=True)]
    return ".".join(parts)


def _shown(text: str) -> str:
    plain = 0 < len(text) <= MAX_LENGTH and text.isprintable() and " " not in text
    return text if plain else quoted(text)


def _key(problem: Problem) -> str:
    return ".".join(map(str, problem.place))
