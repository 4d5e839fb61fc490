"""Settings models from and to YAML."""

from __future__ import annotations

from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import ValidationError

from homeward.errors import InputError
from homeward.io.keys import Strict
from homeward.io.reading import read_small
from homeward.io.table import quoted
from homeward.io.validation_messages import complaint

MOST_VALUES = 50_000
"""Keys count, and an alias as all that it stands for. So many take seconds."""
DEEPEST = 50
"""Values within each other."""
TOO_DEEP = f"more than {DEEPEST} values within each other"
LONGEST_NUMBER = 100
"""Characters."""
LARGEST_WHOLE = 2**63
"""Whole numbers are smaller than that, as everywhere in arrays and in files."""
_PLAIN = ("null", "bool", "int", "float", "str", "seq", "map")


def parse_yaml(text: bytes | str, path: Path | None, typed: bool) -> Any:
    """Return the mappings, lists and texts of YAML or, if `typed`, also numbers, truths and null.

    Bytes are UTF-8; errors speak of `path`. Beware: typed YAML reads 1:30 as 90. `InputError` where
    it is not YAML, or more than settings ever are.
    """
    try:
        # The loaders make plain values alone.
        return yaml.load(text, Loader=_Plain if typed else _Text)
    except yaml.MarkedYAMLError as error:
        row = None if error.problem_mark is None else error.problem_mark.line + 1
        what = "" if isinstance(error, _Refused) else "not YAML: "
        raise InputError(f"{what}{error.problem}", path, row) from error
    except (yaml.YAMLError, UnicodeError) as error:
        raise InputError(f"not YAML: {' '.join(str(error).split())}", path) from error
    except (ValueError, LookupError, TypeError, AttributeError, RecursionError) as error:
        # What a tag announces and its value is not, as in ``!!int x``.
        raise InputError("not YAML: a value that is not what its tag says", path) from error


class _Refused(yaml.MarkedYAMLError):
    """YAML, but none that settings need."""

    def __init__(self, why: str, node: Any = None) -> None:
        super().__init__(problem=why, problem_mark=None if node is None else node.start_mark)


class _Bounded:
    """Counts what comes before anything is made of it."""

    values = depth = 0

    def compose_node(self, parent: Any, index: Any) -> Any:
        """Return the next node of the text."""
        self.values += 1
        if self.values > MOST_VALUES:
            raise _Refused(f"more than {MOST_VALUES:,} values")
        if self.depth > DEEPEST:
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
    """Leaves every value as text."""


class _Plain(_Bounded, yaml.SafeLoader):
    """Makes no dates, no sets, no bytes."""

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
    if abs(value) >= LARGEST_WHOLE:
        raise _Refused("too large a number", node)
    return value


_Plain.add_constructor("tag:yaml.org,2002:int", _whole)


def _measure(node: Any, known: dict[Any, tuple[int, int]], depth: int) -> tuple[int, int]:
    """Return how many values a node stands for, all aliases followed, and how deep they lie."""
    if depth > DEEPEST:  # as in a ring of aliases
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
    if size > MOST_VALUES:
        raise _Refused(f"more than {MOST_VALUES:,} values, aliases followed", node)
    if depth + height > DEEPEST:
        raise _Refused(TOO_DEEP, node)
    return size, height


def _refuse_duplicate_keys(mapping: yaml.MappingNode) -> None:
    """Refuse a key that stands twice in a mapping: YAML libraries keep the last value silently."""
    first: dict[str, yaml.ScalarNode] = {}
    for key, _ in mapping.value:
        if isinstance(key, yaml.ScalarNode) and first.setdefault(key.value, key) is not key:
            row = first[key.value].start_mark.line + 1
            raise _Refused(f"key {key.value!r} is given twice, first in row {row}; keep one", key)


def _check_scalar(node: yaml.ScalarNode) -> None:
    number = node.tag.endswith((":int", ":float"))
    if number and len(node.value) > LONGEST_NUMBER:
        raise _Refused(f"a number of {len(node.value):,} characters", node)
    if any("\ud800" <= c <= "\udfff" for c in node.value):
        raise _Refused("half a character, which no file can hold", node)


Model = TypeVar("Model", bound=Strict)
LARGEST_SETTINGS = 2**20
"""Of a file [byte]: what a person writes has thousands."""


def read_settings(path: Path, model: type[Model]) -> Model:
    """Read a settings model from a YAML file, UTF-8; a key without a value counts as absent.

    Its keys are at most two levels deep. `InputError` where the file is not YAML, has a key that
    the model does not know, or a value out of range.
    """
    return parse_settings(_read(path), model, path)


def parse_settings(text: bytes | str, model: type[Model], path: Path) -> Model:
    """Parse the text of a settings model; as `read_settings`, errors speak of `path`."""
    # As text alone: the model knows the types.
    tree = _without_absent(parse_yaml(text, path, typed=False))
    if not isinstance(tree, dict):
        raise InputError("not a mapping of keys to values", path)
    sections = {k: _without_absent(v) for k, v in tree.items()}
    return validated(model, sections, path)


def read_tree(path: Path) -> dict[str, Any]:
    """Read a YAML file of keys to values of any kind, for settings that are checked later."""
    tree = parse_yaml(_read(path), path, typed=True)
    if not isinstance(tree, dict):
        raise InputError("not a mapping of keys to values", path)
    return tree


def validated(model: type[Model], values: Any, file: Path | None = None) -> Model:
    """Return a settings model of `values`, or raise an `InputError` that names the key."""
    try:
        return model.model_validate(values)
    except ValidationError as error:
        raise InputError(complaint(error, model, values), file) from error


def nested(values: dict[str, Any]) -> dict[str, Any]:
    """Return values whose keys have dots as a tree: ``{"a.b": 1}`` as ``{"a": {"b": 1}}``.

    `InputError` where a key is used both as a value and as the head of others.
    """
    tree: dict[str, Any] = {}
    for key, value in values.items():
        *heads, last = key_parts(key)
        branch = tree
        for head in heads:
            branch = branch.setdefault(head, {})
            if not isinstance(branch, dict):
                raise InputError(f"{key}: {head} is a value already")
        branch[last] = value
    return tree


def key_parts(key: str) -> list[str]:
    """Return the keys that one in dots names, from the outermost on; `InputError` if too many."""
    parts = key.split(".")
    if len(parts) > DEEPEST:
        raise InputError(f"{quoted(key)}: no key lies so deep")
    return parts


def settings_yaml(settings: Strict) -> str:
    """Return a settings model as YAML text, with only the keys that were set; empty if none."""
    tree = settings.model_dump(mode="json", exclude_unset=True, exclude_none=True)
    return yaml.safe_dump(tree, sort_keys=False) if tree else ""


def _read(path: Path) -> bytes:
    return read_small(path, LARGEST_SETTINGS, "settings")


def _without_absent(value: Any) -> Any:
    """Drop the keys that have no value; no value at all is an empty mapping."""
    if value in (None, "", "null", "~"):
        return {}
    if isinstance(value, dict):
        return {k: v for k, v in value.items() if v not in ("", "null", "~")}
    return value
