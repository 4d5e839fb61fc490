"""Reading and writing of settings models as YAML."""

from __future__ import annotations

import inspect
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any, TypeVar

import yaml

from homeward.errors import InputError
from homeward.io.checks import ValidationError
from homeward.io.keys import Strict, meanings
from homeward.io.models import jsonable
from homeward.io.reading import read_small
from homeward.io.table import quoted
from homeward.io.validation_messages import refused

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
    """Limits the number and depth of nodes while they are parsed."""

    values = depth = 0

    def compose_node(self, parent: Any, index: Any) -> Any:
        """Return the next node of the text."""
        self.values += 1
        if self.values > MAX_VALUES:
            raise _Refused(f"more than {MAX_VALUES:,} values")
        if self.depth > MAX_DEPTH:
            raise _Refused(TOO_DEEP)
        self.depth += 1
        node = super().compose_node(parent, index)  # type: ignore[misc]
        self.depth -= 1
        return node

    def get_single_node(self) -> Any:
        """Return the root."""
        root = super().get_single_node()  # type: ignore[misc]
        if root is not None:
            _measure(root, {}, 0)
        return root


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


def _measure(node: Any, known: dict[Any, tuple[int, int]], depth: int) -> tuple[int, int]:
    """Return the number of values of a node, aliases expanded, and their depth."""
    if depth > MAX_DEPTH:  # as in a ring of aliases
        raise _Refused(TOO_DEEP, node)
    if isinstance(node, yaml.ScalarNode):
        _check_scalar(node)
        return 1, 1
    if node not in known:
        mapping = isinstance(node, yaml.MappingNode)
        parts = [part for pair in node.value for part in pair] if mapping else node.value
        if mapping:
            _refuse_duplicate_keys(node)
        found = [_measure(part, known, depth + 1) for part in parts]
        known[node] = 1 + sum(n for n, _ in found), 1 + max((d for _, d in found), default=0)
    size, height = known[node]
    if size > MAX_VALUES:
        raise _Refused(f"more than {MAX_VALUES:,} values, aliases expanded", node)
    if depth + height > MAX_DEPTH:
        raise _Refused(TOO_DEEP, node)
    return size, height


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
    tree = _without_absent(parse_yaml(text, path, typed=False))
    if not isinstance(tree, dict):
        raise InputError("not a mapping of keys to values", path, advice="write KEY: VALUE lines")
    sections = {k: _without_absent(v) for k, v in tree.items()}
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


def _without_absent(value: Any) -> Any:
    """Drop the keys without a value; an absent mapping is empty."""
    if value in (None, "", "null", "~"):
        return {}
    if isinstance(value, dict):
        return {k: v for k, v in value.items() if v not in ("", "null", "~")}
    return value
